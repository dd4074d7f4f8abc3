"""The command `graspforce simulate` with options of the world, and its campaigns."""

from __future__ import annotations

import io
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from matplotlib import image
from rich.console import Console

from graspforce import InvalidInput
from graspforce.cli import main, run_campaign
from graspforce.cli.controllers import Assumptions
from graspforce.cli.world_options import WorldOptions
from graspforce.simulation import MeasuredRecording, World
from graspforce.simulation.campaigns.campaign import read_campaign
from graspforce.simulation.campaigns.outcome import RunOutcome
from graspforce.simulation.campaigns.trial import TrialRecord

SHORT = ["--fingers", "finger_1,finger_2,finger_4", "--travel", "0,0,0.002", "--period", "0.2"]


# ── options ───────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_options_of_the_issue_are_the_world_that_they_describe():
    options = WorldOptions(
        noise="encoder=1e-3,pose=1e-3:0.02", camera="30:0.05", friction_error=-0.4, mass_error=0.3,
        joint_friction="0.05", delay=0.002,
    )  # fmt: skip
    world = options.world(3)
    assert (world.friction_factor, world.mass_factor, world.joint_friction) == pytest.approx((0.6, 1.3, 0.05))
    sensors = world.sensors
    assert (sensors.encoder_noise, sensors.latency, world.seed) == (1e-3, 0.002, 3)
    camera = sensors.camera
    assert (camera.rate, camera.latency, camera.position_noise, camera.angle_noise) == (30.0, 0.05, 1e-3, 0.02)


def test_no_option_is_no_world_and_the_nominal_one_measures_the_pose_exactly():
    assert not WorldOptions().is_given
    assert not WorldOptions(seed=5).is_given
    assert WorldOptions(preset="nominal").is_given
    assert WorldOptions(no_pose=True).is_given
    camera = WorldOptions().world(0).sensors.camera
    assert camera.rate == 1000.0
    assert max(camera.position_noise, camera.angle_noise) <= 1e-6
    assert WorldOptions(no_pose=True).world(0).sensors.camera is None
    assert WorldOptions(rate=250.0).world(0).sensors.camera.rate == 250.0


def test_options_replace_parts_of_the_real_world():
    real, changed = World.real(4, 0.5), WorldOptions(preset="real", friction_error=-0.2, no_pose=True).world(4, 0.5)
    assert changed.friction_factor == pytest.approx(0.8)
    assert changed.sensors == replace(real.sensors, camera=None)
    assert changed.camera_outages == ()
    expected = {**real.to_dict(), "friction_factor": 0.8, "sensors": changed.sensors.to_dict(), "camera_outages": []}
    assert changed.to_dict() == expected


def test_every_option_sets_its_field():
    options = WorldOptions(
        noise="encoder=1e-3:2e-3,velocity=0.1,torque=0.01,tip=0.05,point=5e-4,bias=3e-3:0.01",
        camera_lost=("0.5:1", "3:0.5"),
        rate=500.0,
        centre_error="0.001,0,-0.002",
        contact_error="3e-3:0.09",
        joint_friction="0.1:0.2:0.5",
        torque_error=0.1,
        pad_torsion=0.005,
        lose=("index:0.5", "a:b:2"),
    )
    world = options.world(0, pushes=((0.5, 0.0, 0.0, 1.0, 0.1),))
    sensors = world.sensors
    assert (sensors.encoder_noise, sensors.encoder_resolution, sensors.rate) == (1e-3, 2e-3, 500.0)
    assert (sensors.has_velocity, sensors.velocity_noise, sensors.torque_noise, sensors.tip_force_noise) == (
        True,
        0.1,
        0.01,
        0.05,
    )
    assert (sensors.camera.position_bias, sensors.camera.angle_bias) == (3e-3, 0.01)
    assert world.contact_point_noise == 5e-4
    assert world.camera_outages == ((0.5, 1.0), (3.0, 0.5))
    np.testing.assert_array_equal(world.centre_offset, [0.001, 0.0, -0.002])
    assert (world.tip_offset, world.shape_turn, world.torque_error, world.pad_torsion) == (3e-3, 0.09, 0.1, 0.005)
    assert (world.joint_friction, world.joint_friction_spread, world.stiction) == (0.1, 0.2, 0.5)
    assert world.pushes == ((0.5, 0.0, 0.0, 1.0, 0.1),)
    assert world.drive_losses == (("index", 0.5), ("a:b", 2.0))


