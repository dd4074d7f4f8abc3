"""Slip margin and integral that cover the errors of the drives.

For errors δtau_j of the joint torques, independent of each other and within ± e_j, the slip margin of contact i falls by
Σ_j L_ij |δtau_j| at most, with L of `graspforce.control.drives.drive_margin`. The forces are planned with a margin larger by

    l = max_i √(Σ_j (L_ij e_j)²/3),

one standard deviation of uniformly distributed errors. The errors e of most drives are proportional to the torques, so
a larger margin has larger errors. With l₀ for the forces without a further margin, and a growth of g newtons per newton, the
margin is raised by l₀/(1 − g), but by 2.5 l₀ at most. If g ≥ 1, squeezing does not help, and the margin is not raised.

The errors also accelerate the object, and the integral of the pose error must be able to oppose all of them at once.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from graspforce.control.contacts.contact_constraints import ContactConstraints
from graspforce.control.drives.drive_commands import DriveMap
from graspforce.control.drives.drive_margin import torque_sensitivity
from graspforce.control.forces.margin_solver import MarginSolver
from graspforce.control.settings import ControlSettings
from graspforce.control.step_data import StepTargets
from graspforce.core.arrays import Array
from graspforce.grasp.grasp import Grasp

_MOST_GROWTH = 2.5  # l/l₀: beyond it, a little more certainty costs much force
_FEASIBLE_SHARE = 0.9  # of the largest feasible margin: the motors keep some torque for feedback


class DriveAllowance(NamedTuple):
    """What a controller plans for the errors of the drives.

    Attributes:
        slip_margin: margin beyond that of the settings, N.
        integral_limits: largest linear and angular acceleration from the integral, m/s² and rad/s².
    """

    slip_margin: float
    integral_limits: tuple[float, float]


class _RestForces(NamedTuple):
    """Forces that hold the object at rest.

    Attributes:
        margin: slip margin that they keep, N.
        is_full: whether it is all of the wanted margin.
        torque_error: (n,) errors of the drives with their torques, N·m.
        loss: l for these errors, N.
    """

    margin: float
    is_full: bool
    torque_error: Array
    loss: float


def drive_allowance(
    grasp: Grasp, settings: ControlSettings, constraints: ContactConstraints, drives: DriveMap, targets: StepTargets
) -> DriveAllowance:
    """Return the slip margin and the limits of the integral that cover the drives' errors, for the grasp at rest.

    The margin is 0 if it does not help, or if the motors are too weak for it. Of the largest feasible margin at most 90 % are
    planned.

    Args:
        grasp: hand, object and contacts.
        settings: margins, gravity and limits of the integral.
        constraints: of the contacts.
        drives: map to the set-points of the hand's drives.
        targets: targets of a step at rest in the grasp.
    """
    hand, at_rest = grasp.hand, np.zeros(grasp.hand.n)
    A, B, _ = constraints.constraint_rows(targets.rolling)
    masses = hand.model.mass_matrix(grasp.q), grasp.body.mass_matrix()
    sensitivity = torque_sensitivity(A, B, *masses, constraints, grasp.contacts)
    tau_u = hand.model.inverse_dynamics(grasp.q, at_rest, at_rest, settings.gravity_H)

    def forces_at_rest(extra: float) -> _RestForces | None:
        result = MarginSolver(grasp, settings, extra).solve(targets, tau_u)
        if result.f is None:
            return None
        error = drives.set_points(tau_u + result.f @ targets.J, grasp.q, at_rest).torque_error
        loss = float(np.sqrt(np.square(sensitivity.margin) @ np.square(error) / 3.0).max())
        return _RestForces(result.margin, not result.warning, error, loss)

    limits = settings.integral_limit_linear, settings.integral_limit_angular
    base = forces_at_rest(0.0)
    if base is None:
        return DriveAllowance(0.0, limits)
    extra, final = 0.0, base
    if base.is_full and base.loss > 0.0:
        first = forces_at_rest(base.loss)
        if first is not None and (rise := first.margin - base.margin) > first.loss - base.loss:
            growth = (first.loss - base.loss) / rise
            extra = base.loss * min(1.0 / (1.0 - growth), _MOST_GROWTH)
            final = forces_at_rest(extra) or first
            if not final.is_full:
                extra = max(_FEASIBLE_SHARE * final.margin - base.margin, 0.0)
    sizes = np.linalg.norm(sensitivity.acceleration.reshape(2, 3, -1), axis=1) @ final.torque_error  # m/s² and rad/s²
    linear, angular = np.maximum(limits, sizes).tolist()
    return DriveAllowance(extra, (linear, angular))
