"""``graspforce glove``: recorded frames become a calibration."""

from __future__ import annotations

import json

import numpy as np
import pytest

from graspforce.cli import main
from graspforce.learning import GloveCalibration, PostureLibrary, SimulatedGlove

JOINTS, LOWER, UPPER = ("a", "b", "c"), np.zeros(3), np.full(3, 1.5)


@pytest.fixture
def files(tmp_path):
    """Return the files of 40 postures, and of 10 frames in each."""
    rng = np.random.default_rng(0)
    q, glove = rng.uniform(LOWER, UPPER, (40, 3)), SimulatedGlove(LOWER, UPPER)
    PostureLibrary(JOINTS, q).save(tmp_path / "postures.csv")
    np.savetxt(tmp_path / "frames.csv", glove.readings(np.repeat(q, 10, axis=0), rng), delimiter=",")
    return [str(tmp_path / "postures.csv"), str(tmp_path / "frames.csv")]


def test_a_calibration_is_saved_and_its_errors_are_shown(files, tmp_path, capsys):
    file = tmp_path / "glove.json"
    assert main(["glove", "calibrate", *files, "--save", str(file)]) == 0
    assert "mean error" in capsys.readouterr().out
    readings = SimulatedGlove(LOWER, UPPER, noise=0.0).readings([[0.3, 0.6, 0.9]], np.random.default_rng(1))
    np.testing.assert_allclose(GloveCalibration.load(file).posture(readings[0]), [0.3, 0.6, 0.9], atol=np.radians(2.0))
    assert main(["glove", "calibrate", *files, "--save", str(file)]) == 1
    assert "--force" in capsys.readouterr().err


def test_errors_are_a_record(files, capsys):
    assert main(["glove", "calibrate", *files, "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert set(record["mean_error"]) == set(JOINTS)
    assert max(record["mean_error"].values()) < np.radians(2.0)


@pytest.mark.parametrize(
    ("text", "message"), [("1,2,3\n", "multiple of 40"), ("1,2,3\n1,x,3\n", "frame 2"), ("1,2,3\n1,2\n", "frame 2")]
)
def test_invalid_frames_are_refused(text, message, files, tmp_path, capsys):
    (tmp_path / "frames.csv").write_text(text)
    assert main(["glove", "calibrate", *files]) == 1
    assert message in capsys.readouterr().err
