"""Both halves of a step compiled give what the law in Python gives, to rounding; and the compiled ones trust nobody."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.control_grasps import GRASP_NAMES, named_grasp

from graspforce import Contact, ContactSet
from graspforce.contact.kinematics import TipContactState
from graspforce.contact.motion import BodyMotion
from graspforce.control import (
    ControlMemory,
    ControlSettings,
    DesiredMotion,
    GraspMotion,
    GraspState,
    PoseGains,
)
from graspforce.control.compiled_step import CompiledTargets
from graspforce.control.contact_constraints import ContactConstraints
from graspforce.control.object_controller import ObjectControlLaw
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp

native = pytest.importorskip("graspforce.core._native", reason="the laws were not built: no C compiler at installation")
# Numbers of about one, of which each is a few products and sums; accelerations and what follows are larger, and their tolerance
# with them. Where A is solved its condition, below 1/rank_tolerance = 100, comes in squared.
ROUNDING, SOLVED = 1e-13, 1e-11


def with_models(grasp: Grasp, seed: int) -> Grasp:
    """The same hold with contacts of all models, and the object's centre of mass away from its origin."""
    rng, contacts = np.random.default_rng(seed), []
    for i, one in enumerate(grasp.contacts.contacts):
        kind = ({}, {"model": "soft", "torsional_friction": 0.004}, {"model": "frictionless", "friction": None})[i % 3]
        contacts.append(replace(one, **kind) if kind else Contact(one.position, one.normal, friction=0.7, max_normal=20.0))
    body = Body(0.07, grasp.body.inertia + 1e-5 * np.eye(3), 0.01 * rng.normal(size=3), grasp.body.shape)
    return replace(grasp, contacts=ContactSet.stack(contacts), body=body)


GRASPS = [*((name, False) for name in GRASP_NAMES), ("allegro_right box", True), ("dlr_hit2 sphere", True)]


def made(name: str, mixed: bool) -> Grasp:
    return with_models(named_grasp(name), 3) if mixed else named_grasp(name)


def laws_of(grasp: Grasp, settings: ControlSettings) -> tuple[ObjectControlLaw, ObjectControlLaw]:
    """The law as it is, and in Python."""
    ours, theirs = ObjectControlLaw(grasp, settings), ObjectControlLaw(grasp, settings)
    theirs._compiled = None
    return ours, theirs


def anything(grasp: Grasp, rng: np.random.Generator, turn: float) -> tuple[GraspState, DesiredMotion]:
    """A state in which all moves, and a desired motion whose axes are turned by any angle up to ``turn``, rad.

    Every other time of the joints too.
    """
    n = grasp.hand.n

    def near(angle: float) -> BodyMotion:
        axis = rng.normal(size=3)
        R = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix() @ grasp.R_HO
        return BodyMotion(grasp.p_HO + 1e-4 * rng.normal(size=3), R, 0.1 * rng.normal(size=6), rng.normal(size=6))

    state = GraspState(grasp.q + 2e-3 * rng.normal(size=n), 0.3 * rng.normal(size=n), near(0.01))
    body = near(turn * rng.random())
    joints = grasp.q + rng.normal(size=n), *rng.normal(size=(2, n))  # some further off than they are pulled for
    return state, GraspMotion(body, *joints) if rng.random() < 0.5 else body


def memory_of(grasp: Grasp, rng: np.random.Generator) -> ControlMemory:
    """What some step may have left."""
    count, k = len(grasp.contacts), grasp.contacts.size
    frames = Rotation.random(count, random_state=rng).as_matrix()
    tip_contacts = TipContactState(0.03 * rng.normal(size=(count, 3)), frames, 0.03 * rng.normal(size=(count, 3)))
    return ControlMemory(
        1e-4 * rng.normal(size=6), grasp.contacts.R_OC, 1e-5 * rng.normal(size=(count, 2)), rng.random(k), tip_contacts
    )


def assert_near(ours: np.ndarray, theirs: np.ndarray, tolerance: float, name: str) -> None:
    assert ours.shape == theirs.shape, name
    np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=tolerance * max(1.0, np.abs(theirs).max()), err_msg=name)


