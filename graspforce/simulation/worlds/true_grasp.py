"""The grasp as it is in a plant: the truth that corresponds to the grasp which a controller is told."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from graspforce.contact.contact import Contact, ContactModel, ContactSet
from graspforce.contact.motion import BodyMotion
from graspforce.core.arrays import Array
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.hand.drives.joint_friction import JointFriction
from graspforce.simulation.plants.plant_interface import PlantInterface
from graspforce.simulation.plants.plant_options import PlantOptions

_FRICTION = ("coulomb", "stribeck", "stribeck_velocity", "viscous")


@dataclass(frozen=True, eq=False, slots=True)
class TrueGrasp:
    """A grasp with true hand with its joint friction, object and contacts.

    Its object frame G is fixed to the true surface. O, the frame of the grasp that a controller is told, differs from G if the
    surface is elsewhere.

    Attributes:
        grasp: the true grasp, with frame G.
        p_OG: (3,) position of G in O, m.
        R_OG: (3, 3) axes of G in O.
    """

    grasp: Grasp
    p_OG: Array
    R_OG: Array

    def to_surface(self, motion: BodyMotion) -> BodyMotion:
        """Return the motion of G for a motion of O; both frames are fixed to the object.

        Args:
            motion: pose, twist and acceleration of O in H.
        """
        arm = motion.R_HO @ self.p_OG  # m, in H
        omega, alpha = motion.twist[3:], motion.acceleration[3:]
        v = motion.twist[:3] + np.cross(omega, arm)
        a = motion.acceleration[:3] + np.cross(alpha, arm) + np.cross(omega, np.cross(omega, arm))
        R_HG = motion.R_HO @ self.R_OG
        return BodyMotion(motion.p_HO + arm, R_HG, np.append(v, omega), np.append(a, alpha))

    def contacts_in_O(self, contacts: ContactSet) -> ContactSet:
        """Return contacts in the axes of O.

        Args:
            contacts: contacts in G.
        """
        return replace(contacts, p_OC=self.p_OG + contacts.p_OC @ self.R_OG.T, R_OC=self.R_OG @ contacts.R_OC)


def read_true_grasp(plant: PlantInterface, grasp: Grasp, options: PlantOptions) -> TrueGrasp:
    """Return the grasp in which a plant starts.

    Args:
        plant: the plant; it is reset.
        grasp: the grasp that the controller is told.
        options: true parameters of the plant.

    Raises:
        InvalidInput: the hand cannot hold the object's told weight.
    """
    q, contacts = plant.reset().q, plant.true_contacts()
    R_OG = Rotation.from_rotvec(np.array(options.shape_turn)).as_matrix()
    p_OG = options.shape_offset
    hand = grasp.hand.with_tip_offsets(dict(zip(grasp.fingers, options.tip_offsets(grasp), strict=True)))
    coulomb, stribeck, velocity, viscous = (options.per_joint(name, hand.n) for name in _FRICTION)
    hand = replace(hand, friction=JointFriction(coulomb, stribeck, velocity, viscous))
    mu, gamma, _ = options.contact_friction(grasp)
    true_contacts = [
        _true_contact(told, R_OG.T @ (contacts.p_OC[i] - p_OG), R_OG.T @ contacts.R_OC[i, :, 2], float(mu[i]), float(gamma[i]))
        for i, told in enumerate(grasp.contacts.contacts)
    ]
    body = _body_in_G(options.body or grasp.body, grasp, p_OG, R_OG)
    p_HG, R_HG = grasp.p_HO + grasp.R_HO @ p_OG, grasp.R_HO @ R_OG
    return TrueGrasp(Grasp(hand, body, grasp.fingers, ContactSet.stack(true_contacts), q, p_HG, R_HG), p_OG, R_OG)


def _true_contact(told: Contact, position: Array, normal: Array, mu: float, gamma: float) -> Contact:
    """Return a contact at its true place with its true friction; pads with torsional friction are soft."""
    if told.model is ContactModel.FRICTIONLESS:
        return Contact(position, normal, None, told.model, min_normal=told.min_normal, max_normal=told.max_normal)
    model, torsion = (ContactModel.SOFT, gamma) if gamma > 0.0 else (ContactModel.POINT, None)
    return Contact(
        position, normal, mu, model, torsional_friction=torsion, min_normal=told.min_normal, max_normal=told.max_normal
    )  # fmt: skip


def _body_in_G(body: Body, grasp: Grasp, p_OG: Array, R_OG: Array) -> Body:
    """Return a body with its inertia and centre of mass in G, and the shape of the grasp."""
    return Body(body.mass, R_OG.T @ body.inertia @ R_OG, R_OG.T @ (body.p_OM - p_OG), grasp.body.shape)
