"""The whole step in one call of C equals the reference in Python, and hands over to it where it must."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from support.control_grasps import GRASP_NAMES, named_grasp, soft_box_grasp, with_all_contact_models

from graspforce.contact.kinematics import TipContactState
from graspforce.contact.motion import BodyMotion
from graspforce.control import Command, ContactConditions, ControlMemory, ControlSettings, GraspMotion, GraspState
from graspforce.control.compiled_control_law import CompiledControlLaw
from graspforce.control.contacts.contact_change import ContactChange
from graspforce.control.grasp_control import GraspControl
from graspforce.control.object_control_law import ObjectControlLaw
from graspforce.core.errors import InvalidInput
from graspforce.force.certificate import certify
from graspforce.grasp.grasp import Grasp
from graspforce.hand.drives.drive import Drive

pytest.importorskip("graspforce.core._native", reason="the C code was not built: no C compiler at installation")
# Both solve to 1e-9 relative to the size of the problem, where forces are about 1 N. After a step of the reference their warm
# starts differ, and so do two optima that are not unique: by the square root of the tolerance.
FORCES, TORQUES = 1e-4, 1e-6  # N and N·m
COUNT = 60  # steps
CURRENT_DRIVE = Drive("current", torque_constant=1.0, torque_error=0.1)
POSITION_DRIVE = Drive("position", stiffness=20.0, damping=0.1, stiffness_error=0.1, torque_error=0.1)


def moving_states(grasp: Grasp, seed: int) -> list[tuple[GraspState, BodyMotion | GraspMotion, np.ndarray | None]]:
    """Return states of a slow motion with sensor noise; some have desired joints or an external wrench."""
    rng, n, steps = np.random.default_rng(seed), grasp.hand.n, []
    for i in range(COUNT):
        phase = 2.0 * np.pi * i / COUNT
        body = BodyMotion(grasp.p_HO, grasp.R_HO, acceleration=[0.0, 0.0, 0.1 * np.sin(phase), 0.0, 0.0, 0.0])
        measured = BodyMotion(grasp.p_HO + 1e-5 * rng.normal(size=3), grasp.R_HO, 1e-3 * rng.normal(size=6))
        state = GraspState(grasp.q + 1e-4 * rng.normal(size=n), 1e-2 * rng.normal(size=n), measured)
        joints = GraspMotion(body, grasp.q + 0.01 * rng.normal(size=n), 0.1 * rng.normal(size=n), rng.normal(size=n))
        external = 0.02 * np.array([1.0, 1.0, 1.0, 0.01, 0.01, 0.01]) * rng.normal(size=6)
        steps.append((state, joints if i % 3 == 1 else body, external if i % 4 == 2 else None))
    return steps


def count_whole_steps(law: CompiledControlLaw, monkeypatch: pytest.MonkeyPatch) -> list[bool]:
    """Return a list that gets for each attempt in C whether it succeeded."""
    taken, take = list[bool](), law._take_whole_step

    def counted(*arguments):
        stepped = take(*arguments)
        taken.append(stepped is not None)
        return stepped

    monkeypatch.setattr(law, "_take_whole_step", counted)
    return taken


def assert_equal_memories(found: ControlMemory, expected: ControlMemory) -> None:
    if expected.torque_factors is None:
        assert found.torque_factors is None
    else:
        assert found.torque_factors is not None
        for name, values in expected.torque_factors.to_dict().items():
            np.testing.assert_allclose(found.torque_factors.to_dict()[name], values, rtol=1e-9, atol=1e-11, err_msg=name)
    for name in ("integral", "R_OC", "creep"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=0.0, atol=1e-11, err_msg=name)
    for each in fields(TipContactState):
        one, other = (getattr(memory.tip_contacts, each.name) for memory in (found, expected))
        np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-12, err_msg=each.name)
    others = {each.name for each in fields(ControlMemory)} - {
        "integral",
        "R_OC",
        "creep",
        "f",
        "tip_contacts",
        "torque_factors",
    }
    assert {name for name in others if getattr(found, name) is not None} == set()


def assert_equal_commands(found: Command, expected: Command) -> None:
    np.testing.assert_allclose(found.tau, expected.tau, rtol=0.0, atol=TORQUES)
    np.testing.assert_allclose(found.f, expected.f, rtol=0.0, atol=FORCES)
    for name in ("w", "acceleration", "joint_acceleration", "error", "creep", "uncontrollable", "structural_wrench"):
        one, other = getattr(found, name), getattr(expected, name)
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-11, err_msg=name)
    np.testing.assert_allclose(found.slip_margin, expected.slip_margin, rtol=0.0, atol=FORCES)
    np.testing.assert_allclose(found.drive.torque_error, expected.drive.torque_error, rtol=0.0, atol=TORQUES)
    assert (found.saturated, found.warnings, found.forces_reused) == (expected.saturated, expected.warnings, False)


@pytest.mark.parametrize("name", GRASP_NAMES)
def test_whole_steps_equal_the_reference(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    grasp, settings = named_grasp(name), ControlSettings()
    law, reference = CompiledControlLaw(grasp, settings), ObjectControlLaw(grasp, settings)
    taken = count_whole_steps(law, monkeypatch)
    memory, usual = reference.initial_memory(), 0
    for arguments in moving_states(grasp, seed=3):
        found, after = law.step(memory, *arguments)
        expected, memory = reference.step(memory, *arguments)
        if not expected.forces_reused:
            assert_equal_commands(found, expected)
        if taken and taken[-1]:
            assert_equal_memories(after, memory)
        usual += not (expected.warnings or expected.uncontrollable.size or expected.forces_reused)
    assert law._whole_step is None or sum(taken) >= usual


@pytest.mark.parametrize("name", ["allegro_right sphere", "dlr_hit2 sphere", "four_finger box"])
@pytest.mark.parametrize("drive", [CURRENT_DRIVE, POSITION_DRIVE], ids=["current", "position"])
def test_whole_steps_of_drives_with_errors_equal_the_reference(
    name: str, drive: Drive, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The errors of the drives are estimated, and shift the desired motion of the next step."""
    grasp, settings = named_grasp(name), ControlSettings()
    grasp = replace(grasp, hand=grasp.hand.with_drives(drive))
    law, reference = CompiledControlLaw(grasp, settings), ObjectControlLaw(grasp, settings)
    assert reference._learning.is_active
    taken = count_whole_steps(law, monkeypatch)
    found_memory = memory = reference.initial_memory()
    for arguments in moving_states(grasp, seed=11):
        found, found_memory = law.step(found_memory, *arguments)
        expected, memory = reference.step(memory, *arguments)
        np.testing.assert_allclose(found.tau, expected.tau, rtol=0.0, atol=TORQUES)
        np.testing.assert_allclose(found.guaranteed_margin, expected.guaranteed_margin, rtol=0.0, atol=FORCES)
        assert_equal_memories(found_memory, memory)
    assert memory.torque_factors is not None
    assert sum(taken) > 0


