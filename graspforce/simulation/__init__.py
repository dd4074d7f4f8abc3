"""Closed-loop simulation in MuJoCo: plant, disturbances, sensors, references, recordings and their metrics.

`build_scene` makes the MuJoCo model of a grasp, and checks it against Pinocchio. `Plant` simulates it, with disturbances.
`UrdfPlant` is a second plant, from the hand's URDF, with joint friction and errors of the model.
`simulate` closes the loop with a controller and a reference, and returns a `Recording`. `compute_metrics` computes its metrics.

`World` states how hand, object, contacts and sensors differ from what the controller is told. `make_world_plant` makes its
plant, and `simulate_measured` closes the loop with a controller that knows measurements only.

Films and the interactive viewer are in `graspforce.simulation.rendering`.
"""

from graspforce.core.optional_libraries import optional_imports

with optional_imports("mujoco"):
    from graspforce.simulation.loops.closed_loop import Controller, simulate
    from graspforce.simulation.loops.comparison_controllers import DirectController, ExactController
    from graspforce.simulation.loops.measured_loop import MeasuredController, simulate_measured
    from graspforce.simulation.loops.reference import (
        Reference,
        combined_reference,
        constant_reference,
        linear_reference,
        rotation_reference,
        sine_reference,
    )
from graspforce.simulation.plants.disturbance import ContactLoss, FrictionChange, MassChange, MotorFailure, Push
from graspforce.simulation.plants.engine_settings import EngineSettings
from graspforce.simulation.plants.plant import Disturbance, Plant
from graspforce.simulation.plants.plant_interface import LinkCollision, PlantInterface, TrueContacts
from graspforce.simulation.plants.plant_options import PlantOptions
from graspforce.simulation.plants.scene import Scene, build_scene
from graspforce.simulation.plants.urdf_plant import UrdfPlant
from graspforce.simulation.recordings.measured_recording import MeasuredRecording
from graspforce.simulation.recordings.metrics import RunMetrics, compute_metrics
from graspforce.simulation.recordings.recording import Recording
from graspforce.simulation.recordings.recording_builder import ControllerCommand
from graspforce.simulation.recordings.sliding import sliding_displacement
from graspforce.simulation.sensors.measurement_reader import MeasurementReader
from graspforce.simulation.sensors.sensor_models import SensorChannel, SensorReader, Sensors
from graspforce.simulation.worlds.world import World
from graspforce.simulation.worlds.world_plants import make_plant, make_urdf_plant, make_world_plant

__all__ = [
    "ContactLoss",
    "Controller",
    "ControllerCommand",
    "DirectController",
    "Disturbance",
    "EngineSettings",
    "ExactController",
    "FrictionChange",
    "LinkCollision",
    "MassChange",
    "MeasuredController",
    "MeasuredRecording",
    "MeasurementReader",
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
    "World",
    "build_scene",
    "combined_reference",
    "compute_metrics",
    "constant_reference",
    "linear_reference",
    "make_plant",
    "make_urdf_plant",
    "make_world_plant",
    "rotation_reference",
    "simulate",
    "simulate_measured",
    "sine_reference",
    "sliding_displacement",
]
