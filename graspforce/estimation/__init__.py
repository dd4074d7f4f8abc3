"""Estimation: the state of a grasp from what a hand measures.

- `measurement`: the records of measurements
- `sensor_model`: rate, latency and noise of the sensors
- `joint_filter`: joint positions and rates from encoders
- `contact_pose`: the object's pose from the fingertips
- `pose_fusion`: the object's pose from the contacts and a camera
- `grasp_estimator`: all of them in one step
- `contact_forces`: contact forces from joint torques and fingertip sensors
- `slip`: slip of each finger
- `contact_friction`: friction coefficient of each finger, with bounds
- `payload`: mass, centre of mass and external wrench
- `grasp_monitor`: forces, slip, friction and payload in one step
- `motor_share`, `twin`: the motion against the model, and drift

The estimator loads Pinocchio and SciPy at first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from graspforce.core.lazy import lazy_exports
from graspforce.estimation.measurement import Measurement, PoseMeasurement
from graspforce.estimation.sensor_model import CameraModel, SensorModel
from graspforce.estimation.settings import EstimatorSettings

if TYPE_CHECKING:
    from graspforce.estimation.contact_forces import ContactForceEstimator, ContactForces, ForceModelErrors
    from graspforce.estimation.contact_friction import (
        ContactFrictionEstimate,
        ContactFrictionEstimator,
        ContactFrictionSettings,
    )
    from graspforce.estimation.estimate import EstimatorMemory, GraspEstimate
    from graspforce.estimation.grasp_estimator import GraspEstimator
    from graspforce.estimation.grasp_monitor import AppliedCommand, GraspMonitor, GraspMonitorEstimate, GraspMonitorSettings
    from graspforce.estimation.payload import PayloadEstimate, PayloadEstimator, PayloadSettings
    from graspforce.estimation.slip.detector import SlipDetector, SlipEstimate
    from graspforce.estimation.slip.slip_settings import SlipSettings

__all__ = [
    "AppliedCommand",
    "CameraModel",
    "ContactForceEstimator",
    "ContactForces",
    "ContactFrictionEstimate",
    "ContactFrictionEstimator",
    "ContactFrictionSettings",
    "EstimatorMemory",
    "EstimatorSettings",
    "ForceModelErrors",
    "GraspEstimate",
    "GraspEstimator",
    "GraspMonitor",
    "GraspMonitorEstimate",
    "GraspMonitorSettings",
    "Measurement",
    "PayloadEstimate",
    "PayloadEstimator",
    "PayloadSettings",
    "PoseMeasurement",
    "SensorModel",
    "SlipDetector",
    "SlipEstimate",
    "SlipSettings",
]

__getattr__ = lazy_exports(
    __name__,
    {
        "AppliedCommand": "graspforce.estimation.grasp_monitor",
        "ContactForceEstimator": "graspforce.estimation.contact_forces",
        "ContactForces": "graspforce.estimation.contact_forces",
        "EstimatorMemory": "graspforce.estimation.estimate",
        "ForceModelErrors": "graspforce.estimation.contact_forces",
        "ContactFrictionEstimate": "graspforce.estimation.contact_friction",
        "ContactFrictionEstimator": "graspforce.estimation.contact_friction",
        "ContactFrictionSettings": "graspforce.estimation.contact_friction",
        "GraspEstimate": "graspforce.estimation.estimate",
        "GraspEstimator": "graspforce.estimation.grasp_estimator",
        "GraspMonitor": "graspforce.estimation.grasp_monitor",
        "GraspMonitorEstimate": "graspforce.estimation.grasp_monitor",
        "GraspMonitorSettings": "graspforce.estimation.grasp_monitor",
        "PayloadEstimate": "graspforce.estimation.payload",
        "PayloadEstimator": "graspforce.estimation.payload",
        "PayloadSettings": "graspforce.estimation.payload",
        "SlipDetector": "graspforce.estimation.slip.detector",
        "SlipEstimate": "graspforce.estimation.slip.detector",
        "SlipSettings": "graspforce.estimation.slip.slip_settings",
    },
)
