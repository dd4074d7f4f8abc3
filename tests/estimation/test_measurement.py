"""Records of measurements: everything that is saved can be loaded again, and wrong input is named."""

from __future__ import annotations

import json

import numpy as np
import pytest

from graspforce.core.errors import InvalidInput
from graspforce.estimation import CameraModel, Measurement, PoseMeasurement, SensorModel

TURN = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
POSE = PoseMeasurement(0.02, [0.1, 0.2, 0.3], TURN, np.diag([1e-6] * 3 + [4e-4] * 3))


def full_measurement():
    return Measurement(
        0.05,
        [0.1, 0.2],
        v=[1.0, 2.0],
        tau=[0.3, 0.4],
        current=[0.5, 0.6],
        tip_wrench=np.arange(18.0).reshape(3, 6),
        contact_points=np.arange(9.0).reshape(3, 3),
        object=POSE,
    )


def test_a_measurement_survives_json():
    measurement = full_measurement()
    record = json.loads(json.dumps(measurement.to_dict()))
    loaded = Measurement.from_dict(record)
    assert loaded.to_dict() == measurement.to_dict()
    for name in ("q", "v", "tau", "current", "tip_wrench", "contact_points"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(measurement, name))
    np.testing.assert_array_equal(loaded.object.covariance, POSE.covariance)


def test_quantities_that_are_not_measured_stay_absent():
    record = Measurement(1.0, [0.1]).to_dict()
    assert record == {"t": 1.0, "posture": [0.1]}
    loaded = Measurement.from_dict({**record, "velocity": None, "object": None})
    assert loaded.v is None
    assert loaded.object is None


def test_a_quaternion_gives_the_same_pose():
    record = {"t": 0.0, "position": [0, 0, 0], "quaternion": [np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]}
    np.testing.assert_allclose(PoseMeasurement.from_dict(record).R_HO, TURN, atol=1e-15)


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"t": None}, "measurement.t"),
        ({"t": -1e228}, "measurement.t"),
        ({"t": 1.7e12}, "measurement.t"),  # Unix time in ms
        ({"posture": [0.1, float("nan")]}, "measurement.posture[1]"),
        ({"velocity": [0.1]}, "measurement.velocity"),
        ({"tip_wrenches": [[1.0, 2.0, 3.0]]}, "measurement.tip_wrenches"),
        ({"contact_points": [[1.0, 2.0, 3.0]]}, "measurement.contact_points"),
        ({"colour": 1}, "measurement.colour"),
        ({"object": {"position": [0, 0, 0], "rotation": TURN}}, "measurement.object.t"),
        ({"object": {"t": 1e11, "position": [0, 0, 0], "rotation": TURN}}, "measurement.object.t"),
        (
            {"object": {"t": 0.0, "position": [0, 0, 0], "rotation": np.diag([1.0, 1.0, -1.0]).tolist()}},
            "measurement.object.rotation",
        ),
        (
            {"object": {"t": 0.0, "position": [0, 0, 0], "rotation": TURN, "covariance": np.diag([-1.0] * 6).tolist()}},
            "measurement.object.covariance",
        ),
    ],
)
def test_an_error_names_the_field_with_its_path(change, field):
    with pytest.raises(InvalidInput) as error:
        Measurement.from_dict({**full_measurement().to_dict(), **change})
    assert error.value.field == field


@pytest.mark.parametrize("camera", [None, CameraModel(60.0, 0.03, 5e-4, 0.01, 3e-3, 0.02)])
def test_a_sensor_model_survives_json(camera):
    sensors = SensorModel(1e-3, 2e-4, 500.0, 2e-3, True, 0.1, 0.01, None, camera)
    loaded = SensorModel.from_dict(json.loads(json.dumps(sensors.to_dict())))
    assert loaded == sensors


def test_quantisation_counts_as_noise():
    """A uniform error of width r has the variance r²/12."""
    errors = np.random.default_rng(0).uniform(-0.5, 0.5, 100_000) * 2e-3
    model = SensorModel(encoder_resolution=2e-3)
    assert model.encoder_variance == pytest.approx(errors.var(), rel=0.02)  # standard error of a variance: √(2/N) < 0.5 %


@pytest.mark.parametrize(
    ("record", "field"),
    [
        ({"rate": 0.0}, "sensors.rate"),
        ({"encoder_noise": -1.0}, "sensors.encoder_noise"),
        ({"camera": {"rate": -30.0}}, "sensors.camera.rate"),
        ({"camera": {"position_noise": 0.0}}, "sensors.camera.position_noise"),
        ({"has_velocity": 1}, "sensors.has_velocity"),
        ({"noise": 1}, "sensors.noise"),
    ],
)
def test_a_sensor_model_rejects_impossible_values(record, field):
    with pytest.raises(InvalidInput) as error:
        SensorModel.from_dict(record)
    assert error.value.field == field
