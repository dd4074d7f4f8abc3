"""Settings and gains: allowed values, and stability."""

from __future__ import annotations

import numpy as np
import pytest

from graspforce import InvalidInput, Uncertainty
from graspforce.control import ControlSettings, PoseGains


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"slip_margin": -0.1}, "slip_margin"),
        ({"friction_reserve": 1.0}, "friction_reserve"),
        ({"period": 0.0}, "period"),
        ({"gravity_H": [0.0, 0.0]}, "gravity_H"),
        ({"rank_tolerance": 1.0}, "rank_tolerance"),
        ({"posture_damping": float("nan")}, "posture_damping"),
        ({"friction_error": 1.0}, "friction_error"),
        ({"mass_error": -0.1}, "mass_error"),
        ({"contact_error": float("inf")}, "contact_error"),
    ],
)
def test_invalid_settings_are_named(change, field) -> None:
    with pytest.raises(InvalidInput) as caught:
        ControlSettings(**change)
    assert caught.value.field == field


def test_unstable_gains_are_refused() -> None:
    """Routh: s³ + kd s² + kp s + ki is stable exactly if ki < kd kp."""
    PoseGains(kp_linear=100.0, kd_linear=10.0, ki_linear=999.0)
    with pytest.raises(InvalidInput, match="ki_linear = 1001"):
        PoseGains(kp_linear=100.0, kd_linear=10.0, ki_linear=1001.0)
    poles = np.roots([1.0, 10.0, 100.0, 999.0])
    assert -0.1 < poles.real.max() < 0.0


def test_critically_damped_gains_have_double_poles() -> None:
    gains = PoseGains.critically_damped(40.0, 30.0, 5.0)
    np.testing.assert_allclose(gains.rows()[:, [0, 5]].T, [[1600.0, 80.0, 8000.0], [900.0, 60.0, 4500.0]])


def test_posture_decays_at_least_critically() -> None:
    assert ControlSettings(posture_stiffness=100.0, posture_damping=50.0).posture_decay_rate == 50.0
    assert ControlSettings(posture_stiffness=100.0, posture_damping=1.0).posture_decay_rate == 20.0


def test_settings_take_the_errors_of_a_force_problem():
    errors = Uncertainty(friction_error=[0.1, 0.3], mass_error=0.2, normal_error=0.05, slip_margin=0.4)
    settings = ControlSettings.for_uncertainty(errors, ControlSettings(friction_reserve=0.0))
    taken = (settings.friction_error, settings.mass_error, settings.contact_error, settings.slip_margin)
    assert taken == (0.3, 0.2, 0.05, 0.4)
    assert settings.friction_reserve == 0.0
    with pytest.raises(InvalidInput, match=r"uncertainty\.position_error"):
        ControlSettings.for_uncertainty(Uncertainty(position_error=1e-3))
