"""Bias acceleration of contacts: closed forms, Pinocchio's tip motions, and fast rolling in closed loop."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.tracked_moves import EARTH, SETTINGS, find_move_grasp

from graspforce import ContactSet, simulation
from graspforce.contact.motion import BodyMotion
from graspforce.control import ObjectController
from graspforce.simulation import Plant
from graspforce.simulation.plants.contact_bias import contact_bias_acceleration

BALLS = """
<mujoco><option timestep="1e-5" gravity="0 0 0" cone="elliptic"/>
<worldbody><geom name="big" type="sphere" size="0.05" condim="{condim}"/>
<body pos="0 0 0.0699"><freejoint/><geom type="sphere" size="0.02" condim="{condim}"/></body></worldbody></mujoco>
"""
BOX = """
<mujoco><worldbody><geom type="plane" size="1 1 1"/>
<body pos="0 0 0.0199"><freejoint/><geom type="box" size="0.02 0.02 0.02"/></body></worldbody></mujoco>
"""


def bias_of(xml: str, v: list[float]) -> tuple[np.ndarray, mujoco.MjData]:
    """Return J̇ v of a free body with velocity v, and the data."""
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    data.qvel[:] = v
    mujoco.mj_step1(model, data)
    return contact_bias_acceleration(model, data, mujoco.MjData(model)), data


@pytest.mark.parametrize("condim", [1, 3, 4])
def test_rolling_ball_has_centripetal_and_lateral_bias(condim: int) -> None:
    """With the outward normal n, ṅ = v/d and ω = n × v/r + s n: n·(J̇ v) = v²/d, tangential part − r s n × v/d.

    d = 69.9 mm between the middles; the engine's contact is halfway through 0.1 mm of overlap, which is 1/400 of r. Over a
    step of 10 µs the direction turns by 1e-4.
    """
    speed, spin, d, r = 0.6, 9.0, 0.0699, 0.02  # m/s, rad/s, m
    v, n = np.array([speed, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
    bias, data = bias_of(BALLS.format(condim=condim), [*v, *(np.cross(n, v) / r + spin * n)])
    frame = data.contact[0].frame.reshape(3, 3)
    assert frame[0] == pytest.approx(n)  # from the first ball into the second
    assert len(bias) == condim
    assert bias[0] == pytest.approx(speed**2 / d, rel=1e-3)  # 5.2 m/s²
    if condim >= 3:
        aside = frame[1:3].T @ bias[1:3]
        assert aside == pytest.approx(-r * spin * np.cross(n, v) / d, rel=5e-3, abs=1e-2)  # 1.5 m/s²
    if condim == 4:
        assert bias[3] == pytest.approx(0.0, abs=1e-2)  # ω · ṅ = 0 where the ball rolls along v


def test_pairs_with_several_contacts_get_no_bias() -> None:
    bias, data = bias_of(BOX, [0.3, 0.0, 0.0, 0.0, 5.0, 1.0])
    assert data.ncon > 1
    assert not bias.any()


@pytest.mark.parametrize("model", ["point", "soft"])
@pytest.mark.parametrize("name", ["four_finger", "dlr_hit2"])
def test_bias_matches_the_change_of_pinocchios_contact_velocities(name: str, model: str) -> None:
    """Balls on a ball: relative velocity u at the contact from Pinocchio's tips, at both ends of a step."""
    points = find_move_grasp(name)
    torsion = 0.005 if model == "soft" else None  # m
    grasp = replace(
        points,
        contacts=ContactSet.stack([replace(c, model=model, torsional_friction=torsion) for c in points.contacts.contacts]),
    )
    hand, fingers = grasp.hand, grasp.fingers
    plant = Plant(simulation.build_scene(grasp, gravity_H=EARTH))
    scene, data, dt, radius = plant.scene, plant.data, plant.dt, plant.scene.tip_radius
    q, start, twist = plant.state().q, plant.object_motion(), np.array([0.1, -0.2, 0.15, 3.0, -4.0, 5.0])  # m/s and rad/s
    rates = (twist[:3] + np.cross(twist[3:], grasp.contacts.p_OC @ start.R_HO.T)) @ start.R_HO  # of the object's points, in O
    J = hand.contact_jacobian(q, fingers, points.contacts, start.p_HO, start.R_HO)
    v = np.linalg.lstsq(J, np.einsum("nij,ni->nj", grasp.contacts.R_OC, rates).ravel(), rcond=1e-3)[
        0
    ]  # rad/s: tips follow the object
    data.qvel[scene.v_address] = scene.T @ v
    data.qvel[scene.object_v_address : scene.object_v_address + 6] = np.append(twist[:3], start.R_HO.T @ twist[3:])
    mujoco.mj_step1(plant.model, data)
    bias = contact_bias_acceleration(plant.model, data, mujoco.MjData(plant.model))

    def relative(t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return inward normals (N, 3), and the object's velocities and angular velocities relative to the tips, in H."""
        tips, p_HO = hand.tip_motion(q + t * v, v, fingers), start.p_HO + t * twist[:3]
        offset = p_HO - tips.p_HF
        distance = np.linalg.norm(offset, axis=1)
        n = offset / distance[:, None]
        p = tips.p_HF + n * (radius + (distance - 0.03 - radius) / 2.0)[:, None]
        of_tip = tips.twist[:, :3] + np.cross(tips.twist[:, 3:], p - tips.p_HF)
        return n, twist[:3] + np.cross(twist[3:], p - p_HO) - of_tip, twist[3:] - tips.twist[:, 3:]

    (n, u, spin), (n_later, u_later, spin_later) = relative(0.0), relative(dt)
    largest = 0.0
    for c in range(data.ncon):
        contact = data.contact[c]
        i, row, frame = scene.tip_index(contact), contact.efc_address, contact.frame.reshape(3, 3)
        assert frame[0] == pytest.approx(n[i], abs=1e-12)
        assert data.efc_vel[row : row + 3] == pytest.approx(frame @ u[i], abs=1e-12)
        expected = [n_later[i] @ u_later[i] - n[i] @ u[i], *(frame[1:3] @ (u_later[i] - u[i]))]  # m/s
        expected += [n_later[i] @ spin_later[i] - n[i] @ spin[i]] if model == "soft" else []
        assert bias[row : row + len(expected)] == pytest.approx(np.array(expected) / dt, abs=1e-8)  # rounding over dt
        largest = max(largest, float(np.abs(bias[row : row + 3]).max()))
    assert data.ncon == 3
    assert largest > 1.0  # m/s²


def test_fast_rolling_tips_keep_their_depth_and_do_not_slip() -> None:
    """Rotation out and back by 23° in 0.12 s. Without J̇ v a fingertip lifts off and slips by 0.19 mm."""
    grasp = find_move_grasp("four_finger")
    follow = simulation.rotation_reference(BodyMotion(grasp.p_HO, grasp.R_HO), [0.0, 1.0, 0.0], 0.4, 0.12)
    plant = Plant(simulation.build_scene(grasp, gravity_H=EARTH))
    creep: list[float] = []  # m
    run = simulation.simulate(
        plant, ObjectController(grasp, SETTINGS), follow, 0.12, on_step=lambda _, command: creep.append(command.creep.max())
    )
    turned = Rotation.from_matrix(run.R_HO @ grasp.R_HO.T).magnitude().max()
    assert turned == pytest.approx(0.4, abs=0.02)
    assert run.touching.all()
    assert (run.depth > 0.8 * run.depth[0]).all()  # forces fall by 6 % at most, and posture matters
    assert max(creep) < 5e-5