@pytest.mark.parametrize(("name", "mixed"), GRASPS)
def test_what_is_wanted_by_both(name: str, mixed: bool) -> None:
    """Joints coupled and in any order, all contact models, errors up to half a turn, wrenches from outside."""
    grasp, rng, whole = made(name, mixed), np.random.default_rng(21), 0
    settings = ControlSettings(gravity_H=[3.0, -5.0, -7.8])
    ours, theirs = laws_of(grasp, settings)
    for round_ in range(12):
        state, desired = anything(grasp, rng, np.pi if round_ % 2 else 0.01)
        external = rng.normal(size=6) if round_ % 3 else None
        arguments = memory_of(grasp, rng), state, desired, external
        found, law = ours.compute_targets(*arguments), theirs.compute_targets(*arguments)
        whole += isinstance(found, CompiledTargets)
        for part in ("error", "object_acceleration", "p_OC", "R_OC", "J"):
            assert_near(getattr(found, part), getattr(law, part), ROUNDING, part)
        for part in ("A", "B", "beta", "velocity", "gap"):
            assert_near(getattr(found.rolling, part), getattr(law.rolling, part), SOLVED, part)
        for part in (field.name for field in fields(TipContactState)):
            assert_near(getattr(found.tip_contacts, part), getattr(law.tip_contacts, part), ROUNDING, part)
        for part in ("joint_acceleration", "w"):
            assert_near(getattr(found, part), getattr(law, part), SOLVED, part)
        assert_near(found.accelerations.object_acceleration, law.accelerations.object_acceleration, SOLVED, "object")
        assert (found.uncontrollable_error is None) == (law.uncontrollable_error is None)
        tau_u, shift = rng.normal(size=grasp.hand.n), rng.random(len(grasp.contacts))
        for one, other in zip(found.apply_slip_margin(tau_u, shift), law.apply_slip_margin(tau_u, shift), strict=True):
            assert_near(one, other, SOLVED, "tightened")
    known = grasp.body.shape is None or grasp.body.shape.primitive_parameters is not None
    assert whole == (12 if known and name != "anthropomorphic15" and not mixed else whole)
    assert known or whole == 0


def test_rotations_of_half_a_turn_and_none() -> None:
    """The logarithm takes four ways, by the largest part of the quaternion; each is taken, and the turns between two."""
    grasp = named_grasp("allegro_right sphere")
    ours, theirs = laws_of(grasp, ControlSettings())
    axes = [*np.eye(3), *-np.eye(3), [0.6, 0.0, 0.8], [1.0, 1.0, 1.0], [-1.0, 2.0, -3.0], [1e-9, 1.0, 0.0]]
    state = GraspState(grasp.q, np.zeros(grasp.hand.n), BodyMotion(grasp.p_HO, np.eye(3)))
    for axis in np.array(axes):
        for angle in (0.0, 1e-300, 1e-12, 1e-3, 1.0, 2.0, 2.0944, 3.0, np.pi - 1e-9, np.pi):
            R = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix()
            arguments = theirs.initial_memory(), state, BodyMotion(grasp.p_HO, R), None
            found = ours.compute_targets(*arguments).error
            np.testing.assert_allclose(found, theirs.compute_targets(*arguments).error, rtol=1e-14, atol=1e-16)
            assert abs(np.linalg.norm(found[3:]) - angle) < 1e-8  # rad: what a matrix carries of an angle near π
    exact = BodyMotion(grasp.p_HO, np.diag([-1.0, 1.0, -1.0]))
    np.testing.assert_allclose(
        np.abs(ours.compute_targets(ours.initial_memory(), state, exact, None).error[3:]), [0.0, np.pi, 0.0], atol=1e-15
    )


