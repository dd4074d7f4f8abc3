"""The scene: inertia, gravity, couplings and limits of the hand, the object, and the contact laws."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from support.allegro_grasp import three_finger_grasp
from support.hands import SHIPPED_HANDS, load, random_posture

from graspforce import Contact, ContactSet, Hand, InvalidInput
from graspforce.core.errors import ModelError
from graspforce.geometry import Box, Cylinder, ImplicitSurface, Sphere, Superquadric
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.hand.tendon_modes import stop_tendon_joints
from graspforce.simulation.plants import scene as scenes
from graspforce.simulation.plants.engine_settings import EngineSettings

SAME = 1e-12  # relative; the engines round differently


def any_grasp(hand: Hand, body: Body | None = None, mu: float = 0.5, model: str = "point") -> Grasp:
    """Return a grasp of the first two fingers, whose tips need not touch."""
    contacts = [Contact([0.03 * s, 0.0, 0.0], [-s, 0.0, 0.0], mu, model, torsional_friction=0.01) for s in (1.0, -1.0)]
    fingers = tuple(finger.name for finger in hand.fingers[:2])
    body = body or Body.solid(Sphere(0.03), 0.05)
    return Grasp(hand, body, fingers, ContactSet.stack(contacts), hand.neutral, [0.0, 0.0, 0.3], np.eye(3))


@pytest.mark.parametrize("name", SHIPPED_HANDS)
def test_dynamics_match_pinocchio(name):
    hand = load(name)
    gravity_H = np.array([2.0, -3.0, -8.0])
    scene = scenes.build_scene(any_grasp(hand), gravity_H=gravity_H)
    data = mujoco.MjData(scene.model)
    assert scenes.check_against_pinocchio(scene) < SAME
    for seed in range(3):
        q, v = random_posture(hand, seed), np.random.default_rng(seed).normal(size=hand.n)
        scenes.set_posture(scene, data, q, v)
        mujoco.mj_forward(scene.model, data)
        full = np.zeros((scene.model.nv, scene.model.nv))
        mujoco.mj_fullM(scene.model, data, full)
        M = scene.T.T @ full[np.ix_(scene.v_address, scene.v_address)] @ scene.T
        want = hand.mass_matrix(q)
        np.testing.assert_allclose(M, want, atol=SAME * np.abs(want).max())
        want = hand.inverse_dynamics(q, v, np.zeros(hand.n), gravity_H)
        np.testing.assert_allclose(scene.T.T @ data.qfrc_bias[scene.v_address], want, atol=SAME * np.abs(want).max())
        for i, finger in enumerate(scene.grasp.fingers):
            tip = data.geom_xpos[scene.tip_geoms[i]]
            np.testing.assert_allclose(tip, hand.tip_pose(q, finger)[0], atol=1e-12)  # m


def test_hand_with_a_stopped_tendon_joint_matches_pinocchio():
    """The leader is locked, and the motor's inertia acts on the joint that still moves."""
    for name, stopped in (("barrett", "finger_1_inner"), ("shadow_right", "FFJ1")):
        scene = scenes.build_scene(any_grasp(stop_tendon_joints(load(name), {stopped: 0.6})))
        assert scenes.check_against_pinocchio(scene) < SAME


@pytest.mark.parametrize("field", ["body_mass", "dof_armature"])
def test_changed_hand_is_rejected(field):
    scene = scenes.build_scene(any_grasp(load("four_finger")))
    getattr(scene.model, field)[scene.tip_bodies[0] if field == "body_mass" else scene.v_address[0]] *= 1.001
    with pytest.raises(ModelError, match="differs from Pinocchio's"):
        scenes.check_against_pinocchio(scene)


