"""Rolling contact in C: calls the compiled form of `contact.kinematics` where it applies, and the reference elsewhere.

The compiled form needs the compiled module and a shape that it supports: a sphere, cylinder, box, superquadric or plane.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from graspforce.contact.contact import ContactModel, ContactSet
from graspforce.contact.kinematics import (
    RollingContacts,
    Spin,
    TipContactState,
    rolling_contacts_reference,
    slip_displacement_reference,
    stack_jacobian,
)
from graspforce.contact.motion import BodyMotion, TipMotion
from graspforce.core.arrays import Array
from graspforce.core.compiled import Block, native, new_block
from graspforce.geometry import Shape
from graspforce.geometry.shape import SurfaceParameters

_PLANE: SurfaceParameters = ("plane", 0.0, 0.0, 0.0)  # as Shape.primitive_parameters, for an object without a shape


def rolling_contacts(
    tips: TipMotion, radii: Array, motion: BodyMotion, shape: Shape | None, contacts: ContactSet, R_before: Array
) -> RollingContacts:
    """Return the contacts of fingertips with an object, as `rolling_contacts_reference`, compiled if possible.

    Args:
        tips: the fingertips, in the order of the contacts.
        radii: (N,) fingertip radii, m; zero for a tip that touches with its origin.
        motion: pose and twist of the object.
        shape: the object's surface; None for a plane through each contact.
        contacts: contact positions and frames at the start of the grasp, in O, and the contact models.
        R_before: (N, 3, 3) contact frames in O at the previous step, which the tangents follow.
    """
    parameters = primitive_parameters(shape)
    if native is None or parameters is None:
        return rolling_contacts_reference(tips, radii, motion, shape, contacts, R_before)
    count, n = len(radii), tips.rates.shape[2] - 2
    block = new_block(_contacts_dtype(count, n))
    native.compute_contacts(
        surface=parameters,
        p_HF=tips.p_HF,
        R_HF=tips.R_HF,
        rates=np.ascontiguousarray(tips.rates),
        radii=radii,
        p_HO=motion.p_HO,
        R_HO=motion.R_HO,
        twist=motion.twist,
        p_OC=contacts.p_OC,
        R_OC=contacts.R_OC,
        R_OC_last=R_before,
        contacts=block,
    )
    return contacts_from_block(block, contacts)


def slip_displacement(before: TipContactState, now: TipContactState, R_OC: Array) -> Array:
    """Return how far fingertips slipped over the object, as `slip_displacement_reference`, compiled if possible.

    Args:
        before: the state at the earlier instant.
        now: the state at the later instant.
        R_OC: (N, 3, 3) contact frames in O.

    Returns:
        (N, 2) along t₁ and t₂ of R_OC, m.
    """
    if native is None:
        return slip_displacement_reference(before, now, R_OC)
    slip = np.empty((len(R_OC), 2))  # m
    native.slip_displacement(
        p_OF_last=before.p_OF,
        R_OF_last=before.R_OF,
        p_OC_last=before.p_OC,
        p_OF=now.p_OF,
        R_OF=now.R_OF,
        R_OC=R_OC,
        slip=slip,
    )
    return slip


def primitive_parameters(shape: Shape | None) -> SurfaceParameters | None:
    """Return kind and sizes of a shape for the compiled form; None if it does not support the shape.

    Args:
        shape: the object's surface; None for a plane through each contact.
    """
    return _PLANE if shape is None else shape.primitive_parameters


@cache
def _contacts_dtype(count: int, n: int) -> np.dtype[np.void]:
    """Return the data type of a block of memory with N contacts of a hand with n joints."""
    dtype: np.dtype[np.void] = np.dtype(native.contacts_layout(count, n))
    return dtype


def contacts_from_block(block: Block, contacts: ContactSet, J: Array | None = None) -> RollingContacts:
    """Return the contacts that the compiled form wrote.

    Args:
        block: the block of memory, as the compiled form wrote it.
        contacts: the contact models.
        J: (k, n) the contact Jacobian, if it is already known.
    """
    block.setflags(write=False)
    p_OC, A, spin = block["p_OC"], block["A"], None
    if contacts.models != len(contacts) * (ContactModel.POINT,):
        spin = Spin(block["spin_A"], block["spin_B"], block["spin_beta"])
    if J is None:
        J = A if spin is None else stack_jacobian(A, spin, contacts)
    tip_contacts, rates = TipContactState(block["p_OF"], block["R_OF"], p_OC), (block["beta"], block["velocity"], block["gap"])
    return RollingContacts(p_OC, block["R_OC"], J, A, block["B"], *rates, tip_contacts, spin)
