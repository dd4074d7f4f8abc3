"""Commands: copies, pickles, read-only arrays, and printed tables."""

from __future__ import annotations

import copy
import pickle
from dataclasses import fields, replace

import numpy as np
import pytest
from support.control_grasps import named_grasp
from support.control_steps import disturbed, pose_at_rest, state_at_rest

from graspforce.contact.motion import BodyMotion
from graspforce.control import Command, ObjectController

pytestmark = pytest.mark.usefixtures("arithmetic")


@pytest.mark.parametrize("name", ["allegro_right box", "anthropomorphic15"])
def test_copies_and_pickles_are_equal_plain_commands(name: str) -> None:
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
def test_arrays_of_command_and_memory_are_read_only(name: str) -> None:
    """They share memory, and the next step starts from it."""
    controller = ObjectController(named_grasp(name))
    state, desired = disturbed(controller.grasp, 8)
    for _ in range(2):  # only the second starts from tip contacts
        command, memory = controller.step(state, desired), controller.memory
        tips = memory.tip_contacts
        assert tips is not None
        shared = (memory.integral, memory.R_OC, memory.creep, tips.p_OF, tips.R_OF, tips.p_OC)
        for array in (*shared, command.tau, command.f, command.creep, command.contacts.p_OC, command.contacts.R_OC):
            with pytest.raises(ValueError, match="read-only"):
                array[...] = 0.0


def test_printed_command_shows_contacts_torques_error_and_warnings() -> None:
    grasp = named_grasp("four_finger box")
    command = ObjectController(grasp).step(
        state_at_rest(grasp), BodyMotion(grasp.p_HO + np.array([0.0, 0.0, 1e-3]), grasp.R_HO)
    )
    lines = str(command).splitlines()
    assert lines[0].startswith("Command: torques ")
    assert lines[0].endswith("forces optimal, pose error 1 mm and 0°")
    assert lines[1].split() == ["contact", "f_t1", "N", "f_t2", "N", "f_n", "N", "slip", "margin", "N", "creep", "mm"]
    assert len(lines) == 2 + 4
    assert lines[2].split()[0] == "0"
    assert float(lines[2].split()[4]) == pytest.approx(command.slip_margin[0], abs=5e-4)

    pulled = ObjectController(grasp).step(state_at_rest(grasp), pose_at_rest(grasp), [0.0, 0.0, -100.0, 0.0, 0.0, 0.0])
    assert "forces reused" in str(pulled)
    assert str(pulled).endswith("Warning: no forces hold the object within all limits: the last forces are reused")
    assert repr(command) == "<Command: 12 torques, 4 contacts, forces optimal>"
    assert "<td>" in command._repr_html_()
    assert "Warning: no forces" in pulled._repr_html_()
