"""Kinematics of fingertips that roll on a moving object, integrated along the object's path.

At each contact the material points of fingertip and object move together: A q̇ = B V with the object's twist V in O. The joints
have no other motion but one towards the middle of their ranges, in the null space of A. The path is integrated by the midpoint
rule; after each step the joints are corrected so that every fingertip touches the surface.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Protocol

import numpy as np

from graspforce.contact.compiled_kinematics import rolling_contacts
from graspforce.contact.contact import ContactSet
from graspforce.contact.kinematics import RollingContacts
from graspforce.contact.motion import BodyMotion
from graspforce.core.arrays import Array, freeze
from graspforce.geometry import Shape
from graspforce.hand.hand import Hand

STEP = 0.02  # of the path parameter, rad
_KEPT_MOTIONS = 4096  # poses of the object that are kept: all fingers are followed along the same ones
_CENTRING = 0.3  # of the distance from the middle of its range that a redundant joint returns for each unit of the path
_MIN_SINGULAR_VALUE = 0.03  # of a finger's largest: below, a direction of the tip is lost


@dataclass(frozen=True, eq=False, slots=True)
class HeldObject:
    """Fingers that hold an object at one place of its path.

    Attributes:
        u: path parameter.
        q: (n,) posture, rad.
        fingers: names of the fingers.
        contacts: their contacts at the present places in O, in the same order.
    """

    u: float
    q: Array
    fingers: tuple[str, ...]
    contacts: ContactSet

    def without(self, finger: str) -> HeldObject:
        """Return the state with the contacts of the other fingers.

        Args:
            finger: name of one of the fingers.
        """
        return self.only([name for name in self.fingers if name != finger])

    def only(self, fingers: list[str]) -> HeldObject:
        """Return the state with the contacts of some fingers.

        Args:
            fingers: names of some of the fingers.
        """
        contacts = [self.contacts.contacts[self.fingers.index(name)] for name in fingers]
        return replace(self, fingers=tuple(fingers), contacts=ContactSet.stack(contacts))


class ObjectPath(Protocol):
    """A path of an object, such as a `PosePath`."""

    def motion(self, u: float, rate: float = 0.0) -> BodyMotion:
        """Return pose and twist of the object in H at a path parameter, with its rate in 1/s."""
        ...  # pragma: no cover


class RollingMotion:
    """The rolling motion of fingertips along the path of an object.

    Args:
        hand: the hand; its position limits bound the motion.
        shape: surface of the object.
        path: path of the object.
        centring: of the distance from the middle of its range that a redundant joint returns for each unit of the path.
    """

    def __init__(self, hand: Hand, shape: Shape, path: ObjectPath, centring: float = _CENTRING) -> None:
        self._hand, self._shape, self._centring = hand, shape, centring
        self._motion = lru_cache(_KEPT_MOTIONS)(path.motion)
        middle = (hand.q_lower + hand.q_upper) / 2.0  # rad
        self._middle = np.where(np.isfinite(middle), middle, 0.0)

    def roll(self, start: HeldObject, u_end: float, step: float = STEP) -> list[HeldObject]:
        """Return the states from the start along the path, as far as every finger can follow.

        Args:
            start: the state at the start.
            u_end: path parameter of the end.
            step: largest step of the integration.

        Returns:
            The states at even steps; the first is the start, and the last at `u_end` if it is reached.
        """
        steps = max(int(np.ceil((u_end - start.u) / step - 1e-9)), 0)
        states = [start]
        for u in np.linspace(start.u, u_end, steps + 1)[1:]:
            following = self._step(states[-1], float(u))
            if following is None:
                break
            states.append(following)
        return states

    def weakest_finger(self, state: HeldObject) -> str:
        """Return the finger that is nearest to the loss of a direction of its tip.

        Args:
            state: the state.
        """
        radii = np.array([self._hand.finger(name).tip_radius or 0.0 for name in state.fingers])  # m
        A, ratios = self._rolling(state, radii, state.u, state.q, 1.0).A, []
        for i, name in enumerate(state.fingers):
            sigma = np.linalg.svd(A[3 * i : 3 * i + 3][:, list(self._hand.finger(name).joints)], compute_uv=False)
            ratios.append(float(sigma[-1] / sigma[0]))
        return state.fingers[int(np.argmin(ratios))]

    def _step(self, state: HeldObject, u: float) -> HeldObject | None:
        """Return the state a small step further; None if a joint is at its limit or a finger is singular."""
        radii = np.array([self._hand.finger(name).tip_radius or 0.0 for name in state.fingers])  # m
        du = u - state.u
        slope = self._slope(state, radii, state.u, state.q)
        if slope is None:
            return None
        slope = self._slope(state, radii, state.u + du / 2.0, state.q + du / 2.0 * slope)
        if slope is None:
            return None
        q = state.q + du * slope
        rolling = self._rolling(state, radii, u, q, 0.0)
        q = q + self._correction(rolling)
        if (q < self._hand.q_lower).any() or (q > self._hand.q_upper).any():
            return None
        rolling = self._rolling(state, radii, u, q, 0.0)
        contacts = replace(state.contacts, p_OC=freeze(rolling.p_OC), R_OC=freeze(rolling.R_OC))
        return HeldObject(u, freeze(q), state.fingers, contacts)

    def _rolling(self, state: HeldObject, radii: Array, u: float, q: Array, rate: float) -> RollingContacts:
        """Return the contacts at a place of the path in a posture."""
        tips = self._hand.tip_motion(q, np.zeros(self._hand.n), state.fingers)
        motion = self._motion(u, rate)
        return rolling_contacts(tips, radii, motion, self._shape, state.contacts, state.contacts.R_OC)

    def _slope(self, state: HeldObject, radii: Array, u: float, q: Array) -> Array | None:
        """Return dq/du, (n,); None if a finger cannot follow."""
        rolling = self._rolling(state, radii, u, q, 1.0)
        centring = self._centring * (self._middle - q)
        twist = _twist_in_object(self._motion(u, 1.0))
        slope = np.zeros(self._hand.n)
        for i, name in enumerate(state.fingers):
            rows, joints = slice(3 * i, 3 * i + 3), list(self._hand.finger(name).joints)
            A, wanted = rolling.A[rows][:, joints], rolling.B[rows] @ twist
            U, sigma, Vt = np.linalg.svd(A, full_matrices=False)
            if sigma[-1] < _MIN_SINGULAR_VALUE * sigma[0] or len(sigma) < 3:
                return None
            free = centring[joints]
            slope[joints] = free + Vt.T @ (U.T @ (wanted - A @ free) / sigma)
        return slope

    def _correction(self, rolling: RollingContacts) -> Array:
        """Return the smallest joint motion, (n,), rad, that closes the gaps."""
        normal = rolling.A[2::3]
        return np.asarray(np.linalg.lstsq(normal, rolling.gap, rcond=None)[0])


def _twist_in_object(motion: BodyMotion) -> Array:
    """Return the twist of an object in its own axes, (6,)."""
    return np.asarray((motion.twist.reshape(2, 3) @ motion.R_HO).ravel())
