"""Objects that yield to soft pads near a loss of rank: the contacts are kept, the stated cost is least, C equals Python."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.control_grasps import soft_box_grasp

from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, FrictionSettings, GraspState, ObjectControlLaw
from graspforce.control.contacts.mobility import (
    SPIN_COMPLIANCE_START,
    MassFactor,
    ObjectCompliance,
    compute_compliant_accelerations,
)
from graspforce.core.arrays import Array
from graspforce.core.compiled import native
from graspforce.core.errors import InvalidInput
from graspforce.estimation import SensorModel
from graspforce.grasp.body import Body

COMPLIANCE, TOLERANCE = 0.01, 0.01  # m/rad, and the rank tolerance
MASS = MassFactor.from_body(soft_box_grasp().body)
OBJECT = ObjectCompliance(MASS.mobility, COMPLIANCE)


def matrix(rng: np.random.Generator, sigma: Array, columns: int) -> Array:
    """Return a matrix with given singular values."""
    U, V = (np.linalg.qr(rng.normal(size=(size, size)))[0] for size in (len(sigma), columns))
    return np.asarray(U * sigma @ V[: len(sigma)])


def test_object_yields_near_a_loss_of_rank_and_all_contacts_are_kept() -> None:
    """Two rows become dependent. Far from it, the result is that of the pseudo-inverse; near it, joints stay slow."""
    rng, n, rows = np.random.default_rng(17), 16, 12
    exact = matrix(rng, rng.uniform(0.02, 0.1, rows - 1), n)  # m/rad
    direction = np.linalg.svd(exact)[2][-1]  # not a combination of the rows
    B = rng.normal(size=(rows, 6)) * [1.0, 1.0, 1.0, 0.03, 0.03, 0.03]  # contacts at some 30 mm from O
    a, beta, posture = rng.normal(size=6), rng.normal(size=rows), rng.normal(size=n)
    last = None
    for distance in np.geomspace(0.02, 1e-6, 400):  # m/rad
        A = np.vstack([exact, exact[-1] + distance * direction])
        found = compute_compliant_accelerations(A, B, beta, a, posture, OBJECT, TOLERANCE)
        assert found is not None
        joints, yielded = found.joint_acceleration, found.object_acceleration
        np.testing.assert_allclose(A @ joints, B @ yielded + beta, rtol=0.0, atol=1e-9 * np.abs(joints).max())
        plain = posture + np.linalg.pinv(A) @ (B @ a + beta - A @ posture)
        if 1.0 / np.trace(np.linalg.inv(A @ A.T)) >= SPIN_COMPLIANCE_START**2:
            np.testing.assert_allclose(joints, plain, rtol=0.0, atol=1e-9 * np.abs(plain).max())
            np.testing.assert_array_equal(yielded, a)
        assert last is None or np.abs(joints - last).max() < 0.3 * np.abs(joints).max()  # continuous: 2.5 % a step
        last = joints
    assert np.abs(joints).max() < 1e-3 * np.abs(plain).max()


def test_yielding_accelerations_minimise_the_stated_cost_among_those_that_keep_the_contacts() -> None:
    """The optimality system of the program, solved as one linear system with multipliers."""
    rng, n, rows = np.random.default_rng(21), 16, 12
    A = matrix(rng, np.append(rng.uniform(0.02, 0.1, rows - 1), 1e-3), n)  # m/rad
    B, beta, a, posture = rng.normal(size=(rows, 6)), rng.normal(size=rows), rng.normal(size=6), rng.normal(size=n)
    found = compute_compliant_accelerations(A, B, beta, a, posture, OBJECT, TOLERANCE)
    assert found is not None
    size = COMPLIANCE * (1.0 - 1.0 / np.trace(np.linalg.inv(A @ A.T)) / SPIN_COMPLIANCE_START**2)
    M = MASS.factor @ MASS.factor.T / soft_box_grasp().body.mass
    H = np.block([[M, np.zeros((6, n))], [np.zeros((n, 6)), size**2 * np.eye(n)]])
    both = np.hstack([-B, A])
    system = np.block([[H, both.T], [both, np.zeros((rows, rows))]])
    expected = np.linalg.solve(system, np.concatenate([M @ a, size**2 * posture, beta]))
    np.testing.assert_allclose(found.object_acceleration, expected[:6], rtol=0.0, atol=1e-7 * np.abs(expected[:6]).max())
    np.testing.assert_allclose(found.joint_acceleration, expected[6 : 6 + n], rtol=0.0, atol=1e-7 * np.abs(expected).max())


@pytest.mark.skipif(native is None, reason="the C code was not built: no C compiler at installation")
def test_c_code_yields_as_the_reference() -> None:
    """Random states about a posture close to a loss of rank, with a centre of mass away from the object's origin."""
    grasp, rng = soft_box_grasp(), np.random.default_rng(18)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    body = Body(0.07, turn @ np.diag([2e-5, 3e-5, 4e-5]) @ turn.T, [2e-3, -3e-3, 5e-3], grasp.body.shape)
    laws = [ObjectControlLaw(replace(grasp, body=body), ControlSettings(spin_compliance=COMPLIANCE)) for _ in range(2)]
    laws[1]._compiled = None
    yielding = 0
    for _ in range(120):
        q, v = grasp.q + 0.06 * rng.normal(size=grasp.hand.n), 0.3 * rng.normal(size=grasp.hand.n)
        state = GraspState(q, v, BodyMotion(grasp.p_HO + 1e-3 * rng.normal(size=3), grasp.R_HO, 0.1 * rng.normal(size=6)))
        desired = BodyMotion(grasp.p_HO, grasp.R_HO)
        found, expected = (law.compute_targets(law.initial_memory(), state, desired, None) for law in laws)
        for name in ("joint_acceleration", "object_acceleration", "w"):
            right = getattr(expected, name)
            np.testing.assert_allclose(getattr(found, name), right, rtol=0.0, atol=1e-9 * np.abs(right).max(), err_msg=name)
        A = laws[0]._constraints.constraint_rows(expected.rolling)[0]
        yielding += 1.0 / np.trace(np.linalg.inv(A @ A.T)) < SPIN_COMPLIANCE_START**2
    assert yielding > 10


def test_settings_choose_whether_pads_spin_or_the_object_yields() -> None:
    """Exact states let the pads spin; states from sensors let the object yield, more so with joint friction."""
    pads = [ObjectControlLaw(soft_box_grasp(), settings)._constraints for settings in (ControlSettings(), chosen())]
    assert [(each.spin_damping, each.spin_compliance) for each in pads] == [(0.014, 0.0), (0.0, 0.01)]
    assert chosen(friction=FrictionSettings()).spin_compliance == 0.03
    assert chosen(spin_compliance=0.02).spin_compliance == 0.02
    assert ControlSettings.from_dict(chosen().to_dict()).spin_compliance == 0.01
    assert "spin_compliance" not in ControlSettings().to_dict()
    with pytest.raises(InvalidInput, match="spin_compliance = -1"):
        ControlSettings(spin_compliance=-1.0)


def chosen(**base) -> ControlSettings:
    """Return the settings for exact sensors."""
    return ControlSettings.for_sensors(SensorModel(), ControlSettings(**base)).settings
