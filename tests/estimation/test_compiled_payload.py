"""The payload in C equals the reference in NumPy to rounding."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.allegro_grasp import PALM_UP, three_finger_grasp
from support.control_grasps import named_grasp
from support.shapes import SURFACES

from graspforce.contact.motion import BodyMotion
from graspforce.estimation import GraspEstimator, Measurement, SensorModel
from graspforce.estimation.compiled_contact_forces import CompiledForceEstimator
from graspforce.estimation.compiled_payload import CompiledPayloadEstimator, ForcePayloadEstimator, make_payload_estimator
from graspforce.estimation.contact_forces import ForceMemory, ForceModelErrors
from graspforce.estimation.payload import PayloadSettings
from graspforce.grasp.body import Body

pytest.importorskip("graspforce.core._native", reason="the compiled module was not built: no C compiler at installation")

PERIOD, PERIODS = 8e-3, 8  # s between two updates, and the periods of each
ROUNDING = 1e-10  # relative to the largest number of each field
FIELDS = ("information", "score", "gain", "noise", "direction", "residual", "slow", "disturbed", "updates")
ESTIMATES = ("mass", "p_OM", "covariance", "external", "external_covariance", "is_disturbed")


def assert_same(found, expected):
    """Assert that two memories agree, each field relative to its largest number."""
    for names, parts in ((FIELDS, (found, expected)), (ESTIMATES, (found.estimate, expected.estimate))):
        for name in names:
            ours, theirs = (np.asarray(getattr(part, name), float) for part in parts)
            largest = np.abs(theirs[np.isfinite(theirs)]).max(initial=1e-9)  # unknown before the first update: infinite
            np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=ROUNDING * largest, err_msg=name)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", ["allegro", "four_finger box"])
def test_estimates_equal_those_of_the_reference(name, seed):
    """The object moves and turns; a push that stays becomes payload after a while; the hand turns over."""
    grasp, rng = three_finger_grasp() if name == "allegro" else named_grasp(name), np.random.default_rng(seed)
    settings = PayloadSettings(adaption_time=0.1)
    both = [kind(grasp.body, PERIOD, settings) for kind in (CompiledPayloadEstimator, ForcePayloadEstimator)]
    memories = [estimator.initial_memory() for estimator in both]
    assert_same(*memories)
    n, count = grasp.hand.n, len(grasp.contacts)
    contacts = GraspEstimator(grasp).initial_memory(Measurement(0.0, grasp.q)).pose
    sensors, errors = SensorModel(torque_noise=1e-3, tip_force_noise=0.02), ForceModelErrors(tip_bias=0.01)
    forces, _ = CompiledForceEstimator(grasp, sensors, PALM_UP, errors).step(
        ForceMemory(), contacts, np.zeros((3, n)) + grasp.q * [[1], [0], [0]], np.zeros(n), None, np.zeros((count, 6))
    )
    gravity, disturbed = np.array(PALM_UP), 0
    for k in range(120):
        force_sum = PERIODS * (np.tile([0.1, 0.0, 1.0], (count, 1)) + 0.02 * rng.normal(size=(count, 3)))
        force_sum[0] += PERIODS * (2.0 if 40 <= k < 80 else 0.0)
        if k == 100:
            gravity = Rotation.from_rotvec([1.0, 0.2, 0.0]).apply(PALM_UP)
        motion = BodyMotion(grasp.p_HO, grasp.R_HO, 0.2 * rng.normal(size=6), 0.5 * rng.normal(size=6))
        mean, body_motion = (force_sum, PERIODS), (motion, gravity)
        memories = [
            each.update(memory, contacts, forces, mean, body_motion) for each, memory in zip(both, memories, strict=True)
        ]
        assert_same(*memories)
        disturbed += memories[0].estimate.is_disturbed
    assert disturbed > 0
    assert not memories[0].estimate.external.flags.writeable


def test_surfaces_that_the_c_code_lacks_use_the_reference():
    grasp = three_finger_grasp()
    estimator = make_payload_estimator(grasp.body, PERIOD)
    assert type(estimator) is CompiledPayloadEstimator
    body = Body(0.05, 1e-5 * np.eye(3), np.zeros(3), SURFACES["implicit"])
    assert type(make_payload_estimator(body, PERIOD)) is ForcePayloadEstimator
