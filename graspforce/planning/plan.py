"""A planned move: knots in time, what lies between them, and what its check found.

Every planner hands out the same record, whether it was given a path or found its own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.planning.interpolation import Indices, hermite, hermite_cubic, hermite_rotation, intervals
from graspforce.planning.task import Task
from graspforce.planning.tip_contacts import contact_frames

SCHEMA = "graspforce/plan/1"
_DRIFT_TOLERANCE = 1e-6  # m: as near as inverse kinematics calls reached


@dataclass(frozen=True, eq=False, slots=True)
class Trajectory:
    """States at M times. Arrays over joints have no columns without a hand; those of the object are empty without one.

    Args:
        times: (M,) s, from 0.
        q, v, a: (M, n) joint positions, rad, rates, rad/s, accelerations, rad/s².
        tau: (M, n) motor torques, N·m.
        f: (M, k) stacked contact forces, contact frames, N and N·m.
        p_HO: (M, 3) the object in H, m; M = 0 without an object, here and below.
        R_HO: (M, 3, 3) its axes in H.
        twist: (M, 6) its velocity (ṗ, ω) in H's axes, m/s and rad/s.
        acceleration: (M, 6) (p̈, ω̇) in H's axes, m/s² and rad/s².
        p_OC: (M, N, 3) where the contacts are on the object, in O, m: tips that roll take them along.
        R_OC: (M, N, 3, 3) the contact frames there, in O.
        p_OC_d: (M, N, 3) how fast the contacts move over the object, in O, m/s.
    """

    times: Array
    q: Array
    v: Array
    a: Array
    tau: Array
    f: Array
    p_HO: Array
    R_HO: Array
    twist: Array
    acceleration: Array
    p_OC: Array
    R_OC: Array
    p_OC_d: Array

    def frozen(self) -> Trajectory:
        """The same, read-only."""
        return Trajectory(*(arrays.freeze(getattr(self, name)) for name in self.__slots__))

    def to_dict(self) -> dict[str, Any]:
        """As plain lists."""
        return {name: getattr(self, name).tolist() for name in self.__slots__}


@dataclass(frozen=True, eq=False, slots=True)
class PlanCheck:
    """What a plan does between its knots, found without the equations that made it.

    Excesses are parts of the limit that is exceeded, the largest anywhere; negative where all stay inside. Forces are judged
    as they must be for the object to move as the interpolation says: the plan's own, linear between knots, corrected by the
    least that does it.

    Args:
        slip: load + slip margin over μ f_n, as part of the largest friction that the contact has in the move.
        normal: beyond a contact's largest normal force, or short of its least.
        torque: beyond a motor's limit.
        speed: beyond a joint's speed limit.
        position: beyond a joint's position limit, as part of its range.
        drift: the farthest that a tip is off the surface or slips over it, or its contact is from where the plan has it, m.
        unmet: the largest wrench that no forces at the contacts make, as part of the largest wrench of the move.
        imbalance: likewise, what the plan's own forces miss between knots; a controller adds it. Not held against anything.
        samples: how many times were looked at.
        tolerance: what excesses are held against.
    """

    slip: float
    normal: float
    torque: float
    speed: float
    position: float
    drift: float
    unmet: float
    imbalance: float
    samples: int
    tolerance: float

    @property
    def excess(self) -> float:
        """The largest of all excesses."""
        return max(self.slip, self.normal, self.torque, self.speed, self.position)

    @property
    def verified(self) -> bool:
        """Whether limits are kept and wrenches met to the tolerance, and contacts to a micrometre."""
        return max(self.excess, self.unmet) <= self.tolerance and self.drift <= _DRIFT_TOLERANCE

    def to_dict(self) -> dict[str, Any]:
        """As a record that JSON can hold."""
        named = {name: getattr(self, name) for name in self.__slots__}
        return {"verified": self.verified, **{k: None if v == -np.inf else v for k, v in named.items()}}


@dataclass(frozen=True, slots=True)
class PlanningStatistics:
    """Where the time of planning went.

    Args:
        path, dynamics, building, solver, check: seconds for the fingers' path, the equations, the program's rows, the solver,
            the check.
        solves: how many programs were solved.
        iterations: of the last.
    """

    path: float
    dynamics: float
    building: float
    solver: float
    check: float
    solves: int
    iterations: int


@dataclass(frozen=True, eq=False)
class Plan:
    """A checked move from rest to rest.

    Args:
        task: what moves.
        knots: the states at the knots.
        check: what was found between them.
        gap: by what part of itself the duration could still fall on this grid, as the multipliers say; NaN where they say
            nothing, for a local optimum.
        effort: where the time of planning went.
        s: (K,) the place along the path at each knot; empty where no path was given.
        stopped: whether the budget, or whoever watches, ended the search before its own end.
    """

    task: Task
    knots: Trajectory
    check: PlanCheck
    optimality_gap: float
    statistics: PlanningStatistics
    s: Array
    stopped: bool = False
    found: ClassVar[bool] = True

    @property
    def duration(self) -> float:
        """T, s."""
        return float(self.knots.times[-1])

    def at(self, times: Any) -> Trajectory:
        """The states at some times, each in [0, T].

        Positions, rates and accelerations are quintic Hermite polynomials through the knots, the contacts' places cubic ones.
        Forces and torques are linear between knots: friction cones and limits are convex, so what is inside at the knots is
        inside between them.

        Args:
            times: (M,), s.
        """
        times = arrays.check_array(times, "times", (None,))
        knots = self.knots
        if len(times) and (times.min() < 0.0 or times.max() > self.duration * (1.0 + 1e-12)):
            raise InvalidInput("times", times, f"between 0 and the duration, {self.duration:.9g} s")
        i, u = intervals(knots.times, times)
        step = knots.times[i + 1] - knots.times[i]

        q, v, a = hermite(u, step, _end_states(knots.q, knots.v, knots.a, i))
        tau, f = (x[i] + u[:, None] * (x[i + 1] - x[i]) for x in (knots.tau, knots.f))
        if not len(knots.p_HO):
            return replace(knots, times=times, q=q, v=v, a=a, tau=tau, f=f)
        p, p_d, p_dd = hermite(u, step, _end_states(knots.p_HO, knots.twist[:, :3], knots.acceleration[:, :3], i))
        R, omega, alpha = hermite_rotation(u, step, _end_states(knots.R_HO, *self._spin, i))
        turned = [(R @ x[:, :, None])[:, :, 0] for x in (omega, alpha)]
        places = hermite_cubic(u, step, (knots.p_OC[i], knots.p_OC_d[i], knots.p_OC[i + 1], knots.p_OC_d[i + 1]))
        return Trajectory(
            times,
            q,
            v,
            a,
            tau,
            f,
            p,
            R,
            np.hstack([p_d, turned[0]]),
            np.hstack([p_dd, turned[1]]),
            places[0],
            contact_frames(self.task, places[0]),
            places[1],
        )

    @cached_property
    def _spin(self) -> tuple[Array, Array]:
        """(K, 3) each: ω and α at the knots in O's axes."""
        knots = self.knots
        omega, alpha = (np.einsum("mji,mj->mi", knots.R_HO, x[:, 3:]) for x in (knots.twist, knots.acceleration))
        return omega, alpha

    def to_dict(self) -> dict[str, Any]:
        """The plan as a record that JSON can hold."""
        hand, contacts = self.task.hand, self.task.contacts
        return {
            "schema": SCHEMA,
            "hand": None if hand is None else hand.name,
            "joints": [] if hand is None else [joint.name for joint in hand.joints],
            "fingers": list(self.task.fingers),
            "contacts": [] if contacts is None else [contact.to_dict() for contact in contacts.contacts],
            "duration": self.duration,
            "check": self.check.to_dict(),
            "gap": None if np.isnan(self.optimality_gap) else self.optimality_gap,
            "stopped": self.stopped,
            "s": self.s.tolist(),
            "knots": self.knots.to_dict(),
        }


def _end_states(x: Array, v: Array, a: Array, i: Indices) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Value, rate and acceleration at both ends of the intervals i."""
    return x[i], v[i], a[i], x[i + 1], v[i + 1], a[i + 1]
