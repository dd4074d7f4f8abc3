// Reproduction of a run: the command, and a Python file that does the same task and prints its verdict and residual.
const shellWord = (text) => (/^[\w@%+=:,./-]+$/.test(text) ? text : `'${text.replace(/'/g, `'"'"'`)}'`);
const shellLine = (...words) => words.map(shellWord).join(" ");
const pythonText = (text) => JSON.stringify(text);
const pythonFlag = (flag) => (flag ? "True" : "False");
const folderWords = data.folder ? ["--dir", data.folder] : [];
const answersFile = (run) => data.answers[run.solver] ?? "FILE";

function runCommand(run) {
  if (run.reported) return shellLine("graspforce", "bench", "--answers", answersFile(run), ...folderWords, "--json");
  const task = ["--case", run.case.name, "--solver", run.solver, "--settings", run.settings, "--units", run.units];
  return shellLine("graspforce", "bench", ...task, ...folderWords, "--time-limit", String(data.limit), "--json");
}

// The finding of a run in words. A wrong answer without a residual has no reason in the data; the words cover both reasons.
function finding(run) {
  const residual = run.residual === null ? "" : `residual ${run.residual.toExponential(1)}`;
  if (run.verdict !== "wrong") return `Verdict: ${run.verdict}${residual && `, ${residual}`}.`;
  if (run.residual === null) {
    const incomplete = "reported solved with missing or non-finite numbers";
    return `Wrong: ${run.case.feasible[+run.pyramid] ? `reported infeasible although feasible, or ${incomplete}` : incomplete}.`;
  }
  const [most, load] = [data.wrong_residual[run.settings], data.wrong_load[run.settings]];
  const missing = load !== undefined && run.residual < most ? ` that miss more than ${load.toExponential(0)} of the load` : "";
  return `Wrong: reported solved; forces with ${residual}${missing}.`;
}

function fileName(run) {
  const words = [run.solver, run.case.name.replaceAll("/", "--"), run.settings, run.units, run.pyramid ? "pyramids" : "exact"];
  return `${[...words, ...(run.warm ? ["warm"] : [])].join("_").replace(/[^\w.-]/g, "-")}.py`;
}

function pythonFile(run) {
  const start = run.warm ? (run.hasStart ? "warm start" : "warm task without previous solution") : "cold start";
  const kind = [`${run.settings} settings`, run.units === "si" ? "SI units" : "scaled units", run.pyramid ? "pyramids" : "exact cones", start];
  const head = `"""${run.solver} on ${run.case.name}: ${kind.join(", ")}.\n\n${finding(run)}\n"""\n\n`;
  const library = data.folder ? "from graspforce import problems\n" : "";
  const choice = data.folder ? `problems.choose_folder(${pythonText(data.folder)})` : "";
  return head + (run.reported ? answersProgram(run, library, choice) : taskProgram(run, library, choice));
}

function taskProgram(run, library, choice) {
  const words = [run.solver, run.settings, run.units].map(pythonText).join(", ");
  const task = `RaceTask(${words}, ${pythonFlag(run.pyramid)}, ${pythonFlag(run.warm)}, ${pythonText(run.case.name)})`;
  return `${library}from graspforce.bench.outcome import RaceTask\nfrom graspforce.bench.worker import Worker\n\n` +
    `if __name__ == "__main__":\n${choice && `    ${choice}\n`}    task = ${task}\n    with Worker(limit=${data.limit}) as worker:\n` +
    `        judgement = worker.run(task).judgement\n    print(judgement.verdict.value, judgement.residual)\n`;
}

function answersProgram(run, library, choice) {
  const key = `(${pythonText(run.case.name)}, ${pythonFlag(run.pyramid)}, ${pythonText(run.settings)})`;
  return `from pathlib import Path\n\n${library}from graspforce.bench.answers import judge_answers, load_answers\n\n${choice && `${choice}\n`}` +
    `answers = load_answers(Path(${pythonText(answersFile(run))}))\n` +
    `own = [one for one in answers if (one.case, one.pyramid, one.settings) == ${key}]\n` +
    `for outcome in judge_answers(${pythonText(run.solver)}, own):\n    print(outcome.judgement.verdict.value, outcome.judgement.residual)\n`;
}

function reproduction(run) {
  const text = pythonFile(run);
  const record = `"case": "${run.case.name}", "pyramid": ${Boolean(run.pyramid)}, "warm": ${Boolean(run.warm)}`;
  return `<p>${escapeText(finding(run))}</p><pre class="command">${escapeText(runCommand(run))}</pre>` +
    `<p class="soft">This run is the record with ${escapeText(record)}. The same run in Python:</p><pre class="file">${escapeText(text)}</pre>` +
    `<a download="${escapeText(fileName(run))}" href="data:text/x-python;charset=utf-8,${encodeURIComponent(text)}">Download ${escapeText(fileName(run))}</a>`;
}
