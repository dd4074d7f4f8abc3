"""The largest slip margin with which fingers hold an object at rest, for all errors of friction and normals of the settings."""

from __future__ import annotations

import numpy as np

from graspforce.contact.contact import ContactSet
from graspforce.contact.motion import BodyMotion
from graspforce.control.forces.worst_cases import least_friction
from graspforce.control.settings import ControlSettings
from graspforce.core.arrays import Array
from graspforce.force.largest_margin import LargestMargin
from graspforce.force.problem import ForceProblem
from graspforce.grasp.body import Body
from graspforce.hand.actuation import Actuation
from graspforce.hand.hand import Hand
from graspforce.planning.regrasp.pose_path import PosePath
from graspforce.planning.regrasp.rolling_motion import HeldObject


class HoldingMargin:
    """The largest slip margin of grasps of one object with one hand, under gravity.

    Args:
        hand: the hand; its torque limits bound the forces.
        body: the object.
        path: path of the object.
        settings: friction reserve, errors of friction and normals, and gravity of the controller.
        limit: largest margin of interest, N, > 0.
    """

    def __init__(self, hand: Hand, body: Body, path: PosePath, settings: ControlSettings, limit: float) -> None:
        self._hand, self._body, self._path, self._settings, self._limit = hand, body, path, settings, limit
        self._solvers: dict[tuple[str, ...], LargestMargin] = {}

    def find(self, state: HeldObject) -> float:
        """Return the largest slip margin, N, at most the limit; −1 if no forces hold the object.

        Args:
            state: fingers and object.
        """
        motion, hand, contacts = self._path.motion(state.u), self._hand, state.contacts
        w = self._body.wrench(BodyMotion(motion.p_HO, motion.R_HO), self._settings.gravity_H)
        J = hand.contact_jacobian(state.q, state.fingers, contacts, motion.p_HO, motion.R_HO)
        tau_u = hand.gravity_torque(state.q, self._settings.gravity_H)
        limits = np.array([contacts.min_normal, contacts.max_normal])
        mu, gamma = least_friction(contacts, self._settings)
        friction = np.array([mu * (1.0 - self._settings.friction_reserve), gamma])
        solver = self._solver(state.fingers, contacts, w, J, tau_u)
        margin = solver.solve(w, J, tau_u, contacts.p_OC, contacts.R_OC, friction, limits)
        return -1.0 if margin is None else margin

    def find_without(self, state: HeldObject, finger: str) -> float:
        """Return the margin of the other fingers, N.

        Args:
            state: fingers and object.
            finger: name of the finger that lets go.
        """
        return self.find(state.without(finger))

    def _solver(self, fingers: tuple[str, ...], contacts: ContactSet, w: Array, J: Array, tau_u: Array) -> LargestMargin:
        """Return the solver of some fingers."""
        if fingers not in self._solvers:
            hand = self._hand
            actuation = Actuation(J, tau_u, hand.torque_lower, hand.torque_upper, hand.force_weight)
            self._solvers[fingers] = LargestMargin(ForceProblem(contacts, w, actuation), self._limit)
        return self._solvers[fingers]
