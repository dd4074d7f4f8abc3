"""Tests of the benchmarks: each can be imported and has a help text, and those with a short form run."""

import importlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks import real_world

ROOT = Path(__file__).parents[2]
MODULES = sorted(path.stem for path in (ROOT / "benchmarks").glob("*.py") if path.stem != "__init__")
SHORT = {  # options of the short form, and a text that its output must contain
    "control_step": (["--rounds", "40"], "40 of"),
    "estimation_step": (["--rounds", "40", "--grasp", "allegro_right sphere"], "160 of 160 solutions certified"),
    "min_time_path": (["--rounds", "1"], "| three fingers and an object | 200 |"),
    "import_time": (["--rounds", "1"], "after NumPy: met"),
    "control_stream": (["--rounds", "1"], "times the bare echo"),
    "stream_overhead": (["--rounds", "1"], "MessagePack, binary arrays, all fields"),
    "soak": (["--seconds", "3", "--ordinary"], "Without an answer: 0."),
    "robust": (["--samples", "100", "--steps", "5"], "against closed forms"),
    "ros2_stream": (["--seconds", "1", "--corpus", "20", "--port", "0"], "20 of 20 joint states from the library and 20 of 20"),
    "rigorous": (["--count", "20", "--mutations", "50"], "50 refused with the old checksum"),
    "sensitivities": (["--count", "4"], "Of 28 blocks, 0 differ by more than 1e-5"),
    "batched_adjoints": (["--count", "300", "--repeats", "1"], "0 other flags"),
    "structured_accuracy": (["--count", "5", "--sizes", "3"], "| 0.01 % over the largest load |"),
}


@pytest.fixture
def benchmark(monkeypatch):
    """Return a function that imports a benchmark by name; sys.path is restored afterwards."""
    monkeypatch.setattr(sys, "path", [str(ROOT), *sys.path])
    return lambda name: importlib.import_module(f"benchmarks.{name}")


@pytest.mark.parametrize("name", MODULES)
def test_every_benchmark_imports_and_has_help(name, benchmark, monkeypatch, capsys):
    if name.startswith("drake"):
        pytest.importorskip("pydrake")
    if name == "labelling":
        pytest.importorskip("distributed")
    module = benchmark(name)
    if not hasattr(module, "main"):
        return  # a shared module
    command = "python -m benchmarks" + ("" if name == "__main__" else f".{name}")
    monkeypatch.setattr(sys, "argv", [name, "--help"])
    with pytest.raises(SystemExit) as ended:
        module.main()
    assert ended.value.code == 0
    assert capsys.readouterr().out.startswith(f"usage: {command} [-h]")


@pytest.mark.parametrize("name", SHORT)
def test_short_forms_run(name):
    """Each runs in its own process, which it may pin to a processor."""
    options, text = SHORT[name]
    command = [sys.executable, "-W", "error", "-m", f"benchmarks.{name}", *options]
    ran = subprocess.run(command, cwd=ROOT, env=dict(os.environ), capture_output=True, text=True, timeout=120)
    assert ran.returncode == 0, ran.stderr
    assert text in ran.stdout


def test_unknown_collection_is_rejected_before_writing(benchmark, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["write_collections", "textbok"])
    with pytest.raises(SystemExit) as ended:
        benchmark("write_collections").main()
    assert ended.value.code == 2
    assert "unknown collection 'textbok'; known: batch, hard, infeasible" in capsys.readouterr().err


@pytest.mark.parametrize(("last", "is_met"), [(0.0, True), (6.7e-9, True), (9e-9, False), (4e-7, False)])
def test_creep_is_judged_by_its_last_half_second(last, is_met, benchmark):
    """The requirement covers the last half second; the first half second is reported but not judged."""
    row = benchmark("closed_loop").creep_row(60.0, 6.7e-9, 4e-7, last)
    assert row.is_met is is_met
    assert row.requirement.startswith("last half second")
    assert "not judged: 0.4000" in row.measured


def test_worst_figures_are_the_largest_of_each_kind() -> None:
    texts = ["held, slip 0.02 mm, squeeze 1.10 ×", "held, slip 0.01 mm, squeeze 1.40 ×"]
    assert real_world.worst_figures(texts) == "held, slip 0.02 mm, squeeze 1.40 ×"
    assert (
        real_world.worst_figures([*texts, "dropped, slip 9.00 mm, squeeze 1.00 ×"]) == "dropped, slip 9.00 mm, squeeze 1.00 ×"
    )
    assert real_world.worst_figures([*texts, "ValueError: no forces"]) == "ValueError: no forces"


def test_slip_detection_reports_before_the_first_slip(benchmark):
    module = benchmark("slip_detection")
    rows = [*module.slip_rows([]), *module.friction_rows([]), *module.quiet_rows([])]
    limits = {row.label: row for row in rows if row.requirement.startswith("≥")}
    assert len(limits) == 4
    for row in limits.values():
        assert row.measured == "none yet"
        assert not row.is_met


def test_slip_detection_reports_slips_without_an_alarm(benchmark):
    module = benchmark("slip_detection")
    nothing = {"first": None, "reaction": None, "right": None, "precautions": 0, "early": 0}
    missed = dict.fromkeys(module.SENSORS, nothing)
    for row in module.slip_rows([{"counts": 500, "calm": False, "alarms": missed}]):
        if row.requirement.startswith("≥"):
            assert row.measured == "0.0 %"
            assert not row.is_met


def test_slip_detection_counts_a_precaution_as_reaction_and_not_as_alarm(benchmark):
    module = benchmark("slip_detection")
    late = {"first": 512, "reaction": 512, "right": True, "precautions": 0, "early": 0}
    asked = {**late, "reaction": 495, "precautions": 30}
    alarms = {name: asked if name == module.WITH_FORCES else late for name in module.SENSORS}
    rows = {row.label: row for row in module.slip_rows([{"counts": 500, "calm": False, "kind": "friction", "alarms": alarms}])}
    reaction, alone = (rows[f"{module.WITH_FORCES}: {event} within 5 ms"] for event in ("reaction", "alarm alone"))
    assert reaction.is_met
    assert reaction.measured.startswith("100.0 %; median -5 ms")
    assert alone.measured.startswith("0.0 %; median 12 ms")
