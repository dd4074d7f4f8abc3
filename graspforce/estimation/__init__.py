"""Estimation: the state of a grasp from what a hand measures.

- `measurement`: the records of measurements
- `sensor_model`: rate, latency and noise of the sensors
"""

from graspforce.estimation.measurement import Measurement, PoseMeasurement
from graspforce.estimation.sensor_model import CameraModel, SensorModel

__all__ = ["CameraModel", "Measurement", "PoseMeasurement", "SensorModel"]
