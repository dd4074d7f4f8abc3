"""Settings for all errors of a force problem: the controller's forces survive random members of the set."""

from __future__ import annotations

import numpy as np
import pytest
from support.control_grasps import named_grasp
from support.control_steps import pose_at_rest, settings_with, state_at_rest

from benchmarks.robust_samples import sample
from graspforce import Actuation, ForceProblem, InvalidInput, Uncertainty
from graspforce.control import ControlSettings, ObjectControlLaw, ObjectController, settings_for_errors
from graspforce.grasp.grasp import Grasp

NAMES = ["allegro_right sphere", "four_finger box"]
BASE = settings_with(friction_reserve=0.0)
ERRORS = {
    "places": Uncertainty(position_error=2e-3, slip_margin=0.3),
    "drive gains": Uncertainty(torque_error=0.04, slip_margin=0.3),
    "centre of mass": Uncertainty(centre_of_mass_error=5e-3, mass_error=0.1, slip_margin=0.3),
    "all": Uncertainty(
        friction_error=0.1, normal_error=0.02, mass_error=0.1, position_error=5e-4, torque_error=0.02, slip_margin=0.2
    ),
}


def least_margin(grasp: Grasp, settings: ControlSettings, uncertainty: Uncertainty) -> float:
    """Return the least slip margin of the controller's forces at rest, N, over random members of the set."""
    command = ObjectController(grasp, settings).step(state_at_rest(grasp), pose_at_rest(grasp))
    assert not command.warnings
    law, rest = ObjectControlLaw(grasp, settings), np.zeros(grasp.hand.n)
    targets = law.compute_targets(law.initial_memory(), state_at_rest(grasp), pose_at_rest(grasp), None)
    tau_u = grasp.hand.model.inverse_dynamics(grasp.q, rest, rest, settings.gravity_H)
    problem = ForceProblem(grasp.contacts, targets.w, Actuation(targets.J, tau_u), uncertainty=uncertainty)
    return float(sample(problem, command.f, 4000, np.random.default_rng(4)).margin.min())


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("errors", ERRORS)
def test_forces_at_rest_keep_the_margin_for_all_errors(name, errors):
    grasp, uncertainty = named_grasp(name), ERRORS[errors]
    settings = settings_for_errors(grasp, uncertainty, BASE)
    assert settings.slip_margin >= uncertainty.slip_margin
    assert least_margin(grasp, settings, uncertainty) >= uncertainty.slip_margin - 1e-6


def test_the_margin_without_these_errors_would_not_suffice():
    grasp, uncertainty = named_grasp(NAMES[0]), ERRORS["drive gains"]
    nominal = ControlSettings.for_uncertainty(Uncertainty(slip_margin=uncertainty.slip_margin), BASE)
    assert least_margin(grasp, nominal, uncertainty) < uncertainty.slip_margin


def test_errors_of_friction_normals_and_mass_need_no_further_margin():
    grasp, errors = named_grasp(NAMES[0]), Uncertainty(friction_error=0.2, mass_error=0.1, slip_margin=0.4)
    settings = settings_for_errors(grasp, errors, BASE)
    assert settings.slip_margin == pytest.approx(0.4, abs=0.01)
    assert (settings.friction_error, settings.mass_error) == (0.2, 0.1)


def test_errors_that_no_squeeze_covers_are_refused():
    with pytest.raises(InvalidInput, match="slip margin covers"):
        settings_for_errors(named_grasp(NAMES[0]), Uncertainty(torque_error=0.9, slip_margin=0.3), BASE)
