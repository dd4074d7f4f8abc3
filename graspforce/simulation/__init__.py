"""MuJoCo as the plant: a hand that holds an object in a physics engine that is not ours. Never part of an answer.

scene     = simulation.build(hold, gravity_H=...)                      # checked against Pinocchio
plant     = simulation.Plant(scene, disturbances=[simulation.Push(...)])
recording = simulation.simulate(plant, ObjectController(hold, ...), simulation.reach(start, ...), duration=2.0)
simulation.figures(recording)
"""

from graspforce.simulation.disturbance import ContactLoss, DeadMotor, FrictionChange, MassChange, Push
from graspforce.simulation.pictures import Artist, artist, no_display, window
from graspforce.simulation.plant import Disturbance, Plant, Touch
from graspforce.simulation.recording import Figures, Recording, figures
from graspforce.simulation.reference import Reference, reach, sine, still, turn
from graspforce.simulation.run import Commanded, Controller, simulate
from graspforce.simulation.scene import Engine, Scene, build
from graspforce.simulation.sensors import Channel, Reader, Sensors

__all__ = [
    "Artist",
    "Channel",
    "Commanded",
    "ContactLoss",
    "Controller",
    "DeadMotor",
    "Disturbance",
    "Engine",
    "Figures",
    "FrictionChange",
    "MassChange",
    "Plant",
    "Push",
    "Reader",
    "Recording",
    "Reference",
    "Scene",
    "Sensors",
    "Touch",
    "artist",
    "build",
    "figures",
    "no_display",
    "reach",
    "simulate",
    "sine",
    "still",
    "turn",
    "window",
]
