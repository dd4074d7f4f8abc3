"""What limits a plan where: how much of each motor, joint speed, friction cone and normal force it uses at every instant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graspforce.contact import friction
from graspforce.core.arrays import Array, freeze
from graspforce.planning.plan import Plan

MOTOR, SPEED, FRICTION, NORMAL = "motor", "speed", "friction", "normal force"
_ACTIVE = 0.995  # what is used to this part is what limits: knots are at their limits to 1e-8, instants between them less


@dataclass(frozen=True, eq=False, slots=True)
class LimitUsage:
    """One limit along a plan.

    Args:
        kind: MOTOR, SPEED, FRICTION or NORMAL.
        name: of the joint or the finger (the contact's number where there is no hand).
        used: (M,) which part of it is used; 1 at the limit.
    """

    kind: str
    name: str
    used: Array

    def __str__(self) -> str:
        return f"{self.kind} {'at' if self.kind in (FRICTION, NORMAL) else 'of'} {self.name}"

    @property
    def active(self) -> Array:
        """(M,) 1 where it limits."""
        return np.asarray(self.used >= _ACTIVE, dtype=np.float64)

    def spans(self, times: Array) -> list[tuple[float, float]]:
        """From when to when it limits, for each stretch of the times (M,)."""
        edges = np.flatnonzero(np.diff(np.concatenate([[0.0], self.active, [0.0]])))
        return [(float(times[a]), float(times[b - 1])) for a, b in edges.reshape(-1, 2)]


def limit_usage(plan: Plan, times: Array) -> list[LimitUsage]:
    """Every limit of the task and how much of it the plan uses, the one that limits longest first.

    Args:
        plan: the plan.
        times: (M,) s.
    """
    task, at = plan.task, plan.at(times)
    found: list[LimitUsage] = []
    hand, contacts = task.hand, task.contacts
    if hand is not None:
        torque = np.where(at.tau >= 0.0, at.tau / hand.torque_upper, at.tau / hand.torque_lower)
        for kind, used in ((MOTOR, torque), (SPEED, np.abs(at.v) / hand.velocity_limit)):
            found += [LimitUsage(kind, joint.name, freeze(column)) for joint, column in zip(hand.joints, used.T, strict=True)]
    if contacts is not None:
        padded = contacts.pad(at.f)
        names = task.fingers or tuple(f"contact {i}" for i in range(len(contacts)))
        pressing = padded[:, :, friction.F_N]
        for i, name in enumerate(names):
            if contacts.mu[i] > 0.0:
                most = np.maximum(contacts.mu[i] * pressing[:, i], 1e-300)
                left = friction.slip_margin(padded[:, i], contacts.mu[i], contacts.gamma[i])
                found.append(LimitUsage(FRICTION, name, freeze((most - left + task.slip_margin) / most)))
            if np.isfinite(contacts.max_normal[i]) and contacts.max_normal[i] > 0.0:
                found.append(LimitUsage(NORMAL, name, freeze(pressing[:, i] / contacts.max_normal[i])))
    return sorted(found, key=lambda limit: (-limit.active.mean(), -float(limit.used.max())))
