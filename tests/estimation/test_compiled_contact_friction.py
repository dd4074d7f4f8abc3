"""Friction coefficients in C equal the reference in NumPy to rounding."""

from __future__ import annotations

import numpy as np
import pytest

from graspforce.core.compiled import native, new_block
from graspforce.estimation.compiled_contact_forces import CompiledContactForces, CompiledForceGains
from graspforce.estimation.compiled_contact_friction import CompiledFrictionEstimator
from graspforce.estimation.contact_friction import ContactFrictionEstimator, ContactFrictionSettings
from graspforce.estimation.slip.detector import SlipEstimate

pytest.importorskip("graspforce.core._native", reason="the compiled module was not built: no C compiler at installation")

PERIOD, COUNT, MOTORS, VARIANCE = 1e-3, 3, 9, (4e-4, 1e-6)
NO = np.zeros(COUNT, bool)


def contact_forces(f, rng, *, has_tips):
    """Return forces of a compiled estimator with some noise and some unexpected acceleration."""
    gains, forces = (
        new_block(np.dtype(layout))
        for layout in (native.force_gains_layout(COUNT, MOTORS), native.contact_forces_layout(COUNT))
    )
    root = 0.01 * rng.normal(size=(2, 3 * COUNT, 3 * COUNT))
    gains["noise"], gains["bias"] = root[0] @ root[0].T, 1e-2 * root[1] @ root[1].T
    forces["f"], forces["measured"] = f + 0.01 * rng.normal(size=(2, COUNT, 3))
    forces["inertial"] = 0.01 * rng.normal(size=(COUNT, 3))
    forces.setflags(write=False)
    return CompiledContactForces(forces, CompiledForceGains.of(gains), has_tips, VARIANCE)


def random_slip(rng, f):
    """Return a slip estimate: now and then an alarm of some fingers, mostly along their forces."""
    alarms = (rng.random(COUNT) < 0.5) if rng.random() < 0.05 else NO
    distance = 1e-4 * (f[:, :2] + rng.choice([0.02, 0.3]) * rng.normal(size=(COUNT, 2)))
    slipping = alarms | (rng.random(COUNT) < 0.1)
    certain = bool(rng.random() < 0.5)
    return SlipEstimate(slipping, alarms, NO, NO, distance, np.zeros(0), 40.0, False, bool(alarms.any()), certain)


@pytest.mark.parametrize("has_tips", [False, True])
@pytest.mark.parametrize("seed", range(6))
def test_bounds_equal_those_of_the_reference(seed, has_tips):
    """Forces that stick, slip and change; fingers without force; sensors that fail for a while."""
    rng = np.random.default_rng(seed)
    settings = ContactFrictionSettings(memory_time=0.5, ratio_error=[0.02, 0.0][seed % 2])
    mu = np.array([0.7, 0.4, 0.0])
    compiled, law = CompiledFrictionEstimator(mu, PERIOD, settings, VARIANCE), ContactFrictionEstimator(mu, PERIOD, settings)
    ours, theirs, bounded = compiled.initial_memory(), law.initial_memory(), 0
    for k in range(1500):
        if k % 300 == 0:
            f = rng.uniform([-0.4, -0.4, 0.5], [0.4, 0.4, 2.0], (COUNT, 3))
            f[2] *= rng.choice([0.02, 1.0])
        forces, slip = contact_forces(f, rng, has_tips=has_tips and not 700 <= k < 800), random_slip(rng, f)
        found, ours = compiled.step(ours, forces, slip)
        expected, theirs = law.step(theirs, forces, slip)
        for name in ("lower", "upper", "expected"):
            np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-10, atol=1e-14, err_msg=name)
            assert not getattr(found, name).flags.writeable
        bounded += np.isfinite(found.upper).any()
    assert bounded > 0
