"""One step of the object controller: every equation of the law, computed in another way."""

from __future__ import annotations

from dataclasses import replace

import clarabel
import numpy as np
import pytest
import scipy.sparse as sp
from scipy.spatial.transform import Rotation
from support.control_grasps import named_grasp
from support.control_steps import (
    FAST_GRASPS,
    GRAVITY,
    disturbed,
    jacobian,
    pose_at_rest,
    settings_with,
    state_at_rest,
)

from graspforce import InvalidInput
from graspforce.contact.matrices import grasp_matrix
from graspforce.contact.motion import BodyMotion
from graspforce.control import (
    GraspMotion,
    GraspState,
    ObjectController,
    PoseGains,
)
from graspforce.control.object_control_law import ObjectControlLaw
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp

pytestmark = pytest.mark.usefixtures("arithmetic")


@pytest.mark.parametrize("name", FAST_GRASPS)
def test_command_satisfies_every_equation_of_the_law(name: str) -> None:
    grasp, settings = named_grasp(name), settings_with()
    controller = ObjectController(grasp, settings)
    for seed in range(4):
        state, desired = disturbed(grasp, seed)
        controller.reset()
        command = controller.step(state, desired)
        now, hand = state.object, grasp.hand
        assert command.solution.found
        assert not command.forces_reused

        # Acceleration, with SciPy's logarithm; the integral is zero.
        rotation = Rotation.from_matrix(desired.R_HO @ now.R_HO.T).as_rotvec()
        error = np.array([*(desired.p_HO - now.p_HO), *rotation])
        acceleration = desired.acceleration + 80.0 * (desired.twist - now.twist) + 1600.0 * error
        np.testing.assert_allclose(command.error, error, atol=1e-14)
        if len(command.uncontrollable) == 0:
            np.testing.assert_allclose(command.acceleration, acceleration, rtol=1e-12)

        # Newton–Euler, and G f = w about O.
        w = grasp.body.wrench(BodyMotion(now.p_HO, now.R_HO, now.twist, command.acceleration), GRAVITY)
        np.testing.assert_allclose(command.w, w, atol=1e-14)
        scale = np.abs(command.f).max()  # N; the certificate's tolerance of 1e-8 is relative to it
        np.testing.assert_allclose(grasp_matrix(command.contacts) @ command.f, w, atol=1e-7 * scale)

        # Torques: inertia, Coriolis, gravity and contacts.
        a = command.joint_acceleration
        J = jacobian(grasp, state, command)
        tau = hand.inverse_dynamics(state.q, state.v, a, GRAVITY) + J.T @ command.f
        np.testing.assert_allclose(command.tau, tau, atol=1e-12)
        assert (np.abs(command.tau) <= hand.torque_upper * (1.0 + 1e-7)).all()

        # Friction cones with slip margin and friction reserve.
        f = command.f.reshape(-1, 3)
        slip = 0.7 * f[:, 2] - np.hypot(f[:, 0], f[:, 1])
        np.testing.assert_allclose(command.slip_margin, slip, atol=1e-12)
        assert (slip >= 0.3 + 0.07 * f[:, 2] - 1e-7 * scale).all()


