"""Let a glove lead a held object over a control stream.

The glove gives the desired motion at its own rate. The controller at the server chooses and certifies the forces.
"""

import sys

import numpy as np
from matplotlib.figure import Figure

import graspforce as gf
from graspforce import learning
from graspforce.geometry import Sphere

hand, rng = gf.Hand.load("leap_right"), np.random.default_rng(0)
grasp = gf.find_grasp(hand, gf.Body.solid(Sphere(0.03), mass=0.05), ("index", "middle", "thumb"), friction=0.7)

# calibrate a simulated glove in 60 known postures
glove = learning.SimulatedGlove(hand.q_lower, hand.q_upper, noise=0.003)
q = rng.uniform(hand.q_lower, hand.q_upper, (60, hand.n))
calibration = learning.calibrate_glove(glove.readings(q, rng), hand.joint_names, q)

# the operator lifts by 4 mm within 1 s, at 60 frames a second
heights = 0.004 * np.sin(np.pi * np.linspace(0, 1, 60)) ** 2
postures = [hand.grasp_posture(grasp.fingers, grasp.contacts, grasp.p_HO + [0, 0, z], grasp.R_HO, grasp.q) for z in heights]
frames = learning.RecordedFrames(glove.readings(postures, rng), rate=60.0)

same = learning.FingertipMap({name: name for name in grasp.fingers})
limits = learning.TeleoperationLimits(frequency=20.0, travel=0.005)
hold = learning.GloveHold(grasp, learning.GloveOperator(calibration, hand, same), limits)
plant = gf.simulation.Plant(gf.simulation.build_scene(grasp))
desired = learning.GloveReference(hold, frames, plant.dt)
state, heights_of, margins = plant.reset(), [], []
with gf.service.Server([hand], listen="tcp/127.0.0.1:0") as server:
    with gf.service.Client(server.addresses[0]) as client, client.open_stream(grasp) as stream:
        for k in range(1000):
            motion = desired(k * plant.dt)
            command = stream.step(state, motion, wait=1.0)
            state = plant.step(command.tau)
            heights_of.append((motion.p_HO[2], state.object.p_HO[2]))
            margins.append(command.slip_margin)
print(f"{desired.taken} frames, least slip margin {np.min(margins):.2f} N")

figure = Figure(figsize=(7, 4.6), layout="constrained")
above, below = figure.subplots(2, 1, sharex=True)
lifts = 1e3 * (np.array(heights_of) - grasp.p_HO[2])
above.plot(1e3 * np.interp(np.arange(1000) / 1000, np.arange(60) / 60, heights), label="operator")
above.plot(lifts, label=["desired", "object"])
above.set(ylabel="lift (mm)", title="A glove leads a held object")
above.legend(frameon=False)
below.plot(np.array(margins), label=grasp.fingers)
below.set(xlabel="time (ms)", ylabel="slip margin (N)", ylim=(0, None))
below.legend(frameon=False)
figure.savefig(sys.argv[1] if len(sys.argv) > 1 else "glove_stream.png", dpi=110)
