"""Friction coefficients in C (`csrc/include/graspforce/friction_bounds.h`); `contact_friction` is the reference."""

from __future__ import annotations

import numpy as np

from graspforce.contact.compiled_kinematics import primitive_parameters
from graspforce.core.arrays import Array
from graspforce.core.compiled import native, new_block
from graspforce.estimation.compiled_contact_forces import CompiledContactForces
from graspforce.estimation.contact_forces import ContactForces
from graspforce.estimation.contact_friction import (
    ContactFrictionEstimate,
    ContactFrictionEstimator,
    ContactFrictionMemory,
    ContactFrictionSettings,
    FrictionBlocks,
    make_estimate,
)
from graspforce.estimation.slip.detector import SlipEstimate
from graspforce.grasp.grasp import Grasp


def make_friction_estimator(
    grasp: Grasp, period: float, settings: ContactFrictionSettings, measured_variance: tuple[float, float]
) -> ContactFrictionEstimator:
    """Return an estimator of friction coefficients: compiled if possible, the reference implementation elsewhere.

    Args:
        grasp: hand, object and contacts; their friction is used as long as no finger slips at a smaller ratio.
        period: time between two steps, s.
        settings: windows and bounds.
        measured_variance: variances of the noise and of the constant error of a fingertip force, in a component, N².
    """
    mu = grasp.contacts.mu
    if native is None or primitive_parameters(grasp.body.shape) is None:
        return ContactFrictionEstimator(mu, period, settings)
    return CompiledFrictionEstimator(mu, period, settings, measured_variance)


class CompiledFrictionEstimator(ContactFrictionEstimator):
    """Estimator of the friction coefficients by compiled code. Forces come from a compiled estimator.

    Args:
        mu: (N,) given friction coefficients, used as long as no finger slips at a smaller ratio.
        period: time between two steps, s.
        settings: windows and bounds.
        measured_variance: variances of the noise and of the constant error of a fingertip force, in a component, N².
    """

    def __init__(
        self,
        mu: Array,
        period: float,
        settings: ContactFrictionSettings | None = None,
        measured_variance: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        super().__init__(mu, period, settings)
        self._numbers = new_block(np.dtype(native.bound_settings_layout(len(self._mu))))
        values: dict[str, object] = {"mu": self._mu, "gain": self._gain, "kept": self._kept, "variance": measured_variance}
        values |= {"independent": self._independent, "confirmation": self._confirmation}
        values |= {name: getattr(self.settings, name) for name in ("deviations", "ratio_error", "least_normal")}
        for name, value in values.items():
            self._numbers[name] = value
        self._dtype: np.dtype[np.void] = np.dtype(native.bound_state_layout(len(self._mu)))

    def initial_memory(self) -> FrictionBlocks:
        """Return the memory before the first step."""
        state, start = new_block(self._dtype), super().initial_memory()
        state["since_slip"] = state["since_found"] = self._independent + self._confirmation
        for name in ("lower", "upper", "expected"):
            state[name] = getattr(start.estimate, name)
        return FrictionBlocks(state, start.estimate)

    def step(
        self, memory: ContactFrictionMemory | FrictionBlocks, forces: ContactForces, slip: SlipEstimate
    ) -> tuple[ContactFrictionEstimate, FrictionBlocks]:
        """Return the friction coefficients after a period, and the memory; see `ContactFrictionEstimator.step`.

        Args:
            memory: memory after the last period; `initial_memory` before the first.
            forces: contact forces, of a compiled estimator.
            slip: slip of the fingertips.
        """
        assert isinstance(memory, FrictionBlocks)  # `initial_memory` makes no other
        assert isinstance(forces, CompiledContactForces)
        state, estimate = new_block(self._dtype), memory.estimate
        is_updated = native.friction_bounds_step(
            motor_count=forces.gains.from_torque.shape[1],
            has_tips=forces.has_tips,
            has_alarm=slip.has_alarm,
            is_certain=slip.is_certain,
            distance=slip.distance,
            slipping=slip.slipping,
            alarms=slip.alarms,
            settings=self._numbers,
            forces=forces.block,
            gains=forces.gains.block,
            last=memory.state,
            next=state,
        )
        state.setflags(write=False)
        if is_updated:
            estimate = make_estimate(state["lower"], state["upper"], state["expected"])
        return estimate, FrictionBlocks(state, estimate)
