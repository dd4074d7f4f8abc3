"""Compensation of joint friction in a step of the object controller."""

from __future__ import annotations

import dataclasses

import numpy as np

from graspforce.contact.motion import BodyMotion
from graspforce.control.contacts.contact_constraints import ContactConstraints
from graspforce.control.contacts.mobility import MassFactor, ObjectCompliance
from graspforce.control.friction.compiled_friction import CompiledFriction
from graspforce.control.friction.disturbance_observer import hold_integral
from graspforce.control.friction.friction_compensation import (
    REST_RATE,
    FrictionCompensation,
    FrictionMemory,
    FrictionSettings,
    PlannedRates,
)
from graspforce.control.settings import ControlSettings
from graspforce.control.state import DesiredMotion, GraspMotion, GraspState, object_motion
from graspforce.control.step_data import StepTargets
from graspforce.core.arrays import Array
from graspforce.core.compiled import native
from graspforce.grasp.grasp import Grasp

_LEAST_ENERGY = 1e-20  # J, twice the kinetic energy of a plan at rest


class GraspFriction:
    """Compensation of joint friction for one grasp, without memory of its own.

    Args:
        grasp: hand, object and contacts.
        settings: settings of the controller.
        friction: settings of the compensation.
        constraints: kinematic constraints of the contacts.
    """

    def __init__(
        self, grasp: Grasp, settings: ControlSettings, friction: FrictionSettings, constraints: ContactConstraints
    ) -> None:
        self._compensation = FrictionCompensation(grasp.hand, friction, settings.period)
        self._constraints, self._rest = constraints, np.zeros(grasp.hand.n)
        self._kp, self._kd, _ = settings.gains.rows()
        self._mass = grasp.body.mass_matrix()
        self._damping, self._tolerance = settings.rank_tolerance**2, friction.rest_tolerance
        self._rest_steps = round(friction.rest_time / settings.period)
        self._compliance = ObjectCompliance(MassFactor.from_body(grasp.body).mobility, constraints.spin_compliance)
        self._compiled: CompiledFriction | None = None
        if native is not None and constraints.spin_compliance == 0.0:
            self._compiled = CompiledFriction(self._compensation, self._kp, self._kd, self._mass, self._damping)

    def compensate(
        self, memory: FrictionMemory | None, state: GraspState, targets: StepTargets, desired: DesiredMotion
    ) -> tuple[Array, FrictionMemory, bool]:
        """Return the torques that overcome friction, (n,), N·m, the next memory, and whether the plan is at rest.

        The planned joint rates v = v_d + A⁺(B V_d − A v_d) make the desired twist V_d with rolling contacts. They contain no
        measured rate.

        Args:
            memory: memory after the last step; None before the first.
            state: measured state.
            targets: targets of this step.
            desired: desired motion.
        """
        memory = memory or self._compensation.initial_memory()
        if self._constraints.point_rows is None and self._constraints.spin_contacts is None:
            A, B = targets.velocity_rows
        else:
            A, B, _ = self._constraints.constraint_rows(targets.rolling)
        body, v_d = object_motion(desired), desired.v if isinstance(desired, GraspMotion) else None
        if self._compiled is not None:
            compiled = self._compiled.step(memory, A, B, body, state.object, targets.error, v_d)
            if compiled is not None:
                return compiled
        planned = self.plan_rates(A, B, body, state.object, targets.error, self._rest if v_d is None else v_d)
        tau, after = self._compensation.step(memory, planned)
        return tau, after, bool(np.abs(planned.v).max() < REST_RATE)

    def plan_rates(self, A: Array, B: Array, body: BodyMotion, measured: BodyMotion, error: Array, v_d: Array) -> PlannedRates:
        """Return planned rates and feedback of the joints.

        The part of a feedback a that acts along the desired twist V_d is V_d (V_dᵀ M a)/(V_dᵀ M V_d), with the object's mass
        matrix M.

        Args:
            A: (r, n) contact velocities per joint rate.
            B: (r, 6) contact velocities per twist of the object, in O.
            body: desired motion of the object.
            measured: measured motion of the object.
            error: (6,) pose error in H, m and rad.
            v_d: (n,) desired rates of the joints, rad/s.
        """
        feedback_H = self._kd * (body.twist - measured.twist) + self._kp * error  # m/s² and rad/s²
        twists = (np.array([body.twist, feedback_H]).reshape(4, 3) @ measured.R_HO).reshape(2, 6)  # in O
        energy = twists[0] @ self._mass @ twists[0]  # J, twice the kinetic energy
        part = twists[0] @ self._mass @ twists[1] / energy if energy > _LEAST_ENERGY else 0.0  # 1/s
        wanted = B @ np.vstack([twists, part * twists[0]]).T
        wanted[:, 0] -= A @ v_d
        K = A @ A.T
        if self._compliance.largest > 0.0:  # the object yields to its pads, see `contacts.mobility`
            yielding = self._compliance.at(A) * (B @ self._compliance.mobility)
            K += yielding @ yielding.T
        K.flat[:: len(K) + 1] += self._damping * K.trace() / len(K)  # singular contacts get no rate instead of a large one
        v, feedback, along = np.linalg.solve(K, wanted).T @ A
        return PlannedRates(v_d + v, feedback, along)

    def hold_integral(
        self, memory: FrictionMemory, error: Array, integral: Array, next_integral: Array, is_at_rest: bool
    ) -> tuple[Array, FrictionMemory]:
        """Return the integral for the next step, which is held at rest, and the memory with the state of the hold.

        Args:
            memory: memory after `compensate`.
            error: (6,) pose error in H, m and rad.
            integral: (6,) integral of this step, m·s and rad·s.
            next_integral: (6,) integral of the next step without hold.
            is_at_rest: whether the plan is at rest.
        """
        if not is_at_rest:
            return next_integral, dataclasses.replace(memory, rest=None) if memory.rest is not None else memory
        held, rest = hold_integral(memory.rest, error, integral, next_integral, self._tolerance, self._rest_steps)
        return held, dataclasses.replace(memory, rest=rest)
