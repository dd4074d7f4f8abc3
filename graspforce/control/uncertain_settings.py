"""Settings of the object controller for all errors of a force problem, of one grasp at rest.

Errors of friction, normals and mass are settings of their own. Errors of contact places, of the centre of mass, of the
drives' gains and further wrenches take slip margin. With forces f of the controller,
`graspforce.force.robust_limits.worst_case` bounds the least slip margin over all errors. The slip margin of the settings
grows until this bound is the required one. Larger margins have larger forces, and with them larger losses, so that either few
iterations suffice or no margin does.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from graspforce.contact.motion import BodyMotion
from graspforce.control.forces.margin_solver import MarginSolver
from graspforce.control.object_control_law import ObjectControlLaw
from graspforce.control.settings import ControlSettings
from graspforce.control.state import GraspState
from graspforce.core.errors import InvalidInput
from graspforce.force.problem import ForceProblem
from graspforce.force.robust_limits import worst_case
from graspforce.force.robust_set import RobustSet
from graspforce.force.uncertainty import Uncertainty
from graspforce.grasp.grasp import Grasp
from graspforce.hand.actuation import Actuation

_MOST_ITERATIONS = 30
_ACCURACY = 1e-3  # N: a margin that lacks less gets this much more
_GROWTH = 1.1  # of the missing margin: larger forces lose more


def settings_for_errors(grasp: Grasp, uncertainty: Uncertainty, base: ControlSettings | None = None) -> ControlSettings:
    """Return settings with which the forces of a grasp at rest keep the slip margin of an uncertainty for all its errors.

    The bound covers slip, not the torque limits. Forces that accelerate the object are larger, and with them the losses by
    errors of contact places and drive gains.

    Args:
        grasp: hand, object and contacts.
        uncertainty: the errors, and the slip margin that is kept.
        base: the other settings, of which friction_reserve stays. Default: `ControlSettings()`.

    Raises:
        InvalidInput: no margin covers the errors, the motors are too weak for it, or the errors do not fit the grasp.
    """
    simple = Uncertainty(
        friction_error=uncertainty.friction_error,
        normal_error=uncertainty.normal_error,
        mass_error=uncertainty.mass_error,
        slip_margin=uncertainty.slip_margin,
    )
    settings = ControlSettings.for_uncertainty(simple, base)
    law = ObjectControlLaw(grasp, settings)
    hand, at_rest, body = grasp.hand, np.zeros(grasp.hand.n), BodyMotion(grasp.p_HO, grasp.R_HO)
    targets = law.compute_targets(law.initial_memory(), GraspState(grasp.q, at_rest, body), body, None)
    tau_u = hand.model.inverse_dynamics(grasp.q, at_rest, at_rest, settings.gravity_H)
    actuation = Actuation(targets.J, tau_u, hand.torque_lower, hand.torque_upper)
    robust = RobustSet(ForceProblem(grasp.contacts, targets.w, actuation, uncertainty=uncertainty))
    extra = 0.0  # N
    for _ in range(_MOST_ITERATIONS):
        result = MarginSolver(grasp, settings, extra).solve(targets, tau_u)
        if result.f is None or result.warning:
            break
        lacking = settings.slip_margin - float(worst_case(robust, result.f).guaranteed.min())  # N
        if lacking <= 0.0:
            return dataclasses.replace(settings, slip_margin=settings.slip_margin + extra)
        extra += _GROWTH * lacking + _ACCURACY
    allowed = (
        f"errors that a larger slip margin covers: {extra:.3g} N more do not, within the limits of motors and normal forces"
    )
    raise InvalidInput("uncertainty", uncertainty.to_dict(), allowed)
