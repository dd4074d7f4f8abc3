// The views of the page, chosen by the address after #.
const main = document.getElementById("main");
function time(s) {
  if (s === null || !Number.isFinite(s)) return "–";
  if (s >= 0.9995) return `${s.toPrecision(3)} s`;
  return s >= 1e-3 ? `${(1e3 * s).toPrecision(3)} ms` : `${(1e6 * s).toFixed(0)} µs`;
}

const markedTime = (s, reported) => time(s) + (reported && time(s) !== "–" ? " (reported)" : "");
const percent = (share) => `${(100 * share).toFixed(1)} %`;
const link = (kind, name) => `<a href="#/${kind}/${escapeText(name)}">${escapeText(name)}</a>`;
const unique = (list) => [...new Set(list)];
const state = { sort: {}, filter: null };

// columns: [title, value for sorting, cell as HTML]
function table(id, columns, rows) {
  const order = state.sort[id] || { column: 0, down: false };
  const value = columns[order.column][1];
  const sorted = [...rows].sort((a, b) => {
    const [x, y] = [value(a), value(b)].map((v) => (Number.isNaN(v) ? Infinity : v));
    return (x < y ? -1 : x > y ? 1 : 0) * (order.down ? -1 : 1);
  });
  const head = columns.map(([title], i) => {
    const kind = i === order.column ? (order.down ? "descending" : "ascending") : "none";
    const arrow = i === order.column ? (order.down ? " ▾" : " ▴") : "";
    return `<th scope="col" aria-sort="${kind}"><button type="button" data-table="${id}" data-column="${i}">${title}${arrow}</button></th>`;
  });
  const body = sorted.map((row) => `<tr>${columns.map(([, , cell]) => `<td>${cell(row)}</td>`).join("")}</tr>`);
  return `<div class="scroll"><table id="${id}"><thead><tr>${head.join("")}</tr></thead><tbody>${body.join("")}</tbody></table></div>`;
}

// The options of a filter that some run has, in a fixed order.
function present(options, key) {
  const found = new Set(runs.map(key));
  return options.filter((one) => found.has(one));
}

function choices() {
  const collections = unique(data.cases.map((one) => one.name.split("/")[0])).sort();
  return {
    cones: present(["exact", "pyramids"], (run) => (run.pyramid ? "pyramids" : "exact")),
    settings: present(["default", "high", "low", "float32"], (run) => run.settings),
    units: present(["scaled", "si"], (run) => run.units),
    start: present(["cold", "warm"], startOf),
    collection: ["all", ...collections],
    size: Object.keys(SIZES),
  };
}

function filterForm(given) {
  const names = { cones: "cones", settings: "accuracy", units: "units", start: "start", collection: "collection", size: "contacts" };
  const fields = Object.entries(given).map(([name, options]) => {
    const items = options.map((one) => `<option${one === state.filter[name] ? " selected" : ""}>${escapeText(one)}</option>`);
    return `<label>${names[name]}<select name="${name}">${items.join("")}</select></label>`;
  });
  return `<form class="filters" aria-label="Filters">${fields.join("")}</form>`;
}

function overview() {
  const given = choices();
  state.filter = state.filter || Object.fromEntries(Object.entries(given).map(([name, options]) => [name, options[0]]));
  const chosen = select(state.filter);
  const number = (name) => [(row) => row[name], (row) => row[name]];
  const columns = [
    ["solver", (row) => row.solver, (row) => link("solver", row.solver)],
    ["cases", ...number("cases")], ["correct", ...number("correct")],
    ["correct, %", (row) => row.share, (row) => percent(row.share)],
    ["wrong", (row) => row.wrong, (row) => (row.wrong ? `<span class="bad">${row.wrong}</span>` : 0)],
    ["inexact", ...number("inexact")], ["no answer", ...number("none")], ["stopped", ...number("stopped")],
    ["unsupported", ...number("unsupported")],
    ["mean", (row) => row.mean, (row) => markedTime(row.mean, row.reported)],
    ["median", (row) => row.median, (row) => markedTime(row.median, row.reported)],
  ];
  const reported = "(Reported): time of the solver's author, not measured in this race.";
  const note = "Mean: shifted geometric mean over the feasible cases that all solvers support; a case that is not solved counts as " +
    `${data.limit} s. Median: over the cases that the solver solved. Stopped: timed out or crashed. ${runs.some((run) => run.reported) ? reported : ""}`;
  const body = chosen.length ? table("solvers", columns, summary(chosen)) + `<p class="soft">${note}</p><div class="charts">` +
    profileChart(chosen, false) + profileChart(chosen, true) + sizeChart(chosen) + "</div>" : "<p>No runs with these filters.</p>";
  return `<h2>Results</h2>${filterForm(given)}${body}`;
}

