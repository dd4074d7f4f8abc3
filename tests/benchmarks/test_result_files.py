"""Benchmarks that run in slices: a call runs the missing cases only, and the tables count what is there."""

import importlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

from graspforce.simulation.campaigns.outcome import RunOutcome
from graspforce.simulation.campaigns.trial import TrialRecord
from graspforce.simulation.worlds.world import World

ROOT = Path(__file__).parents[2]


def test_real_world_runs_only_the_missing_cases(tmp_path):
    path = tmp_path / "results.jsonl"
    options = ["--cases", "5", "--hands", "allegro_right", "--plants", "links", "--longest", "0.02", "--workers", "1"]
    command = [sys.executable, "-m", "benchmarks.real_world", *options, "--results", str(path)]
    for more, done in ((["--slice", "0"], 0), ([], 2), (["--slice", "0"], 2)):
        ran = subprocess.run(
            [*command, *more], cwd=ROOT, env=dict(os.environ), capture_output=True, text=True, timeout=120, check=True
        )
        assert f"{done} of 2 runs." in ran.stdout
        assert len(path.read_text().splitlines()) == 1 + done


def test_campaign_counts_hard_and_soft_pads_apart(monkeypatch):
    monkeypatch.setattr(sys, "path", [str(ROOT), *sys.path])
    campaign = importlib.import_module("benchmarks.campaign")
    held, slipped = RunOutcome("held"), RunOutcome("slipped", "slip")

    def record(seed, torsion, outcome, exact=None):
        return TrialRecord("dlr_hit2 sphere:0.03", seed, World(pad_torsion=torsion), outcome, exact, 1.0)

    records = [
        record(0, 0.0, held),
        record(1, 3e-3, held),
        record(2, 2e-3, slipped, held),
        record(3, 1e-3, slipped, slipped),
        record(4, 0.0, slipped, slipped),
    ]
    assert campaign.pad_rows(records) == [("dlr_hit2", "ball", "1 of 2", "1 of 3", "1")]


@pytest.mark.parametrize("seed", range(4))
def test_hard_pads_change_nothing_else_in_a_world(seed, monkeypatch):
    monkeypatch.setattr(sys, "path", [str(ROOT), *sys.path])
    world, hard = World.real(seed, 0.2).to_dict(), importlib.import_module("benchmarks.campaign").draw_hard(seed, 0.2).to_dict()
    assert hard == {**world, "pad_torsion": 0.0}