@pytest.mark.parametrize(("name", "mixed"), GRASPS)
def test_what_is_settled_by_both(name: str, mixed: bool) -> None:
    """Torques within and at their limits, integrals below and at theirs, tips that slip, joints at their ends."""
    grasp, rng = made(name, mixed), np.random.default_rng(22)
    settings = ControlSettings(PoseGains(), integral_limit_linear=0.5, integral_limit_angular=0.5)
    ours, theirs = laws_of(grasp, settings)
    seen = set()
    for round_ in range(40):
        state, desired = anything(grasp, rng, 0.01)
        if round_ % 4 == 3:
            state = replace(state, q=np.where(np.arange(grasp.hand.n) == 1, grasp.hand.q_upper[1], state.q))
        memory = memory_of(grasp, rng)
        wanted = ours.compute_targets(memory, state, desired, None)
        if not isinstance(wanted, CompiledTargets):
            continue
        near = [getattr(wanted.tip_contacts, part) for part in ("p_OF", "R_OF", "p_OC")]
        near[0] = near[0] + (1e-5, 1e-3)[round_ % 3 == 0] * rng.normal(size=near[0].shape)  # m
        memory = replace(memory, tip_contacts=TipContactState(*near))
        f, hold_forces = (0.1, 30.0)[round_ % 2] * rng.random(grasp.contacts.size), bool(round_ % 5 == 4)
        arguments = memory, state, wanted, 0.02 * rng.normal(size=grasp.hand.n), f, hold_forces
        found, law = ours.compute_result(*arguments), theirs.compute_result(*arguments)
        for part in ("tau", "creep", "creep_distance", "integral"):
            assert_near(getattr(found, part), getattr(law, part), ROUNDING, part)
        assert (found.saturated, found.has_warnings) == (law.saturated, law.has_warnings)
        assert grasp.hand.torque_lower.min() <= found.tau.min()
        seen.add((found.saturated, found.has_warnings))
        if hold_forces or found.saturated:
            np.testing.assert_array_equal(found.integral, memory.integral)
        else:
            assert 8000.0 * np.linalg.norm(found.integral[:3]) <= 0.5 * (1.0 + 1e-12)  # m/s²
            assert (found.integral != memory.integral).all()
    if name.startswith("allegro") and not mixed:
        assert {saturated for saturated, _ in seen} == {has_warnings for _, has_warnings in seen} == {True, False}


def test_ties_by_their_padded_rows() -> None:
    """Two rows of friction and one of pressing for each contact, a fourth for a soft one's spin."""
    points, mixed = (
        ContactConstraints.from_contacts(named_grasp("allegro_right box").contacts),
        ContactConstraints.from_contacts(made("allegro_right box", True).contacts),
    )
    np.testing.assert_array_equal(points.padded_rows, [0, 1, 2, 4, 5, 6, 8, 9, 10])
    np.testing.assert_array_equal(mixed.padded_rows, [0, 1, 2, 4, 5, 6, 10, 7])


N, K, J, FULL, R = 2, 6, 3, 4, 6  # contacts, force components, motors, joints and tied rows of a made-up hand


def numbers(rng: np.random.Generator) -> list[np.ndarray]:
    """What a `Step` is made of."""
    shapes = [(43,), (N,), (N, 3), (N, 3, 3), (J,), (J,), (N, 3), (N, 3, 3), (FULL, J), (2, J), (2, J), (2, J), (N, FULL)]
    rows = np.array([0.0, 1.0, 2.0, 4.0, 5.0, 6.0])
    return [*(rng.normal(size=shape) for shape in shapes), np.array([1.0, 2.0]), rows, rows]


def told(rng: np.random.Generator) -> list:
    """What `want` takes, but for where it writes."""
    shapes = [(J,), (J,), (3,), (3, 3), (6,), (3,), (3, 3), (6,), (6,), (J,), (J,), (J,)]
    shapes += [(6,), (N, 3, 3), (6,), (6, FULL), (6, FULL)]
    places = tuple(rng.normal(size=(3,) if i % 2 == 0 else (3, 3)) for i in range(6))
    return [*(rng.normal(size=shape) for shape in shapes), places]


ROOM = 24 + J + K * J + 56 * N + 4 * N * J
FORM = (3, 0.02, 0.03, 0.04)


def wrong(right: np.ndarray) -> list:
    return [right.astype(np.float32), np.zeros(right.size + 1), right[:-1], right[..., None], right.tolist(), None]