function caseList() {
  const byCase = groupBy(runs, (run) => run.case.name);
  const rows = data.cases.map((one) => {
    const own = byCase.get(one.name) || [];
    return { ...one, runs: own.length, correct: own.filter(isCorrect).length / (own.length || 1), wrong: own.filter((r) => r.verdict === "wrong").length };
  });
  return "<h2>Cases</h2>" + table("cases", [
    ["case", (row) => row.name, (row) => link("case", row.name)], ["contacts", (row) => row.contacts, (row) => row.contacts],
    ["objective", (row) => row.objective, (row) => row.objective],
    ["answer", (row) => +row.feasible[0], (row) => (row.feasible[0] ? "optimum" : "infeasible")], ["runs", (row) => row.runs, (row) => row.runs],
    ["correct", (row) => row.correct, (row) => percent(row.correct)], ["wrong", (row) => row.wrong, (row) => row.wrong],
  ], rows);
}

const RUN_COLUMNS = [
  ["accuracy", (run) => run.settings, (run) => run.settings], ["units", (run) => run.units, (run) => run.units],
  ["cones", (run) => +run.pyramid, (run) => (run.pyramid ? "pyramids" : "exact")], ["start", startOf, startOf],
  ["verdict", (run) => run.verdict, (run) => (run.verdict === "wrong" ? '<span class="bad">wrong</span>' : run.verdict)],
  ["residual", (run) => run.residual ?? NaN, (run) => (run.residual === null ? "–" : run.residual.toExponential(1))],
  ["time", (run) => run.seconds ?? NaN, (run) => markedTime(run.seconds, run.reported)], ["iterations", (run) => run.iterations, (run) => run.iterations],
  ["details", (run) => run.index, (run) => `<button type="button" data-run="${run.index}" aria-expanded="false">Reproduce</button>`],
];

function caseView(name) {
  const one = data.cases.find((each) => each.name === name);
  if (!one) return `<h2>No case ${escapeText(name)}</h2>`;
  const own = runs.filter((run) => run.case === one);
  const vector = (values) => `(${values.join(", ")})`;
  const motors = one.limits === null ? "no hand" : `${one.limits} torque limits`;
  const shown = shellLine("graspforce", "problems", ...folderWords, "show", name);
  const more = one.positions.length < one.contacts ? ` The picture shows ${one.positions.length} of ${one.contacts} contacts.` : "";
  return `<h2>${escapeText(name)}</h2><p>${escapeText(one.source)}</p><p>${one.contacts} contacts, objective ${one.objective}, ` +
    `${motors}, ${one.feasible[0] ? `optimum ${one.optimum}` : "infeasible"}. Tags: ${one.tags.join(", ")}.${more}</p>` +
    `<p>Load that the contacts supply: force ${vector(one.load.slice(0, 3))} N, moment ${vector(one.load.slice(3))} N·m about the origin.</p>` +
    `${contactPicture(one)}<h3>Problem as JSON</h3><pre>${escapeText(shown)}</pre>` +
    `<h3>Solve</h3><pre>${escapeText(shown)} | graspforce solve -</pre><h3>Runs</h3>` +
    table("runs", [["solver", (run) => run.solver, (run) => link("solver", run.solver)], ...RUN_COLUMNS], own);
}

