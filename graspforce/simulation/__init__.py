"""MuJoCo as the plant: a hand that holds an object in a physics engine that is not ours. Never part of an answer.

scene     = simulation.build(hold, gravity_H=...)                      # checked against Pinocchio
plant     = simulation.Plant(scene, disturbances=[simulation.Push(...)])
recording = simulation.simulate(plant, ObjectController(hold, ...), simulation.reach(start, ...), duration=2.0)
simulation.figures(recording)
"""

from graspforce.simulation.closed_loop import Controller, ControllerCommand, simulate
from graspforce.simulation.disturbance import ContactLoss, FrictionChange, MassChange, MotorFailure, Push
from graspforce.simulation.plant import Disturbance, Plant, TrueContacts
from graspforce.simulation.recording import Recording, RunMetrics, compute_metrics
from graspforce.simulation.reference import (
    Reference,
    constant_reference,
    linear_reference,
    rotation_reference,
    sine_reference,
)
from graspforce.simulation.rendering.renderer import Renderer, make_renderer, missing_display_reason, open_viewer
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
    "Renderer",
    "RunMetrics",
    "Scene",
    "SensorChannel",
    "SensorReader",
    "Sensors",
    "TrueContacts",
    "build_scene",
    "compute_metrics",
    "constant_reference",
    "linear_reference",
    "make_renderer",
    "missing_display_reason",
    "open_viewer",
    "rotation_reference",
    "simulate",
    "sine_reference",
]
