"""How much of each limit a plan uses over time: motor torques, joint speeds, contact forces, accelerations and jerk."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graspforce.contact import friction
from graspforce.core.arrays import Array, freeze
from graspforce.planning.plan import Plan
from graspforce.planning.task import HandTask, ObjectTask

MOTOR, SPEED, FRICTION, NORMAL, ACCELERATION, JERK = "motor", "speed", "friction", "normal force", "acceleration", "jerk"
_QUOTIENT = 1e-6  # of the duration: interval of the difference quotients that give the jerk
_ACTIVE_SHARE = 0.995  # from this share on a limit is active: knots reach 1 to rounding, instants between them less


@dataclass(frozen=True, eq=False, slots=True)
class LimitUsage:
    """The usage of one limit along a plan.

    Args:
        kind: MOTOR, SPEED, FRICTION, NORMAL, ACCELERATION or JERK.
        name: the joint or finger; the contact's number if there is no hand; "the object".
        used: (M,) share of the limit; 1 at the limit.
    """

    kind: str
    name: str
    used: Array

    def __str__(self) -> str:
        return f"{self.kind} {'at' if self.kind in (FRICTION, NORMAL) else 'of'} {self.name}"

    @property
    def active(self) -> Array:
        """Return (M,) 1 where the limit is active, 0 elsewhere."""
        return np.asarray(self.used >= _ACTIVE_SHARE, dtype=np.float64)

    def spans(self, times: Array) -> list[tuple[float, float]]:
        """Return the time spans in which the limit is active, s.

        Args:
            times: (M,) times of ``used``, s.
        """
        edges = np.flatnonzero(np.diff(np.concatenate([[0.0], self.active, [0.0]])))
        return [(float(times[a]), float(times[b - 1])) for a, b in edges.reshape(-1, 2)]


def limit_usage(plan: Plan, times: Array) -> list[LimitUsage]:
    """Return the usage of every limit of a plan's task, the one that is active longest first.

    Args:
        plan: the plan.
        times: (M,) times, s.
    """
    task, at = plan.task, plan.at(times)
    usages: list[LimitUsage] = []
    if isinstance(task, HandTask):
        hand = task.hand
        torque = np.where(at.tau >= 0.0, at.tau / hand.torque_upper, at.tau / hand.torque_lower)
        for kind, used in ((MOTOR, torque), (SPEED, np.abs(at.v) / hand.velocity_limit)):
            usages += [LimitUsage(kind, joint.name, freeze(column)) for joint, column in zip(hand.joints, used.T, strict=True)]
        limit = task.acceleration_limits.joints
        if limit < np.inf:
            shares = (np.abs(at.a) / limit).T
            usages += [
                LimitUsage(ACCELERATION, each.name, freeze(used)) for each, used in zip(hand.joints, shares, strict=True)
            ]
    if isinstance(task, ObjectTask):
        usages += _contact_usages(task, at.f)
        parts = np.split(at.acceleration, 2, axis=1)
        limits = zip(("the object", "the object's rotation"), parts, task.acceleration_limits.object_limits, strict=True)
        usages += [
            LimitUsage(ACCELERATION, name, freeze(np.linalg.norm(part, axis=1) / limit))
            for name, part, limit in limits
            if limit < np.inf
        ]
    if task.acceleration_limits.has_jerk:
        usages += _jerk_usages(plan, times)
    return sorted(usages, key=lambda limit: (-limit.active.mean(), -float(limit.used.max())))


def _jerk_usages(plan: Plan, times: Array) -> list[LimitUsage]:
    """Return the usages of limits of jerk, from difference quotients of the accelerations."""
    task, limits, step = plan.task, plan.task.acceleration_limits, _QUOTIENT * plan.duration
    before = plan.at(np.clip(times, 0.0, plan.duration - step))
    after = plan.at(np.clip(times, 0.0, plan.duration - step) + step)
    usages: list[LimitUsage] = []
    if isinstance(task, HandTask) and limits.joint_jerk < np.inf:
        shares = np.abs(after.a - before.a).T / (step * limits.joint_jerk)
        usages += [LimitUsage(JERK, joint.name, freeze(used)) for joint, used in zip(task.hand.joints, shares, strict=True)]
    if isinstance(task, ObjectTask):
        parts = np.split((after.acceleration - before.acceleration) / step, 2, axis=1)
        for name, part, limit in zip(("the object", "the object's rotation"), parts, limits.object_jerks, strict=True):
            if limit < np.inf:
                usages.append(LimitUsage(JERK, name, freeze(np.linalg.norm(part, axis=1) / limit)))
    return usages


def _contact_usages(task: ObjectTask, f: Array) -> list[LimitUsage]:
    """Return the usages of friction and normal force limits for forces (M, k)."""
    usages: list[LimitUsage] = []
    contacts, padded = task.contacts, task.contacts.pad(f)
    f_n = padded[:, :, friction.F_N]
    for i, name in enumerate(task.contact_names):
        if contacts.mu[i] > 0.0:
            limit = np.maximum(contacts.mu[i] * f_n[:, i], 1e-300)  # N
            margin = friction.slip_margin(padded[:, i], contacts.mu[i], contacts.gamma[i])
            usages.append(LimitUsage(FRICTION, name, freeze((limit - margin + task.slip_margin) / limit)))
        if np.isfinite(contacts.max_normal[i]) and contacts.max_normal[i] > 0.0:
            usages.append(LimitUsage(NORMAL, name, freeze(f_n[:, i] / contacts.max_normal[i])))
    return usages
