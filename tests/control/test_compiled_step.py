"""The control step in C equals the reference in Python: targets, results, and whole commands."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.control_grasps import GRASP_NAMES, named_grasp, with_all_contact_models

from graspforce.contact import compiled_kinematics
from graspforce.contact.kinematics import TipContactState
from graspforce.contact.motion import BodyMotion
from graspforce.control import (
    ControlMemory,
    ControlSettings,
    DesiredMotion,
    GraspMotion,
    GraspState,
    PoseGains,
    object_control_law,
)
from graspforce.control.compiled_step import CompiledTargets
from graspforce.control.contacts import mobility
from graspforce.control.object_control_law import ObjectControlLaw
from graspforce.control.step_data import IntegralRule
from graspforce.grasp.grasp import Grasp

pytest.importorskip("graspforce.core._native", reason="the C code was not built: no C compiler at installation")
# Most numbers are about one, and each is a few products and sums; tolerances scale with larger ones. Where A is solved, the
# square of its condition, which is below 1/rank_tolerance = 100, multiplies the rounding.
ROUNDING, SOLVED = 1e-13, 1e-11
INTEGRAL_RULES = [IntegralRule.UNLESS_SATURATED] * 3 + [IntegralRule.ALWAYS, IntegralRule.NEVER]
GRASPS = [*((name, False) for name in GRASP_NAMES), ("allegro_right box", True), ("dlr_hit2 sphere", True)]


def make_grasp(name: str, mixed: bool) -> Grasp:
    """Return a grasp, with contacts of all models if ``mixed``."""
    return with_all_contact_models(named_grasp(name), 3) if mixed else named_grasp(name)


def make_laws(grasp: Grasp, settings: ControlSettings) -> tuple[ObjectControlLaw, ObjectControlLaw]:
    """Return the compiled law, and the reference in Python."""
    compiled, reference = ObjectControlLaw(grasp, settings), ObjectControlLaw(grasp, settings)
    reference._compiled = None
    return compiled, reference


def random_step(grasp: Grasp, rng: np.random.Generator, max_angle: float) -> tuple[GraspState, DesiredMotion]:
    """Return a moving state, and a desired motion that is rotated by at most ``max_angle``, rad.

    Every other desired motion has joints.
    """
    n = grasp.hand.n

    def motion_near(angle: float) -> BodyMotion:
        axis = rng.normal(size=3)
        R = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix() @ grasp.R_HO
        return BodyMotion(grasp.p_HO + 1e-4 * rng.normal(size=3), R, 0.1 * rng.normal(size=6), rng.normal(size=6))

    state = GraspState(grasp.q + 2e-3 * rng.normal(size=n), 0.3 * rng.normal(size=n), motion_near(0.01))
    body = motion_near(max_angle * rng.random())
    joints = grasp.q + rng.normal(size=n), *rng.normal(size=(2, n))  # some with the largest pull
    return state, GraspMotion(body, *joints) if rng.random() < 0.5 else body


def random_memory(grasp: Grasp, rng: np.random.Generator) -> ControlMemory:
    count, k = len(grasp.contacts), grasp.contacts.size
    frames = Rotation.random(count, random_state=rng).as_matrix()
    tip_contacts = TipContactState(0.03 * rng.normal(size=(count, 3)), frames, 0.03 * rng.normal(size=(count, 3)))
    creep, spin = 1e-5 * rng.normal(size=(count, 2)), rng.normal(size=(count, 2))
    return ControlMemory(1e-4 * rng.normal(size=6), grasp.contacts.R_OC, creep, rng.random(k), tip_contacts, spin=spin)


def assert_near(found: np.ndarray, expected: np.ndarray, tolerance: float, name: str) -> None:
    assert found.shape == expected.shape, name
    scale = max(1.0, np.abs(expected).max())
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=tolerance * scale, err_msg=name)


@pytest.mark.parametrize(("name", "mixed"), GRASPS)
def test_targets_in_c_equal_the_reference(name: str, mixed: bool) -> None:
    """For coupled joints in any order, all contact models, errors up to half a turn, and external wrenches."""
    grasp, rng, compiled_count = make_grasp(name, mixed), np.random.default_rng(21), 0
    compiled, reference = make_laws(grasp, ControlSettings(gravity_H=[3.0, -5.0, -7.8]))
    for round_ in range(12):
        state, desired = random_step(grasp, rng, np.pi if round_ % 2 else 0.01)
        external = rng.normal(size=6) if round_ % 3 else None
        arguments = random_memory(grasp, rng), state, desired, external
        found, expected = compiled.compute_targets(*arguments), reference.compute_targets(*arguments)
        compiled_count += isinstance(found, CompiledTargets)
        for part in ("error", "object_acceleration", "p_OC", "R_OC", "J"):
            assert_near(getattr(found, part), getattr(expected, part), ROUNDING, part)
        for part in ("A", "B", "beta", "velocity", "gap"):
            assert_near(getattr(found.rolling, part), getattr(expected.rolling, part), SOLVED, part)
        for part in (field.name for field in fields(TipContactState)):
            assert_near(getattr(found.tip_contacts, part), getattr(expected.tip_contacts, part), ROUNDING, part)
        for part in ("joint_acceleration", "w"):
            assert_near(getattr(found, part), getattr(expected, part), SOLVED, part)
        accelerations = found.accelerations.object_acceleration, expected.accelerations.object_acceleration
        assert_near(*accelerations, SOLVED, "object_acceleration in O")
        assert (found.uncontrollable_error is None) == (expected.uncontrollable_error is None)
        tau_u, shift = rng.normal(size=grasp.hand.n), rng.random(len(grasp.contacts))
        shifted = found.apply_slip_margin(tau_u, shift), expected.apply_slip_margin(tau_u, shift)
        for one, other in zip(*shifted, strict=True):
            assert_near(one, other, SOLVED, "slip margin")
    has_closed_form = grasp.body.shape is None or grasp.body.shape.primitive_parameters is not None
    if has_closed_form and name != "anthropomorphic15" and not mixed:
        assert compiled_count == 12
    assert has_closed_form or compiled_count == 0


def test_rotation_errors_in_c_equal_the_reference_at_every_angle() -> None:
    """The logarithm has four branches, by the largest part of the quaternion: each is taken, and the angles between two."""
    grasp = named_grasp("allegro_right sphere")
    compiled, reference = make_laws(grasp, ControlSettings())
    axes = [*np.eye(3), *-np.eye(3), [0.6, 0.0, 0.8], [1.0, 1.0, 1.0], [-1.0, 2.0, -3.0], [1e-9, 1.0, 0.0]]
    state = GraspState(grasp.q, np.zeros(grasp.hand.n), BodyMotion(grasp.p_HO, np.eye(3)))
    for axis in np.array(axes):
        for angle in (0.0, 1e-300, 1e-12, 1e-3, 1.0, 2.0, 2.0944, 3.0, np.pi - 1e-9, np.pi):
            R = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix()
            arguments = reference.initial_memory(), state, BodyMotion(grasp.p_HO, R), None
            found = compiled.compute_targets(*arguments).error
            np.testing.assert_allclose(found, reference.compute_targets(*arguments).error, rtol=1e-14, atol=1e-16)
            assert abs(np.linalg.norm(found[3:]) - angle) < 1e-8  # rad: the accuracy of a matrix near π
    half_turn = BodyMotion(grasp.p_HO, np.diag([-1.0, 1.0, -1.0]))
    error = compiled.compute_targets(compiled.initial_memory(), state, half_turn, None).error
    np.testing.assert_allclose(np.abs(error[3:]), [0.0, np.pi, 0.0], atol=1e-15)


@pytest.mark.parametrize(("name", "mixed"), GRASPS)
def test_results_in_c_equal_the_reference(name: str, mixed: bool) -> None:
    """With torques and integrals below and at their limits, slipping fingertips, and joints at their limits."""
    grasp, rng = make_grasp(name, mixed), np.random.default_rng(22)
    settings = ControlSettings(PoseGains(), integral_limit_linear=0.5, integral_limit_angular=0.5)
    compiled, reference = make_laws(grasp, settings)
    seen = set()
    for round_ in range(40):
        state, desired = random_step(grasp, rng, 0.01)
        if round_ % 4 == 3:
            state = replace(state, q=np.where(np.arange(grasp.hand.n) == 1, grasp.hand.q_upper[1], state.q))
        memory = random_memory(grasp, rng)
        targets = compiled.compute_targets(memory, state, desired, None)
        if not isinstance(targets, CompiledTargets):
            continue
        p_OF, R_OF, p_OC = (getattr(targets.tip_contacts, part) for part in ("p_OF", "R_OF", "p_OC"))
        p_OF = p_OF + (1e-5, 1e-3)[round_ % 3 == 0] * rng.normal(size=p_OF.shape)  # m
        memory = replace(memory, tip_contacts=TipContactState(p_OF, R_OF, p_OC))
        f, rule = (0.1, 30.0)[round_ % 2] * rng.random(grasp.contacts.size), INTEGRAL_RULES[round_ % 5]
        arguments = memory, state, targets, 0.02 * rng.normal(size=grasp.hand.n), f, rule
        found, expected = compiled.compute_result(*arguments), reference.compute_result(*arguments)
        for part in ("tau", "creep", "creep_distance", "integral"):
            assert_near(getattr(found, part), getattr(expected, part), ROUNDING, part)
        assert (found.saturated, found.has_warnings) == (expected.saturated, expected.has_warnings)
        assert grasp.hand.torque_lower.min() <= found.tau.min()
        seen.add((found.saturated, found.has_warnings))
        if rule is IntegralRule.NEVER or (found.saturated and rule is not IntegralRule.ALWAYS):
            np.testing.assert_array_equal(found.integral, memory.integral)
        else:
            assert 8000.0 * np.linalg.norm(found.integral[:3]) <= 0.5 * (1.0 + 1e-12)  # m/s²
            assert (found.integral != memory.integral).all()
    if name.startswith("allegro") and not mixed:
        assert {saturated for saturated, _ in seen} == {has_warnings for _, has_warnings in seen} == {True, False}


@pytest.mark.parametrize("name", ["allegro_right sphere", "allegro_right box", "four_finger cylinder", "dlr_hit2 sphere"])
def test_commands_are_the_same_without_the_c_code(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Several steps in a row, with C and without."""
    grasp, rng, steps = named_grasp(name), np.random.default_rng(17), []
    for _ in range(4):
        desired = BodyMotion(grasp.p_HO, grasp.R_HO, 0.02 * rng.normal(size=6), 0.1 * rng.normal(size=6))
        measured = replace(desired, p_HO=grasp.p_HO + 1e-4 * rng.normal(size=3))
        q, v = grasp.q + 1e-3 * rng.normal(size=grasp.hand.n), 0.1 * rng.normal(size=grasp.hand.n)
        steps.append((GraspState(q, v, measured), desired))

    def run() -> list:
        law = ObjectControlLaw(grasp, ControlSettings())
        memory, results = law.initial_memory(), []
        for state, desired in steps:
            command, memory = law.step(memory, state, desired)
            results.append((command, memory))
        return results

    compiled = run()
    for module in (object_control_law, compiled_kinematics, mobility):
        monkeypatch.setattr(module, "native", None)
    for (found, memory), (expected, expected_memory) in zip(compiled, run(), strict=True):
        for part in ("w", "acceleration", "joint_acceleration", "error", "creep"):
            assert_near(getattr(found, part), getattr(expected, part), 1e-11, part)
        np.testing.assert_allclose(found.tau, expected.tau, atol=1e-6)  # N·m: the solver's tolerance
        assert found.warnings == expected.warnings
        np.testing.assert_allclose(memory.R_OC, expected_memory.R_OC, atol=1e-12)