def test_most_named_grasps_have_whole_steps() -> None:
    supported = [CompiledControlLaw(named_grasp(name), ControlSettings())._whole_step is not None for name in GRASP_NAMES]
    assert sum(supported) > 0.6 * len(supported)


def test_contacts_of_all_models_equal_the_reference(monkeypatch: pytest.MonkeyPatch) -> None:
    grasp, settings = with_all_contact_models(named_grasp("allegro_right box"), 3), ControlSettings()
    law, reference = CompiledControlLaw(grasp, settings), ObjectControlLaw(grasp, settings)
    memory = reference.initial_memory()
    for arguments in moving_states(grasp, seed=4):
        found, _ = law.step(memory, *arguments)
        expected, memory = reference.step(memory, *arguments)
        np.testing.assert_allclose(found.tau, expected.tau, rtol=0.0, atol=TORQUES)


def test_the_solution_of_a_whole_step_has_its_proof() -> None:
    grasp = named_grasp("allegro_right sphere")
    law, memory = CompiledControlLaw(grasp, ControlSettings()), None
    for arguments in moving_states(grasp, seed=5):
        command, memory = law.step(law.initial_memory() if memory is None else memory, *arguments)
        solution = command.solution
        assert solution.found
        assert solution.problem is not None
        proof = certify(solution.problem, solution.f, solution.multipliers)
        assert proof.verified
        assert proof.is_tight
        np.testing.assert_allclose(solution.problem.torques(solution.f), solution.torques, rtol=0.0, atol=1e-12)
        found = np.array([solution.certificate.primal_residual, solution.certificate.dual_residual, solution.certificate.gap])
        np.testing.assert_allclose(found, [proof.primal_residual, proof.dual_residual, proof.gap], rtol=1e-2, atol=1e-13)


