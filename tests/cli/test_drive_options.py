"""The option --drive: its text, and runs with drives."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from graspforce.cli.drive_options import parse_drive
from graspforce.cli.options import GraspOptions
from graspforce.core.errors import InvalidInput, UnknownName
from graspforce.hand.drives.drive import Drive


def test_text_gives_mode_and_numbers_at_the_joint():
    drive = parse_drive("position,stiffness=20,damping=0.1,stiffness_error=0.3")
    assert drive == Drive("position", stiffness=20.0, damping=0.1, stiffness_error=0.3)
    assert parse_drive("torque") == Drive()


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ("posit", InvalidInput, "did you mean 'position'"),
        ("position,stifness=3", UnknownName, "did you mean 'stiffness'"),
        ("position,stiffness", InvalidInput, "NAME=VALUE after the mode"),
        ("position,stiffness=soft", InvalidInput, "must be a number"),
        ("position,stiffness=-1", InvalidInput, "--drive stiffness"),
        ("current", InvalidInput, r"--drive.*torque_constant.*the mode current needs it"),
    ],
)
def test_errors_name_the_option_and_what_is_allowed(text, error, message):
    with pytest.raises(error, match=message):
        parse_drive(text)


@pytest.mark.parametrize("drive", [None, "impedance,stiffness=2"])
def test_grasps_of_the_command_have_the_drive(drive):
    options = GraspOptions("four_finger", "sphere:0.03", None, None, None, "0,0,-9.81", 0, drive)
    grasp = options.search(Console(file=io.StringIO()))
    assert set(grasp.hand.drives.modes) == {"torque" if drive is None else "impedance"}
