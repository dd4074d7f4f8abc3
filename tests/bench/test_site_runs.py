"""Tests of the runs on the page of a race: commands and files that reproduce them, their words, warm starts, reported times."""

from __future__ import annotations

import base64
import gzip
import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from support.headless_browser import CHROMIUM, HeadlessBrowser

from graspforce import problems
from graspforce.bench.judge import Judgement, Verdict
from graspforce.bench.outcome import RaceOutcome, RaceTask
from graspforce.bench.readme_table import readme_table
from graspforce.bench.site import save_history, write_site
from graspforce.cli import main
from graspforce.problems.library import FOLDER_VARIABLE

CONDITIONS = {"machine": "a processor", "cores": 2, "python": "3.12", "limit": 0.5, "versions": {"graspforce": "0.3.0"}}
CASE, INFEASIBLE, MOTORS = "ring/3-force", "opposed/capped", "opposed/torque-limit"


def outcome(
    task: RaceTask, verdict: Verdict, residual: float | None, cold: float | None = None, reported: bool = False
) -> RaceOutcome:
    """Return an outcome with a time if it is solved."""
    judgement = Judgement(verdict, residual)
    seconds = 1e-4 if judgement.is_solved else None
    return RaceOutcome(task, 3, task.case == CASE, judgement, seconds, cold, 5, time_is_reported=reported)


PLAIN = RaceTask("clarabel", "default", "scaled", False, False, CASE)
OUTCOMES = (
    outcome(PLAIN, Verdict.CERTIFIED, 1e-9),
    outcome(replace(PLAIN, pyramid=True), Verdict.WRONG, None),
    outcome(replace(PLAIN, case=INFEASIBLE), Verdict.WRONG, None),
    outcome(replace(PLAIN, case=MOTORS), Verdict.WRONG, 0.25),
    outcome(replace(PLAIN, settings="high"), Verdict.WRONG, 5e-7),
    outcome(replace(PLAIN, settings="high", units="si"), Verdict.WRONG, 0.25),
    outcome(replace(PLAIN, warm=True), Verdict.CERTIFIED, 1e-9),  # first of a sequence
    outcome(replace(PLAIN, warm=True, pyramid=True), Verdict.CERTIFIED, 1e-9, cold=2e-4),
    outcome(replace(PLAIN, warm=True, case=MOTORS), Verdict.CERTIFIED, 1e-9, cold=2e-4),
    outcome(replace(PLAIN, solver="mine"), Verdict.CERTIFIED, 1e-9, reported=True),
)
REPORTED = len(OUTCOMES) - 1


def opened(page: Path) -> HeadlessBrowser:
    """Return a browser that shows a page."""
    if CHROMIUM is None:
        pytest.skip("needs Chromium")
    pytest.importorskip("websockets")
    browser = HeadlessBrowser(f"file://{page}", 1200, 900)
    browser.wait(lambda: browser.evaluate("!!document.querySelector('main h2')"))
    return browser


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[HeadlessBrowser]:
    shown = opened(write_site(tmp_path_factory.mktemp("site"), CONDITIONS, OUTCOMES, "graspforce bench"))
    try:
        yield shown
    finally:
        shown.close()


def page_data(page: Path) -> dict[str, Any]:
    """Return the data that a page holds."""
    found = re.search(r'id="data">([^<]*)<', page.read_text())
    assert found is not None
    return dict(json.loads(gzip.decompress(base64.b64decode(found[1]))))


def open_case(browser: HeadlessBrowser, name: str) -> str:
    """Open the page of a case, and return its text."""
    browser.evaluate(f"location.hash = {json.dumps(f'#/case/{name}')}")
    browser.wait(lambda: browser.evaluate("document.querySelector('main h2')?.innerText") == name)
    return browser.text()


