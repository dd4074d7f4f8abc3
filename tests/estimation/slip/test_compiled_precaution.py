"""The test for precautions in C equals the reference in NumPy to rounding."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from support.allegro_grasp import three_finger_grasp
from support.control_grasps import named_grasp
from support.shapes import SURFACES

from graspforce.contact.motion import BodyMotion
from graspforce.core.compiled import native, new_block
from graspforce.estimation import GraspEstimator, Measurement, SensorModel
from graspforce.estimation.slip.compiled_precaution import CompiledPrecautionTest, make_precaution_test
from graspforce.estimation.slip.precaution import PrecautionTest
from graspforce.estimation.slip.slip_memory import SlipBlocks
from graspforce.estimation.slip.slip_settings import SlipSettings
from graspforce.geometry.rotations import rotation_exp

pytest.importorskip("graspforce.core._native", reason="the compiled module was not built: no C compiler at installation")

PERIOD, NOISE, SENSORS = 1e-3, 1e-3, SensorModel(1e-3)  # s, rad
SETTINGS = SlipSettings(precaution_interval=2.0)  # s: short, so that precautions occur
FIELDS = ("means", "variance", "updates", "level")


class Slip(NamedTuple):
    """The quantities of the slip detector that the reference reads."""

    residual: np.ndarray
    force_statistic: float
    force_level: float

    def blocks(self) -> SlipBlocks:
        """Return the memory of a compiled detector with these quantities."""
        count = len(self.residual) // 3
        state = new_block(np.dtype(native.slip_state_layout(count, len(SETTINGS.windows))))
        state["residual"], state["force_statistic"], state["level"] = self
        return SlipBlocks(state, None, None, -np.inf, np.zeros((count, 2)), False)


@pytest.mark.parametrize("name", ["allegro", "four_finger box"])
def test_results_and_memories_equal_those_of_the_reference(name: str) -> None:
    """Contacts move, desired poses differ from the estimated ones, and forces are unexpected at times."""
    grasp = three_finger_grasp() if name == "allegro" else named_grasp(name)
    rng, count = np.random.default_rng(7), len(grasp.contacts)
    estimator, due = GraspEstimator(grasp, SENSORS, PERIOD), []
    tests = make_precaution_test(grasp, NOISE**2, PERIOD, SETTINGS), PrecautionTest(count, NOISE**2, PERIOD, 2.0)
    assert type(tests[0]) is CompiledPrecautionTest
    state, memories = estimator.initial_memory(Measurement(0.0, grasp.q), 50), [None, None]
    for k in range(500):
        _, state = estimator.step(state, Measurement(k * PERIOD, grasp.q + NOISE * rng.normal(size=grasp.hand.n)))
        contacts, turn = state.pose, rotation_exp(1e-3 * rng.normal(size=3) + np.array([0.0, 0.02, 0.0]) * (k > 400))
        desired = BodyMotion(contacts.p_HO + 1e-4 * rng.normal(size=3), turn @ contacts.R_HO)
        slip = Slip(1e-4 * rng.normal(size=3 * count), float(rng.exponential(8.0)), float(rng.uniform(0.5, 3.0)))
        results = []
        for i, (test, known) in enumerate(zip(tests, (slip.blocks(), slip), strict=True)):
            is_due, memories[i] = test.step(memories[i], known, contacts, desired)
            results.append(is_due)
        assert results[0] == results[1]
        due.append(results[0])
        block, expected = memories
        assert block is not None
        for field in FIELDS:
            np.testing.assert_allclose(np.squeeze(block[field]), getattr(expected, field), rtol=1e-9, atol=1e-15)
    assert 0 < sum(due) < 300


def test_surfaces_that_the_c_code_lacks_use_the_reference() -> None:
    grasp = three_finger_grasp()
    other = replace(grasp, body=replace(grasp.body, shape=SURFACES["implicit"]))
    assert type(make_precaution_test(other, NOISE**2, PERIOD, SETTINGS)) is PrecautionTest
