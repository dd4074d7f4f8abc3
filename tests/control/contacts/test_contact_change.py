"""Changes of contacts: forces of contacts that let go or join move at a bounded rate, and every step is certified."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from support.control_grasps import named_grasp
from support.control_steps import pose_at_rest, settings_with, state_at_rest

from graspforce.contact import friction
from graspforce.contact.matrices import grasp_matrix
from graspforce.control import Command, ControlMemory, ObjectController
from graspforce.control.contacts.contact_change import ContactChange, ForceRamp
from graspforce.core.errors import InvalidInput, UnknownName
from graspforce.grasp.grasp import Grasp
from graspforce.hand.drives.drive import Drive

GRASPS = ["four_finger box", "four_finger sphere", "dlr_hit2 sphere"]
ROUNDING = 1e-6  # of the largest force: the certificate's tolerance of 1e-8 leaves this much after scaling
RATE = 40.0  # N/s


def run_change(controller: ObjectController, largest: int = 1000) -> list[tuple[tuple[str, ...], Command]]:
    """Return fingers and command of each step at rest, until no contact changes any more."""
    state, desired, steps = state_at_rest(controller.grasp), pose_at_rest(controller.grasp), []
    for _ in range(largest):
        fingers = controller.grasp.fingers
        steps.append((fingers, controller.step(state, desired)))
        if not controller.is_changing:
            return steps
    raise AssertionError(f"the change takes more than {largest} steps")


def normal_forces(fingers: tuple[str, ...], command: Command) -> dict[str, float]:
    """Return the normal force of each finger, N."""
    return dict(zip(fingers, command.contacts.pad(command.f)[:, 2].tolist(), strict=True))


def check_step(command: Command) -> None:
    """Check certificate, equilibrium, cones and motor limits of a step."""
    assert command.solution.found
    assert not command.forces_reused
    padded = command.contacts.pad(command.f)
    scale = np.abs(padded).max()
    np.testing.assert_allclose(grasp_matrix(command.contacts) @ command.f, command.w, atol=ROUNDING * scale)
    assert friction.slip_margin(padded, command.contacts.mu, command.contacts.gamma).min() >= -ROUNDING * scale
    assert not command.saturated


@pytest.mark.parametrize("name", GRASPS)
def test_finger_lets_go_and_joins_again_without_a_jump(name: str) -> None:
    """Forces move at the stated rate; those after letting go and joining again are those before."""
    grasp = named_grasp(name)
    finger = grasp.fingers[1]
    controller = ObjectController(grasp, settings_with())
    state, desired = state_at_rest(grasp), pose_at_rest(grasp)
    before = controller.step(state, desired)
    contact = grasp.contacts.contacts[1]

    controller.change_contacts(ContactChange(release=[finger], force_rate=RATE), state)
    last = normal_forces(grasp.fingers, before)[finger]
    released = run_change(controller)
    for fingers, command in released:
        check_step(command)
        force = normal_forces(fingers, command)[finger]
        assert last - RATE * 1e-3 - ROUNDING <= force <= last + ROUNDING
        last = force
    assert last == 0.0
    assert finger not in controller.grasp.fingers
    alone = controller.step(state, desired)
    at_end = dict(zip(released[-1][0], released[-1][1].contacts.pad(released[-1][1].f), strict=True))
    for name_, f in zip(controller.grasp.fingers, alone.contacts.pad(alone.f), strict=True):
        np.testing.assert_allclose(f, at_end[name_], atol=2e-3 * np.abs(alone.f).max())

    controller.change_contacts(ContactChange(add={finger: contact}, force_rate=RATE), state)
    assert controller.grasp.fingers[-1] == finger
    limit = 0.0
    for fingers, command in run_change(controller):
        check_step(command)
        limit += RATE * 1e-3
        assert normal_forces(fingers, command)[finger] <= limit + ROUNDING
    after = dict(zip(controller.grasp.fingers, controller.step(state, desired).f.reshape(-1, 3), strict=True))
    for name_, f in zip(grasp.fingers, before.f.reshape(-1, 3), strict=True):
        np.testing.assert_allclose(after[name_], f, atol=2e-3 * np.abs(before.f).max())


def check_rates(grasp: Grasp, commands: list[Command]) -> None:
    """Check that forces move by the rate times the period, up to eight times it where their slope changes; torques likewise."""
    normals = np.array([command.contacts.pad(command.f)[:, 2] for command in commands])
    torques = np.array([command.tau for command in commands])
    assert np.abs(np.diff(normals, axis=0)).max() <= 8.0 * RATE * 1e-3
    levers = np.abs(grasp.actuation().J).sum(axis=0).max()  # m
    assert np.abs(np.diff(torques, axis=0)).max() <= 8.0 * RATE * 1e-3 * levers


@pytest.mark.parametrize("slip_margin", [0.3, 1.0])  # N
@pytest.mark.parametrize("name", GRASPS)
def test_forces_and_torques_change_by_a_bounded_amount_in_each_step(name: str, slip_margin: float) -> None:
    """Also at the begin and the end, where the slip margin takes most of the normal force."""
    grasp = named_grasp(name)
    controller = ObjectController(grasp, settings_with(slip_margin=slip_margin))
    state, contact = state_at_rest(grasp), grasp.contacts.contacts[1]
    first = controller.step(state, pose_at_rest(grasp))
    controller.change_contacts(ContactChange(release=[grasp.fingers[1]], force_rate=RATE), state)
    check_rates(grasp, [first, *(command for _, command in run_change(controller, 5000))])
    controller.change_contacts(ContactChange(add={grasp.fingers[1]: contact}, force_rate=RATE), state)
    after = [command for _, command in run_change(controller, 5000)]
    check_rates(grasp, [*after, controller.step(state, pose_at_rest(grasp))])


@pytest.mark.parametrize(("name", "i"), [("four_finger sphere", 0), ("four_finger sphere", 3), ("dlr_hit2 sphere", 1)])
def test_margins_of_other_contacts_are_approached_at_a_bounded_rate(name: str, i: int) -> None:
    """The slip margin covers the errors of the drives, which differ with the contacts: torques do not step at the swaps."""
    grasp = named_grasp(name)
    grasp = dataclasses.replace(grasp, hand=grasp.hand.with_drives(Drive("current", torque_constant=1.0, torque_error=0.2)))
    controller = ObjectController(grasp, settings_with(slip_margin=0.5))
    state, desired = state_at_rest(grasp), pose_at_rest(grasp)
    finger, contact = grasp.fingers[i], grasp.contacts.contacts[i]
    commands, margins = [controller.step(state, desired)], list[float]()
    for change in (ContactChange(release=[finger]), ContactChange(add={finger: contact})):
        controller.change_contacts(change, state)
        commands += [command for _, command in run_change(controller, 5000)]
        commands += [controller.step(state, desired) for _ in range(300)]
        assert controller.memory.margin is None  # that of the settings is reached
        margins.append(float(min(commands[-1].slip_margin)))
    assert not any(command.warnings for command in commands)
    assert abs(margins[1] - margins[0]) > 0.02  # N: the margins differ
    assert np.abs(np.diff([command.tau for command in commands], axis=0)).max() < 5e-3  # N·m: half the watchdog's bound


@pytest.mark.parametrize(("name", "slip_margin"), [("dlr_hit2 sphere", 3.0), ("four_finger box", 5.0)])
def test_torques_do_not_step_at_a_slip_margin_that_is_infeasible(name: str, slip_margin: float) -> None:
    """Near the largest margin forces change with the root of its distance: the margin moves less there, or waits."""
    grasp = named_grasp(name)
    controller = ObjectController(grasp, settings_with(slip_margin=slip_margin))
    state, contact = state_at_rest(grasp), grasp.contacts.contacts[1]
    commands = [controller.step(state, pose_at_rest(grasp)) for _ in range(3)][-1:]
    for change in (ContactChange(release=[grasp.fingers[1]]), ContactChange(add={grasp.fingers[1]: contact})):
        controller.change_contacts(dataclasses.replace(change, force_rate=RATE), state)
        commands += [command for _, command in run_change(controller, 5000)]
    assert all(command.solution.found and not command.forces_reused for command in commands)
    assert np.abs(np.diff([command.tau for command in commands], axis=0)).max() < 0.02  # N·m


def test_finger_stays_without_a_jump_if_the_others_keep_no_slip_margin() -> None:
    """Two point contacts cannot balance gravity across their line: the third finger keeps its force."""
    grasp = named_grasp("dlr_hit2 sphere")
    controller = ObjectController(grasp, settings_with())
    state, desired = state_at_rest(grasp), pose_at_rest(grasp)
    for finger in grasp.fingers[3:]:
        controller.step(state, desired)
        controller.change_contacts(ContactChange(release=[finger], force_rate=RATE), state)
        run_change(controller)
    assert len(controller.grasp.fingers) == 3
    before = controller.step(state, desired)
    controller.change_contacts(ContactChange(release=controller.grasp.fingers[1:2], force_rate=RATE), state)
    steps = [command for _, command in run_change(controller)]
    assert len(controller.grasp.fingers) == 3
    assert any("no finger lets go" in text for command in steps for text in command.warnings)
    assert min(command.slip_margin.min() for command in steps) > 0.0
    check_rates(grasp, [before, *steps, controller.step(state, desired)])
    np.testing.assert_allclose(controller.step(state, desired).tau, before.tau, atol=1e-3)


def test_finger_stays_if_the_others_cannot_hold_the_object() -> None:
    """One finger holds nothing: each finger that would leave too few keeps its force."""
    grasp = named_grasp("four_finger box")
    controller = ObjectController(grasp, settings_with())
    state, desired = state_at_rest(grasp), pose_at_rest(grasp)
    for finger in grasp.fingers[:-1]:
        controller.step(state, desired)
        controller.change_contacts(ContactChange(release=[finger], force_rate=RATE), state)
        steps = run_change(controller)
    assert any("cannot hold the object: no finger lets go" in text for _, command in steps for text in command.warnings)
    assert len(controller.grasp.fingers) >= 2
    command = controller.step(state, desired)
    check_step(command)


def test_joining_comes_before_letting_go() -> None:
    """With both in one change the forces of the finger that lets go fall only when the other is free of its limit."""
    grasp = named_grasp("dlr_hit2 sphere")
    controller = ObjectController(grasp, settings_with())
    state, desired = state_at_rest(grasp), pose_at_rest(grasp)
    controller.step(state, desired)
    first, second = grasp.fingers[1], grasp.fingers[2]
    controller.change_contacts(ContactChange(release=[first], force_rate=RATE), state)
    run_change(controller)
    change = ContactChange(release=[second], add={first: grasp.contacts.contacts[1]}, force_rate=RATE)
    controller.change_contacts(change, state)
    for _, command in run_change(controller):
        check_step(command)
    assert first in controller.grasp.fingers
    assert second not in controller.grasp.fingers


def test_reset_returns_to_the_grasp_of_the_start() -> None:
    grasp = named_grasp("four_finger sphere")
    controller = ObjectController(grasp, settings_with())
    controller.step(state_at_rest(grasp), pose_at_rest(grasp))
    controller.change_contacts(ContactChange(release=grasp.fingers[:1], force_rate=1e4), state_at_rest(grasp))
    run_change(controller)
    assert controller.grasp.fingers == grasp.fingers[1:]
    controller.reset()
    assert controller.grasp is grasp


def test_invalid_changes_are_refused_by_name() -> None:
    grasp = named_grasp("four_finger sphere")
    controller, state = ObjectController(grasp, settings_with()), state_at_rest(grasp)
    contact = grasp.contacts.contacts[0]
    with pytest.raises(InvalidInput, match="at least one finger"):
        ContactChange()
    with pytest.raises(InvalidInput, match="each finger once"):
        ContactChange(release=["finger_1", "finger_1"])
    with pytest.raises(InvalidInput, match="force_rate"):
        ContactChange(release=["finger_1"], force_rate=0.0)
    with pytest.raises(UnknownName, match="thumb"):
        controller.change_contacts(ContactChange(release=["thumb"]), state)
    with pytest.raises(InvalidInput, match="must let go first"):
        controller.change_contacts(ContactChange(add={"finger_1": contact}), state)
    with pytest.raises(InvalidInput, match="one contact must be left"):
        controller.change_contacts(ContactChange(release=grasp.fingers), state)
    controller.change_contacts(ContactChange(release=["finger_1"]), state)
    with pytest.raises(InvalidInput, match="another change of contacts is in progress"):
        controller.change_contacts(ContactChange(release=["finger_2"]), state)


def test_records_of_changes_and_ramps_are_read_back() -> None:
    grasp = named_grasp("four_finger sphere")
    change = ContactChange(release=["finger_2"], add={"finger_1": grasp.contacts.contacts[0]}, force_rate=RATE)
    assert ContactChange.from_dict(change.to_dict(), grasp.hand).to_dict() == change.to_dict()
    with pytest.raises(InvalidInput, match=r"contacts\.force_rate"):
        ContactChange.from_dict({"release": ["finger_1"], "force_rate": "fast"}, grasp.hand)
    ramp = ForceRamp.begin(grasp.fingers, change)
    assert ForceRamp.from_dict(ramp.to_dict(), 4).to_dict() == ramp.to_dict()
    controller = ObjectController(grasp, settings_with())
    controller.step(state_at_rest(grasp), pose_at_rest(grasp))
    controller.change_contacts(ContactChange(release=["finger_2"]), state_at_rest(grasp))
    controller.step(state_at_rest(grasp), pose_at_rest(grasp))
    record = controller.memory.to_dict()
    assert ControlMemory.from_dict(record, controller.grasp.contacts).to_dict() == record