def test_page_of_a_case_states_load_limits_and_objective(browser: HeadlessBrowser) -> None:
    for name in (CASE, MOTORS):
        problem, text = problems.load(name).problem, open_case(browser, name)
        found = re.search(r"force \(([^)]*)\) N, moment \(([^)]*)\) N·m", text)
        assert found is not None
        numbers = [float(word) for part in found.groups() for word in part.split(",")]
        assert numbers == pytest.approx(list(problem.w), rel=5e-3)
        assert f"objective {problem.objective.type}" in text
        hand = problem.actuation
        count = None if hand is None else sum(abs(value) < float("inf") for value in [*hand.lower, *hand.upper])
        assert ("no hand" if count is None else f"{count} torque limits") in text
        assert f"\ngraspforce problems show {name}\n" in text


def test_every_run_has_a_file_of_its_own_name_that_compiles(browser: HeadlessBrowser) -> None:
    names = browser.evaluate("runs.map(fileName)")
    assert len(set(names)) == len(OUTCOMES)
    assert all(re.fullmatch(r"[\w.-]+\.py", name) for name in names)
    for text in browser.evaluate("runs.map(pythonFile)"):
        compile(text, "file.py", "exec")
    open_case(browser, CASE)
    own = [one for one in OUTCOMES if one.task.case == CASE]
    assert browser.evaluate("document.querySelectorAll('main button[data-run]').length") == len(own)
    browser.evaluate("[...document.querySelectorAll('main button[data-run]')].forEach((one) => one.click())")
    links = "[...document.querySelectorAll('main a[download]')].map((one) => one.download)"
    assert len(set(browser.evaluate(links))) == len(own)


def test_files_state_only_what_the_data_show(browser: HeadlessBrowser) -> None:
    """A wrong answer without a residual has two possible reasons on a feasible case, and one on an infeasible case."""
    words = browser.evaluate("runs.map(finding)")
    incomplete = "reported solved with missing or non-finite numbers"
    assert words[:6] == [
        "Verdict: certified, residual 1.0e-9.",
        f"Wrong: reported infeasible although feasible, or {incomplete}.",
        f"Wrong: {incomplete}.",
        "Wrong: reported solved; forces with residual 2.5e-1.",
        "Wrong: reported solved; forces with residual 5.0e-7 that miss more than 1e-4 of the load.",
        "Wrong: reported solved; forces with residual 2.5e-1.",
    ]
    for text, word in zip(browser.evaluate("runs.map(pythonFile)"), words, strict=True):
        assert word in text.split('"""')[1]


def test_warm_starts_have_a_previous_solution(browser: HeadlessBrowser) -> None:
    chosen = "select({cones: 'exact', settings: 'default', units: 'scaled', start: 'warm', collection: 'all', size: 'all'})"
    assert browser.evaluate(f"{chosen}.map((run) => run.case.name)") == [MOTORS]
    cold = browser.evaluate(chosen.replace("'warm'", "'cold'") + ".map((run) => run.warm)")
    assert cold == [0] * 4
    assert browser.evaluate("choices().start") == ["cold", "warm"]


