"""Friction that MuJoCo simulates is identified from a free motion, and a controller can use it."""

from __future__ import annotations

import numpy as np
from support.friction_recordings import free_motion
from support.simulated_runs import free_body_plant

from graspforce.hand.identification.friction_identification import IdentificationSettings, identify_friction
from graspforce.hand.identification.joint_recording import JointRecording

COULOMB = np.linspace(0.03, 0.08, 12)  # N·m
VISCOUS = np.linspace(0.006, 0.002, 12)  # N·m·s/rad


def test_friction_of_the_plant_is_identified() -> None:
    """A PD law moves the free hand for 4 s. MuJoCo's dry friction is stiff, so 3 % and the filter at reversals remain."""
    plant = free_body_plant("four_finger")
    scene, hand = plant.scene, plant.scene.grasp.hand
    rows = scene.v_address[scene.motor_joints]
    plant.model.dof_frictionloss[rows], plant.model.dof_damping[rows] = COULOMB, VISCOUS
    plant.model.dof_solref[rows], plant.model.dof_solimp[rows] = (0.002, 1.0), (0.9999, 0.9999, 0.001, 0.5, 2.0)
    t = np.arange(4000) * plant.dt
    q_d, v_d, a_d = free_motion(hand, t)
    state, samples = plant.state(), []
    for k in range(len(t)):
        a = a_d[k] + 60.0 * (v_d[k] - state.v) + 900.0 * (q_d[k] - state.q)
        tau = hand.inverse_dynamics(state.q, state.v, a, np.zeros(3)) + COULOMB * np.tanh(v_d[k] / 0.02)
        tau = np.clip(tau, hand.torque_lower, hand.torque_upper)
        samples.append((state.q, tau))
        state = plant.step(tau)
    q, tau = (np.array(column)[500:] for column in zip(*samples, strict=True))  # without the first approach
    settings = IdentificationSettings(slowest_rate=0.1, gravity_H=(0.0, 0.0, 0.0))
    identified = identify_friction(hand, JointRecording(t[500:], q, tau), settings)
    assert identified.is_identified.all()
    np.testing.assert_allclose(identified.coulomb, COULOMB, atol=0.03 * COULOMB.max())
    np.testing.assert_allclose(identified.viscous, VISCOUS, atol=0.002)
