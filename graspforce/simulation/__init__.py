"""Closed-loop simulation in MuJoCo: plant, disturbances, sensors, references, recordings and their metrics.

`build_scene` makes the MuJoCo model of a grasp, and checks it against Pinocchio. `Plant` simulates it, with disturbances.
`UrdfPlant` is a second plant, from the hand's URDF, with joint friction and errors of the model.
`simulate` closes the loop with a controller and a reference, and returns a `Recording`. `compute_metrics` computes its metrics.

Films and the interactive viewer are in `graspforce.simulation.rendering`.
"""

from graspforce.simulation.closed_loop import Controller, ControllerCommand, simulate
from graspforce.simulation.disturbance import ContactLoss, FrictionChange, MassChange, MotorFailure, Push
from graspforce.simulation.engine_settings import EngineSettings
from graspforce.simulation.metrics import RunMetrics, compute_metrics
from graspforce.simulation.plant import Disturbance, Plant
from graspforce.simulation.plant_interface import PlantInterface, TrueContacts
from graspforce.simulation.plant_options import PlantOptions
from graspforce.simulation.recording import Recording
from graspforce.simulation.reference import (
    Reference,
    combined_reference,
    constant_reference,
    linear_reference,
    rotation_reference,
    sine_reference,
)
from graspforce.simulation.scene import Scene, build_scene
from graspforce.simulation.sensors import SensorChannel, SensorReader, Sensors
from graspforce.simulation.urdf_plant import UrdfPlant

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
    "PlantInterface",
    "PlantOptions",
    "Push",
    "Recording",
    "Reference",
    "RunMetrics",
    "Scene",
    "SensorChannel",
    "SensorReader",
    "Sensors",
    "TrueContacts",
    "UrdfPlant",
    "build_scene",
    "combined_reference",
    "compute_metrics",
    "constant_reference",
    "linear_reference",
    "rotation_reference",
    "simulate",
    "sine_reference",
]