@pytest.mark.parametrize("name", FAST_GRASPS)
def test_forces_have_least_cost_within_cones_with_slip_margin(name: str) -> None:
    """Clarabel solves a second program, with ‖f_t‖ ≤ μ f_n − s as it stands."""
    grasp, settings = named_grasp(name), settings_with(force_weight=0.0)
    state, desired = disturbed(grasp, 3)
    command = ObjectController(grasp, settings).step(state, desired)
    J, G = jacobian(grasp, state, command), grasp_matrix(command.contacts)
    tau_u = grasp.hand.inverse_dynamics(state.q, state.v, command.joint_acceleration, GRAVITY)
    W, k, mu = np.diag(grasp.hand.torque_weight), len(command.f), 0.7 * 0.9
    rows, offsets, cones = [G], [command.w], [clarabel.ZeroConeT(6)]
    for i in range(k // 3):
        cone = np.zeros((3, k))
        cone[0, 3 * i + 2], cone[1, 3 * i], cone[2, 3 * i + 1] = -mu, -1.0, -1.0
        rows.append(cone)
        offsets.append(np.array([-0.3, 0.0, 0.0]))
        cones.append(clarabel.SecondOrderConeT(3))
    limit = grasp.hand.torque_upper
    rows += [J.T, -J.T, np.eye(k)[2::3]]
    offsets += [limit - tau_u, limit + tau_u, grasp.contacts.max_normal]
    cones.append(clarabel.NonnegativeConeT(2 * len(limit) + k // 3))
    quiet = clarabel.DefaultSettings()
    quiet.verbose = False
    quiet.tol_gap_abs = quiet.tol_gap_rel = quiet.tol_feas = 1e-10
    P, A = sp.csc_matrix(np.triu(J @ W @ J.T)), sp.csc_matrix(np.vstack(rows))
    reference = clarabel.DefaultSolver(P, J @ W @ tau_u, A, np.concatenate(offsets), cones, quiet).solve()

    def cost(f: np.ndarray) -> float:
        tau = tau_u + J.T @ f
        return 0.5 * float(tau @ W @ tau)

    # The kernel is accurate to 1e-8 of the cost, and the forces to the root of that where they are unique.
    assert cost(command.f) == pytest.approx(cost(np.array(reference.x)), rel=1e-6)
    if not len(command.uncontrollable):
        np.testing.assert_allclose(command.f, reference.x, atol=1e-3)


@pytest.mark.parametrize("name", ["dlr_hit2 sphere", "anthropomorphic15"])
def test_point_tips_accelerate_with_the_object(name: str) -> None:
    """The finger's point at each contact accelerates as the object's, J̇ q̇ included. Spherical tips have their own tests."""
    grasp = named_grasp(name)
    state, desired = disturbed(grasp, 1)
    command = ObjectController(grasp, settings_with()).step(state, desired)
    v, now, h = state.v, state.object, 1e-6
    tips, a = grasp.hand.tip_motion(state.q, v, grasp.fingers), command.joint_acceleration
    arms = grasp.contacts.p_OC @ now.R_HO.T
    omega, alpha = now.twist[3:], command.acceleration[3:]
    later, earlier = (
        grasp.hand.tip_motion(state.q + s * h * v + h**2 / 2 * a, v + s * h * a, grasp.fingers) for s in (1.0, -1.0)
    )
    for i, arm in enumerate(arms):
        point = command.acceleration[:3] + np.cross(alpha, arm) + np.cross(omega, np.cross(omega, arm))
        # The measured tips are not exactly at the contacts: the finger's point is `lever` away from its tip.
        lever = now.p_HO + arm - tips.p_HF[i]
        rate = now.twist[:3] + np.cross(omega, arm) - tips.twist[i, :3]
        finger = (later.twist[i] - earlier.twist[i]) / (2 * h)
        finger = finger[:3] + np.cross(finger[3:], lever) + np.cross(tips.twist[i, 3:], rate)
        # Rounding is 1e-16/h, truncation h². Five planar fingers cannot all have the rates of this state: the squares of the
        # differences, (0.01 rad/s)², remain.
        np.testing.assert_allclose(finger, point, atol=1e-4 if name == "anthropomorphic15" else 1e-8)


def test_contacts_carry_weight_and_external_wrench_at_rest() -> None:
    """For gravity in six directions, the wrench is the weight in O less the external wrench."""
    grasp = named_grasp("allegro_right cylinder")
    for g in [sign * 9.81 * axis for axis in np.eye(3) for sign in (1.0, -1.0)]:
        controller = ObjectController(grasp, settings_with(gravity_H=g))
        command = controller.step(state_at_rest(grasp), pose_at_rest(grasp))
        np.testing.assert_allclose(command.w, [*(-0.05 * g @ grasp.R_HO), 0.0, 0.0, 0.0], atol=1e-15)
        np.testing.assert_allclose(command.joint_acceleration, 0.0, atol=1e-12)
        push = np.array([0.1, 0.0, -0.2, 0.001, 0.0, 0.0])
        np.testing.assert_allclose(
            controller.step(state_at_rest(grasp), pose_at_rest(grasp), push).w, command.w - push, atol=1e-15
        )


@pytest.mark.parametrize("name", ["allegro_right box", "dlr_hit2 sphere", "anthropomorphic15"])
def test_torques_are_invariant_to_the_frame_of_the_object(name: str) -> None:
    """The same body with its frame O shifted and rotated gets the same torques for the same motion."""
    grasp, settings = named_grasp(name), settings_with(gains=PoseGains.critically_damped(0.0, 0.0), rank_tolerance=0.005)
    shift, R = np.array([0.01, -0.02, 0.015]), Rotation.from_rotvec([0.5, -0.7, 0.9]).as_matrix()  # pose of O' in O
    body = Body(grasp.body.mass, R.T @ grasp.body.inertia @ R, (grasp.body.p_OM - shift) @ R)
    c = grasp.contacts
    contacts = replace(c, p_OC=(c.p_OC - shift) @ R, R_OC=R.T @ c.R_OC)
    plain = replace(grasp, body=Body(grasp.body.mass, grasp.body.inertia, grasp.body.p_OM))  # without shapes
    moved = Grasp(grasp.hand, body, grasp.fingers, contacts, grasp.q, grasp.p_HO + grasp.R_HO @ shift, grasp.R_HO @ R)

    def in_moved_frame(motion: BodyMotion) -> BodyMotion:
        arm, (v, omega), (a, alpha) = motion.R_HO @ shift, np.split(motion.twist, 2), np.split(motion.acceleration, 2)
        twist = [*(v + np.cross(omega, arm)), *omega]
        rates = [*(a + np.cross(alpha, arm) + np.cross(omega, np.cross(omega, arm))), *alpha]
        return BodyMotion(motion.p_HO + arm, motion.R_HO @ R, twist, rates)

    state, desired = disturbed(grasp, 5)
    desired = replace(state.object, acceleration=desired.acceleration)
    original = ObjectController(plain, settings).step(state, desired)
    shifted = ObjectController(moved, settings).step(
        GraspState(state.q, state.v, in_moved_frame(state.object)), in_moved_frame(desired)
    )
    np.testing.assert_allclose(shifted.joint_acceleration, original.joint_acceleration, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(shifted.tau, original.tau, atol=1e-5)  # the root of the solver's tolerance
    np.testing.assert_allclose(shifted.w[:3], R.T @ original.w[:3], atol=1e-10)
    assert len(shifted.uncontrollable) == len(original.uncontrollable)


@pytest.mark.parametrize("name", ["allegro_right sphere", "four_finger box"])
def test_null_space_of_the_contacts_keeps_the_posture(name: str) -> None:
    """Joint accelerations differ from the posture's only where contacts need it; idle fingers have the posture's."""
    grasp, settings = named_grasp(name), settings_with()
    state, desired = disturbed(grasp, 2)
    command = ObjectController(grasp, settings).step(state, desired)
    posture = 400.0 * (grasp.q - state.q) - 40.0 * state.v
    J = jacobian(grasp, state, command)
    free = np.linalg.svd(J)[2][np.linalg.matrix_rank(J, tol=1e-6) :]  # joint motions that move no contact
    np.testing.assert_allclose(free @ command.joint_acceleration, free @ posture, rtol=1e-9)
    if name.startswith("allegro"):  # three fingers of four joints, and an idle ring finger
        assert len(free) == 3 + 4
        ring = list(grasp.hand.finger("ring").joints)
        np.testing.assert_allclose(command.joint_acceleration[ring], posture[ring], rtol=1e-12)


@pytest.mark.parametrize("name", ["allegro_right sphere", "four_finger box"])
def test_null_space_of_the_contacts_follows_the_desired_joint_motion(name: str) -> None:
    """There q̈ = a_d + 40 (v_d − v) + 400 (q_d − q), and the object's motion is unchanged."""
    grasp, settings = named_grasp(name), settings_with()
    state, desired = disturbed(grasp, 2)
    rng = np.random.default_rng(8)
    q, v, a = grasp.q + 0.02 * rng.normal(size=grasp.hand.n), *rng.normal(size=(2, grasp.hand.n))
    plain = ObjectController(grasp, settings).step(state, desired)
    command = ObjectController(grasp, settings).step(state, GraspMotion(desired, q, v, a))
    np.testing.assert_array_equal(command.acceleration, plain.acceleration)
    np.testing.assert_array_equal(command.w, plain.w)
    posture = a + 40.0 * (v - state.v) + 400.0 * (q - state.q)  # rad/s²
    J = jacobian(grasp, state, command)
    free = np.linalg.svd(J)[2][np.linalg.matrix_rank(J, tol=1e-6) :]  # joint motions that move no contact
    np.testing.assert_allclose(free @ command.joint_acceleration, free @ posture, rtol=1e-9)
    moved = J @ (command.joint_acceleration - plain.joint_acceleration)  # m/s²: the contacts accelerate as before
    np.testing.assert_allclose(moved, 0.0, atol=1e-12 * np.abs(posture).max())
    with pytest.raises(InvalidInput, match=rf"desired\.q = .*{grasp.hand.n} numbers, one for each motor of {grasp.hand.name}"):
        ObjectController(grasp, settings).step(state, GraspMotion(desired, q[:-1], v[:-1], a[:-1]))
    with pytest.raises(InvalidInput, match="a = "):
        GraspMotion(desired, q, v, a[:-1])


@pytest.mark.parametrize("name", ["allegro_right box", "dlr_hit2 sphere"])
def test_far_desired_joint_positions_leave_torque_for_the_forces(name: str) -> None:
    """The pull towards a joint position is limited to the one that brings the joint at its speed limit."""
    grasp, rng = named_grasp(name), np.random.default_rng(31)
    for _ in range(10):
        far = grasp.q + rng.choice([-30.0, 30.0], grasp.hand.n)  # rad
        motion = GraspMotion(pose_at_rest(grasp), far, np.zeros(grasp.hand.n), np.zeros(grasp.hand.n))
        command = ObjectController(grasp, settings_with(gravity_H=[0.0, 0.0, -9.81])).step(state_at_rest(grasp), motion)
        assert not command.forces_reused
        limit = 40.0 * grasp.hand.velocity_limit * (1.0 + 1e-12)  # rad/s²
        idle = sorted(set(range(grasp.hand.n)) - {j for f in grasp.fingers for j in grasp.hand.finger(f).joints})
        np.testing.assert_allclose(np.abs(command.joint_acceleration[idle]), limit[idle], rtol=1e-9)
        np.testing.assert_allclose(command.acceleration, 0.0, atol=1e-12)


# ── integral ──────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_infeasible_forces_reuse_the_last_ones_and_stop_the_integral() -> None:
    grasp = named_grasp("four_finger box")
    law = ObjectControlLaw(grasp, settings_with())
    off = BodyMotion(grasp.p_HO + np.array([1e-4, 0.0, 0.0]), grasp.R_HO)
    before, memory = law.step(law.initial_memory(), state_at_rest(grasp), off)
    assert memory.integral[0] == pytest.approx(1e-7)  # m·s: 0.1 mm for a millisecond
    pull = np.array([0.0, 0.0, -100.0, 0.0, 0.0, 0.0])  # N: more than friction can carry
    command, after = law.step(memory, state_at_rest(grasp), off, pull)
    assert command.forces_reused
    assert not command.solution.found
    assert command.solution.certificate is not None  # infeasibility is certified
    np.testing.assert_array_equal(command.f, before.f)
    np.testing.assert_array_equal(after.integral, memory.integral)
    assert "last forces are reused" in command.warnings[-1]
    again, later = law.step(after, state_at_rest(grasp), off)
    assert not again.forces_reused
    assert later.integral[0] == pytest.approx(2e-7)


def test_integral_stops_while_a_motor_is_saturated() -> None:
    """An idle finger far from its posture saturates its motor."""
    grasp = named_grasp("allegro_right sphere")
    law = ObjectControlLaw(grasp, settings_with(slip_margin=0.1))
    q = np.array(grasp.q)
    q[list(grasp.hand.finger("ring").joints)] += 1.0
    off = BodyMotion(grasp.p_HO + np.array([1e-4, 0.0, 0.0]), grasp.R_HO)
    fast = replace(law.settings, posture_stiffness=4e4)
    for settings, saturated in ((law.settings, False), (fast, True)):
        law = ObjectControlLaw(grasp, settings)
        command, memory = law.step(law.initial_memory(), GraspState(q, np.zeros(16), pose_at_rest(grasp)), off)
        assert command.saturated is saturated
        assert not command.forces_reused
        assert bool(memory.integral[0] == 0.0) is saturated
        assert (np.abs(command.tau) <= grasp.hand.torque_upper).all()


def test_integral_grows_with_the_error_up_to_its_limit() -> None:
    grasp = named_grasp("four_finger sphere")
    settings = settings_with(integral_limit_linear=0.02, integral_limit_angular=0.1)
    controller = ObjectController(grasp, settings)
    off = BodyMotion(grasp.p_HO + np.array([3e-5, 0.0, -4e-5]), grasp.R_HO)
    first = controller.step(state_at_rest(grasp), off)
    second = controller.step(state_at_rest(grasp), off)
    np.testing.assert_allclose(second.acceleration - first.acceleration, 8.0 * first.error, atol=1e-12)  # ki × 1 ms
    for _ in range(60):
        last = controller.step(state_at_rest(grasp), off)
    np.testing.assert_allclose(last.acceleration - first.acceleration, [0.012, 0, -0.016, 0, 0, 0], atol=1e-9)
    controller.reset()
    np.testing.assert_allclose(controller.step(state_at_rest(grasp), off).acceleration, first.acceleration, atol=1e-12)


# ── arguments ─────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_law_is_stateless_except_for_warm_starts() -> None:
    """What a law solved before changes nothing but the solver's start."""
    grasp = named_grasp("allegro_right sphere")
    fresh, used = ObjectControlLaw(grasp, settings_with()), ObjectControlLaw(grasp, settings_with())
    memory = used.initial_memory()
    for seed in range(5):
        _, memory = used.step(memory, *disturbed(grasp, seed))
    kept = [np.array(x) for x in (memory.integral, memory.R_OC, memory.creep, memory.f)]
    one, after_one = fresh.step(memory, *disturbed(grasp, 9))
    two, after_two = used.step(memory, *disturbed(grasp, 9))
    np.testing.assert_allclose(one.tau, two.tau, atol=1e-5)  # the root of the solver's tolerance
    np.testing.assert_array_equal(one.w, two.w)
    for name in ("integral", "R_OC", "creep"):
        np.testing.assert_array_equal(getattr(after_one, name), getattr(after_two, name))
    for x, y in zip(kept, (memory.integral, memory.R_OC, memory.creep, memory.f), strict=True):
        np.testing.assert_array_equal(x, y)


def test_states_of_other_hands_and_invalid_numbers_are_named() -> None:
    grasp = named_grasp("four_finger box")
    controller = ObjectController(grasp)
    with pytest.raises(InvalidInput, match=r"state\.q = .*12 numbers, one for each motor of four_finger"):
        controller.step(GraspState(np.zeros(16), np.zeros(16), pose_at_rest(grasp)), pose_at_rest(grasp))
    with pytest.raises(InvalidInput, match="external"):
        controller.step(state_at_rest(grasp), pose_at_rest(grasp), [0.0, 0.0, np.nan, 0.0, 0.0, 0.0])
    far = GraspState(grasp.q, np.zeros(12), BodyMotion(np.full(3, np.finfo(float).max), grasp.R_HO))
    with pytest.raises(InvalidInput, match="state"), np.errstate(all="ignore"):
        controller.step(far, pose_at_rest(grasp))
    with pytest.raises(InvalidInput, match="v = "):
        GraspState(np.zeros(12), np.zeros(11), pose_at_rest(grasp))
