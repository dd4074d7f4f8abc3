"""States, desired motions and settings for tests of the object controller."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from graspforce import ContactSet
from graspforce.contact.motion import BodyMotion
from graspforce.control import Command, ControlSettings, GraspState
from graspforce.grasp.grasp import Grasp
from support.control_grasps import GRASP_NAMES

# Grasps whose closest points have a closed form; those of superquadrics take milliseconds.
FAST_GRASPS = [name for name in GRASP_NAMES if not name.endswith("superquadric")]
GRAVITY = np.array([3.0, -5.0, -7.8])  # m/s², in a general direction


def pose_at_rest(grasp: Grasp) -> BodyMotion:
    """Return the pose of the grasp, at rest."""
    return BodyMotion(grasp.p_HO, grasp.R_HO)


def state_at_rest(grasp: Grasp) -> GraspState:
    """Return posture and pose of the grasp, at rest."""
    return GraspState(grasp.q, np.zeros(grasp.hand.n), pose_at_rest(grasp))


def disturbed(grasp: Grasp, seed: int) -> tuple[GraspState, BodyMotion]:
    """Return a moving state near the grasp, and a desired motion elsewhere."""
    rng = np.random.default_rng(seed)

    def motion_near(p: float, angle: float, speed: float, acceleration: float = 0.0) -> BodyMotion:
        R = Rotation.from_rotvec(angle * rng.normal(size=3)).as_matrix() @ grasp.R_HO
        twist = rng.normal(size=6) * speed * np.repeat([0.03, 1.0], 3)
        return BodyMotion(grasp.p_HO + p * rng.normal(size=3), R, twist, acceleration * rng.normal(size=6))

    q, v = grasp.q + 2e-3 * rng.normal(size=grasp.hand.n), 0.1 * rng.normal(size=grasp.hand.n)
    return GraspState(q, v, motion_near(1e-4, 1e-3, 0.1)), motion_near(2e-4, 3e-3, 0.3, 0.2)


def settings_with(**change) -> ControlSettings:
    """Return settings with general gravity, a slip margin of 0.3 N, and changes."""
    return ControlSettings(**{"gravity_H": GRAVITY, "slip_margin": 0.3, **change})


def jacobian(grasp: Grasp, state: GraspState, command: Command) -> np.ndarray:
    """Return the contact Jacobian at the contacts of a command."""
    return grasp.hand.contact_jacobian(state.q, grasp.fingers, command.contacts, state.object.p_HO, state.object.R_HO)


def with_contacts(grasp: Grasp, **change) -> Grasp:
    """Return the grasp with other fields of its contacts."""
    return replace(grasp, contacts=ContactSet.stack([replace(contact, **change) for contact in grasp.contacts.contacts]))
