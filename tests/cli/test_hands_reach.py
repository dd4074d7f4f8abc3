"""``graspforce hands reach``: the numbers of the workspace, as a table, as JSON and as plots."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.hands import load

from graspforce.cli import main
from graspforce.hand.workspace import sample_workspace


def test_reach_prints_a_row_for_each_finger(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["hands", "reach", "four_finger", "--samples", "200"]) == 0
    out = capsys.readouterr().out
    for finger in load("four_finger").fingers:
        assert finger.name in out
    assert "mm/rad" in out


def test_reach_prints_the_summary_of_each_finger_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["hands", "reach", "parallel_jaws", "--samples", "100", "--seed", "5", "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    hand = load("parallel_jaws")
    assert record["fingers"] == [sample_workspace(hand, finger.name, 100, 5).to_dict() for finger in hand.fingers]


def test_reach_writes_a_plot_of_the_workspace_and_of_each_finger(tmp_path: Path) -> None:
    folder = tmp_path / "plots"
    assert main(["hands", "reach", "barrett", "--samples", "50", "--plots", str(folder)]) == 0
    names = {f"mobility_{finger.name}.png" for finger in load("barrett").fingers}
    assert {file.name for file in folder.iterdir()} == {"workspace.png", *names}


def test_reach_names_the_option_that_is_wrong(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["hands", "reach", "four_finger", "--samples", "1"]) == 1
    assert "samples = 1" in capsys.readouterr().err
