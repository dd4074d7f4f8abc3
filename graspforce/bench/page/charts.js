// Charts as SVG: performance profiles, time against size, and the contacts of a case.
const COLOURS = ["#2f7fc1", "#d1495b", "#2e933c", "#c2850f", "#8e63b5", "#14969c", "#a5794a", "#e0705a", "#6b78a8", "#7d9a34"];
const DASHES = ["", "7 3", "2 3"];
const solverStyle = (solver) => {
  const i = data.solvers.findIndex((one) => one.name === solver);
  return `stroke="${COLOURS[i % COLOURS.length]}" stroke-dasharray="${DASHES[Math.floor(i / COLOURS.length) % 3]}"`;
};
const escapeText = (text) => String(text).replace(/[&<>"]/g, (c) => ({ "&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;" })[c]);

function logAxis(low, high, pixels, start) {
  const span = Math.log10(high / low) || 1;
  return (value) => start + (Math.log10(value / low) / span) * pixels;
}

function textWidth(text) {
  const context = document.createElement("canvas").getContext("2d");
  context.font = "12px system-ui, sans-serif"; // as page.css sets it
  return context.measureText(text).width;
}

function chart(title, lines, x, y, xTicks, yTicks, xLabel, yLabel) {
  const step = Math.max(96, 34 + Math.max(...lines.map(([name]) => textWidth(name)))); // a name with its line
  const columns = Math.max(1, Math.floor(500 / step));
  const legend = lines.map(([name, d], i) => {
    const [left, top] = [60 + (i % columns) * step, 352 + Math.floor(i / columns) * 18];
    return `<path d="${d}" fill="none" stroke-width="2" ${solverStyle(name)}/>` +
      `<path d="M${left} ${top}h22" stroke-width="2.5" ${solverStyle(name)}/><text x="${left + 26}" y="${top + 4}">${escapeText(name)}</text>`;
  });
  const grid = [
    ...xTicks.map((t) => `<path class="grid" d="M${x(t[0])} 20V290"/><text x="${x(t[0])}" y="306" text-anchor="middle">${t[1]}</text>`),
    ...yTicks.map((t) => `<path class="grid" d="M60 ${y(t[0])}H540"/><text x="54" y="${y(t[0]) + 4}" text-anchor="end">${t[1]}</text>`),
  ];
  const height = 350 + 18 * Math.ceil(lines.length / columns);
  return `<figure><h3>${escapeText(title)}</h3><svg viewBox="0 0 560 ${height}" role="img" aria-label="${escapeText(title)}">${grid.join("")}` +
    `<text x="300" y="326" text-anchor="middle">${xLabel}</text>` +
    `<text x="60" y="11">${yLabel}</text>${legend.join("")}</svg></figure>`;
}

function profileChart(chosen, onlyCommon) {
  const { curves, count } = profile(chosen, onlyCommon);
  const x = logAxis(1, 1000, 480, 60);
  const y = (share) => 290 - 2.7 * share;
  const lines = [...curves].map(([solver, ratios]) => {
    let d = "";
    ratios.filter((ratio) => ratio <= 1000).forEach((ratio, i) => {
      const share = (100 * (i + 1)) / count;
      d += d ? `H${x(ratio).toFixed(1)}V${y(share).toFixed(1)}` : `M${x(ratio).toFixed(1)} ${y(0)}V${y(share).toFixed(1)}`;
    });
    return [solver, d ? `${d}H540` : "M60 290H540"];
  });
  const missing = chosen.some((run) => run.warm) ? "unsupported or no warm start" : "unsupported";
  const which = onlyCommon ? `the ${count} feasible cases that all support` : `all ${count} feasible cases; ${missing} counts as not solved`;
  const ticks = [1, 10, 100, 1000].map((t) => [t, t]);
  return chart(`Profile, ${which}`, lines, x, y, ticks, [0, 25, 50, 75, 100].map((t) => [t, t]), "time / shortest time on the case", "cases solved, %");
}

function timeLabel(seconds) {
  const [scale, unit] = seconds >= 0.999 ? [1, "s"] : seconds >= 0.999e-3 ? [1e3, "ms"] : [1e6, "µs"];
  return `${+(scale * seconds).toPrecision(1)} ${unit}`;
}

function sizeChart(chosen) {
  const solved = chosen.filter((run) => run.seconds !== null && run.case.feasible[+run.pyramid]);
  if (!solved.length) return "";
  const sizes = solved.map((run) => run.case.contacts);
  const times = solved.map((run) => run.seconds);
  const [least, most] = [Math.min(...sizes), Math.max(...sizes)];
  const [low, high] = [10 ** Math.floor(Math.log10(Math.min(...times))), 10 ** Math.ceil(Math.log10(Math.max(...times)))];
  const x = logAxis(least, Math.max(most, least + 1), 480, 60);
  const y = (seconds) => 310 - logAxis(low, high, 270, 20)(seconds);
  const lines = [...groupBy(solved, (run) => run.solver)].map(([solver, own]) => {
    const points = [...groupBy(own, (run) => run.case.contacts)].sort((a, b) => a[0] - b[0]);
    return [solver, "M" + points.map(([size, some]) => `${x(size).toFixed(1)} ${y(median(some.map((r) => r.seconds))).toFixed(1)}`).join("L")];
  });
  const xTicks = [2, 3, 5, 10, 20, 50, 100, 200, 500, 1000].filter((t) => t >= least && t <= most).map((t) => [t, t]);
  const yTicks = [];
  for (let t = low; t <= 1.01 * high; t *= 10) yTicks.push([t, timeLabel(t)]);
  return chart("Time against size", lines, x, y, xTicks, yTicks, "contacts", "median time of solved cases");
}

// Contacts in an oblique view: a point, the inward normal, and the edges of the friction cone in the plane of the view.
function contactPicture(one) {
  const view = (v) => [v[0] * 0.866 - v[1] * 0.866, -v[2] + 0.5 * (v[0] + v[1])];
  const points = one.positions.map(view);
  const radius = Math.max(1e-9, ...points.map((p) => Math.hypot(...p)));
  const place = (p) => [180 + (115 * p[0]) / radius, 180 + (115 * p[1]) / radius];
  const marks = one.positions.map((_, i) => {
    const [a, b] = place(points[i]);
    const n = view(one.normals[i]);
    const angle = Math.atan(one.frictions[i]);
    const turned = (s) => [n[0] * Math.cos(s) - n[1] * Math.sin(s), n[0] * Math.sin(s) + n[1] * Math.cos(s)];
    const [left, right] = [turned(angle), turned(-angle)];
    return `<path d="M${a + 46 * left[0]} ${b + 46 * left[1]}L${a} ${b}L${a + 46 * right[0]} ${b + 46 * right[1]}" fill="${COLOURS[0]}" ` +
      `fill-opacity="0.25" stroke="${COLOURS[0]}"/><path d="M${a} ${b}l${50 * n[0]} ${50 * n[1]}" stroke="currentColor"/>` +
      `<circle cx="${a}" cy="${b}" r="4" fill="${COLOURS[1]}"/>`;
  });
  const axes = [["x", [1, 0, 0]], ["y", [0, 1, 0]], ["z", [0, 0, 1]]].map(([name, v]) => {
    const p = view(v).map((c) => 28 * c);
    return `<path d="M40 320l${p[0]} ${p[1]}" stroke="currentColor"/><text x="${42 + 1.3 * p[0]}" y="${322 + 1.3 * p[1]}">${name}</text>`;
  });
  const label = `Contacts of ${one.name}: points, inward normals and friction cones`;
  return `<svg viewBox="0 0 360 360" width="360" role="img" aria-label="${escapeText(label)}">${axes.join("")}${marks.join("")}</svg>`;
}