def test_the_reference_takes_over_without_the_full_margin_and_gives_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """A wrench that leaves no room for the margin: the commands are those of the reference, and C is tried every tenth step."""
    grasp, settings = named_grasp("allegro_right sphere"), ControlSettings()
    law, reference = CompiledControlLaw(grasp, settings), ObjectControlLaw(grasp, settings)
    taken = count_whole_steps(law, monkeypatch)
    memory, states = reference.initial_memory(), moving_states(grasp, seed=6)
    for i, (state, desired, _) in enumerate(states[:30]):
        external = np.array([0.0, 0.0, -14.0 if 10 <= i < 20 else 0.0, 0.0, 0.0, 0.0])
        found, _ = law.step(memory, state, desired, external)
        expected, memory = reference.step(memory, state, desired, external)
        np.testing.assert_allclose(found.tau, expected.tau, rtol=0.0, atol=1e-4)
        assert found.warnings == expected.warnings
        if 10 <= i < 20:
            assert found.warnings
    assert taken == [True] * 10 + [False] + [True] * 10


@pytest.mark.parametrize("finger", ["index", "middle"])
def test_steps_without_a_drive_are_those_of_the_reference(finger: str, monkeypatch: pytest.MonkeyPatch) -> None:
    grasp = named_grasp("allegro_right sphere")
    law = CompiledControlLaw(grasp, ControlSettings())
    taken, memory = count_whole_steps(law, monkeypatch), law.initial_memory()
    states = moving_states(grasp, seed=7)
    for state, desired, _ in states[:5]:
        _, memory = law.step(memory, state, desired)
    assert len(taken) == 5
    command, memory = law.step(memory, *states[5][:2], conditions=ContactConditions(lost=(finger,)))
    assert len(taken) == 5
    assert any(finger in warning for warning in command.warnings)
    if memory.stop is not None:
        law.step(memory, *states[6][:2])
        assert len(taken) == 5


