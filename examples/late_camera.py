"""Control with a late camera.

The hand measures joint positions only. A camera sees the ball 15 times a second, 60 ms late and with 1 mm of noise. The
controller follows its estimate, which combines fingertips and camera.
"""

import sys

import numpy as np
from matplotlib.figure import Figure

import graspforce as gf
from graspforce import simulation
from graspforce.contact.motion import BodyMotion
from graspforce.control import OutputFeedbackController
from graspforce.estimation import CameraModel, SensorModel
from graspforce.geometry import Sphere

grasp = gf.find_grasp(gf.Hand.load("dlr_hit2"), gf.Body.solid(Sphere(0.03), mass=0.05), friction=0.7)
sensors = SensorModel(encoder_noise=2e-4, camera=CameraModel(rate=15.0, latency=0.06, position_noise=1e-3))
world = simulation.World(sensors=sensors, seed=1)
plant = simulation.make_plant(grasp, world.plant_options(grasp))
motion = simulation.linear_reference(BodyMotion(grasp.p_HO, grasp.R_HO), np.array([0.0, 0.0, 0.01]), 1.0)
run = simulation.simulate_measured(plant, OutputFeedbackController(grasp, sensors=sensors), motion, 2.0, world)
error = 1e3 * np.sqrt(np.mean(np.sum(run.estimation_error()[:, :3] ** 2, axis=1)))  # mm
print(f"error of the estimate {error:.2f} mm RMS; noise of the camera 1 mm in each axis")

height = [1e3 * (p - grasp.p_HO[2]) for p in (run.truth.p_HO[:, 2], run.estimate.p_HO[:, 2], run.camera.p_HO[:, 2])]  # mm
figure = Figure(figsize=(7, 3.4), layout="constrained")
axes = figure.subplots()
axes.plot(run.camera.t_arrival, height[2], "o", color="#E69F00", markersize=4, label="camera, when it arrives")
axes.plot(run.truth.t, height[0], color="#999999", linewidth=4, label="true")
axes.plot(run.estimate.t, height[1], color="#0072B2", linewidth=1.5, label="estimated")
axes.set(xlabel="time (s)", ylabel="height (mm)", title=f"The estimate follows the ball to {error:.2f} mm with a late camera")
axes.legend(frameon=False, ncols=3, loc="lower center")
figure.savefig(sys.argv[1] if len(sys.argv) > 1 else "late_camera.png", dpi=110)
