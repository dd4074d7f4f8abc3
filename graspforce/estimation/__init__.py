"""Estimation: the state of a grasp from what a hand measures.

- `measurement`: the records of measurements
- `sensor_model`: rate, latency and noise of the sensors
- `joint_filter`: joint positions and rates from encoders
- `contact_pose`: the object's pose from the fingertips
- `pose_fusion`: the object's pose from the contacts and a camera
- `grasp_estimator`: all of them in one step

The estimator loads Pinocchio and SciPy at first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from graspforce.core.lazy import lazy_exports
from graspforce.estimation.measurement import Measurement, PoseMeasurement
from graspforce.estimation.sensor_model import CameraModel, SensorModel
from graspforce.estimation.settings import EstimatorSettings

if TYPE_CHECKING:
    from graspforce.estimation.estimate import EstimatorMemory, GraspEstimate
    from graspforce.estimation.grasp_estimator import GraspEstimator

__all__ = [
    "CameraModel",
    "EstimatorMemory",
    "EstimatorSettings",
    "GraspEstimate",
    "GraspEstimator",
    "Measurement",
    "PoseMeasurement",
    "SensorModel",
]

__getattr__ = lazy_exports(
    __name__,
    {
        "EstimatorMemory": "graspforce.estimation.estimate",
        "GraspEstimate": "graspforce.estimation.estimate",
        "GraspEstimator": "graspforce.estimation.grasp_estimator",
    },
)
