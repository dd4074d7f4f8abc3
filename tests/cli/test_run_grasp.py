"""The command ``graspforce grasp``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from graspforce.cli import main
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.link_grasp import LinkGrasp


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("grasp") / "grasp.json"
    assert main(["grasp", "--hand", "allegro_right", "--object", "sphere:0.03", "--save", str(path)]) == 0
    return path


def test_the_saved_grasp_touches_and_is_the_same_for_the_same_seed(saved: Path, tmp_path: Path) -> None:
    grasp = Grasp.load(saved)
    assert grasp.hand.name == "allegro_right"
    assert grasp.contact_errors().max() < 1e-9
    again = tmp_path / "again.json"
    assert main(["grasp", "--hand", "allegro_right", "--object", "sphere:0.03", "--save", str(again)]) == 0
    assert again.read_bytes() == saved.read_bytes()


def test_postures_of_a_file_are_shown_and_refused_with_a_reason(
    saved: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    grasp, table = Grasp.load(saved), tmp_path / "grasps.csv"
    names = [joint.name for joint in grasp.hand.joints]
    pose = [*grasp.p_HO, *Rotation.from_matrix(grasp.R_HO).as_quat(scalar_first=True)]
    near, far = np.concatenate([grasp.q, pose]), np.concatenate([grasp.q, pose])
    far[grasp.hand.n + 2] += 0.3
    rows = [",".join([*names, "x", "y", "z", "qw", "qx", "qy", "qz"])]
    rows += [",".join(repr(float(x)) for x in row) for row in (far, near)]
    table.write_text("\n".join(rows) + "\n")
    command = ["grasp", "--hand", "allegro_right", "--object", "sphere:0.03", "--postures", str(table)]
    assert main([*command, "--save", str(tmp_path / "one.json"), "--plots", str(tmp_path / "plots")]) == 0
    text = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert "holds with" in text
    assert "mm from the" in text
    np.testing.assert_allclose(Grasp.load(tmp_path / "one.json").q, grasp.q, atol=1e-8)
    assert (tmp_path / "plots" / "grasp.png").stat().st_size > 0
    table.write_text("\n".join(rows[:2]) + "\n")
    assert main(command) == 1


def test_several_grasps_of_a_class_have_its_fingers_and_their_own_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "grasp.json"
    words = ["--hand", "allegro_right", "--object", "sphere:0.03", "--class", "tripod", "--count", "2", "--save", str(path)]
    assert main(["grasp", *words]) == 0
    assert "different grasps" in capsys.readouterr().out
    grasps = [Grasp.load(path), Grasp.load(tmp_path / "grasp_2.json")]
    assert all(len(grasp.fingers) == 3 for grasp in grasps)
    assert all("thumb" in grasp.fingers for grasp in grasps)


def test_power_grasps_are_shown_and_saved(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, command = tmp_path / "power.json", ["grasp", "--hand", "dlr_hit2", "--object", "sphere:0.03", "--class", "power"]
    assert main([*command, "--save", str(path), "--plots", str(tmp_path / "plots")]) == 0
    assert "palm" in LinkGrasp.load(path).links
    assert "largest slip margin" in capsys.readouterr().out
    assert (tmp_path / "plots" / "grasp.png").stat().st_size > 0
    assert main([*command, "--count", "2"]) == 1
    assert "--count = 2" in capsys.readouterr().err


def test_options_are_checked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["grasp", "--repair", "-1"]) == 1
    assert "--repair" in capsys.readouterr().err
    assert main(["grasp", "--budget", "0"]) == 1
    assert "budget" in capsys.readouterr().err
    assert main(["grasp", "--class", "claw"]) == 1
    assert "tripod" in capsys.readouterr().err
    assert main(["grasp", "--postures", str(tmp_path / "grasps.yaml")]) == 1
    assert ".npy or .csv" in capsys.readouterr().err