def run_file(text: str, folder: Path) -> list[str]:
    """Return the words that a Python file prints."""
    (folder / "one.py").write_text(text)
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    done = subprocess.run([sys.executable, "one.py"], cwd=folder, env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def test_file_and_command_of_a_run_reproduce_it(
    browser: HeadlessBrowser, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for index in (0, 5):  # scaled and SI units
        task = OUTCOMES[index].task
        verdict, residual = run_file(browser.evaluate(f"pythonFile(runs[{index}])"), tmp_path)
        words = shlex.split(browser.evaluate(f"runCommand(runs[{index}])"))
        assert words[0] == "graspforce"
        assert main(words[1:]) == 0
        report = json.loads(capsys.readouterr().out)
        assert report["facts"]["limit"] == CONDITIONS["limit"]
        records = [RaceOutcome.from_dict(record) for record in report["outcomes"]]
        (same,) = [one for one in records if one.task == task]
        assert verdict == same.judgement.verdict.value == "certified"
        assert float(residual) == pytest.approx(same.judgement.residual)


def test_own_problems_and_answers_are_named_in_commands_and_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(FOLDER_VARIABLE, "")  # restored after the test
    own = tmp_path / "own problems"
    (own / "mine").mkdir(parents=True)
    record = {**problems.load(CASE).to_dict(), "name": "mine/first"}
    (own / "mine" / "first.json").write_text(json.dumps(record) + "\n")
    answers = tmp_path / "other.json"
    answers.write_text(json.dumps([{"case": "mine/first", "status": "no answer"}]))
    options = ["--dir", str(own), "--solver", "clarabel", "--answers", str(answers), "--max-cases", "0"]
    assert main(["bench", *options, "--site", str(tmp_path / "out")]) == 0
    page = tmp_path / "out" / "index.html"
    words = shlex.split(page_data(page)["command"])
    assert words[words.index("--dir") + 1] == str(own)
    shown = opened(page)
    try:
        capsys.readouterr()
        monkeypatch.setenv(FOLDER_VARIABLE, "")
        assert main(shlex.split(shown.evaluate("runCommand(runs[0])"))[1:]) == 0
        found = json.loads(capsys.readouterr().out)["outcomes"]
        assert ("mine/first", False, "certified") in [(one["case"], one["pyramid"], one["verdict"]) for one in found]
        monkeypatch.setenv(FOLDER_VARIABLE, "")
        assert run_file(shown.evaluate("pythonFile(runs[0])"), tmp_path)[0] == "certified"
        last = "runs.findIndex((run) => run.reported)"
        assert str(answers) in shown.evaluate(f"runCommand(runs[{last}])")
        assert run_file(shown.evaluate(f"pythonFile(runs[{last}])"), tmp_path) == ["no", "answer", "None"]
        monkeypatch.setenv(FOLDER_VARIABLE, "")
        shown.evaluate("location.hash = '#/case/mine/first'")
        shown.wait(lambda: shown.evaluate("document.querySelector('main h2')?.innerText") == "mine/first")
        line = shown.evaluate("document.querySelector('main pre').innerText")
        assert main(shlex.split(line)[1:]) == 0
        assert json.loads(capsys.readouterr().out)["name"] == "mine/first"
    finally:
        shown.close()


def test_reported_times_are_marked(browser: HeadlessBrowser, tmp_path: Path) -> None:
    browser.evaluate("location.hash = '#/'")
    browser.wait(lambda: browser.evaluate("document.querySelector('main h2')?.innerText") == "Results")
    rows = browser.evaluate("[...document.querySelectorAll('#solvers tbody tr')].map((one) => one.innerText)")
    assert {row.split()[0]: "µs (reported)" in row for row in rows} == {"clarabel": False, "mine": True}
    rows = browser.evaluate("(() => { location.hash = '#/history'; show(); return main.innerText.split('\\n'); })()")
    assert next(line for line in rows if "(reported)" in line).startswith("mine")
    history = save_history(tmp_path / "history.json", CONDITIONS, OUTCOMES)
    assert {one["solver"] for one in history if one["reported"]} == {"mine"}
    pyramids = replace(PLAIN, pyramid=True)
    both = [outcome(task, Verdict.CERTIFIED, 1e-9) for task in (PLAIN, pyramids)] + [OUTCOMES[REPORTED]]
    table = readme_table(save_history(tmp_path / "table.json", CONDITIONS, both))
    lines = {line.split()[1]: line for line in table.splitlines()[2:]}
    assert "1.0 × (reported)" in lines["mine"]
    assert "reported" not in lines["clarabel"]


def test_terminal_marks_reported_times() -> None:
    from rich.console import Console

    from graspforce.cli.tables import race_tables

    console = Console(width=120)
    with console.capture() as captured:
        for table in race_tables([OUTCOMES[0], OUTCOMES[REPORTED]], 0.5):
            console.print(table)
    lines = captured.get().splitlines()
    assert [line.split()[0] for line in lines if "(reported)" in line] == ["mine"]