@pytest.mark.parametrize(
    "conditions",
    [
        ContactConditions(slipping=[False] * 3, touching=[True] * 3),
        ContactConditions(slipping=[False] * 3, touching=[True, False, True]),
        ContactConditions(touching=[True] * 3),
    ],
)
def test_conditions_that_do_not_affect_the_forces_have_whole_steps(
    conditions: ContactConditions, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Their warnings are those of the reference."""
    grasp, settings = named_grasp("allegro_right sphere"), ControlSettings()
    law, reference = CompiledControlLaw(grasp, settings), ObjectControlLaw(grasp, settings)
    taken, warnings = count_whole_steps(law, monkeypatch), set()
    found_memory = memory = reference.initial_memory()
    for state, desired, external in moving_states(grasp, seed=12):
        given = conditions if external is None else None  # by turns with steps without conditions
        found, found_memory = law.step(found_memory, state, desired, external, given)
        expected, memory = reference.step(memory, state, desired, external, given)
        assert_equal_commands(found, expected)
        assert_equal_memories(found_memory, memory)
        warnings.update(expected.warnings)
    assert taken == [True] * COUNT
    assert any("lost contact" in each for each in warnings) == (False in np.ravel(conditions.touching))


def test_conditions_of_other_contacts_are_refused() -> None:
    grasp = named_grasp("allegro_right sphere")
    law = CompiledControlLaw(grasp, ControlSettings())
    state, desired, _ = moving_states(grasp, seed=1)[0]
    for _ in range(2):
        _, memory = law.step(law.initial_memory(), state, desired)
    with pytest.raises(InvalidInput) as caught:
        law.step(memory, state, desired, conditions=ContactConditions(touching=[True]))
    assert caught.value.field == "touching"


def test_changed_contacts_have_whole_steps_before_and_after_the_change(monkeypatch: pytest.MonkeyPatch) -> None:
    grasp, settings = named_grasp("four_finger cylinder"), ControlSettings()
    state = GraspState(grasp.q, np.zeros(grasp.hand.n), BodyMotion(grasp.p_HO, grasp.R_HO))
    controls = [GraspControl.start(grasp, settings, None, law) for law in (CompiledControlLaw, ObjectControlLaw)]
    change = ContactChange(release=(grasp.fingers[0],))
    for i in range(2000):
        if i == 5:
            controls = [each.begin(each.prepare(change, state), state) for each in controls]
        (found, one), (expected, other) = (each.step(state, state.object) for each in controls)
        np.testing.assert_allclose(found.tau, expected.tau, rtol=0.0, atol=1e-4)
        controls = [one.without_released(state), other.without_released(state)]
        if i > 5 and not controls[0].is_changing:
            break
    assert len(controls[0].grasp.fingers) == len(grasp.fingers) - 1
    assert isinstance(controls[0].law, CompiledControlLaw)
    assert controls[0].law._whole_step is not None
    taken = count_whole_steps(controls[0].law, monkeypatch)
    control = controls[0]
    for _ in range(200):
        _, control = control.step(state, state.object)
    assert taken
    assert taken[-1]


def test_a_law_at_another_posture_pulls_towards_it() -> None:
    grasp, settings = named_grasp("allegro_right sphere"), ControlSettings()
    moved = Grasp(grasp.hand, grasp.body, grasp.fingers, grasp.contacts, grasp.q + 0.01, grasp.p_HO, grasp.R_HO)
    laws = CompiledControlLaw(grasp, settings).with_grasp(moved), ObjectControlLaw(grasp, settings).with_grasp(moved)
    memory = laws[1].initial_memory()
    for state, desired, external in moving_states(grasp, seed=8)[:10]:
        found, _ = laws[0].step(memory, state, desired, external)
        expected, memory = laws[1].step(memory, state, desired, external)
        assert_equal_commands(found, expected)


def test_soft_pads_whose_spin_is_followed_have_no_whole_steps() -> None:
    law = CompiledControlLaw(soft_box_grasp(), ControlSettings())
    assert law._constraints.is_tracking_spin == (law._whole_step is None)


def test_inputs_of_a_whole_step_are_refused_as_by_the_reference() -> None:
    grasp = named_grasp("allegro_right sphere")
    law = CompiledControlLaw(grasp, ControlSettings())
    state, desired, _ = moving_states(grasp, seed=9)[0]
    _, memory = law.step(law.initial_memory(), state, desired)
    other = GraspState(np.zeros(3), np.zeros(3), state.object)
    for arguments in ((other, desired), (state, desired, [1.0, 2.0]), (state, desired, [np.nan] * 6)):
        errors = []
        for each in (law, ObjectControlLaw(grasp, ControlSettings())):
            with pytest.raises(InvalidInput) as caught:
                each.step(memory, *arguments)
            errors.append(str(caught.value))
        assert errors[0] == errors[1]


def test_arrays_of_a_whole_step_are_read_only_and_its_own() -> None:
    grasp = named_grasp("allegro_right sphere")
    law = CompiledControlLaw(grasp, ControlSettings())
    (state, desired, _), later = moving_states(grasp, seed=10)[0], moving_states(grasp, seed=10)[5]
    command, memory = law.step(law.step(law.initial_memory(), state, desired)[1], state, desired)
    kept = command.tau.copy(), command.f.copy(), memory.integral.copy()
    law.step(memory, *later)
    for array, copy in zip((command.tau, command.f, memory.integral), kept, strict=True):
        np.testing.assert_array_equal(array, copy)
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
