"""Rolling contact in C: calls the compiled form of `contact.kinematics` where it applies, and the reference elsewhere.

The compiled form needs the compiled module and a shape whose closest points have a closed form: a sphere, cylinder, box or
plane.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import numpy.typing as npt

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
from graspforce.core.compiled import native
from graspforce.geometry import Shape

_PLANE = (0, 0.0, 0.0, 0.0)  # as Shape.primitive_parameters, for an object without a shape


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
    block = np.empty((), _cached_block_dtype(count, n))
    rates = np.ascontiguousarray(tips.rates)
    pose, initial = (motion.p_HO, motion.R_HO, motion.twist), (contacts.p_OC, contacts.R_OC)
    native.roll(parameters, tips.p_HF, tips.R_HF, rates, radii, *pose, *initial, R_before, block)
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
    native.slip_displacement(before.p_OF, before.R_OF, before.p_OC, now.p_OF, now.R_OF, R_OC, slip)
    return slip


def primitive_parameters(shape: Shape | None) -> tuple[int, float, float, float] | None:
    """Return kind and sizes of a shape for the compiled form; None if it does not support the shape.

    Args:
        shape: the object's surface; None for a plane through each contact.
    """
    return _PLANE if shape is None else shape.primitive_parameters


def field_shapes(count: int, n: int) -> dict[str, tuple[int, ...]]:
    """Return names and shapes of the arrays that the compiled form writes, in their order in memory.

    Args:
        count: number of contacts N.
        n: number of actuated joints.
    """
    shapes: dict[str, tuple[int, ...]] = {
        "p_OC": (count, 3),
        "R_OC": (count, 3, 3),
        "A": (3 * count, n),
        "B": (3 * count, 6),
        "beta": (3 * count,),
    }
    shapes |= {"velocity": (count, 3), "gap": (count,), "p_OF": (count, 3), "R_OF": (count, 3, 3)}
    shapes |= {"spin_A": (count, n), "spin_B": (count, 6), "spin_beta": (count,)}
    return shapes


def block_dtype(field_shapes: dict[str, tuple[int, ...]]) -> np.dtype[np.void]:
    """Return the data type of a block of memory that holds float64 arrays one after the other.

    Args:
        field_shapes: names and shapes of the arrays, in their order in memory.
    """
    return np.dtype([(name, np.float64, shape) for name, shape in field_shapes.items()])


@cache
def _cached_block_dtype(count: int, n: int) -> np.dtype[np.void]:
    """Return `block_dtype` of `field_shapes`."""
    return block_dtype(field_shapes(count, n))


def contacts_from_block(block: npt.NDArray[np.void], contacts: ContactSet, J: Array | None = None) -> RollingContacts:
    """Return the contacts that the compiled form wrote.

    Args:
        block: the block of memory, of `block_dtype`.
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
