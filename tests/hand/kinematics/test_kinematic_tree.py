"""Kinematics and mass matrix computed link by link from the kinematic tree equal those of the hand."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from graspforce import Hand
from graspforce.hand.descriptions.description import shipped_hands
from graspforce.hand.kinematics.kinematic_tree import KinematicTree

TOL = 1e-12  # m, kg·m²: rounding of numbers below 1 after about ten rotations


def poses(tree: KinematicTree, q_full):
    """Return (p, R) of each link in H, by the definition of `Link`."""
    found = []
    for link, x in zip(tree.links, q_full, strict=True):
        p, R = (np.zeros(3), np.eye(3)) if link.parent < 0 else found[link.parent]
        p, R = p + R @ link.p_PL, R @ link.R_PL
        if link.is_prismatic:
            found.append((p + R @ link.axis * x, R))
        else:
            found.append((p, R @ Rotation.from_rotvec(link.axis * x).as_matrix()))
    return found


def mass_matrix(tree: KinematicTree, q_full):
    """Return M = Σ m Jᵀ J + J_ωᵀ I J_ω over the links, from the centres of mass and the joint axes."""
    link_poses = poses(tree, q_full)
    M = np.zeros((len(q_full), len(q_full)))
    for i, link in enumerate(tree.links):
        p, R = link_poses[i]
        com = p + R @ link.p_LM
        J, J_omega = np.zeros((3, len(q_full))), np.zeros((3, len(q_full)))
        k = i
        while k >= 0:
            axis = link_poses[k][1] @ tree.links[k].axis
            if tree.links[k].is_prismatic:
                J[:, k] = axis
            else:
                J[:, k], J_omega[:, k] = np.cross(axis, com - link_poses[k][0]), axis
            k = tree.links[k].parent
        M += link.mass * J.T @ J + J_omega.T @ R @ link.inertia @ R.T @ J_omega
    return M


@pytest.mark.parametrize("name", shipped_hands())
def test_tips_and_mass_matrix_of_the_tree_are_those_of_the_hand(name):
    hand = Hand.load(name)
    tree = hand.tree()
    assert tuple(link.joint for link in tree.links) == hand.full_joints
    assert all(link.parent < i for i, link in enumerate(tree.links))
    rng = np.random.default_rng(1)
    for _ in range(5):
        q = rng.uniform(hand.q_lower, hand.q_upper)
        q_full = hand.T @ q + hand.q0
        link_poses = poses(tree, q_full)
        np.testing.assert_allclose(hand.model.joint_origins(q), [p for p, _ in link_poses], atol=TOL)
        for tip in tree.tips:
            p, R = link_poses[tip.link]
            p_HF, R_HF = hand.tip_pose(q, tip.finger)
            np.testing.assert_allclose(p + R @ tip.p_LF, p_HF, atol=TOL)
            np.testing.assert_allclose(R @ tip.R_LF, R_HF, atol=TOL)
        M = hand.T.T @ mass_matrix(tree, q_full) @ hand.T + np.diag(hand.rotor_inertia)
        np.testing.assert_allclose(M, hand.mass_matrix(q), atol=TOL)


def test_prismatic_joint_translates_its_link(tmp_path):
    (tmp_path / "gripper.urdf").write_text("""<robot name="gripper"><link name="base"/>
      <link name="jaw"><inertial><origin xyz="0.01 0 0.02"/><mass value="0.1"/>
        <inertia ixx="1e-5" iyy="2e-5" izz="2e-5" ixy="0" ixz="0" iyz="0"/></inertial></link>
      <joint name="slide" type="prismatic"><parent link="base"/><child link="jaw"/><origin xyz="0 0 0.1" rpy="0.3 0 0"/>
        <axis xyz="0 1 0"/><limit lower="0" upper="0.05" effort="20" velocity="0.1"/></joint></robot>""")
    (tmp_path / "gripper.json").write_text("""{"schema": "graspforce/hand/1", "name": "gripper", "title": "One jaw",
      "source": "a test", "license": "Apache-2.0", "urdf": "gripper.urdf", "fingers": [{"name": "jaw", "tip": "jaw"}],
      "motors": [{"joints": ["*"], "torque": 20.0, "velocity": 0.1, "rotor_inertia": 0.0, "source": "a test"}]}""")
    hand = Hand.load(tmp_path / "gripper.json")
    tree = hand.tree()
    assert tree.links[0].is_prismatic
    q = np.array([0.03])
    p, R = poses(tree, q)[0]
    np.testing.assert_allclose(p, hand.tip_pose(q, "jaw")[0], atol=TOL)
    np.testing.assert_allclose(p, hand.model.joint_origins(q)[0], atol=TOL)
    np.testing.assert_allclose(R, hand.tip_pose(q, "jaw")[1], atol=TOL)
    np.testing.assert_allclose(mass_matrix(tree, q), hand.mass_matrix(q), atol=TOL)


def test_joints_read_a_configuration_of_all_joints(monkeypatch):
    """Pinocchio does not check the size: a shorter array is memory of something else, which can end the process."""
    hand, sizes, usual = Hand.load("four_finger"), set(), pin.JointModel.calc

    def calc(joint, data, q):
        sizes.add(len(q))
        usual(joint, data, q)

    monkeypatch.setattr(pin.JointModel, "calc", calc)
    hand.tree()
    assert sizes == {len(hand.full_joints)}
