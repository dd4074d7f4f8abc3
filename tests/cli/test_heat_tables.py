"""Temperatures of motors after a run of the command line."""

from __future__ import annotations

import json

import pytest

from graspforce.cli import main
from graspforce.cli.heat_tables import duration_text


@pytest.mark.parametrize(
    ("seconds", "text"), [(float("inf"), "no limit"), (0.0, "0 s"), (119.0, "119 s"), (600.0, "10 min"), (9000.0, "2.5 h")]
)
def test_times_are_short_words(seconds: float, text: str) -> None:
    assert duration_text(seconds) == text


def test_simulation_of_a_hand_with_thermal_data_reports_its_heat(capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--hand", "dclaw", "--reference", "still", "--duration", "0.05"]
    assert main(["simulate", *options, "--json"]) == 0
    heat = json.loads(capsys.readouterr().out)["heat"]
    assert len(heat["winding"]) == len(heat["housing"]) == len(heat["hold_times"]) == 9
    assert min(heat["winding"]) >= 25.0  # °C, of the air
    assert heat["finger_to_rest"] is None
    assert main(["simulate", *options, "--no-pose", "--controller", "protected"]) == 0
    shown = capsys.readouterr().out
    assert "every finger can hold on" in shown
    assert "no limit" in shown


def test_protection_needs_thermal_data(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", "--hand", "four_finger", "--controller", "protected", "--duration", "0.01"]) == 1
    assert "drives[0].torque_constant" in capsys.readouterr().err
