"""Closed-loop simulation in MuJoCo: plant, disturbances, sensors, references, recordings and their metrics.

scene     = simulation.build_scene(grasp, gravity_H=...)               # checked against Pinocchio
plant     = simulation.Plant(scene, disturbances=[simulation.Push(...)])
reference = simulation.linear_reference(start, travel, period)
recording = simulation.simulate(plant, ObjectController(grasp, ...), reference, duration=2.0)
metrics   = simulation.compute_metrics(recording)

Films and the interactive viewer are in `graspforce.simulation.rendering`.
"""

from graspforce.simulation.closed_loop import Controller, ControllerCommand, simulate
from graspforce.simulation.disturbance import ContactLoss, FrictionChange, MassChange, MotorFailure, Push
from graspforce.simulation.metrics import RunMetrics, compute_metrics
from graspforce.simulation.plant import Disturbance, Plant, TrueContacts
from graspforce.simulation.recording import Recording
from graspforce.simulation.reference import (
    Reference,
    combined_reference,
    constant_reference,
    linear_reference,
    rotation_reference,
    sine_reference,
)
from graspforce.simulation.scene import EngineSettings, Scene, build_scene
from graspforce.simulation.sensors import SensorChannel, SensorReader, Sensors

__all__ = [
    "ContactLoss",
    "Controller",
    "ControllerCommand",
    "Disturbance",
    "EngineSettings",
    "FrictionChange",
    "MassChange",
    "MotorFailure",
    "Plant",
    "Push",
    "Recording",
    "Reference",
    "RunMetrics",
    "Scene",
    "SensorChannel",
    "SensorReader",
    "Sensors",
    "TrueContacts",
    "build_scene",
    "combined_reference",
    "compute_metrics",
    "constant_reference",
    "linear_reference",
    "rotation_reference",
    "simulate",
    "sine_reference",
]
