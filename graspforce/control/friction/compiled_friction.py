"""Compensation of joint friction in C (`csrc/include/graspforce/friction_step.h`), for one hand."""

from __future__ import annotations

import numpy as np

from graspforce.contact.motion import BodyMotion
from graspforce.control.friction.friction_compensation import REST_RATE, FrictionCompensation, FrictionMemory
from graspforce.core.arrays import Array
from graspforce.core.compiled import native


class CompiledFriction:
    """Compiled compensation of joint friction. `GraspFriction` is the reference.

    Args:
        compensation: the compensation of the hand.
        kp, kd: (6,) gains on the pose error, 1/s² and 1/s.
        mass: (6, 6) mass matrix of the object about O, in O.
        damping: of A Aᵀ, relative to its mean eigenvalue.
    """

    def __init__(self, compensation: FrictionCompensation, kp: Array, kd: Array, mass: Array, damping: float) -> None:
        model, observer, settings = compensation.model, compensation.observer, compensation.settings
        block = np.zeros((), np.dtype(native.friction_layout(model.n)))
        values = {
            "smoothing_rate": settings.smoothing_rate,
            "rest_rate": REST_RATE,
            "damping": damping,
            "rate_common": observer.rate_common,
            "rate_across": observer.rate_across,
            "rate_joint": observer.rate_joint,
            "rate_forgetting": observer.rate_forgetting,
            "kp": kp,
            "kd": kd,
            "mass": mass.ravel(),
            "inertia": compensation.inertia,
            "share": observer.share,
            "largest": observer.largest,
            "stribeck": model.stribeck,
            "stribeck_velocity": model.stribeck_velocity,
            "viscous": model.viscous,
        }
        for name, value in values.items():
            block[name] = value
        self._block, self._observes = block, settings.observe
        self._result_dtype = np.dtype(native.friction_result_layout(model.n))

    def step(
        self,
        memory: FrictionMemory,
        A: Array,
        B: Array,
        body: BodyMotion,
        measured: BodyMotion,
        error: Array,
        v_d: Array | None,
    ) -> tuple[Array, FrictionMemory, bool] | None:
        """Return what `GraspFriction.compensate` returns; None if a number is not finite.

        Args:
            memory: memory after the last step.
            A: (r, n) contact velocities per joint rate.
            B: (r, 6) contact velocities per twist of the object, in O.
            body: desired motion of the object.
            measured: measured motion of the object.
            error: (6,) pose error in H, m and rad.
            v_d: (n,) desired rates of the joints, rad/s; None for zeros.
        """
        result = np.empty((), self._result_dtype)
        status = native.friction_step(
            friction=self._block,
            observes=self._observes,
            A=np.ascontiguousarray(A),
            B=np.ascontiguousarray(B),
            R_HO=measured.R_HO,
            twist=measured.twist,
            twist_d=body.twist,
            error=np.ascontiguousarray(error),
            v_d=v_d,
            level=memory.level,
            result=result,
        )
        if status < 0:
            return None
        result.setflags(write=False)  # the memory shares its arrays
        return result["tau"], FrictionMemory(result["level"], memory.rest), bool(status)
