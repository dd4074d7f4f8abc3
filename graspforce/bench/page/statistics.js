// Decoded runs, filters and statistics. The formulas are those of graspforce.bench.statistics.
const data = window.pageData; // the loader of the page sets it
const FIELDS = ["solver", "settings", "units", "pyramid", "warm", "hasStart", "reported", "case", "verdict", "residual", "seconds", "iterations"];
const runs = data.runs[0].map((_, row) => Object.fromEntries(FIELDS.map((name, i) => [name, data.runs[i][row]]))).map((run, index) => ({
  ...run,
  index,
  solver: data.solvers[run.solver].name,
  case: data.cases[run.case],
  verdict: data.verdicts[run.verdict],
}));
const SOLVED = new Set(["certified", "correct, without multipliers", "correct, inexact multipliers"]);
const isCorrect = (run) => SOLVED.has(run.verdict) || run.verdict === "unproven";
// A warm task without a previous solution, such as the first case of a sequence, starts as a cold one; it counts as neither.
const startOf = (run) => (!run.warm ? "cold" : run.hasStart ? "warm" : "no previous solution");
const SIZES = { all: () => true, "up to 5": (n) => n <= 5, "6 to 20": (n) => n > 5 && n <= 20, "above 20": (n) => n > 20 };

function select(filter) {
  return runs.filter((run) =>
    run.settings === filter.settings && run.units === filter.units && (run.pyramid ? "pyramids" : "exact") === filter.cones &&
    startOf(run) === filter.start && SIZES[filter.size](run.case.contacts) &&
    (filter.collection === "all" || run.case.name.startsWith(filter.collection + "/")));
}

function groupBy(list, key) {
  const groups = new Map();
  for (const item of list) {
    if (!groups.has(key(item))) groups.set(key(item), []);
    groups.get(key(item)).push(item);
  }
  return groups;
}

function commonCases(chosen) {
  const bySolver = groupBy(chosen.filter((run) => run.verdict !== "unsupported"), (run) => run.solver);
  const solvers = new Set(chosen.map((run) => run.solver));
  const counts = new Map();
  for (const own of bySolver.values()) for (const run of own) counts.set(run.case.name, (counts.get(run.case.name) || 0) + 1);
  return new Set([...counts].filter(([, count]) => count === solvers.size).map(([name]) => name));
}

function median(values) {
  const sorted = [...values].sort((a, b) => a - b);
  const half = sorted.length >> 1;
  return sorted.length % 2 ? sorted[half] : (sorted[half - 1] + sorted[half]) / 2;
}

function shiftedMean(times, shift = 1e-4) {
  return times.length ? Math.exp(times.reduce((sum, t) => sum + Math.log(t + shift), 0) / times.length) - shift : NaN;
}

function summary(chosen) {
  const common = commonCases(chosen);
  return [...groupBy(chosen, (run) => run.solver)].map(([solver, own]) => {
    const count = (verdict) => own.filter((run) => run.verdict === verdict).length;
    const feasible = own.filter((run) => run.case.feasible[+run.pyramid] && common.has(run.case.name));
    const solved = own.filter((run) => run.case.feasible[+run.pyramid] && run.seconds !== null).map((run) => run.seconds);
    const correct = own.filter(isCorrect).length;
    return {
      solver, reported: own.some((run) => run.reported), cases: own.length, correct, share: correct / own.length, wrong: count("wrong"), inexact: count("inexact"),
      none: count("no answer"), stopped: count("timed out") + count("crashed"), unsupported: count("unsupported"),
      mean: shiftedMean(feasible.map((run) => (run.seconds === null ? data.limit : run.seconds))),
      median: solved.length ? median(solved) : NaN,
    };
  });
}

function profile(chosen, onlyCommon) {
  const common = commonCases(chosen);
  const feasible = chosen.filter((run) => run.case.feasible[+run.pyramid] && (!onlyCommon || common.has(run.case.name)));
  const byCase = groupBy(feasible, (run) => run.case.name);
  const curves = new Map([...new Set(chosen.map((run) => run.solver))].map((solver) => [solver, []]));
  for (const own of byCase.values()) {
    const best = Math.min(...own.filter((run) => run.seconds !== null).map((run) => run.seconds));
    for (const run of own) if (run.seconds !== null) curves.get(run.solver).push(run.seconds / best);
  }
  for (const ratios of curves.values()) ratios.sort((a, b) => a - b);
  return { curves, count: byCase.size };
}
