"""A step's arithmetic in C (`step.h`) for one hold, by the laws of `ObjectLaw`.

What is wanted lies in a block, part after part; a part becomes an array when it is first asked for.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from graspforce.arrays import Array, frozen
from graspforce.control.compiled import laws
from graspforce.control.memory import ControlMemory
from graspforce.control.mobility import NONE, Accelerations
from graspforce.control.rolling import RollingContacts, Touched, block_of, closed_form, contacts_in, parts
from graspforce.control.settings import ControlSettings
from graspforce.control.state import Desired, GraspMotion, GraspState, body_of
from graspforce.control.ties import Ties
from graspforce.control.wanted import Settled, Wanted
from graspforce.hold import Hold

_HOLD = (None, None, None)  # in place of q, v, a: those of the hold, at rest
_SATURATED, _NOTED = 1, 6  # signs of `Step.settle`


class CompiledStep:
    """Both halves of a step, for a hold on a surface whose nearest points have a closed form.

    Args:
        hold, settings: the controller's.
        ties: what the contacts tie.
        at_limits: (2, n) the torques at which motors count as at their limits, N·m.
        reach: (n,) the strongest pull on a joint towards its posture, rad/s².
        kept_creep: the part of the creep that a period leaves.
    """

    def __init__(
        self, hold: Hold, settings: ControlSettings, ties: Ties, at_limits: Array, reach: Array, kept_creep: float
    ) -> None:
        hand, contacts, body, n, count = hold.hand, hold.contacts, hold.body, hold.hand.n, len(hold.contacts)
        fingers = [hand.finger(name) for name in hold.fingers]
        links, p_LF, R_LF = zip(*(hand.model.fixed_to(finger.tip) for finger in fingers), strict=True)
        numbers = [
            *settings.gains.rows().ravel(),
            *(settings.integral_limit_linear, settings.integral_limit_angular),
            *(settings.posture_stiffness, settings.posture_damping, settings.least_lever),
            *(settings.period, kept_creep, settings.creep_limit, settings.touch_gap),
            *(*settings.gravity_H, body.mass, *body.inertia.ravel(), *body.p_OM),
        ]
        given: list[Any] = [
            *(
                numbers,
                [finger.tip_radius or 0.0 for finger in fingers],
                contacts.p_OC,
                contacts.R_OC,
                hold.q,
                reach,
                p_LF,
                R_LF,
            ),
            *(hand.model.T, [hand.torque_lower, hand.torque_upper], at_limits, [hand.q_lower, hand.q_upper]),
            *([hand.model.moved(finger.tip) for finger in fingers], np.array(links) + 1, ties.padded, contacts.columns),
        ]
        self._step = laws.Step(closed_form(body.shape), *map(frozen, given))
        self._model, self._contacts = hand.model, contacts
        first = {"error": (6,), "acceleration": (6,), "object": (6,), "w": (6,), "joints": (n,), "J": (contacts.size, n)}
        last = {"tau": (n,), "creep": (count, 2), "crept": (count,), "integral": (6,)}
        self._wanted = block_of({**first, **parts(count, n)})
        self._settled = block_of(last)
        self._tightened = 6 + n

    def wanted(self, memory: ControlMemory, state: GraspState, desired: Desired, external: Array | None) -> WantedBlock:
        """What is wanted, of arguments as in `ObjectLaw.step`."""
        swept, now, block = self._model.sweep(state.q, state.v), state.object, np.empty((), self._wanted)
        joints, body = (desired.q, desired.v, desired.a) if isinstance(desired, GraspMotion) else _HOLD, body_of(desired)
        every_way = self._step.want(
            *(state.q, state.v, now.p_HO, now.R_HO, now.twist),
            *(body.p_HO, body.R_HO, body.twist, body.acceleration, *joints),
            *(memory.integral, memory.R_OC, external, swept.J, swept.J_rate, swept.places, block),
        )
        block.setflags(write=False)  # commands and memories are made of its parts
        return WantedBlock(self, block, every_way)

    def tightened(self, block: Any, tau_u: Array, shift: Array) -> tuple[Array, Array]:
        """As `Wanted.tightened`, of a block that `wanted` wrote."""
        both = np.empty(self._tightened)
        self._step.tighten(block, tau_u, shift, both)
        return both[:6], both[6:]

    def settled(
        self, memory: ControlMemory, touched: Touched, q: Array, wanted: WantedBlock, tau_u: Array, f: Array, grows: bool
    ) -> Settled:
        """What comes of forces f, as `ObjectLaw` settles it.

        Args:
            memory, touched: what the last step left.
            q: (n,) where the joints are, rad.
            wanted: what this one wants.
            tau_u: (n,) what the hand's own motion takes, N·m.
            f: (k,) N and N·m.
            grows: whether the integral may.
        """
        block = np.empty((), self._settled)
        signs = self._step.settle(
            *(wanted.block, q, tau_u, f, memory.integral, memory.creep),
            *(touched.p_OF, touched.R_OF, touched.p_OC, grows, block),
        )
        block.setflags(write=False)
        tau, creep, crept, integral = block["tau"], block["creep"], block["crept"], block["integral"]
        return Settled(tau, bool(signs & _SATURATED), creep, crept, integral, bool(signs & _NOTED))

    def contacts_in(self, block: Any) -> RollingContacts:
        """The contacts of a block that `wanted` wrote."""
        return contacts_in(block, self._contacts, block["J"])


def _part(name: str) -> Any:
    """A part of the block as an array, made when it is first asked for."""
    return cached_property(lambda wanted: wanted.block[name])


class WantedBlock(Wanted):
    """What is wanted, in the block that the compiled law wrote.

    Attributes:
        block: the parts.
        whole: whether the fingers can surely make every motion; if not, only the contacts and the error count.
    """

    block: Any
    whole: bool
    _of: CompiledStep
    lost = None
    error, acceleration, w = _part("error"), _part("acceleration"), _part("w")
    rolling = cached_property(lambda wanted: wanted._of.contacts_in(wanted.block))
    moves = cached_property(lambda wanted: Accelerations(wanted.block["object"], wanted.joints, NONE, None, None))

    def __init__(self, of: CompiledStep, block: Any, whole: bool) -> None:
        p_OC, always = block["p_OC"], {"joints": block["joints"], "J": block["J"], "R_OC": block["R_OC"]}
        touched = Touched(block["p_OF"], block["R_OF"], p_OC)
        vars(self).update(always, _of=of, block=block, whole=whole, p_OC=p_OC, touched=touched)

    def tightened(self, tau_u: Array, shift: Array) -> tuple[Array, Array]:
        return self._of.tightened(self.block, tau_u, shift)
