"""Tests of the static page of a race: size, data, history, and the page in a headless browser in both themes."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from support.headless_browser import CHROMIUM, HeadlessBrowser

from graspforce import problems
from graspforce.bench.judge import Judgement, Verdict
from graspforce.bench.outcome import RaceOutcome, RaceTask
from graspforce.bench.site import save_history, write_site
from graspforce.bench.statistics import group_outcomes, performance_profile, summarize_solvers

CONDITIONS = {
    "machine": "a processor",
    "cores": 2,
    "python": "3.12",
    "limit": 0.5,
    "versions": {"graspforce": "0.3.0", "alpha": "1.2", "beta": ""},
    "problems": {"version": "1.0.1", "sha256": "ab" * 32},
}
CASES = ("opposed/force", "ring/3-force", "ring/3-torque", "opposed/capped")
# verdict and time in µs of each solver on each case; the last one is infeasible
RESULTS = {
    "alpha": ((Verdict.CERTIFIED, 10), (Verdict.CERTIFIED, 40), (Verdict.UNSUPPORTED, None), (Verdict.CERTIFIED, 9)),
    "beta": ((Verdict.CORRECT, 20), (Verdict.WRONG, None), (Verdict.CERTIFIED, 30), (Verdict.UNPROVEN, None)),
}


def outcomes() -> list[RaceOutcome]:
    """Return the outcomes of `RESULTS`."""
    made = []
    for solver, results in RESULTS.items():
        for case, (verdict, time) in zip(CASES, results, strict=True):
            task = RaceTask(solver, "default", "scaled", False, False, case)
            residual = 0.25 if verdict is Verdict.WRONG else 1e-9
            seconds = None if time is None else 1e-6 * time
            feasible = case != "opposed/capped"
            made.append(RaceOutcome(task, 3, feasible, Judgement(verdict, residual), seconds, None, 5))
    return made


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_site(tmp_path_factory.mktemp("site"), CONDITIONS, outcomes(), "graspforce bench --smoke")


def test_page_is_one_small_file_that_loads_nothing(page: Path) -> None:
    text = page.read_text()
    assert len(text) < 100_000
    assert not re.search(r"(src|href)=\"(https?:)?//|import\(|fetch\(|@import|url\(", text)
    assert not re.search(r"\{(css|data|script)\}", text)


def test_history_keeps_races_of_other_cases_or_limits_and_the_newest_entries_are_last(tmp_path: Path) -> None:
    old = {"solver": "alpha", "version": "1.2", "graspforce": "0.3.0", "data": "1.0.1", "group": "exact cones, default, scaled"}
    (tmp_path / "history.json").write_text(json.dumps([{**old, "cases": 4, "correct": 4, "wrong": 0, "mean": 1e-3}]))
    alpha = outcomes()[:4]
    races = ((CONDITIONS, alpha), (CONDITIONS, alpha[:2]), ({**CONDITIONS, "limit": 2.0}, alpha), (CONDITIONS, alpha))
    for conditions, some in races:
        history = save_history(tmp_path / "history.json", conditions, some)
    assert history == json.loads((tmp_path / "history.json").read_text())
    assert [(one["cases"], one.get("limit")) for one in history] == [(4, None), (2, 0.5), (4, 2.0), (4, 0.5)]


def test_history_keeps_earlier_versions_and_replaces_equal_ones(tmp_path: Path) -> None:
    write_site(tmp_path, CONDITIONS, outcomes(), "c")
    write_site(tmp_path, CONDITIONS, outcomes(), "c")
    later = {**CONDITIONS, "versions": {**CONDITIONS["versions"], "alpha": "1.3"}}
    write_site(tmp_path, later, outcomes()[:4], "c")
    history = json.loads((tmp_path / "history.json").read_text())
    assert [(one["solver"], one["version"], one["correct"], one["wrong"]) for one in history] == [
        ("alpha", "1.2", 3, 0),
        ("beta", "", 3, 1),
        ("alpha", "1.3", 3, 0),
    ]


@pytest.fixture(scope="module")
def browser(page: Path) -> Iterator[HeadlessBrowser]:
    if CHROMIUM is None:
        pytest.skip("needs Chromium")
    pytest.importorskip("websockets")
    opened = HeadlessBrowser(f"file://{page}", 1200, 900)
    try:
        opened.wait(lambda: opened.evaluate("!!document.querySelector('#solvers')"))
        yield opened
    finally:
        opened.close()


def open_view(browser: HeadlessBrowser, address: str, heading: str) -> None:
    """Open a view of the page, and wait until its heading is shown."""
    browser.evaluate(f"location.hash = {json.dumps('#/' + address)}")
    browser.wait(lambda: browser.evaluate("document.querySelector('main h2')?.innerText") == heading)


def test_statistics_of_the_script_are_those_of_the_report(browser: HeadlessBrowser) -> None:
    open_view(browser, "", "Results")
    (group,) = group_outcomes(outcomes())
    rows = {row["solver"]: row for row in browser.evaluate("summary(select(state.filter))")}
    for known in summarize_solvers(group, CONDITIONS["limit"]):
        assert rows[known.solver]["mean"] == pytest.approx(known.mean, rel=1e-9)
        assert rows[known.solver]["median"] == pytest.approx(known.median, rel=1e-9)
        assert rows[known.solver]["wrong"] == known.counts[Verdict.WRONG]
    for common, count in ((False, 3), (True, 2)):
        found = browser.evaluate(f"(p => [[...p.curves], p.count])(profile(select(state.filter), {str(common).lower()}))")
        assert found[1] == count
        for solver, ratios in found[0]:
            known = [ratio for ratio in performance_profile(group, common)[solver] if ratio < float("inf")]
            assert ratios == pytest.approx(known)
    assert "all 3 feasible cases; unsupported counts as not solved" in browser.text()
    assert "the 2 feasible cases that all support" in browser.text()


def test_tables_sort_and_filter_by_keyboard(browser: HeadlessBrowser) -> None:
    open_view(browser, "", "Results")
    first = "document.querySelector('#solvers tbody td').innerText"
    assert browser.evaluate(first) == "alpha"
    browser.evaluate("document.querySelector('#solvers th button').focus()")
    for kind in ("keyDown", "keyUp"):
        browser.call("Input.dispatchKeyEvent", type=kind, key="Enter", code="Enter", windowsVirtualKeyCode=13, text="\r")
    browser.wait(lambda: browser.evaluate(first) == "beta")
    assert browser.evaluate("document.querySelector('#solvers th').ariaSort") == "descending"
    assert browser.evaluate("document.activeElement.dataset.column") == "0"  # the focus stays on the button
    browser.evaluate("const s = document.querySelector('select[name=collection]'); s.value = 'opposed'")
    browser.evaluate("document.querySelector('select[name=collection]').dispatchEvent(new Event('change', {bubbles: true}))")
    browser.wait(lambda: browser.evaluate("document.querySelector('#solvers tbody td:nth-child(2)').innerText") == "2")


def test_pages_of_cases_and_solvers_say_how_to_reproduce(browser: HeadlessBrowser) -> None:
    open_view(browser, "case/ring/3-force", "ring/3-force")
    assert "graspforce problems show ring/3-force | graspforce solve -" in browser.text()
    assert browser.evaluate("document.querySelectorAll('main svg circle').length") == 3
    open_view(browser, "solver/beta", "beta")
    assert "Wrong answers: 1" in browser.text()
    assert browser.evaluate("document.querySelector('main pre')") is None
    browser.click("Reproduce")
    text = browser.evaluate("document.querySelector('main pre.file').innerText")
    assert 'RaceTask("beta", "default", "scaled", False, False, "ring/3-force")' in text
    compile(text, "wrong.py", "exec")
    assert browser.evaluate("document.querySelector('main button[data-run]').getAttribute('aria-expanded')") == "true"
    browser.click("Reproduce")
    assert browser.evaluate("document.querySelector('main pre')") is None
    open_view(browser, "history", "History by version")
    assert "1.0.1" in browser.text()


CONTRASTS = """
(() => {
  const linear = (v) => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
  const light = (text) => {
    const [r, g, b] = text.match(/[\\d.]+/g).slice(0, 3).map((v) => linear(v / 255));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const back = (element) => {
    for (let e = element; e; e = e.parentElement) {
      const colour = getComputedStyle(e).backgroundColor;
      if (colour !== "rgba(0, 0, 0, 0)") return colour;
    }
  };
  const kinds = "h1, h2, h3, p, td, th, a, button, label, select, footer, pre, .bad";
  return Math.min(...[...document.querySelectorAll(kinds)].map((e) => {
    const [a, b] = [light(getComputedStyle(e).color), light(back(e) || "rgb(255,255,255)")];
    return (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
  }));
})()
"""


def test_contrast_of_text_is_sufficient_in_both_themes(browser: HeadlessBrowser) -> None:
    """WCAG 2 asks for a ratio of 4.5 for text of normal size."""
    themes = set()
    for address, heading in (("", "Results"), ("solver/beta", "beta"), ("case/ring/3-force", "ring/3-force")):
        open_view(browser, address, heading)
        for _ in range(2):
            browser.evaluate("document.getElementById('theme').click()")
            themes.add(browser.evaluate("document.documentElement.dataset.theme"))
            assert browser.evaluate(CONTRASTS) >= 4.5
    assert themes == {"light", "dark"}
    labelled = browser.evaluate("[...document.querySelectorAll('svg')].every((one) => one.getAttribute('aria-label'))")
    assert labelled


def test_page_of_all_solvers_on_all_cases_is_below_2_megabytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One case of each twenty, with random numbers: twenty solvers, eight of them with exact cones, as the suite has."""
    monkeypatch.setattr("graspforce.bench.site.case_tags", lambda case: ("difficulty:easy", "exact", "feasible"))
    rng, names, many = np.random.default_rng(3), problems.names()[::20], []
    for solver in range(20):
        for pyramid in (False, True) if solver < 8 else (True,):
            for name in names:
                task = RaceTask(f"solver-{solver}", "default", "scaled", pyramid, False, name)
                judgement = Judgement(tuple(Verdict)[int(rng.integers(5))], float(10.0 ** rng.uniform(-16, -3)))
                many.append(
                    RaceOutcome(task, 3, True, judgement, float(10.0 ** rng.uniform(-5, -2)), None, int(rng.integers(40)))
                )
    size = write_site(tmp_path, CONDITIONS, many, "graspforce bench --max-cases 0").stat().st_size
    empty = write_site(tmp_path / "one", CONDITIONS, many[:1], "graspforce bench").stat().st_size
    assert empty + (size - empty) * len(problems.names()) / len(names) < 2e6


def press(browser: HeadlessBrowser, key: str, code: int) -> None:
    """Press and release a key."""
    text = {"text": "\r"} if key == "Enter" else {}
    for kind in ("keyDown", "keyUp"):
        browser.call("Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=code, **text)


CURVE_CONTRASTS = """
(() => {
  const linear = (v) => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
  const light = (text) => {
    const [r, g, b] = text.match(/[\\d.]+/g).slice(0, 3).map((v) => linear(v / 255));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const back = light(getComputedStyle(document.body).backgroundColor);
  const probe = document.body.appendChild(document.createElement("i"));
  const ratios = COLOURS.map((colour) => {
    probe.style.color = colour;
    const own = light(getComputedStyle(probe).color);
    return (Math.max(own, back) + 0.05) / (Math.min(own, back) + 0.05);
  });
  probe.remove();
  return Math.min(...ratios);
})()
"""


OVERLAPS = """
(() => {
  const names = [...Array(19).keys()].map((i) => "x".repeat(LENGTH - (i % 4)));
  const box = document.createElement("div");
  box.innerHTML = chart("", names.map((name) => [name, "M60 290H540"]), (v) => v, (v) => v, [], [], "", "");
  main.append(box);
  const parts = [...box.querySelectorAll("text, path[stroke-width='2.5']")].map((one) => one.getBBox());
  const [, , width, height] = box.querySelector("svg").getAttribute("viewBox").split(" ").map(Number);
  box.remove();
  const crosses = (a, b) => a.x < b.x + b.width && b.x < a.x + a.width && a.y < b.y + b.height && b.y < a.y + a.height;
  const outside = parts.filter((a) => a.x < 0 || a.x + a.width > width || a.y + a.height > height).length;
  return outside + parts.filter((a, i) => parts.some((b, j) => j > i && crosses(a, b))).length;
})()
"""


@pytest.mark.parametrize("length", [5, 14, 25])
def test_names_in_the_legend_do_not_overlap(browser: HeadlessBrowser, length: int) -> None:
    assert browser.evaluate(OVERLAPS.replace("LENGTH", str(length))) == 0


def test_contrast_of_curves_is_sufficient_in_both_themes(browser: HeadlessBrowser) -> None:
    """WCAG 2 asks for a ratio of 3 for graphics. All colours of solvers count, not only those in use."""
    themes = set()
    for _ in range(2):
        browser.evaluate("document.getElementById('theme').click()")
        themes.add(browser.evaluate("document.documentElement.dataset.theme"))
        assert browser.evaluate(CURVE_CONTRASTS) >= 3.0
    assert themes == {"light", "dark"}


@pytest.mark.parametrize(
    ("address", "heading"), [("", "Results"), ("cases", "Cases"), ("solver/beta", "beta"), ("history", "History by version")]
)
def test_tab_key_reaches_each_control_in_order(browser: HeadlessBrowser, address: str, heading: str) -> None:
    """The first stop skips to the content; each stop is visible and shows its focus."""
    open_view(browser, address, heading)
    controls = "[...document.querySelectorAll('a[href], button, select, input')]"
    browser.evaluate("document.activeElement.blur(); window.getSelection().removeAllRanges()")
    browser.evaluate("document.body.tabIndex = -1; document.body.focus(); document.body.removeAttribute('tabindex')")
    count, seen = browser.evaluate(f"{controls}.length"), []
    for _ in range(min(count, 25)):
        press(browser, "Tab", 9)
        seen.append(browser.evaluate(f"{controls}.indexOf(document.activeElement)"))
        outline = "(s => s.outlineStyle !== 'none' || s.boxShadow !== 'none')(getComputedStyle(document.activeElement))"
        assert browser.evaluate(outline)
    assert seen == list(range(len(seen)))
    assert browser.evaluate(f"{controls}[0].getAttribute('href')") == "#main"


def test_theme_and_filters_work_by_keyboard(browser: HeadlessBrowser) -> None:
    open_view(browser, "", "Results")
    before = browser.evaluate("document.documentElement.dataset.theme ?? ''")
    browser.evaluate("document.getElementById('theme').focus()")
    press(browser, "Enter", 13)
    browser.wait(lambda: browser.evaluate("document.documentElement.dataset.theme ?? ''") != before)


def test_page_has_language_title_headings_and_labels(browser: HeadlessBrowser) -> None:
    for address, heading in (("", "Results"), ("case/ring/3-force", "ring/3-force"), ("solvers", "Solvers")):
        open_view(browser, address, heading)
        assert browser.evaluate("document.documentElement.lang") == "en"
        assert browser.evaluate("document.title") == "Solvers on grasp-force problems"
        assert browser.evaluate("document.querySelectorAll('h1').length") == 1
        unnamed = "[...document.querySelectorAll('select, input')].filter((e) => !e.labels.length && !e.ariaLabel).length"
        assert browser.evaluate(unnamed) == 0
        assert browser.evaluate("[...document.querySelectorAll('button, a')].every((e) => e.innerText.trim() || e.ariaLabel)")
        assert browser.evaluate("document.querySelectorAll('main table thead th').length") > 0 or address.startswith("case")
