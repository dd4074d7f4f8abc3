"""Tests of sequences: their compact storage, and the recorded control periods."""

from __future__ import annotations

import json
from itertools import pairwise

import numpy as np
import pytest

from graspforce import problems
from graspforce.problems.sequences import apply_changes, find_changes, format_sequence, step_name

FIRST = {"schema": "s", "contacts": [{"p": [1, 2], "mu": 0.5}, {"p": [3, 4], "mu": 0.5}], "expected": {"status": "a", "x": 1}}


@pytest.mark.parametrize(
    "case",
    [
        FIRST,
        {**FIRST, "contacts": [{"p": [1, 2], "mu": 0.5}, {"p": [3, 5], "mu": 0.4}]},
        {**FIRST, "expected": {"status": "b", "proof": {"y": [1]}}},
        {**FIRST, "contacts": [{"p": [1, 2], "mu": 0.5, "more": 1}, {"p": [3, 4], "mu": 0.5}]},
        {**FIRST, "contacts": FIRST["contacts"][:1]},
        {**FIRST, "expected": {"status": "b", "x": 2}, "schema": "t"},
    ],
)
def test_changes_return_the_case(case: dict) -> None:
    changes = json.loads(json.dumps(find_changes(FIRST, case)))
    assert apply_changes(FIRST, changes) == case
    assert (not changes) == (case == FIRST)


def test_record_without_a_field_is_rejected() -> None:
    with pytest.raises(ValueError, match="fields differ"):
        find_changes(FIRST, {"schema": "s"})


def test_stored_sequence_is_shorter_than_its_cases() -> None:
    names = [step_name("closed-loop/ideal-01", i) for i in range(101)]
    records = [json.loads(problems.text(name)) for name in names]
    line = format_sequence("closed-loop/ideal-01", records)
    whole = sum(len(json.dumps(record, separators=(",", ":"))) for record in records)
    assert len(line) < 0.75 * whole
    stored = json.loads(line)
    for name, changes, record in zip(names, stored["steps"], records, strict=True):
        assert {"name": name, **apply_changes(stored["first"], changes)} == record


def test_closed_loops_have_ideal_and_real_sequences_of_101_periods() -> None:
    sequences: dict[str, list[problems.Case]] = {}
    for name in problems.names("closed-loop"):
        sequences.setdefault(name.rpartition("-")[0].partition("/")[2], []).append(problems.load(name))
    assert {len(cases) for cases in sequences.values()} == {101}
    assert sum(name.startswith("ideal") for name in sequences) == sum(name.startswith("real") for name in sequences) == 7
    for name, cases in sequences.items():
        loads = np.array([case.problem.w[:3] for case in cases])
        if name.startswith("ideal"):  # a real controller's load has the noise of its sensors
            assert np.linalg.norm(np.diff(loads, axis=0), axis=1).max() <= 0.05 * np.linalg.norm(loads, axis=1).max()
        joints = [case.problem.actuation.J for case in cases]
        assert max(np.abs(b - a).max() for a, b in pairwise(joints)) > 0.0  # the hand moves


def test_recorded_periods_are_those_of_a_run() -> None:
    """The loop contracts, so that other versions of MuJoCo, which round differently, record nearly the same."""
    pytest.importorskip("mujoco")
    from benchmarks.record_sequences import RUNS, recorded_problems

    run = RUNS[4]
    for i, problem in enumerate(recorded_problems(run, 3)):
        stored = problems.load(step_name(f"closed-loop/{run.name}", i)).problem
        assert problem.w == pytest.approx(stored.w, abs=1e-3 * np.linalg.norm(stored.w))
        assert problem.contacts.p_OC == pytest.approx(stored.contacts.p_OC, abs=1e-6)
        moved = np.abs(problem.actuation.J).max(axis=0) > 0.0
        assert problem.actuation.J[:, moved] == pytest.approx(stored.actuation.J, abs=1e-6)
