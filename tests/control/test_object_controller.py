"""One step of the held object's controller: every equation of the law, worked out by another way."""

from __future__ import annotations

import copy
import pickle
from dataclasses import fields, replace

import clarabel
import numpy as np
import pytest
import scipy.sparse as sp
from scipy.spatial.transform import Rotation
from support.control_grasps import GRASP_NAMES, named_grasp

from graspforce import ContactSet, InvalidInput
from graspforce.contact import compiled_kinematics
from graspforce.contact.matrices import grasp_matrix
from graspforce.contact.motion import BodyMotion
from graspforce.control import (
    Command,
    ControlSettings,
    GraspMotion,
    GraspState,
    ObjectController,
    PoseGains,
    mobility,
    object_controller,
)
from graspforce.control.object_controller import ObjectControlLaw
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp

QUICK = [name for name in GRASP_NAMES if not name.endswith("superquadric")]  # whose nearest point takes milliseconds
GRAVITY = np.array([3.0, -5.0, -7.8])  # m/s², off the axes


@pytest.fixture(params=["compiled", "python"], autouse=True)
def arithmetic(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every test is of the law, whoever computes it."""
    if request.param == "python":
        for room in (object_controller, compiled_kinematics, mobility):
            monkeypatch.setattr(room, "native", None)
    elif object_controller.native is None:
        pytest.skip("the laws were not built: no C compiler at installation")


def resting(grasp: Grasp) -> BodyMotion:
    return BodyMotion(grasp.p_HO, grasp.R_HO)


def still(grasp: Grasp) -> GraspState:
    return GraspState(grasp.q, np.zeros(grasp.hand.n), resting(grasp))


def disturbed(grasp: Grasp, seed: int) -> tuple[GraspState, BodyMotion]:
    """A state near the hold in which everything moves, and a desired motion elsewhere."""
    rng = np.random.default_rng(seed)

    def near(p: float, turn: float, speed: float, acceleration: float = 0.0) -> BodyMotion:
        R = Rotation.from_rotvec(turn * rng.normal(size=3)).as_matrix() @ grasp.R_HO
        rates = rng.normal(size=6) * speed * np.repeat([0.03, 1.0], 3)
        return BodyMotion(grasp.p_HO + p * rng.normal(size=3), R, rates, acceleration * rng.normal(size=6))

    q, v = grasp.q + 2e-3 * rng.normal(size=grasp.hand.n), 0.1 * rng.normal(size=grasp.hand.n)
    return GraspState(q, v, near(1e-4, 1e-3, 0.1)), near(2e-4, 3e-3, 0.3, 0.2)


def settings_of(**change) -> ControlSettings:
    return ControlSettings(**{"gravity_H": GRAVITY, "slip_margin": 0.3, **change})


def jacobian(grasp: Grasp, state: GraspState, command: Command) -> np.ndarray:
    return grasp.hand.contact_jacobian(state.q, grasp.fingers, command.contacts, state.object.p_HO, state.object.R_HO)


@pytest.mark.parametrize("name", QUICK)
def test_every_equation_of_the_law_holds(name: str) -> None:
    grasp, settings = named_grasp(name), settings_of()
    controller = ObjectController(grasp, settings)
    for seed in range(4):
        state, desired = disturbed(grasp, seed)
        controller.reset()
        command = controller.step(state, desired)
        now, hand = state.object, grasp.hand
        assert command.solution.found
        assert not command.forces_reused

        # The acceleration, by SciPy's logarithm; no integral yet.
        turn = Rotation.from_matrix(desired.R_HO @ now.R_HO.T).as_rotvec()
        error = np.array([*(desired.p_HO - now.p_HO), *turn])
        wanted = desired.acceleration + 80.0 * (desired.twist - now.twist) + 1600.0 * error
        np.testing.assert_allclose(command.error, error, atol=1e-14)
        if len(command.uncontrollable) == 0:
            np.testing.assert_allclose(command.acceleration, wanted, rtol=1e-12)

        # Newton and Euler, and G f = w about O, both by the rooms that own them.
        w = grasp.body.wrench(BodyMotion(now.p_HO, now.R_HO, now.twist, command.acceleration), GRAVITY)
        np.testing.assert_allclose(command.w, w, atol=1e-14)
        scale = np.abs(command.f).max()  # N; the certificate's 1e-8 is relative to forces of this size
        np.testing.assert_allclose(grasp_matrix(command.contacts) @ command.f, w, atol=1e-7 * scale)

        # The motors: inertia, Coriolis, gravity and the contacts.
        a = command.joint_acceleration
        J = jacobian(grasp, state, command)
        tau = hand.inverse_dynamics(state.q, state.v, a, GRAVITY) + J.T @ command.f
        np.testing.assert_allclose(command.tau, tau, atol=1e-12)
        assert (np.abs(command.tau) <= hand.torque_upper * (1.0 + 1e-7)).all()

        # Cones with the margin and the reserve.
        f = command.f.reshape(-1, 3)
        slip = 0.7 * f[:, 2] - np.hypot(f[:, 0], f[:, 1])
        np.testing.assert_allclose(command.slip_margin, slip, atol=1e-12)
        assert (slip >= 0.3 + 0.07 * f[:, 2] - 1e-7 * scale).all()


@pytest.mark.parametrize("name", QUICK)
def test_the_forces_cost_least_among_those_with_the_margin(name: str) -> None:
    """A second program, with ‖f_t‖ ≤ μ f_n − s written as it stands, by Clarabel on its own."""
    grasp, settings = named_grasp(name), settings_of(force_weight=0.0)
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
    other = clarabel.DefaultSolver(P, J @ W @ tau_u, A, np.concatenate(offsets), cones, quiet).solve()

    def cost(f: np.ndarray) -> float:
        tau = tau_u + J.T @ f
        return 0.5 * float(tau @ W @ tau)

    # The kernel answers to 1e-8 of the cost; forces follow to its root where they are determined at all.
    assert cost(command.f) == pytest.approx(cost(np.array(other.x)), rel=1e-6)
    if not len(command.uncontrollable):
        np.testing.assert_allclose(command.f, other.x, atol=1e-3)


@pytest.mark.parametrize("name", ["dlr_hit2 sphere", "anthropomorphic15"])
def test_bare_tips_keep_up_with_the_object(name: str) -> None:
    """The finger's point at each contact accelerates as the object's, J̇ q̇ included. Round tips have tests of their own."""
    grasp = named_grasp(name)
    state, desired = disturbed(grasp, 1)
    command = ObjectController(grasp, settings_of()).step(state, desired)
    v, now, h = state.v, state.object, 1e-6
    tips, a = grasp.hand.tip_motion(state.q, v, grasp.fingers), command.joint_acceleration
    arms = grasp.contacts.p_OC @ now.R_HO.T
    omega, alpha = now.twist[3:], command.acceleration[3:]
    ahead, behind = (
        grasp.hand.tip_motion(state.q + s * h * v + h**2 / 2 * a, v + s * h * a, grasp.fingers) for s in (1.0, -1.0)
    )
    for i, arm in enumerate(arms):
        point = command.acceleration[:3] + np.cross(alpha, arm) + np.cross(omega, np.cross(omega, arm))
        # The state is a little off the contacts: the finger's point is the one that is there now, off the tip by `lever`.
        lever = now.p_HO + arm - tips.p_HF[i]
        rate = now.twist[:3] + np.cross(omega, arm) - tips.twist[i, :3]
        finger = (ahead.twist[i] - behind.twist[i]) / (2 * h)
        finger = finger[:3] + np.cross(finger[3:], lever) + np.cross(tips.twist[i, 3:], rate)
        # Rounding 1e-16/h, truncation h². Five planar fingers cannot all have the rates of this state: the squares of what is
        # amiss in them, (0.01 rad/s)², stay.
        np.testing.assert_allclose(finger, point, atol=1e-4 if name == "anthropomorphic15" else 1e-8)


def test_at_rest_the_contacts_bear_the_weight_whichever_way_the_hand_is_turned() -> None:
    """Gravity in six directions: the wrench is the weight turned into O, less what else pushes."""
    grasp = named_grasp("allegro_right cylinder")
    for g in [sign * 9.81 * axis for axis in np.eye(3) for sign in (1.0, -1.0)]:
        controller = ObjectController(grasp, settings_of(gravity_H=g))
        command = controller.step(still(grasp), resting(grasp))
        np.testing.assert_allclose(command.w, [*(-0.05 * g @ grasp.R_HO), 0.0, 0.0, 0.0], atol=1e-15)
        np.testing.assert_allclose(command.joint_acceleration, 0.0, atol=1e-12)
        push = np.array([0.1, 0.0, -0.2, 0.001, 0.0, 0.0])
        np.testing.assert_allclose(controller.step(still(grasp), resting(grasp), push).w, command.w - push, atol=1e-15)


@pytest.mark.parametrize("name", ["allegro_right box", "dlr_hit2 sphere", "anthropomorphic15"])
def test_where_the_object_s_frame_stands_makes_no_difference(name: str) -> None:
    """The same body, its frame O shifted and turned: the same torques, for the same motion."""
    grasp, settings = named_grasp(name), settings_of(gains=PoseGains.critically_damped(0.0, 0.0), rank_tolerance=0.005)
    shift, turn = np.array([0.01, -0.02, 0.015]), Rotation.from_rotvec([0.5, -0.7, 0.9]).as_matrix()  # of O' in O
    body = Body(grasp.body.mass, turn.T @ grasp.body.inertia @ turn, (grasp.body.p_OM - shift) @ turn)
    c = grasp.contacts
    there = replace(c, p_OC=(c.p_OC - shift) @ turn, R_OC=turn.T @ c.R_OC)
    plain = replace(grasp, body=Body(grasp.body.mass, grasp.body.inertia, grasp.body.p_OM))  # both without a shape: flat
    moved = Grasp(grasp.hand, body, grasp.fingers, there, grasp.q, grasp.p_HO + grasp.R_HO @ shift, grasp.R_HO @ turn)

    def seen(motion: BodyMotion) -> BodyMotion:
        arm, (v, omega), (a, alpha) = motion.R_HO @ shift, np.split(motion.twist, 2), np.split(motion.acceleration, 2)
        twist = [*(v + np.cross(omega, arm)), *omega]
        rates = [*(a + np.cross(alpha, arm) + np.cross(omega, np.cross(omega, arm))), *alpha]
        return BodyMotion(motion.p_HO + arm, motion.R_HO @ turn, twist, rates)

    state, desired = disturbed(grasp, 5)
    desired = replace(state.object, acceleration=desired.acceleration)
    here = ObjectController(plain, settings).step(state, desired)
    other = ObjectController(moved, settings).step(GraspState(state.q, state.v, seen(state.object)), seen(desired))
    np.testing.assert_allclose(other.joint_acceleration, here.joint_acceleration, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(other.tau, here.tau, atol=1e-5)  # the solver's answer, to the root of its 1e-9
    np.testing.assert_allclose(other.w[:3], turn.T @ here.w[:3], atol=1e-10)
    assert len(other.uncontrollable) == len(here.uncontrollable)


@pytest.mark.parametrize("name", ["allegro_right sphere", "four_finger box"])
def test_what_the_contacts_leave_free_keeps_the_posture(name: str) -> None:
    """The joint accelerations differ from the posture's wish only where the contacts need it; idle fingers do as they wish."""
    grasp, settings = named_grasp(name), settings_of()
    state, desired = disturbed(grasp, 2)
    command = ObjectController(grasp, settings).step(state, desired)
    wish = 400.0 * (grasp.q - state.q) - 40.0 * state.v
    J = jacobian(grasp, state, command)
    free = np.linalg.svd(J)[2][np.linalg.matrix_rank(J, tol=1e-6) :]  # joint motions that move no contact
    np.testing.assert_allclose(free @ command.joint_acceleration, free @ wish, rtol=1e-9)
    if name.startswith("allegro"):  # three fingers of four joints hold, the ring finger is idle
        assert len(free) == 3 + 4
        ring = list(grasp.hand.finger("ring").joints)
        np.testing.assert_allclose(command.joint_acceleration[ring], wish[ring], rtol=1e-12)


@pytest.mark.parametrize("name", ["allegro_right sphere", "four_finger box"])
def test_what_the_contacts_leave_free_follows_the_joints_that_are_wanted(name: str) -> None:
    """q̈ = a_d + 40 (v_d − v) + 400 (q_d − q) where no contact says otherwise; to the object it makes no difference."""
    grasp, settings = named_grasp(name), settings_of()
    state, desired = disturbed(grasp, 2)
    rng = np.random.default_rng(8)
    q, v, a = grasp.q + 0.02 * rng.normal(size=grasp.hand.n), *rng.normal(size=(2, grasp.hand.n))
    plain = ObjectController(grasp, settings).step(state, desired)
    command = ObjectController(grasp, settings).step(state, GraspMotion(desired, q, v, a))
    np.testing.assert_array_equal(command.acceleration, plain.acceleration)
    np.testing.assert_array_equal(command.w, plain.w)
    wish = a + 40.0 * (v - state.v) + 400.0 * (q - state.q)  # rad/s²
    J = jacobian(grasp, state, command)
    free = np.linalg.svd(J)[2][np.linalg.matrix_rank(J, tol=1e-6) :]  # joint motions that move no contact
    np.testing.assert_allclose(free @ command.joint_acceleration, free @ wish, rtol=1e-9)
    moved = J @ (command.joint_acceleration - plain.joint_acceleration)  # m/s²: contacts go where they went
    np.testing.assert_allclose(moved, 0.0, atol=1e-12 * np.abs(wish).max())
    with pytest.raises(InvalidInput, match=rf"desired\.q = .*{grasp.hand.n} numbers, one for each motor of {grasp.hand.name}"):
        ObjectController(grasp, settings).step(state, GraspMotion(desired, q[:-1], v[:-1], a[:-1]))
    with pytest.raises(InvalidInput, match="a = "):
        GraspMotion(desired, q, v, a[:-1])


@pytest.mark.parametrize("name", ["allegro_right box", "dlr_hit2 sphere"])
def test_whatever_is_wanted_of_the_joints_the_object_is_held(name: str) -> None:
    """A joint is pulled no harder than brings it at its speed limit, so that motors have torque left for the forces."""
    grasp, rng = named_grasp(name), np.random.default_rng(31)
    for _ in range(10):
        far = grasp.q + rng.choice([-30.0, 30.0], grasp.hand.n)  # rad
        wish = GraspMotion(resting(grasp), far, np.zeros(grasp.hand.n), np.zeros(grasp.hand.n))
        command = ObjectController(grasp, settings_of(gravity_H=[0.0, 0.0, -9.81])).step(still(grasp), wish)
        assert not command.forces_reused
        most = 40.0 * grasp.hand.velocity_limit * (1.0 + 1e-12)  # rad/s²
        idle = sorted(set(range(grasp.hand.n)) - {j for f in grasp.fingers for j in grasp.hand.finger(f).joints})
        np.testing.assert_allclose(np.abs(command.joint_acceleration[idle]), most[idle], rtol=1e-9)
        np.testing.assert_allclose(command.acceleration, 0.0, atol=1e-12)


# ── fingers that cannot move their contacts every way ─────────────────────────────────────────────────────────────────────────


def planar() -> tuple[Grasp, GraspState, BodyMotion, Command]:
    grasp = named_grasp("anthropomorphic15")
    state, desired = disturbed(grasp, 1)
    return grasp, state, desired, ObjectController(grasp, settings_of()).step(state, desired)


def test_planar_fingers_make_exactly_the_twists_that_are_not_uncontrollable() -> None:
    grasp, state, _, command = planar()
    U, R = command.uncontrollable, state.object.R_HO
    np.testing.assert_allclose(U @ U.T, np.eye(len(U)), atol=1e-12)
    J, G = jacobian(grasp, state, command), grasp_matrix(command.contacts)
    B = G.T @ np.kron(np.eye(2), R.T)  # a twist in H's axes to the contacts' velocities
    unit = np.repeat([1.0, 0.03], 3)  # so that turns count by what they move
    free = np.linalg.svd(U)[2][len(U) :]  # orthonormal
    assert 0 < len(U) < 6
    for twist in free:
        rates = np.linalg.lstsq(J, B @ twist, rcond=1e-6)[0]
        np.testing.assert_allclose(J @ rates, B @ twist, atol=1e-12)
    for twist in U / unit**2:  # each has a part that no rates make
        rates = np.linalg.lstsq(J, B @ twist, rcond=1e-6)[0]
        assert np.abs(J @ rates - B @ twist).max() > 1e-4


def test_the_commanded_acceleration_is_the_nearest_that_planar_fingers_can_make() -> None:
    """Gauss: (a − a_wanted)ᵀ M x = 0 for every acceleration x that is free, and the joints do keep the contacts."""
    grasp, state, desired, command = planar()
    now = state.object
    turn = Rotation.from_matrix(desired.R_HO @ now.R_HO.T).as_rotvec()
    error = np.array([*(desired.p_HO - now.p_HO), *turn])
    wanted = desired.acceleration + 80.0 * (desired.twist - now.twist) + 1600.0 * error
    R6 = np.kron(np.eye(2), now.R_HO)
    M = R6 @ grasp.body.mass_matrix() @ R6.T
    change = command.acceleration - wanted
    free = np.linalg.svd(command.uncontrollable)[2][len(command.uncontrollable) :]
    size = np.sqrt(change @ M @ change)
    assert size > 1e-2  # √(kg) m/s²: something was given up
    for x in free:
        assert abs(change @ M @ x) < 1e-9 * size * np.sqrt(x @ M @ x)


def test_what_the_structure_bears_loads_no_motor() -> None:
    grasp, state, _, command = planar()
    J, G = jacobian(grasp, state, command), grasp_matrix(command.contacts)
    f = command.f - J @ np.linalg.lstsq(J, command.f, rcond=1e-6)[0]  # the part of f with Jᵀ f = 0
    np.testing.assert_allclose(J.T @ f, 0.0, atol=1e-12)
    np.testing.assert_allclose(command.structural_wrench, G @ f, atol=1e-9)
    assert np.abs(command.structural_wrench[:3]).max() > 1e-2  # N


@pytest.mark.parametrize("name", [name for name in QUICK if name != "anthropomorphic15"])
def test_fingers_that_move_every_way_leave_nothing_uncontrollable(name: str) -> None:
    grasp = named_grasp(name)
    command = ObjectController(grasp, settings_of()).step(*disturbed(grasp, 1))
    assert command.uncontrollable.shape == (0, 6)
    np.testing.assert_array_equal(command.structural_wrench, 0.0)


# ── when there are no such forces ─────────────────────────────────────────────────────────────────────────────────────────────


def with_contacts(grasp: Grasp, **change) -> Grasp:
    return replace(grasp, contacts=ContactSet.stack([replace(c, **change) for c in grasp.contacts.contacts]))


def test_a_margin_that_cannot_be_kept_is_halved_then_given_up_and_said() -> None:
    grasp = with_contacts(named_grasp("four_finger box"), max_normal=2.0)
    for margin, kept in ((1.0, 1.0), (1.6, 0.8), (3.0, 0.0)):  # μ (1 − reserve) 2 N = 1.26 N of friction, less the weight's
        command = ObjectController(grasp, settings_of(slip_margin=margin)).step(still(grasp), resting(grasp))
        assert not command.forces_reused
        f = command.f.reshape(-1, 3)
        assert (0.63 * f[:, 2] - np.hypot(f[:, 0], f[:, 1]) >= kept - 1e-6).all()
        assert len(command.warnings) == (0 if kept == margin else 1)
        if kept == 0.8:
            assert "the full slip margin is infeasible: half of it is kept, 0.8 N" in command.warnings[0]
        if kept == 0.0:
            assert "only the friction reserve is kept, 10 %" in command.warnings[0]


def test_without_any_forces_the_last_ones_are_held_and_the_integral_waits() -> None:
    grasp = named_grasp("four_finger box")
    law = ObjectControlLaw(grasp, settings_of())
    off = BodyMotion(grasp.p_HO + np.array([1e-4, 0.0, 0.0]), grasp.R_HO)
    before, memory = law.step(law.initial_memory(), still(grasp), off)
    assert memory.integral[0] == pytest.approx(1e-7)  # m·s: 0.1 mm for a millisecond
    pulled = np.array([0.0, 0.0, -100.0, 0.0, 0.0, 0.0])  # N: more than any friction holds
    command, after = law.step(memory, still(grasp), off, pulled)
    assert command.forces_reused
    assert not command.solution.found
    assert command.solution.certificate is not None  # proven, not given up
    np.testing.assert_array_equal(command.f, before.f)
    np.testing.assert_array_equal(after.integral, memory.integral)
    assert "last forces are reused" in command.warnings[-1]
    again, later = law.step(after, still(grasp), off)
    assert not again.forces_reused
    assert later.integral[0] == pytest.approx(2e-7)


def test_the_integral_waits_while_a_motor_is_at_its_limit() -> None:
    """A finger that holds nothing is far from its posture: its motor saturates, and every integral waits with it."""
    grasp = named_grasp("allegro_right sphere")
    law = ObjectControlLaw(grasp, settings_of(slip_margin=0.1))
    q = np.array(grasp.q)
    q[list(grasp.hand.finger("ring").joints)] += 1.0
    off = BodyMotion(grasp.p_HO + np.array([1e-4, 0.0, 0.0]), grasp.R_HO)
    fast = replace(law.settings, posture_stiffness=4e4)
    for settings, waits in ((law.settings, False), (fast, True)):
        law = ObjectControlLaw(grasp, settings)
        command, memory = law.step(law.initial_memory(), GraspState(q, np.zeros(16), resting(grasp)), off)
        assert command.saturated is waits
        assert not command.forces_reused
        assert bool(memory.integral[0] == 0.0) is waits
        assert (np.abs(command.tau) <= grasp.hand.torque_upper).all()


def test_the_integral_grows_with_the_error_up_to_its_limit_and_is_felt() -> None:
    grasp = named_grasp("four_finger sphere")
    settings = settings_of(integral_limit_linear=0.02, integral_limit_angular=0.1)
    controller = ObjectController(grasp, settings)
    off = BodyMotion(grasp.p_HO + np.array([3e-5, 0.0, -4e-5]), grasp.R_HO)
    first = controller.step(still(grasp), off)
    second = controller.step(still(grasp), off)
    np.testing.assert_allclose(
        second.acceleration - first.acceleration, 8.0 * first.error, atol=1e-12
    )  # ki times a millisecond
    for _ in range(60):
        last = controller.step(still(grasp), off)
    np.testing.assert_allclose(last.acceleration - first.acceleration, [0.012, 0, -0.016, 0, 0, 0], atol=1e-9)
    controller.reset()
    np.testing.assert_allclose(controller.step(still(grasp), off).acceleration, first.acceleration, atol=1e-12)


# ── sliding ───────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_a_finger_that_slips_is_named_before_the_object_has_moved_half_a_millimetre() -> None:
    """The object sinks between the fingers at 2 mm/s; all slide. Then one finger alone is pulled along."""
    grasp = named_grasp("four_finger box")
    controller, speed = ObjectController(grasp, settings_of()), np.array([0.0, 0.0, -2e-3])
    warned = None
    for i in range(300):
        motion = BodyMotion(grasp.p_HO + 1e-3 * i * speed, grasp.R_HO, [*speed, 0.0, 0.0, 0.0])
        command = controller.step(GraspState(grasp.q, np.zeros(12), motion), resting(grasp))
        if command.warnings and warned is None:
            warned = np.linalg.norm(motion.p_HO - grasp.p_HO)
            assert [said.split()[:2] for said in command.warnings] == [[finger, "slips:"] for finger in grasp.fingers]
            np.testing.assert_allclose(command.creep, warned, rtol=0.06)  # forgotten with 1 s, after 0.05 s
    assert warned is not None
    assert 1e-4 <= warned < 5e-4

    controller.reset()
    J = grasp.hand.contact_jacobian(grasp.q, grasp.fingers, grasp.contacts, grasp.p_HO, grasp.R_HO)
    v = np.linalg.lstsq(J, [0.0] * 3 + [0.005, 0.0, 0.0] + [0.0] * 6, rcond=None)[0]
    for i in range(31):
        command = controller.step(GraspState(grasp.q + 1e-3 * i * v, v, resting(grasp)), resting(grasp))
    assert [said.split()[0] for said in command.warnings] == ["finger_2"]
    np.testing.assert_allclose(command.creep, [0.0, 1.5e-4, 0.0, 0.0], atol=5e-6)


def test_rolling_far_and_fast_is_not_sliding() -> None:
    """The object goes to and fro with its fingers, 6 mm at 3 Hz, and the rates that are told are half a period old."""
    grasp, period = named_grasp("allegro_right sphere"), 1e-3
    law = ObjectControlLaw(grasp, settings_of())
    memory, q, v, farthest = law.initial_memory(), np.array(grasp.q), np.zeros(16), 0.0

    def place(t: float) -> np.ndarray:
        return grasp.p_HO + np.array([0.0, 3e-3 * (1.0 - np.cos(6.0 * np.pi * t)), 0.0])

    def rates(q: np.ndarray, t: float) -> np.ndarray:
        """With which the fingers' points at the contacts keep up with the object, on the sphere alone."""
        velocity = np.array([0.0, 18e-3 * np.pi * np.sin(6.0 * np.pi * t), 0.0])  # m/s
        rows = []
        for finger in grasp.fingers:
            c = grasp.hand.tip_pose(q, finger)[0] - place(t)
            rows.append(grasp.hand.point_jacobian(q, finger, place(t) + 0.03 * c / np.linalg.norm(c))[:3])
        return np.linalg.lstsq(np.vstack(rows), np.tile(velocity, 3), rcond=None)[0]

    for i in range(700):
        t = i * period
        command, memory = law.step(memory, GraspState(q, v, BodyMotion(place(t), grasp.R_HO)), resting(grasp))
        assert command.creep.max() < 1e-5  # m: a tenth of what is called slipping
        farthest = max(farthest, float(np.linalg.norm(command.contacts.p_OC - grasp.contacts.p_OC, axis=1).max()))
        v = rates(q + period / 2 * rates(q, t), t + period / 2)
        q = q + period * v
    assert farthest > 1e-3  # m: the contacts went over the sphere


def test_a_joint_at_the_end_of_its_range_is_named() -> None:
    grasp = named_grasp("four_finger box")
    q = np.array(grasp.q)
    q[4] = grasp.hand.q_upper[4] + 1e-3
    said = ObjectController(grasp, settings_of()).step(GraspState(q, np.zeros(12), resting(grasp)), resting(grasp)).warnings
    assert f"{grasp.hand.joints[4].name} is at its position limit: {q[4]:.3f} rad" in said


def test_the_integral_does_not_wind_up_where_planar_fingers_cannot_push() -> None:
    grasp = named_grasp("anthropomorphic15")
    law = ObjectControlLaw(grasp, settings_of())
    off = BodyMotion(grasp.p_HO + np.array([1e-4, 2e-4, -1e-4]), grasp.R_HO)
    command, memory = law.step(law.initial_memory(), still(grasp), off)
    np.testing.assert_allclose(command.uncontrollable @ memory.integral, 0.0, atol=1e-18)
    assert np.linalg.norm(memory.integral) > 1e-8


def test_a_finger_that_has_left_the_object_is_named() -> None:
    grasp = named_grasp("four_finger box")
    q = np.array(grasp.q)
    grown = replace(grasp.contacts, p_OC=grasp.contacts.p_OC * np.array([[1.0 + 2e-3 / 0.03, 1.0, 1.0]] + [[1.0] * 3] * 3))
    q = grasp.hand.grasp_posture(grasp.fingers, grown, grasp.p_HO, grasp.R_HO, grasp.q)
    command = ObjectController(grasp, settings_of()).step(GraspState(q, np.zeros(12), resting(grasp)), resting(grasp))
    assert command.warnings == ("finger_1 has lost contact: 2.00 mm from the object",)


# ── pure, and checked ─────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_a_step_depends_on_its_arguments_alone() -> None:
    """What a law solved before changes nothing but the solver's start."""
    grasp = named_grasp("allegro_right sphere")
    fresh, used = ObjectControlLaw(grasp, settings_of()), ObjectControlLaw(grasp, settings_of())
    memory = used.initial_memory()
    for seed in range(5):
        _, memory = used.step(memory, *disturbed(grasp, seed))
    kept = [np.array(x) for x in (memory.integral, memory.R_OC, memory.creep, memory.f)]
    one, after_one = fresh.step(memory, *disturbed(grasp, 9))
    two, after_two = used.step(memory, *disturbed(grasp, 9))
    np.testing.assert_allclose(one.tau, two.tau, atol=1e-5)  # the solver's answer, to the root of its 1e-9
    np.testing.assert_array_equal(one.w, two.w)
    for name in ("integral", "R_OC", "creep"):
        np.testing.assert_array_equal(getattr(after_one, name), getattr(after_two, name))
    for x, y in zip(kept, (memory.integral, memory.R_OC, memory.creep, memory.f), strict=True):
        np.testing.assert_array_equal(x, y)


def test_a_body_of_which_no_accelerations_follow_is_refused() -> None:
    """Planar fingers bear part of it, so its mass matrix is inverted, of which the numbers are too large."""
    grasp = replace(named_grasp("anthropomorphic15"), body=Body(1.0, 1e-300 * np.eye(3), [1e160, 0.0, 0.0]))
    with pytest.raises(InvalidInput, match=r"body = .* finite accelerations"):
        ObjectController(grasp).step(still(grasp), resting(grasp))


@pytest.mark.parametrize("name", ["allegro_right box", "anthropomorphic15"])
def test_a_command_can_be_copied_and_sent_to_another_process(name: str) -> None:
    """With its solution and proof, and without what it was made of."""
    controller = ObjectController(named_grasp(name))
    state, desired = disturbed(controller.grasp, 9)
    for command in (controller.step(state, desired), controller.step(state, desired)):
        for same in (pickle.loads(pickle.dumps(command)), copy.deepcopy(command), replace(command)):
            for each in fields(Command):
                if isinstance(getattr(command, each.name), np.ndarray):
                    np.testing.assert_array_equal(getattr(same, each.name), getattr(command, each.name))
            np.testing.assert_array_equal(same.contacts.R_OC, command.contacts.R_OC)
            assert (same.warnings, same.forces_reused) == (command.warnings, command.forces_reused)
            assert same.solution.status is command.solution.status
            np.testing.assert_array_equal(same.solution.f, command.solution.f)
            assert same.solution.certificate.gap == command.solution.certificate.gap
            np.testing.assert_array_equal(same.solution.problem.w, command.solution.problem.w)


@pytest.mark.parametrize("name", ["allegro_right box", "four_finger superquadric", "dlr_hit2 sphere"])
def test_nobody_can_write_to_what_the_next_step_goes_on_from(name: str) -> None:
    """A command shows the contacts of the controller's own memory."""
    controller = ObjectController(named_grasp(name))
    state, desired = disturbed(controller.grasp, 8)
    for _ in range(2):  # the second begins where tips stood
        command, memory = controller.step(state, desired), controller.memory
        assert memory.tip_contacts is not None
        kept = [
            memory.integral,
            memory.R_OC,
            memory.creep,
            memory.tip_contacts.p_OF,
            memory.tip_contacts.R_OF,
            memory.tip_contacts.p_OC,
        ]
        for array in (*kept, command.tau, command.f, command.creep, command.contacts.p_OC, command.contacts.R_OC):
            with pytest.raises(ValueError, match="read-only"):
                array[...] = 0.0


def test_frictionless_and_soft_contacts_are_planned_too() -> None:
    """A soft finger's moment counts in the margin; a contact without friction has no margin to keep and only pushes."""
    grasp = named_grasp("four_finger box")
    soft = with_contacts(grasp, model="soft", torsional_friction=0.005)
    command = ObjectController(soft, settings_of()).step(*disturbed(soft, 1))
    assert command.f.shape == (16,)
    f = command.f.reshape(-1, 4)
    load = np.sqrt(f[:, 0] ** 2 + f[:, 1] ** 2 + (0.63 * f[:, 3] / 0.005) ** 2)
    assert (load <= 0.63 * f[:, 2] - 0.3 + 1e-6).all()
    np.testing.assert_allclose(grasp_matrix(command.contacts) @ command.f, command.w, atol=1e-6)

    contacts = [*grasp.contacts.contacts[:3], replace(grasp.contacts.contacts[3], model="frictionless", friction=None)]
    slick = replace(grasp, contacts=ContactSet.stack(contacts))
    command = ObjectController(slick, settings_of()).step(*disturbed(slick, 1))
    assert command.f.shape == (10,)
    assert not command.warnings
    np.testing.assert_allclose(grasp_matrix(command.contacts) @ command.f, command.w, atol=1e-6)


def test_soft_fingers_of_three_joints_tie_what_they_cannot_follow() -> None:
    """Sixteen rows for twelve joints: what forces that load none bear, and what the object is kept from, by least squares."""
    soft = with_contacts(named_grasp("four_finger box"), model="soft", torsional_friction=0.005)
    state, desired = disturbed(soft, 2)
    command = ObjectController(soft, settings_of()).step(state, desired)
    J, G = jacobian(soft, state, command), grasp_matrix(command.contacts)
    unit = np.tile([1.0, 1.0, 1.0, 0.03], 4)  # a spin counts as the speed that it makes 30 mm off n
    rows, f = unit[:, None] * J, command.f / unit
    bare = f - rows @ np.linalg.lstsq(rows, f, rcond=1e-6)[0]  # the part of f with Jᵀ f = 0
    np.testing.assert_allclose(command.structural_wrench, G @ (unit * bare), atol=1e-9)
    assert np.abs(command.structural_wrench).max() > 1e-4  # N and N·m
    U, B = command.uncontrollable, G.T @ np.kron(np.eye(2), state.object.R_HO.T)
    assert 0 < len(U) <= 4
    for twist in np.linalg.svd(U)[2][len(U) :]:
        rates = np.linalg.lstsq(J, B @ twist, rcond=1e-6)[0]
        np.testing.assert_allclose(J @ rates, B @ twist, atol=1e-12)


def test_an_error_that_the_fingers_cannot_take_away_is_told() -> None:
    """Soft fingers of three joints about a sphere cannot lift it without spinning; point contacts can."""
    points = named_grasp("four_finger sphere")
    soft = with_contacts(points, model="soft", torsional_friction=0.005)
    for off, told in ((2e-3, True), (5e-4, False)):
        desired = BodyMotion(points.p_HO + np.array([0.0, 0.0, off]), points.R_HO)
        said = ObjectController(soft, settings_of()).step(still(soft), desired).warnings
        assert any("cannot make all of this motion" in text for text in said) is told
        assert not ObjectController(points, settings_of()).step(still(points), desired).warnings


def test_the_state_must_be_this_hand_s() -> None:
    grasp = named_grasp("four_finger box")
    controller = ObjectController(grasp)
    with pytest.raises(InvalidInput, match=r"state\.q = .*12 numbers, one for each motor of four_finger"):
        controller.step(GraspState(np.zeros(16), np.zeros(16), resting(grasp)), resting(grasp))
    with pytest.raises(InvalidInput, match="external"):
        controller.step(still(grasp), resting(grasp), [0.0, 0.0, np.nan, 0.0, 0.0, 0.0])
    far = GraspState(grasp.q, np.zeros(12), BodyMotion(np.full(3, np.finfo(float).max), grasp.R_HO))
    with pytest.raises(InvalidInput, match="state"), np.errstate(all="ignore"):
        controller.step(far, resting(grasp))
    with pytest.raises(InvalidInput, match="v = "):
        GraspState(np.zeros(12), np.zeros(11), resting(grasp))


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"slip_margin": -0.1}, "slip_margin"),
        ({"friction_reserve": 1.0}, "friction_reserve"),
        ({"period": 0.0}, "period"),
        ({"gravity_H": [0.0, 0.0]}, "gravity_H"),
        ({"rank_tolerance": 1.0}, "rank_tolerance"),
        ({"posture_damping": float("nan")}, "posture_damping"),
    ],
)
def test_settings_that_cannot_be_are_refused(change, field) -> None:
    with pytest.raises(InvalidInput) as caught:
        ControlSettings(**change)
    assert caught.value.field == field


def test_gains_that_would_swing_up_are_refused() -> None:
    """Routh: s³ + kd s² + kp s + ki is stable exactly when ki < kd kp."""
    PoseGains(kp_linear=100.0, kd_linear=10.0, ki_linear=999.0)
    with pytest.raises(InvalidInput, match="ki_linear = 1001"):
        PoseGains(kp_linear=100.0, kd_linear=10.0, ki_linear=1001.0)
    poles = np.roots([1.0, 10.0, 100.0, 999.0])
    assert -0.1 < poles.real.max() < 0.0
    gains = PoseGains.critically_damped(40.0, 30.0, 5.0)
    np.testing.assert_allclose(gains.rows()[:, [0, 5]].T, [[1600.0, 80.0, 8000.0], [900.0, 60.0, 4500.0]])
