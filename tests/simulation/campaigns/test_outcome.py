"""Outcomes: the gravest failure and its first sign, from recordings with known faults."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from support.allegro_grasp import three_finger_grasp
from support.simulated_runs import replay, simulate_three_fingers

from graspforce import InvalidInput
from graspforce.simulation.campaigns.outcome import FailureWatch, OutcomeLimits, judge_run
from graspforce.simulation.recordings.measured_recording import CameraHistory, MeasuredRecording

STEPS = 400
NO_POSES = CameraHistory(np.zeros(0), np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3, 3)))


@pytest.fixture(scope="module")
def held():
    """Return a recording of 0.4 s in which nothing happens."""
    return simulate_three_fingers(duration=STEPS * 1e-3)


def measured(recording, sliding=None, drop_time=None, **rows) -> MeasuredRecording:
    """Return a recording with faults: values of fields from a step on, as (step, value)."""
    changed = {}
    for name, (first, value) in rows.items():
        changed[name] = np.array(getattr(recording, name))
        changed[name][first:] = value
    slid = np.zeros((STEPS, 3)) if sliding is None else sliding
    return MeasuredRecording(dataclasses.replace(recording, **changed), None, NO_POSES, slid, drop_time)


def test_nothing_happens(held):
    outcome = judge_run(measured(held))
    assert (outcome.result, outcome.sign, outcome.t) == ("held", "none", None)
    assert outcome.peak_force == held.f[..., 2].max()
    assert outcome.motion_peak == pytest.approx(np.linalg.norm(held.p_HO - held.p_HO[0], axis=1).max(), abs=1e-12)


def test_faults_are_found_with_their_first_sign(held):
    far = held.p_HO + np.linspace(0.0, 6e-3, STEPS)[:, None] * [1.0, 0.0, 0.0]
    slid = np.zeros((STEPS, 3))
    slid[100:, 1] = 1.2e-3
    no_touch = np.array([1.0, 1.0, 0.0])
    cases = [
        (measured(held, sliding=slid), "slipped", "slip", 0.1),
        (measured(held, touching=(250, no_touch)), "lost contact", "contact lost", 0.25),
        (measured(held, forces_reused=(200, 1.0)), "no forces", "no forces", 0.2),
        (measured(held, p_HO=(0, far)), "off target", "none", None),
        (measured(held, p_HO=(0, far), saturated=(50, 1.0)), "off target", "torque limit", 0.05),
        (measured(held, sliding=slid, touching=(250, no_touch), drop_time=0.3), "dropped", "slip", 0.1),
        (measured(held, forces_reused=(20, 1.0), sliding=slid, drop_time=0.3), "dropped", "no forces", 0.02),
        (measured(held, drop_time=0.3), "dropped", "none", 0.3),
    ]
    for recording, result, sign, t in cases:
        outcome = judge_run(recording)
        assert (outcome.result, outcome.sign) == (result, sign)
        assert outcome.t == (None if t is None else pytest.approx(t, abs=1e-9)), result


def test_short_faults_are_no_failure(held):
    """Contact lost for less than 0.1 s, and slip below 1 mm; with other limits they are failures."""
    touching = np.ones((STEPS, 3))
    touching[100:150, 0] = 0.0  # 50 ms
    slid = np.full((STEPS, 3), 0.9e-3)
    recording = measured(held, sliding=slid, touching=(0, touching))
    assert judge_run(recording).result == "held"
    assert judge_run(recording, OutcomeLimits(absence=0.04)).result == "lost contact"
    assert judge_run(recording, OutcomeLimits(sliding=0.5e-3)).result == "slipped"
    with pytest.raises(InvalidInput, match="sliding = 0"):
        OutcomeLimits(sliding=0.0)


def test_figures_of_a_dropped_object_end_with_the_drop(held):
    far = held.p_HO + (np.arange(STEPS) >= 300)[:, None] * [0.5, 0.0, 0.0]
    outcome = judge_run(measured(held, p_HO=(0, far), drop_time=0.3))
    assert outcome.motion_peak < 1e-4


class Replay:
    """A plant that repeats the steps of a recording."""

    dt = 1e-3

    def __init__(self, recording):
        self.grasp, self.t = three_finger_grasp(), 0.0
        self._steps, self._states = iter(replay(recording)), iter(state for state, _ in replay(recording))
        self._state = next(self._states)

    def step(self):
        self._contacts = next(self._steps)[1]
        self._state, self.t = next(self._states, self._state), self.t + self.dt

    def state(self):
        return self._state

    def true_contacts(self):
        return self._contacts


def end_of(recording, grace=0.0, limits=None):
    """Return the time at which a run with the steps of a recording ends, s; None if it goes to the end."""
    plant = Replay(recording)
    watch = FailureWatch(plant, limits or OutcomeLimits(), grace)
    for reused in recording.forces_reused:
        plant.step()
        if watch.is_over(plant, SimpleNamespace(forces_reused=reused > 0.0)):
            return plant.t
    return None


def test_run_ends_after_a_failure_and_a_grace_time(held):
    """The limits are looked at every 50 ms."""
    assert end_of(held) is None
    apart, short = np.ones((STEPS, 3)), np.ones((STEPS, 3))
    apart[100:, 2], short[100:190, 2] = 0.0, 0.0
    reused = np.zeros(STEPS)
    reused[50:] = 1.0
    twist = np.array(held.twist)
    twist[:, 0] += 0.02  # m/s: 1.05 mm after 53 ms, if a fingertip slides in this direction
    for fault, end in (({"touching": apart}, 0.25), ({"forces_reused": reused}, 0.2), ({"twist": twist}, 0.1)):
        run = dataclasses.replace(held, **fault)
        assert end_of(run) == pytest.approx(end)
        assert end_of(run, grace=0.1) == pytest.approx(end + 0.1)
    assert end_of(dataclasses.replace(held, touching=short)) is None
    assert end_of(dataclasses.replace(held, touching=short), limits=OutcomeLimits(absence=0.04)) == pytest.approx(0.15)