def test_arrays_that_do_not_fit_are_refused() -> None:
    rng = np.random.default_rng(23)
    made_of, state, block = numbers(rng), told(rng), np.empty(ROOM)
    step = native.Step(FORM, *made_of)
    assert step.want(*state, block) in (True, False)
    for at, right in enumerate(made_of):
        for other in wrong(right):
            if (
                at in (1, 8, 14, 15)
                and isinstance(other, np.ndarray)
                and other.dtype == np.float64
                and other.ndim == right.ndim
            ):
                continue  # these say how many of all there are
            with pytest.raises((ValueError, TypeError, BufferError)):
                native.Step(FORM, *made_of[:at], other, *made_of[at + 1 :])
    for at, name in ((13, "links"), (14, "tied"), (15, "force")):
        for number in (-1.0, 1e300, np.nan, np.inf):
            with pytest.raises(ValueError, match=name):
                native.Step(FORM, *made_of[:at], np.append(made_of[at][:-1], number), *made_of[at + 1 :])
    for at in (14, 15):
        with pytest.raises(ValueError, match="indices"):
            native.Step(FORM, *made_of[:at], np.append(made_of[at][:-1], 4.0 * N), *made_of[at + 1 :])
    with pytest.raises(TypeError, match="sixteen"):
        native.Step(FORM, *made_of[:-1])
    with pytest.raises(ValueError, match="no such shape"):
        native.Step((7, 0.0, 0.0, 0.0), *made_of)
    with pytest.raises(ValueError, match="too long"):
        native.Step(FORM, made_of[0], np.zeros(5000), *made_of[2:])

    for at, right in enumerate(state[:-1]):
        for other in wrong(right):
            if at in (9, 10, 11, 14) and other is None:
                continue  # nothing wanted of the joints, no wrench from outside
            with pytest.raises((ValueError, TypeError, BufferError)):
                step.want(*state[:at], other, *state[at + 1 :], block)
    places = state[-1]
    for other in (places[:5], list(places), (*places[:2], None, *places[3:]), (*places[:3], places[0], *places[4:]), None):
        with pytest.raises((ValueError, TypeError)):
            step.want(*state[:-1], other, block)
    for other in (block[:-1], np.append(block, 0.0), bytes(block.nbytes), None):
        with pytest.raises((ValueError, TypeError, BufferError)):
            step.want(*state, other)

    tighten = [block, np.ones(J), np.ones(N), np.empty(6 + J)]
    settle = [block, *(np.ones(shape) for shape in ((J,), (J,), (K,), (6,), (N, 2), (N, 3), (N, 3, 3), (N, 3))), True]
    settle.append(np.empty(J + 3 * N + 6))
    for call, right in ((step.tighten, tighten), (step.settle, settle)):
        call(*right)
        for at, array in enumerate(right):
            if not isinstance(array, np.ndarray):
                continue
            blocks = [array[:-1], np.append(array, 0.0), None]
            read_only = [bytes(array.nbytes)] if at else []  # what `want` wrote is read
            for other in [*blocks, *read_only] if at in (0, len(right) - 1) else wrong(array):
                with pytest.raises((ValueError, TypeError, BufferError)):
                    call(*right[:at], other, *right[at + 1 :])
        with pytest.raises(TypeError, match="takes"):
            call(*right[:-1])
    with pytest.raises(TypeError, match="takes"):
        step.want(*state)


def test_arrays_may_lie_in_memory_in_any_way() -> None:
    rng = np.random.default_rng(24)
    made_of, state = numbers(rng), told(rng)
    straight, turned = np.empty(ROOM), np.empty(ROOM)
    strided = [np.repeat(array, 2, axis=0)[::2] if array.ndim == 1 else np.asfortranarray(array) for array in state[:-1]]
    whole = native.Step(FORM, *made_of).want(*state, straight)
    assert (
        native.Step(FORM, *map(np.asfortranarray, made_of)).want(*strided, tuple(map(np.asfortranarray, state[-1])), turned)
        == whole
    )
    np.testing.assert_array_equal(straight[:18], turned[:18])
    np.testing.assert_array_equal(straight[24 + J :], turned[24 + J :])
