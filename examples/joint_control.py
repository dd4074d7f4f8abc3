"""Move a finger to a posture with a joint-space law.

Proportional-derivative control with gravity compensation, simulated with the hand's own dynamics.
"""

import sys

import numpy as np
from matplotlib.figure import Figure

import graspforce as gf
from graspforce.control.joints.joint_laws import JointMotion, PDGains, pd_gravity

hand = gf.Hand.load("anthropomorphic15")
n, dt = hand.n, 1e-3
gains = PDGains(kp=0.5 * np.ones(n), kv=0.03 * np.ones(n))
goal = JointMotion(0.5 * (hand.q_lower + hand.q_upper))
q, v, path = goal.q + 0.3, np.zeros(n), []
for _ in range(1500):
    tau = pd_gravity(gains, hand, JointMotion(q, v), goal, [0.0, 0.0, -9.81]).tau
    a = np.linalg.solve(hand.mass_matrix(q), tau - hand.inverse_dynamics(q, v, np.zeros(n)))
    v = v + dt * a
    q = q + dt * v
    path.append(q - goal.q)
print(f"largest error after 1.5 s: {np.degrees(np.abs(path[-1]).max()):.4f}°")

figure = Figure(figsize=(7, 3.4), layout="constrained")
axes = figure.subplots()
axes.plot(dt * np.arange(len(path)), np.degrees(path))
axes.set(xlabel="time (s)", ylabel="joint error (°)", title="Fifteen joints settle at their goals")
figure.savefig(sys.argv[1] if len(sys.argv) > 1 else "joint_control.png", dpi=110)