@pytest.mark.parametrize(
    ("given", "option"),
    [
        ({"noise": "encoder"}, "--noise"),
        ({"noise": "sound=1"}, "--noise"),
        ({"noise": "pose=1e-3"}, "--noise pose"),
        ({"noise": "encoder=-1"}, "--noise encoder"),
        ({"camera": "30"}, "--camera"),
        ({"camera": "0:0.05"}, "--camera"),
        ({"camera_lost": ("1",)}, "--camera-lost"),
        ({"no_pose": True, "camera": "30:0.05"}, "--no-pose"),
        ({"delay": -1.0}, "--delay"),
        ({"friction_error": -1.0}, "--friction-error"),
        ({"mass_error": float("nan")}, "--mass-error"),
        ({"centre_error": "1,2"}, "--centre-error"),
        ({"contact_error": "a"}, "--contact-error"),
        ({"joint_friction": "0.1:0.2:0.3:0.4"}, "--joint-friction"),
        ({"torque_error": -0.1}, "--torque-error"),
        ({"lose": ("index",)}, "--lose"),
        ({"lose": (":1",)}, "--lose"),
        ({"lose": ("index:-1",)}, "--lose"),
    ],
)
def test_impossible_options_are_rejected_by_name(given, option):
    with pytest.raises(InvalidInput) as error:
        WorldOptions(**given)
    assert error.value.field == option


def test_assumptions_are_settings_of_the_controller():
    assumptions = Assumptions.parse("friction=0.4,contact=0.1")
    assert assumptions == Assumptions(0.4, 0.0, 0.1)
    settings = assumptions.settings((0.0, 0.0, -9.81), 500.0)
    assert (settings.friction_error, settings.mass_error, settings.contact_error) == (0.4, 0.0, 0.1)
    assert settings.period == 0.002
    assert settings.friction is not None
    assert Assumptions.parse("none") == Assumptions()
    for text in ("friction", "friction=a", "size=1", "friction=1.0", "mass=-1"):
        with pytest.raises(InvalidInput, match="--assume"):
            Assumptions.parse(text)


# ── one run ───────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_command_simulates_a_world_and_writes_its_outputs(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    options = [
        *SHORT,
        "--duration",
        "0.05",
        "--noise",
        "encoder=1e-5,pose=1e-5:1e-4",
        "--joint-friction",
        "0.01",
        "--delay",
        "0.001",
    ]
    options += ["--save", str(tmp_path / "run.npz"), "--plots", str(tmp_path / "plots"), "--frames", str(tmp_path / "frames")]
    assert main(["simulate", *options]) == 0
    said = capsys.readouterr().out
    assert re.search(r"Coulomb friction of the joints +│ 0\.01 N·m", said)
    assert re.search(r"result +│ held", said)
    assert re.search(r"estimate less truth +│ 0\.0\d+ mm", said)
    recording = MeasuredRecording.load(tmp_path / "run.npz")
    assert len(recording.estimate.t) == len(recording.truth.t) == 50
    for name in ("error", "forces", "torques", "estimate"):
        assert image.imread(tmp_path / "plots" / f"{name}.png").std() > 0.02
    assert len(list((tmp_path / "frames").iterdir())) == 2


def test_a_dropped_object_is_told_and_exits_with_1(capsys, monkeypatch, tmp_path):
    monkeypatch.setenv("COLUMNS", "120")
    options = ["--push", "0,0,40,0.01,0.1", "--duration", "0.5", "--no-pose", "--plant", "urdf", "--plots", str(tmp_path)]
    assert main(["simulate", *SHORT, *options]) == 1
    said = capsys.readouterr().out
    assert re.search(r"result +│ dropped; first sign: [a-z ]+ at 0\.\d+ s", said)
    assert re.search(r"dropped at +│ 0\.\d+ s", said)
    assert re.search(r"pose of the object +│ not measured", said)
    assert (tmp_path / "estimate.png").exists()


def test_full_knowledge_can_be_simulated(capsys):
    assert main(["simulate", *SHORT, "--duration", "0.05", "--world", "real", "--controller", "exact", "--seed", "0"]) in (0, 1)
    assert "World of seed 0" in capsys.readouterr().out


