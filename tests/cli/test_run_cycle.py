"""The command ``graspforce cycle``."""

from __future__ import annotations

import json

import pytest

from graspforce.cli import main, run_cycle
from graspforce.simulation.cycle.plan_cycle import CycleMotion, plan_cycle
from tests.support.table_scenes import ball_scene


def test_cycle_prints_phases_and_outcome(monkeypatch, capsys, tmp_path):
    def find(*_, **given):
        scene = ball_scene()
        return scene, plan_cycle(scene, given["settings"], CycleMotion(move=(0.02, 0.0), optimised=False))

    monkeypatch.setattr(run_cycle, "find_cycle", find)
    arguments = ["--hand", "allegro_right", "--object", "sphere:0.03", "--pose-error", "0,0", "--plots", str(tmp_path)]
    assert main(["cycle", *arguments]) == 0
    text = capsys.readouterr().out
    assert all(name in text for name in ("approach", "squeeze", "release", "done"))
    assert (tmp_path / "cycle.png").stat().st_size > 0
    assert main(["cycle", *arguments[:6], "--json"]) == 0
    assert json.loads(capsys.readouterr().out)


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("--world", "moon"),
        ("--controller", "direct"),
        ("--lift", "0"),
        ("--touch-force", "-1"),
        ("--pose-error", "1"),
        ("--move", "x,y"),
    ],
)
def test_wrong_option_is_named(option, value, capsys):
    assert main(["cycle", option, value]) == 1
    assert option.lstrip("-").replace("-", "") in capsys.readouterr().err.replace("-", "").replace("_", "")
