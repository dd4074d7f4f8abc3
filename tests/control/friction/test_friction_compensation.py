"""Friction compensation: its torque is that of the friction model along the plan, and off by default."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.control_grasps import named_grasp, with_all_contact_models

from graspforce.contact.motion import BodyMotion
from graspforce.control import (
    ControlMemory,
    ControlSettings,
    GraspMotion,
    GraspState,
    ObjectControlLaw,
    ObjectController,
    grasp_friction,
)
from graspforce.control.contacts.contact_constraints import ContactConstraints
from graspforce.control.forces.margin_solver import MarginSolver
from graspforce.control.forces.worst_cases import friction_margin
from graspforce.control.friction.disturbance_observer import ObserverTimes
from graspforce.control.friction.friction_compensation import (
    FrictionCompensation,
    FrictionMemory,
    FrictionSettings,
    PlannedRates,
    friction_slip_margin,
)
from graspforce.control.grasp_friction import GraspFriction
from graspforce.core.errors import InvalidInput
from graspforce.hand.drives.joint_friction import JointFriction

NAMES = ["four_finger box", "allegro_right sphere"]  # without and with joints that are free beside the contacts


def friction_of(n: int) -> JointFriction:
    """Return different Coulomb, Stribeck and viscous friction of n joints."""
    c = np.linspace(0.03, 0.08, n)
    return JointFriction(c, 0.2 * c, np.full(n, 0.05), 0.01 * c)


def moving_state(grasp, speed: float = 0.02) -> tuple[GraspState, BodyMotion]:
    """Return a state with rolling contacts while the object moves along x, and the same desired motion."""
    twist = np.array([speed, 0.0, 0.0, 0.0, 0.0, 0.0])
    J = grasp.hand.contact_jacobian(grasp.q, grasp.fingers, grasp.contacts, grasp.p_HO, grasp.R_HO)
    twist_O = np.append(grasp.R_HO.T @ twist[:3], grasp.R_HO.T @ twist[3:])
    G = grasp.contacts.wrench_bases().transpose(1, 0, 2).reshape(6, -1)[:, grasp.contacts.columns]
    v = np.linalg.pinv(J) @ (G.T @ twist_O)
    body = BodyMotion(grasp.p_HO, grasp.R_HO, twist)
    return GraspState(grasp.q, v, body), body


def with_friction(**options) -> ControlSettings:
    return ControlSettings(friction=FrictionSettings(**options))


@pytest.mark.parametrize("name", NAMES)
def test_torque_along_the_plan_is_that_of_the_model(name: str) -> None:
    """Without an observer and away from the torque limits, the torques differ by τ_friction(v) of the rolling joint rates."""
    grasp = named_grasp(name)
    state, desired = moving_state(grasp)
    model = friction_of(grasp.hand.n)
    loose = dataclasses.replace(
        grasp,
        hand=dataclasses.replace(grasp.hand, joints=tuple(dataclasses.replace(j, torque=10.0) for j in grasp.hand.joints)),
    )
    plain = ObjectController(loose, ControlSettings()).step(state, desired)
    fed = ObjectController(loose, with_friction(model=model, observe=False)).step(state, desired)
    G = grasp.contacts.wrench_bases().transpose(1, 0, 2).reshape(6, -1)[:, grasp.contacts.columns]
    for command in (plain, fed):  # both hold the same wrench
        np.testing.assert_allclose(G @ command.f, plain.w, atol=1e-6)
    # The least-torque forces may change with tau_u, so the torques are compared without them.
    J = grasp.hand.contact_jacobian(grasp.q, grasp.fingers, grasp.contacts, grasp.p_HO, grasp.R_HO)
    difference = (fed.tau - J.T @ fed.f) - (plain.tau - J.T @ plain.f)
    # Damping of the planned rates and the tilt of the contact frames after one period are below 1e-3 relative.
    np.testing.assert_allclose(difference, model.torque(state.v), atol=2e-3 * np.abs(model.torque(state.v)).max())


def random_motion(rng: np.random.Generator, grasp) -> BodyMotion:
    """Return a motion of the object near the grasp."""
    R = Rotation.from_rotvec(0.1 * rng.normal(size=3)).as_matrix() @ grasp.R_HO
    return BodyMotion(grasp.p_HO + 1e-3 * rng.normal(size=3), R, *(0.02 * rng.normal(size=(2, 6))))


@pytest.mark.parametrize("observe", [True, False])
@pytest.mark.parametrize("name", ["four_finger box", "allegro_right sphere", "soft", "anthropomorphic15"])
def test_compiled_compensation_equals_the_reference(name: str, observe: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """For point and soft contacts, more and fewer joints than constraints; rounding grows with the condition of A Aᵀ."""
    if grasp_friction.native is None:
        pytest.skip("the C code was not built: no C compiler at installation")
    soft = with_all_contact_models(named_grasp("allegro_right sphere"), 1) if name == "soft" else named_grasp(name)
    grasp, rng = soft, np.random.default_rng(3)
    n = grasp.hand.n
    settings = with_friction(model=friction_of(n), observe=observe)
    law = ObjectControlLaw(grasp, settings)
    constraints = ContactConstraints.from_contacts(grasp.contacts)
    assert settings.friction is not None
    compiled = GraspFriction(grasp, settings, settings.friction, constraints)
    monkeypatch.setattr(grasp_friction, "native", None)
    reference = GraspFriction(grasp, settings, settings.friction, constraints)
    for k in range(20):
        state = GraspState(grasp.q + 0.01 * rng.normal(size=n), 0.3 * rng.normal(size=n), random_motion(rng, grasp))
        desired = random_motion(rng, grasp)
        desired = GraspMotion(desired, grasp.q, *(0.3 * rng.normal(size=(2, n)))) if k % 2 else desired
        targets = law.compute_targets(law.initial_memory(), state, desired, None)
        memory = FrictionMemory(rng.uniform(0.0, 0.1, size=n))
        ours, theirs = (each.compensate(memory, state, targets, desired) for each in (compiled, reference))
        np.testing.assert_allclose(ours[0], theirs[0], atol=1e-8)
        np.testing.assert_allclose(ours[1].level, theirs[1].level, atol=1e-8)
        assert ours[2] == theirs[2]


@pytest.mark.parametrize("name", NAMES)
def test_feedback_along_the_plan_is_its_part_in_the_objects_mass_metric(name: str) -> None:
    """An error across the plan, eᵀ M V = 0, has no part along it; an error along the plan has no other part."""
    grasp, rng = named_grasp(name), np.random.default_rng(9)
    settings = with_friction()
    assert settings.friction is not None
    constraints = ContactConstraints.from_contacts(grasp.contacts)
    friction = GraspFriction(grasp, settings, settings.friction, constraints)
    state, law = moving_state(grasp)[0], ObjectControlLaw(grasp, settings)
    A, B, _ = constraints.constraint_rows(law.compute_targets(law.initial_memory(), state, state.object, None).rolling)
    turn = np.kron(np.eye(2), grasp.R_HO)  # from O to H
    mass, v_d = turn @ grasp.body.mass_matrix() @ turn.T, np.zeros(grasp.hand.n)
    for _ in range(5):
        V, any_error = rng.normal(size=(2, 6)) * np.repeat([0.02, 0.5], 3)  # m/s and rad/s; m and rad
        body = BodyMotion(grasp.p_HO, grasp.R_HO, V)  # moves as desired: only the pose differs
        across = any_error - V * (V @ mass @ any_error) / (V @ mass @ V)
        for error, share in ((across, 0.0), (0.1 * V, 1.0)):
            planned = friction.plan_rates(A, B, body, body, error, v_d)
            size = np.abs(planned.feedback).max()
            assert size > 0.1  # rad/s²
            np.testing.assert_allclose(planned.along, share * planned.feedback, rtol=0, atol=1e-9 * size)


def test_standing_error_across_the_plan_does_not_act_through_the_fast_common_level() -> None:
    """While static friction holds a wrong orientation, the levels do not depend on the time for feedback along the plan."""
    grasp, levels = named_grasp("four_finger box"), []
    turned = Rotation.from_rotvec([0.0, 0.1, 0.1]).as_matrix() @ grasp.R_HO
    for common in (0.05, 1e9):
        settings = with_friction(times=ObserverTimes(common=common))
        assert settings.friction is not None
        friction = GraspFriction(grasp, settings, settings.friction, ContactConstraints.from_contacts(grasp.contacts))
        law, memory = ObjectControlLaw(grasp, settings), FrictionMemory(np.full(grasp.hand.n, 0.07))
        for k in range(1000):
            twist = 0.02 * (-1.0) ** (k // 250) * np.eye(6)[0]  # m/s, along x and back
            desired, measured = (BodyMotion(grasp.p_HO, R, twist) for R in (grasp.R_HO, turned))
            state = GraspState(grasp.q, np.zeros(grasp.hand.n), measured)
            targets = law.compute_targets(law.initial_memory(), state, desired, None)
            memory = friction.compensate(memory, state, targets, desired)[1]
        levels.append(memory.level)
    np.testing.assert_allclose(levels[0], levels[1], rtol=0, atol=1e-12)
    assert np.ptp(levels[0]) > 0.01  # N·m: single joints follow


@pytest.mark.usefixtures("arithmetic")
def test_plan_is_at_rest_without_desired_motion() -> None:
    grasp = named_grasp("four_finger box")
    settings = with_friction()
    assert settings.friction is not None
    friction = GraspFriction(grasp, settings, settings.friction, ContactConstraints.from_contacts(grasp.contacts))
    law, (state, moving) = ObjectControlLaw(grasp, settings), moving_state(grasp)
    targets = law.compute_targets(law.initial_memory(), state, moving, None)
    rest = BodyMotion(grasp.p_HO, grasp.R_HO)
    assert not friction.compensate(None, state, targets, moving)[2]
    assert friction.compensate(None, state, targets, rest)[2]


@pytest.mark.parametrize("name", NAMES)
def test_compensation_is_off_by_default(name: str) -> None:
    grasp = named_grasp(name)
    state, desired = moving_state(grasp)
    controller = ObjectController(grasp, ControlSettings())
    controller.step(state, desired)
    assert controller.memory.friction is None
    assert "friction" not in controller.memory.to_dict()
    assert "friction" not in ControlSettings().to_dict()


@pytest.mark.usefixtures("arithmetic")
def test_unknown_friction_of_a_resting_plan_changes_nothing_but_the_slip_margin() -> None:
    grasp = named_grasp("four_finger box")
    rest = BodyMotion(grasp.p_HO, grasp.R_HO)
    state = GraspState(grasp.q, np.zeros(grasp.hand.n), rest)
    margin = ControlSettings().slip_margin + friction_margin(grasp, with_friction())  # N
    choices = ControlSettings(slip_margin=margin), with_friction()
    commands = [ObjectController(grasp, settings).step(state, rest) for settings in choices]
    np.testing.assert_array_equal(commands[0].tau, commands[1].tau)


@pytest.mark.usefixtures("arithmetic")
def test_levels_rise_while_the_object_lags_the_plan() -> None:
    grasp = named_grasp("allegro_right sphere")
    state, desired = moving_state(grasp)
    late = dataclasses.replace(state, v=np.zeros(grasp.hand.n), object=BodyMotion(grasp.p_HO, grasp.R_HO))
    controller = ObjectController(grasp, with_friction())
    controller.step(late, desired)
    level = controller.memory.friction.level
    moving = sorted({joint for name in grasp.fingers for joint in grasp.hand.finger(name).joints})
    assert (level[moving] > 0.0).all()
    # 80/s · 0.02 m/s of feedback on lever arms of some 50 mm and inertias of 1e-3 kg·m², over 0.05 s: some 1e-3 N·m a period
    assert 1e-5 < level[moving].mean() < 1e-2


def test_fingers_without_contact_are_compensated_along_their_own_motion() -> None:
    grasp = named_grasp("allegro_right sphere")
    (ring,) = [finger for finger in grasp.hand.fingers if finger.name == "ring"]
    v = np.zeros(grasp.hand.n)
    v[list(ring.joints)] = 0.4  # rad/s
    rest, model = BodyMotion(grasp.p_HO, grasp.R_HO), friction_of(grasp.hand.n)
    state, desired = GraspState(grasp.q, v, rest), GraspMotion(rest, grasp.q, v, np.zeros(grasp.hand.n))
    commands = [
        ObjectController(grasp, settings).step(state, desired)
        for settings in (ControlSettings(), with_friction(model=model, observe=False))
    ]
    difference = commands[1].tau - commands[0].tau
    np.testing.assert_allclose(difference[list(ring.joints)], model.torque(v)[list(ring.joints)], rtol=1e-9)


def test_compensation_alone_follows_the_model_and_keeps_the_level() -> None:
    grasp = named_grasp("four_finger box")
    n = grasp.hand.n
    model, v = friction_of(n), np.linspace(-0.5, 0.5, n)
    compensation = FrictionCompensation(grasp.hand, FrictionSettings(model, observe=False))
    tau, memory = compensation.step(compensation.initial_memory(), PlannedRates(v, np.ones(n)))
    np.testing.assert_allclose(tau, model.torque(v), rtol=1e-12)
    np.testing.assert_array_equal(memory.level, model.coulomb)


def test_slip_margin_grows_by_the_friction_that_the_settings_expect() -> None:
    """Known friction c has a standard deviation of c/√3 at rest; unknown friction counts as 5 % of the torque."""
    grasp = named_grasp("four_finger box")
    known = JointFriction(np.linspace(0.02, 0.1, grasp.hand.n))
    expected = {
        None: 0.0,
        FrictionSettings(known): friction_slip_margin(grasp, known.coulomb / np.sqrt(3.0)),
        FrictionSettings(known, torque_error=0.03): friction_slip_margin(grasp, 0.03),
        FrictionSettings(): friction_slip_margin(grasp, 0.05 * grasp.hand.torque_upper / np.sqrt(3.0)),
        FrictionSettings(torque_error=0.0): 0.0,
    }
    for friction, added in expected.items():
        settings = ControlSettings(slip_margin=0.4, friction=friction)
        assert MarginSolver(grasp, settings).margin == pytest.approx(0.4 + added, rel=1e-12)
    with pytest.raises(InvalidInput, match="torque_error"):
        friction_slip_margin(grasp, [0.05, 0.05])


def test_slip_margin_covers_random_torque_errors() -> None:
    """It is one standard deviation, so by Chebyshev at least half of the errors stay within 1.5 of it; it scales with them."""
    grasp = named_grasp("four_finger box")
    margin = friction_slip_margin(grasp, 0.05)
    assert friction_slip_margin(grasp, 0.1) == pytest.approx(2.0 * margin)
    J = grasp.hand.contact_jacobian(grasp.q, grasp.fingers, grasp.contacts, grasp.p_HO, grasp.R_HO)
    G = grasp.contacts.wrench_bases().transpose(1, 0, 2).reshape(6, -1)[:, grasp.contacts.columns]
    null = np.eye(len(J)) - np.linalg.pinv(G) @ G
    errors = 0.05 * np.random.default_rng(0).normal(size=(2000, grasp.hand.n))
    f = grasp.contacts.pad((null @ -np.linalg.pinv(J.T) @ errors.T).T)
    loss = np.linalg.norm(f[..., :2], axis=-1) - grasp.contacts.mu * f[..., 2]
    assert (loss <= 1.5 * margin).mean(axis=0).min() > 0.5
    # RMS of ‖δf_t‖ + μ|δf_n| exceeds the margin by at most √2: (a + b)² ≤ 2 (a² + b²).
    size = np.linalg.norm(f[..., :2], axis=-1) + grasp.contacts.mu * np.abs(f[..., 2])
    assert np.sqrt(np.square(size).mean(axis=0)).max() <= np.sqrt(2.0) * margin


def test_records_are_read_as_written() -> None:
    grasp = named_grasp("four_finger box")
    settings = with_friction(model=friction_of(12), largest_fraction=0.2, rest_tolerance_linear=1e-4)
    again = ControlSettings.from_dict(json.loads(json.dumps(settings.to_dict())))
    assert again.to_dict() == settings.to_dict()
    controller = ObjectController(grasp, settings)
    controller.step(*moving_state(grasp))
    rest = BodyMotion(grasp.p_HO, grasp.R_HO)
    controller.step(GraspState(grasp.q, np.zeros(12), rest), rest)
    record = json.loads(json.dumps(controller.memory.to_dict()))
    assert ControlMemory.from_dict(record, grasp.contacts).to_dict() == record
    assert record["friction"]["rest"] is not None


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"largest_fraction": 1.0}, "settings.friction.largest_fraction"),
        ({"smoothing_rate": 0.0}, "settings.friction.smoothing_rate"),
        ({"times": {"common": -1.0}}, "settings.friction.times.common"),
        ({"model": {"coulomb": [-0.1]}}, r"settings.friction.model.coulomb[0]"),
        ({"friction": 0.1}, "settings.friction.friction"),
    ],
)
def test_wrong_settings_are_named_by_their_path(change, field) -> None:
    with pytest.raises(InvalidInput) as caught:
        ControlSettings.from_dict({"friction": change})
    assert caught.value.field == field


def test_model_of_another_hand_is_named() -> None:
    hand = named_grasp("four_finger box").hand
    with pytest.raises(InvalidInput, match="12 numbers, one for each joint of four_finger"):
        FrictionCompensation(hand, FrictionSettings(JointFriction([0.1])))
    with pytest.raises(InvalidInput, match=r"friction\.level"):
        FrictionMemory.from_dict({"level": [-1.0]})
