"""Contacts between a hand and an object: the force problem of holding the object at rest."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy.typing as npt

from graspforce.contact.contact import ContactSet
from graspforce.contact.motion import BodyMotion
from graspforce.core.arrays import Array
from graspforce.force.problem import ForceProblem
from graspforce.force.problem_options import Cone, Objective
from graspforce.grasp.body import Body
from graspforce.hand.actuation import Actuation
from graspforce.hand.hand import GRAVITY_PALM_UP, Hand


class HandContacts:
    """Base of grasps: a hand and an object in contact at one instant, with the same forces wherever the contacts are."""

    __slots__ = ()

    if TYPE_CHECKING:  # the grasps have these as fields, except the links of fingertips

        @property
        def hand(self) -> Hand:
            """The hand."""

        @property
        def body(self) -> Body:
            """The object, with its frame O."""

        @property
        def links(self) -> tuple[str, ...]:
            """At each contact the link that touches, or the finger whose tip touches."""

        @property
        def contacts(self) -> ContactSet:
            """The contacts in O, in the order of `links`."""

        @property
        def q(self) -> Array:
            """(n,) joint positions, rad."""

        @property
        def p_HO(self) -> Array:
            """(3,) position of the object in H, m."""

        @property
        def R_HO(self) -> Array:
            """(3, 3) axes of the object in H."""

    def actuation(self, gravity_H: npt.ArrayLike = GRAVITY_PALM_UP) -> Actuation:
        """Return the hand's actuation at rest in this grasp; see `Hand.actuation`.

        Args:
            gravity_H: (3,) acceleration of gravity in H, m/s².
        """
        return self.hand.actuation(self.q, self.links, self.contacts, self.p_HO, self.R_HO, gravity_H=gravity_H)

    def force_problem(
        self,
        gravity_H: npt.ArrayLike = GRAVITY_PALM_UP,
        *,
        cone: Cone | None = None,
        objective: Objective | None = None,
    ) -> ForceProblem:
        """Return the force problem of holding the object at rest.

        Args:
            gravity_H: (3,) acceleration of gravity in H, m/s².
            cone: friction cone; exact by default.
            objective: objective; least motor torque by default.
        """
        w = self.body.wrench(BodyMotion(self.p_HO, self.R_HO), gravity_H)
        return ForceProblem(self.contacts, w, self.actuation(gravity_H), cone, objective)