def test_locked_joints_are_fixed_and_prismatic_joints_slide(tmp_path):
    link = """<inertial><origin xyz="0.01 0 0.02"/><mass value="0.1"/>
        <inertia ixx="1e-5" iyy="2e-5" izz="2e-5" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
    limit = '<limit lower="-1" upper="1" effort="20" velocity="0.1"/></joint>'
    (tmp_path / "gripper.urdf").write_text(f"""<robot name="gripper"><link name="base"/>
      <link name="turret">{link}<link name="wrist">{link}<link name="jaw">{link}
      <joint name="turn" type="revolute"><parent link="base"/><child link="turret"/><origin xyz="0 0 0.1" rpy="0.3 0 0"/>
        <axis xyz="0 1 0"/>{limit}
      <joint name="stiff" type="revolute"><parent link="turret"/><child link="wrist"/><origin xyz="0.05 0 0.1" rpy="0 0 0.2"/>
        <axis xyz="1 0 0"/>{limit}
      <joint name="slide" type="prismatic"><parent link="wrist"/><child link="jaw"/><origin xyz="0 0 0.1" rpy="0 0.4 0"/>
        <axis xyz="0 0 1"/>{limit}</robot>""")
    (tmp_path / "gripper.json").write_text("""{"schema": "graspforce/hand/1", "name": "gripper", "title": "One jaw",
      "source": "a test", "license": "Apache-2.0", "urdf": "gripper.urdf", "fingers": [{"name": "jaw", "tip": "jaw"}],
      "locked": [{"joint": "stiff", "position": 0.7, "source": "a test"}],
      "motors": [{"joints": ["*"], "torque": 20.0, "velocity": 0.1, "rotor_inertia": 1e-6, "source": "a test"}]}""")
    hand = Hand.load(tmp_path / "gripper.json")
    contacts = ContactSet.stack([Contact([0.03, 0.0, 0.0], [-1.0, 0.0, 0.0], 0.5)])
    grasp = Grasp(hand, Body.solid(Sphere(0.03), 0.05), ("jaw",), contacts, [0.3, 0.02], [0.0, 0.0, 0.9], np.eye(3))
    scene = scenes.build_scene(grasp)
    assert scene.model.njnt == 3  # turn, slide and the object's
    assert scenes.check_against_pinocchio(scene) < SAME
    data = mujoco.MjData(scene.model)
    scenes.set_posture(scene, data, grasp.q, np.zeros(2))
    mujoco.mj_forward(scene.model, data)
    np.testing.assert_allclose(data.geom_xpos[scene.tip_geoms[0]], hand.tip_pose(grasp.q, "jaw")[0], atol=1e-12)


def test_joints_have_their_limits_and_no_damping():
    hand = load("dlr_hit2")
    scene = scenes.build_scene(any_grasp(hand))
    for link in hand.tree().links:
        np.testing.assert_allclose(scene.model.joint(link.joint).range, [link.lower, link.upper])
    assert scene.model.jnt_limited[: len(hand.full_joints)].all()
    assert not scene.model.dof_damping.any()
    assert not scene.model.dof_frictionloss.any()
    rotors = scene.model.dof_armature[scene.v_address]
    np.testing.assert_allclose(scene.T.T @ rotors, hand.rotor_inertia)  # at leading joints only


@pytest.mark.parametrize(
    "shape",
    [Sphere(0.03), Cylinder(0.02, 0.07), Box([0.04, 0.05, 0.06]), Superquadric([0.03, 0.04, 0.05], [1.0, 1.0])],
    ids=lambda shape: type(shape).__name__,
)
def test_object_has_the_shapes_surface_and_inertia(shape):
    """Rays from outside to the centre hit the geom where φ = 0."""
    scene = scenes.build_scene(any_grasp(load("four_finger"), Body.solid(shape, 0.2)))
    data = mujoco.MjData(scene.model)
    mujoco.mj_forward(scene.model, data)
    p_HO = scene.grasp.p_HO
    rng = np.random.default_rng(4)
    for _ in range(20):
        ray = rng.normal(size=3)
        start = p_HO - 0.2 * ray / np.linalg.norm(ray)
        only, which = np.zeros(6, np.uint8), np.zeros(1, np.int32)
        only[0] = 1
        length = mujoco.mj_ray(scene.model, data, start, ray / np.linalg.norm(ray), None, 1, -1, which)
        hit = start + length * ray / np.linalg.norm(ray) - p_HO
        if which[0] == scene.object_geom:
            assert abs(shape.phi(hit)) < 1e-9  # m
        else:
            assert which[0] >= 0  # a finger hides the object
    full = np.zeros((scene.model.nv, scene.model.nv))
    mujoco.mj_fullM(scene.model, data, full)
    M = full[scene.object_v_address : scene.object_v_address + 6, scene.object_v_address : scene.object_v_address + 6]
    np.testing.assert_allclose(M, scene.grasp.body.mass_matrix(), atol=1e-12)


def test_centre_of_mass_may_differ_from_the_origin():
    inertia = np.array([[2e-5, 1e-6, 0.0], [1e-6, 3e-5, -2e-6], [0.0, -2e-6, 4e-5]])
    body = Body(0.1, inertia, [0.004, -0.003, 0.006], Sphere(0.03))
    scene = scenes.build_scene(any_grasp(load("four_finger"), body))
    data = mujoco.MjData(scene.model)
    mujoco.mj_forward(scene.model, data)
    full = np.zeros((scene.model.nv, scene.model.nv))
    mujoco.mj_fullM(scene.model, data, full)
    M = full[scene.object_v_address : scene.object_v_address + 6, scene.object_v_address : scene.object_v_address + 6]
    np.testing.assert_allclose(M, body.mass_matrix(), atol=1e-12)


def test_shapes_without_an_exact_geom_are_rejected():
    rounded = Superquadric([0.03, 0.03, 0.03], [0.5, 1.0])
    implicit = ImplicitSurface(lambda p: float(p @ p) - 0.03**2, lambda p: 2.0 * p, 0.03)
    for shape in (rounded, implicit, None):
        with pytest.raises(InvalidInput, match="an ellipsoid"):
            scenes.build_scene(any_grasp(load("four_finger"), Body(0.1, np.eye(3) * 1e-5, shape=shape)))
    with pytest.raises(InvalidInput, match="absent without gravity"):
        scenes.build_scene(three_finger_grasp(), gravity_H=[0.0, 0.0, 0.0], floor=0.1)
    with pytest.raises(InvalidInput, match="noslip"):
        EngineSettings(noslip=-1)


def test_contact_pairs_have_the_contact_model_and_friction():
    """condim is 1, 3 and 4 for frictionless, point and soft contacts."""
    hand = load("four_finger")
    for model, condim in (("frictionless", 1), ("point", 3), ("soft", 4)):
        scene = scenes.build_scene(any_grasp(hand, mu=0.45, model=model))
        for pair in scene.contact_pairs:
            assert scene.model.pair_dim[pair] == condim
            if model != "frictionless":
                np.testing.assert_allclose(scene.model.pair_friction[pair][:2], 0.45)
            if model == "soft":
                assert scene.model.pair_friction[pair][2] == pytest.approx(0.01)
    assert not scene.model.geom_contype.any()  # only explicit pairs collide
    assert sum(scene.model.pair(i).name.startswith("tip ") for i in range(scene.model.npair)) == 2


def test_true_object_may_differ_from_the_grasps():
    grasp = three_finger_grasp()
    heavier = replace(grasp.body, mass=1.2 * grasp.body.mass, inertia=1.2 * grasp.body.inertia)
    scene = scenes.build_scene(grasp, body=heavier)
    assert scene.model.body_mass[scene.object_body] == pytest.approx(1.2 * grasp.body.mass)