def test_options_that_exclude_each_other_are_rejected(capsys, monkeypatch):
    monkeypatch.setattr("graspforce.cli.options.find_grasp", None)  # what follows is refused before the search
    for asked, field in (
        (["--serve", "--no-pose"], "--serve"),
        (["--plant", "urdf", "--frames", "x"], "--plant"),
        (["--plant", "clay"], "--plant"),
        (["--controller", "best"], "--controller"),
        (["--assume", "moon=1"], "--assume"),
        (["--world", "flat"], "--world"),
        (["--campaign", "2", "--plots", "x"], "--campaign"),
        (["--campaign", "0"], "--campaign"),
        (["--campaign", "2", "--workers", "0"], "--workers"),
        (["--campaign", "2", "--compare", "often"], "--compare"),
        (["--campaign", "2", "--controller", "exact"], "--controller"),
    ):
        assert main(["simulate", *asked]) == 1
        assert capsys.readouterr().err.startswith(f"Error: {field} = "), asked


# ── campaigns ─────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_campaign_runs_hands_in_worlds_and_is_continued(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    results = tmp_path / "results.jsonl"
    options = [
        "--hand",
        "four_finger,dlr_hit2",
        "--travel",
        "0,0,0.002",
        "--period",
        "0.2",
        "--duration",
        "0.05",
        "--world-seed",
        "7",
    ]
    options += ["--results", str(results), "--workers", "2", "--world", "nominal", "--joint-friction", "0.01"]
    assert main(["simulate", *options, "--campaign", "1"]) == 0
    said = capsys.readouterr().out
    assert re.search(r"four_finger sphere:0\.03 +│ 1 +│ 1 \(100\.0 %\)", said)
    assert re.search(r"dlr_hit2 sphere:0\.03 +│ 1 +│ 1 \(100\.0 %\)", said)
    conditions, first = read_campaign(results)
    assert (conditions["controller"], conditions["plant"], conditions["duration"]) == ("estimate", "links", 0.05)
    options[1] = "four_finger"
    assert main(["simulate", *options, "--campaign", "2"]) == 0
    _, records = read_campaign(results)
    assert [record.to_dict() for record in records[:2]] == [record.to_dict() for record in first]
    assert sorted((record.grasp.split()[0], record.seed) for record in records) == [
        ("dlr_hit2", 7), ("four_finger", 7), ("four_finger", 8)
    ]  # fmt: skip
    assert main(["simulate", *options, "--campaign", "2", "--no-pose"]) == 1
    assert "it differs in world" in capsys.readouterr().err


def table_text(table) -> str:
    text = io.StringIO()
    Console(file=text, width=160).print(table)
    return text.getvalue()


def test_tables_count_failures_that_full_knowledge_avoids():
    held, dropped = RunOutcome("held"), RunOutcome("dropped", "slip", 0.4)
    records = [
        TrialRecord("a ball", seed, World(seed=seed), controller, exact, 1.0)
        for seed, controller, exact in ((0, held, None), (1, dropped, held), (2, dropped, dropped), (3, dropped, held))
    ]
    assert re.search(r"a ball +│ 4 +│ 1 \(25\.0 %\) +│ 3 +│ 2 +│", table_text(run_campaign.held_table(records)))
    assert re.search(r"a ball +│ dropped +│ slip +│ 3 +│ 2 +│ 1, 2, 3 +│", table_text(run_campaign.failure_table(records)))
    without = [replace(record, exact=None) for record in records]
    assert re.search(r"a ball +│ 4 +│ 1 \(25\.0 %\) +│ 3 +│ – +│", table_text(run_campaign.held_table(without)))


def test_records_in_a_results_file_name_the_seed_of_each_failure(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    results = tmp_path / "results.jsonl"
    options = [*SHORT, "--duration", "0.3", "--push", "0,0,40,0.01,0.1", "--world", "nominal", "--results", str(results)]
    assert main(["simulate", *options, "--campaign", "1", "--world-seed", "12"]) == 0  # full knowledge drops it, too
    said = capsys.readouterr().out
    assert re.search(r"dropped +│ [a-z ]+ +│ 1 +│ 0 +│ 12 +│", said)
    record = json.loads(results.read_text().splitlines()[1])
    assert (record["seed"], record["controller"]["result"], record["exact"]["result"]) == (12, "dropped", "dropped")
