"""Records of control survive the way through JSON, and errors name the field."""

from __future__ import annotations

import json

import numpy as np
import pytest
from support.control_grasps import named_grasp

from graspforce import InvalidInput
from graspforce.contact.motion import BodyMotion
from graspforce.control import (
    Command,
    ControlMemory,
    ControlSettings,
    GraspMotion,
    GraspState,
    ObjectController,
    PoseGains,
    desired_from_dict,
)

NAMES = ["four_finger box", "anthropomorphic15"]  # the second has uncontrollable twists


def through_json(record):
    return json.loads(json.dumps(record))


def moving_body(rng: np.random.Generator) -> BodyMotion:
    return BodyMotion(0.1 * rng.normal(size=3), np.eye(3), *rng.normal(size=(2, 6)))


def assert_equal(ours, theirs) -> None:
    """Two records with equal fields, nested ones too."""
    assert type(ours) is type(theirs)
    for name in type(ours).__dataclass_fields__:
        one, other = getattr(ours, name), getattr(theirs, name)
        if hasattr(type(one), "__dataclass_fields__"):
            assert_equal(one, other)
        else:
            np.testing.assert_array_equal(one, other, err_msg=name)


def test_settings_are_read_as_written() -> None:
    settings = ControlSettings(PoseGains(kp_linear=900.0), slip_margin=0.2, gravity_H=[0.0, 3.0, -9.0])
    assert_equal(ControlSettings.from_dict(through_json(settings.to_dict())), settings)
    assert settings.to_dict()["gravity"] == [0.0, 3.0, -9.0]
    unknowns = ControlSettings(friction_error=0.4, mass_error=0.3, contact_error=0.1)
    assert_equal(ControlSettings.from_dict(through_json(unknowns.to_dict())), unknowns)


def test_absent_and_null_settings_take_their_defaults() -> None:
    settings = ControlSettings.from_dict({"gains": {"kd_linear": None}, "period": None})
    assert_equal(settings, ControlSettings())


@pytest.mark.parametrize(
    ("record", "field"),
    [
        ({"gravity": [0.0]}, "settings.gravity"),
        ({"gravity_H": [0.0, 0.0, 0.0]}, "settings.gravity_H"),
        ({"gains": {"kp": 1.0}}, "settings.gains.kp"),
        ({"gains": {"ki_linear": 1e9}}, "settings.gains.ki_linear"),
    ],
)
def test_wrong_settings_are_named_by_their_path(record, field) -> None:
    with pytest.raises(InvalidInput) as caught:
        ControlSettings.from_dict(record)
    assert caught.value.field == field


def test_states_and_motions_are_read_as_written() -> None:
    rng, n = np.random.default_rng(1), 4
    state = GraspState(*rng.normal(size=(2, n)), BodyMotion([0.1, 0.2, 0.3], np.eye(3), rng.normal(size=6)))
    assert_equal(GraspState.from_dict(through_json(state.to_dict()), n), state)
    body = moving_body(rng)
    assert_equal(desired_from_dict(through_json(body.to_dict()), n), body)
    motion = GraspMotion(body, *rng.normal(size=(3, n)))
    assert_equal(desired_from_dict(through_json(motion.to_dict()), n), motion)
    assert_equal(GraspMotion.from_dict(through_json(motion.to_dict()), n), motion)
    with pytest.raises(InvalidInput, match=r"motion\.joints"):
        GraspMotion.from_dict(body.to_dict(), n)


@pytest.mark.parametrize("name", NAMES)
def test_commands_and_memories_are_read_as_written(name: str) -> None:
    controller = ObjectController(named_grasp(name))
    grasp = controller.grasp
    first = controller.memory
    assert_equal(ControlMemory.from_dict(through_json(first.to_dict()), grasp.contacts), first)

    still = GraspState(grasp.q, np.zeros(grasp.hand.n), BodyMotion(grasp.p_HO, grasp.R_HO))
    off = BodyMotion(grasp.p_HO + 2e-3, grasp.R_HO)
    command = controller.step(still, off)
    assert_equal(ControlMemory.from_dict(through_json(controller.memory.to_dict()), grasp.contacts), controller.memory)

    record = through_json(command.to_dict())
    again = Command.from_dict(record, grasp.contacts)
    assert through_json(again.to_dict()) == record
    for part in ("tau", "f", "w", "error", "slip_margin", "uncontrollable", "structural_wrench", "creep"):
        np.testing.assert_array_equal(getattr(again, part), getattr(command, part), err_msg=part)
    np.testing.assert_array_equal(again.contacts.p_OC, command.contacts.p_OC)
    assert again.contacts.models == grasp.contacts.models
    assert (again.saturated, again.forces_reused, again.warnings) == (
        command.saturated,
        command.forces_reused,
        command.warnings,
    )
    assert again.solution.status is command.solution.status


def test_a_wrong_command_is_named_by_its_path() -> None:
    controller = ObjectController(named_grasp("four_finger box"))
    grasp = controller.grasp
    still = GraspState(grasp.q, np.zeros(grasp.hand.n), BodyMotion(grasp.p_HO, grasp.R_HO))
    record = controller.step(still, still.object).to_dict()
    for change, field in (
        ({"torque": [0.0]}, "command.torque"),
        ({"held": 1}, "command.held"),
        ({"frames": np.ones((4, 3, 3)).tolist()}, r"command.frames[0]"),
        ({"warnings": [3]}, "command.warnings[0]"),
        ({"extra": 3}, "command.extra"),
    ):
        with pytest.raises(InvalidInput) as caught:
            Command.from_dict({**record, **change}, grasp.contacts)
        assert caught.value.field == field
