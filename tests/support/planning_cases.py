"""Moves whose minimum time has a closed form, and moves of the shipped hands."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from graspforce.contact.contact import Contact, ContactSet
from graspforce.core.arrays import Array
from graspforce.grasp.body import Body
from graspforce.hand.hand import Hand
from graspforce.planning.path.dynamics import PathDynamics
from graspforce.planning.path.paths import ScrewPath, StraightPath
from graspforce.planning.task import GraspTask, IdealTask
from support.hands import load

MASS, FRICTION, MAX_NORMAL, DISTANCE, GRAVITY = 0.1, 0.5, 5.0, 0.1, 9.81  # kg, 1, N, m, m/s²
A = 2.0 * FRICTION * MAX_NORMAL / MASS  # m/s², from the friction of both fingers
RADIUS = 0.03  # m, of the disc
AXES = np.eye(3)

# ms
LIFT, TANGENTIAL, NORMAL, OBLIQUE, DISC = 91.2156, 90.3248, 99.7633, 107.3447, 28.4066


def block(**changes: float) -> IdealTask:
    """Return a block between two ideal fingers that press along x through its centre."""
    numbers = {"friction": FRICTION, "largest": MAX_NORMAL, "mass": MASS, "slip_margin": 0.0, **changes}
    contacts = [
        Contact([x, 0.0, 0.0], [-np.sign(x), 0.0, 0.0], numbers["friction"], max_normal=numbers["largest"])
        for x in (-0.02, 0.02)
    ]
    body = Body(numbers["mass"], 1e-5 * np.eye(3))
    return IdealTask(body, ContactSet.stack(contacts), slip_margin=numbers["slip_margin"])


def straight_move(x: float, y: float, z: float) -> StraightPath:
    """Return a straight line of 0.1 m along a unit vector."""
    return StraightPath(np.zeros(3), AXES, DISTANCE * np.array([x, y, z]), AXES)


def disc() -> tuple[IdealTask, StraightPath]:
    """Return a disc between three ideal fingers on its rim, and a rotation by 1 rad about the vertical."""
    angles = 2.0 * np.pi * np.arange(3) / 3.0
    rim = [np.array([np.cos(angle), np.sin(angle), 0.0]) for angle in angles]
    contacts = [Contact(RADIUS * out, -out, FRICTION, max_normal=MAX_NORMAL) for out in rim]
    spin = MASS * RADIUS**2 / 2.0  # kg·m²
    task = IdealTask(Body(MASS, np.diag([spin / 2.0, spin / 2.0, spin])), ContactSet.stack(contacts))
    turned = Rotation.from_rotvec([0.0, 0.0, 1.0]).as_matrix()
    return task, StraightPath(np.zeros(3), AXES, np.zeros(3), turned)


def motor_dynamics(
    s: Array, tau: Callable[[Array], tuple[Array, Array, Array]], lower: Array, upper: Array, b_max: float = np.inf
) -> PathDynamics:
    """Return equations of motors alone; tau(s) gives tau_0, tau_b and tau_a (K, n)."""
    tau_0, tau_b, tau_a = tau(s)
    K, n = tau_a.shape
    none, b_limits = np.zeros((K, 6)), np.full(K, b_max)
    G, J = np.zeros((6, 0)), np.zeros((K, 0, n))
    return PathDynamics(s, None, G, none, none, none, J, tau_0, tau_b, tau_a, lower, upper, b_limits, b_limits[1:])


FINGERS = {
    "four_finger": ("finger_1", "finger_2", "finger_3", "finger_4"),
    "dlr_hit2": ("thumb", "index", "middle"),
    "allegro_right": ("index", "middle", "thumb"),
}
# Joint angles of postures away from all limits; the others are neutral, rad.
BENT_JOINTS = {
    "four_finger": {"_joint_2": 0.3, "_joint_3": 0.6},
    "dlr_hit2": {"_joint_2": 0.6, "_joint_3": 0.8},
    "allegro_right": {},
}


SCREW_DISPLACEMENT = {
    "four_finger": (0.001, 0.002, 0.006),
    "dlr_hit2": (-0.006, 0.004, 0.006),
    "allegro_right": (-0.004, 0.004, 0.006),
}  # m
SCREW_ROTATION = {"four_finger": (0.02, -0.02, 0.03), "dlr_hit2": (0.08, -0.06, 0.1), "allegro_right": (0.1, 0.1, 0.02)}  # rad


def star_grasp(hand: Hand, mass: float = 0.05, friction: float = 0.6, largest: float = 8.0) -> tuple[GraspTask, Array, Array]:
    """Return a task with an object in the middle of the fingertips, which press towards it, its position, and the posture.

    Links of neighbouring fingers overlap there in some hands: the task is for dynamics, and has no collision checks.
    """
    q = np.array(hand.neutral)
    for i, joint in enumerate(hand.joints):
        for ending, angle in BENT_JOINTS[hand.name].items():
            q[i] = angle if joint.name.endswith(ending) else q[i]
    fingers = FINGERS[hand.name]
    tips = np.array([hand.tip_pose(q, name)[0] for name in fingers])
    middle = tips.mean(axis=0)
    contacts = []
    for name, tip in zip(fingers, tips, strict=True):
        normal = (middle - tip) / np.linalg.norm(middle - tip)
        contacts.append(
            Contact(tip + (hand.finger(name).tip_radius or 0.0) * normal - middle, normal, friction, max_normal=largest)
        )
    body = Body(mass, 0.4 * mass * 0.02**2 * np.diag([0.6, 1.0, 1.5]), np.array([0.003, -0.002, 0.004]))
    return GraspTask(hand, body, ContactSet.stack(contacts), fingers, collisions=None), middle, q


def screw_move(name: str, **changes: float) -> tuple[GraspTask, ScrewPath, Array]:
    """Return a small move of a shipped hand along a screw, with the posture; all terms of the dynamics are nonzero."""
    task, middle, q = star_grasp(load(name), **changes)
    return (
        task,
        ScrewPath(middle, AXES, middle + SCREW_DISPLACEMENT[name], Rotation.from_rotvec(SCREW_ROTATION[name]).as_matrix()),
        q,
    )


def random_move(rng: np.random.Generator, middle: Array, distance: tuple[float, float], turn: float) -> StraightPath:
    """Return a move in any direction by a distance in a range, m, with a rotation of up to ``turn`` degrees about any axis."""
    along, axis = rng.normal(size=(2, 3))
    along *= rng.uniform(*distance) / np.linalg.norm(along)
    axis *= np.deg2rad(rng.uniform(0.0, turn)) / np.linalg.norm(axis)
    return StraightPath(middle, AXES, middle + along, Rotation.from_rotvec(axis).as_matrix())