function solverView(name) {
  const one = data.solvers.find((each) => each.name === name);
  if (!one) return `<h2>No solver ${escapeText(name)}</h2>`;
  const own = runs.filter((run) => run.solver === name);
  const counts = [...groupBy(own, (run) => run.verdict)].map(([verdict, list]) => `${verdict}: ${list.length}`).join("; ");
  const wrong = own.filter((run) => run.verdict === "wrong");
  const columns = [["case", (run) => run.case.name, (run) => link("case", run.case.name)], ...RUN_COLUMNS];
  const found = wrong.length ? table("wrong", columns, wrong) : "<p>None.</p>";
  return `<h2>${escapeText(name)} ${escapeText(one.version)}</h2><p>${own.length} runs. ${escapeText(counts)}.</p>` +
    `<h3>Wrong answers: ${wrong.length}</h3>${found}`;
}

function solverList() {
  const rows = data.solvers.map((one) => ({ ...one, wrong: runs.filter((run) => run.solver === one.name && run.verdict === "wrong").length }));
  return "<h2>Solvers</h2>" + table("list", [
    ["solver", (row) => row.name, (row) => link("solver", row.name)], ["version", (row) => row.version, (row) => escapeText(row.version)],
    ["wrong answers", (row) => row.wrong, (row) => row.wrong],
  ], rows);
}

function history() {
  const columns = ["solver", "version", "graspforce", "data", "group", "cases", "limit", "correct", "wrong", "mean"];
  const text = (row, name) => (name === "limit" && row.limit != null ? `${row.limit} s` : escapeText(row[name] ?? "–"));
  const cell = (name) => (row) => (name === "mean" ? markedTime(row.mean ?? NaN, row.reported) : text(row, name));
  return "<h2>History by version</h2>" + table("history", columns.map((name) => [name, (row) => row[name] ?? NaN, cell(name)]), data.history);
}

function show() {
  const [, page, ...rest] = decodeURIComponent(location.hash).split("/");
  const views = { cases: caseList, solvers: solverList, history, case: () => caseView(rest.join("/")), solver: () => solverView(rest.join("/")) };
  main.innerHTML = (views[page] || overview)();
}

function setTheme(theme) {
  document.documentElement.dataset.theme = theme;
  document.getElementById("theme").textContent = theme === "dark" ? "Light theme" : "Dark theme";
}

// Show or hide the row with the reproduction of a run.
function toggleReproduction(button) {
  const row = button.closest("tr");
  const isOpen = button.getAttribute("aria-expanded") === "true";
  button.setAttribute("aria-expanded", String(!isOpen));
  if (isOpen) return row.nextElementSibling.remove();
  row.insertAdjacentHTML("afterend", `<tr class="detail"><td colspan="${row.cells.length}">${reproduction(runs[+button.dataset.run])}</td></tr>`);
}

main.addEventListener("click", (event) => {
  const opener = event.target.closest("button[data-run]");
  if (opener) toggleReproduction(opener);
  const button = event.target.closest("button[data-table]");
  if (!button) return;
  const { table: id, column } = button.dataset;
  const old = state.sort[id] || { column: 0, down: false };
  state.sort[id] = { column: +column, down: old.column === +column ? !old.down : false };
  show();
  main.querySelector(`button[data-table="${id}"][data-column="${column}"]`).focus();
});
main.addEventListener("change", (event) => {
  state.filter[event.target.name] = event.target.value;
  show();
  main.querySelector(`select[name="${event.target.name}"]`).focus();
});
document.getElementById("theme").addEventListener("click", () => setTheme(document.documentElement.dataset.theme === "dark" ? "light" : "dark"));
document.getElementById("facts").textContent = `${data.facts} Command: ${data.command}`;
window.addEventListener("hashchange", () => { show(); main.focus(); });
setTheme(matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
show();
