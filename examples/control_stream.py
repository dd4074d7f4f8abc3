"""Control over the network: a stream of states and commands.

The driver sends a state each period and receives torques. If a command is late, the watchdog supplies the torques.
"""

import sys

import numpy as np
from matplotlib.figure import Figure

import graspforce as gf
from graspforce.contact.motion import BodyMotion
from graspforce.control import GraspState
from graspforce.geometry import Sphere

grasp = gf.find_grasp(gf.Hand.load("dlr_hit2"), gf.Body.solid(Sphere(0.03), mass=0.05), friction=0.7)
state = GraspState(grasp.q, np.zeros(grasp.hand.n), BodyMotion(grasp.p_HO, grasp.R_HO))
torques, ages = [], []
with gf.service.Server(["dlr_hit2"], listen="tcp/127.0.0.1:0") as server:
    with gf.service.Client(server.addresses[0]) as client, client.open_stream(grasp) as stream:
        for i in range(200):
            height = 5e-4 * (1 - np.cos(2 * np.pi * i / 200))  # m
            command = stream.step(state, BodyMotion(grasp.p_HO + [0, 0, height], grasp.R_HO))
            torques.append(command.tau)
            ages.append(command.age)
print(f"median age of a command: {1e3 * np.median(ages):.2f} ms")

figure = Figure(figsize=(7, 3.4), layout="constrained")
axes = figure.subplots()
axes.plot(1e3 * np.array(torques))
axes.set(xlabel="period", ylabel="torque (mN·m)", title="Torques of 15 motors, received over Zenoh")
figure.savefig(sys.argv[1] if len(sys.argv) > 1 else "control_stream.png", dpi=110)
