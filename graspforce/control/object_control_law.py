"""Cartesian computed-torque control of a grasped object, with contact forces inside their friction cones.

One step computes, from the measured state and the desired motion:

- a = a_d + K_d (V_d − V) + K_p e + K_i ∫ e dt, the object's acceleration for the pose error e = (p_d − p, log(R_d Rᵀ)) in H;
- w, the wrench that the object needs for a, less the external wrench;
- q̈ with A q̈ = B a + β: the contacts roll without slip, and the null space follows the posture;
- tau_u = M q̈ + h, the torques of the hand's own motion, and those that overcome joint friction if the settings ask for it;
- f with the least torques, subject to G f = w, ‖f_t‖ ≤ μ f_n − s and all limits;
- tau = tau_u + Jᵀ f, the motor torques.

Sources: Al-Gallaf; Mattar (2013), eqs. (39)–(44) with J̇ q̇ in place of J q̈ in eq. (41).
"""

from __future__ import annotations

import copy
import dataclasses
import math
from typing import Any

import numpy as np
import numpy.typing as npt

from graspforce.contact.compiled_kinematics import primitive_parameters, rolling_contacts, slip_displacement
from graspforce.contact.kinematics import slip_velocity
from graspforce.contact.motion import BodyMotion
from graspforce.control.clearance import ClearanceQuery
from graspforce.control.command import Command, CommandSource, make_lazy_command
from graspforce.control.compiled_step import CompiledStep, CompiledTargets, step_parameters
from graspforce.control.contacts.contact_conditions import ContactConditions
from graspforce.control.contacts.contact_constraints import SPIN_DAMPING, ContactConstraints
from graspforce.control.contacts.feasible_twists import contacts_at_rest
from graspforce.control.contacts.lost_drives import LostDrives
from graspforce.control.contacts.mobility import (
    MassFactor,
    ObjectCompliance,
    compute_accelerations,
    compute_compliant_accelerations,
    compute_damped_accelerations,
    has_full_rank,
)
from graspforce.control.contacts.pad_spin import next_spin, spin_acceleration
from graspforce.control.drive_learning import DriveLearning
from graspforce.control.drives.drive_commands import DriveMap
from graspforce.control.forces.drive_allowance import DriveAllowance, drive_allowance
from graspforce.control.forces.force_planner import ContactPlan, ForcePlanner
from graspforce.control.forces.margin_solver import MarginResult, MarginSolver
from graspforce.control.grasp_friction import GraspFriction
from graspforce.control.memory import ControlMemory
from graspforce.control.pose_error import limit_integral, pose_error
from graspforce.control.settings import ControlSettings
from graspforce.control.state import DesiredMotion, GraspMotion, GraspState, check_joint_count, object_motion
from graspforce.control.step_data import FreeTorques, IntegralRule, StepResult, StepTargets
from graspforce.control.step_warnings import StepWarnings, uncontrollable_warning
from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.compiled import native
from graspforce.grasp.grasp import Grasp, check_grasp
from graspforce.hand.hand import Hand

_SATURATION_TOLERANCE = 1e-6  # fraction of the torque range within which a motor counts as saturated
_NO_INTEGRAL = freeze(np.zeros(6))


class ObjectControlLaw:
    """Control law of one grasp, without memory of its own.

    The law is stateless except for the warm starts of its solvers, which affect speed only. `ObjectController` adds the memory.

    Attributes:
        grasp: hand, object and contacts.
        settings: gains, margins, gravity and limits.
        warnings: warnings of contacts and joints.

    Args:
        grasp: hand, object and contacts.
        settings: gains, margins, gravity and limits.
    """

    def __init__(self, grasp: Grasp, settings: ControlSettings) -> None:
        self.grasp, self.settings = check_grasp(grasp), settings
        hand = grasp.hand
        fingers = [hand.finger(name) for name in grasp.fingers]
        self._radii = np.array([finger.tip_radius or 0.0 for finger in fingers])  # m
        self._contact_joints = sorted({joint for finger in fingers for joint in finger.joints})
        # Limits of tau_u, N·m. Motors of fingers without contact saturate; contact forces can relieve the others.
        self._tau_u_lower, self._tau_u_upper = np.array(hand.torque_lower), np.array(hand.torque_upper)
        self._tau_u_lower[self._contact_joints], self._tau_u_upper[self._contact_joints] = -np.inf, np.inf
        tolerance = _SATURATION_TOLERANCE * (hand.torque_upper - hand.torque_lower)  # N·m
        edges = np.array([hand.torque_lower + tolerance, hand.torque_upper - tolerance])
        self._saturation_limits = np.where(tolerance > 0.0, edges, [[-np.inf], [np.inf]])  # not of joints without motor
        self._constraints = ContactConstraints.from_contacts(grasp.contacts)
        self._tips = [hand.frame_id(name) for name in grasp.fingers]
        if self._constraints.spin_count > 0 and self._has_full_rank(settings.rank_tolerance):
            damping = 0.0 if settings.spin_compliance > 0.0 else SPIN_DAMPING  # m/rad
            compliance = settings.spin_compliance
            self._constraints = dataclasses.replace(self._constraints, spin_damping=damping, spin_compliance=compliance)
        self._gains = tuple(settings.gains.rows())  # kp, kd and ki
        self._max_posture_pull = _max_posture_pull(hand, settings)
        self._M_factor = MassFactor.from_body(grasp.body)
        self._compliance = ObjectCompliance(self._M_factor.mobility, self._constraints.spin_compliance)
        self._creep_decay = math.exp(-settings.period / settings.creep_time)
        self._drives = DriveMap(hand, settings.position_error, settings.period)
        self._learning = DriveLearning(grasp, settings, self._constraints)
        self._compiled: CompiledStep | None = None
        self._clearance = ClearanceQuery(grasp, settings.obstacles)
        if settings.clearance_steps:
            self._clearance.prepare()
        drive_margin, self._integral_limits = self._allow_for_drives()
        self._planner, self.warnings = ForcePlanner(grasp, settings, drive_margin), StepWarnings(grasp, settings)
        friction = settings.friction
        self._friction = None if friction is None else GraspFriction(grasp, settings, friction, self._constraints)
        if native is not None and primitive_parameters(grasp.body.shape) is not None:
            self._compiled = CompiledStep(grasp, self.step_parameters())

    def step_parameters(self) -> dict[str, Any]:
        """Return the numbers of the compiled step; see `compiled_step.step_parameters`."""
        limits = self._saturation_limits, self._integral_limits, self._max_posture_pull, self._creep_decay
        return step_parameters(self.grasp, self.settings, self._constraints, *limits)

    @property
    def free_torque_limits(self) -> Array:
        """(2, n) limits of the torques without contact forces, N·m; infinite for the motors of fingers in contact."""
        return np.array([self._tau_u_lower, self._tau_u_upper])

    @property
    def force_solver(self) -> MarginSolver:
        """The solver of the contact forces."""
        return self._planner.solver

    def with_grasp(self, grasp: Grasp) -> ObjectControlLaw:
        """Return the law of the same contacts at another posture. It shares the solvers and is much faster than a new law.

        Args:
            grasp: grasp of the same hand, body, fingers and contact models; positions, posture and pose may differ.
        """
        law = copy.copy(self)
        law.grasp = grasp
        law._compiled = None if self._compiled is None else self._compiled.at_posture(grasp.q)
        return law

    def _allow_for_drives(self) -> DriveAllowance:
        """Return the slip margin and the limits of the integral for the errors of the hand's drives."""
        grasp, settings = self.grasp, self.settings
        if grasp.hand.drives.is_ideal:
            return DriveAllowance(0.0, (settings.integral_limit_linear, settings.integral_limit_angular))
        rest = BodyMotion(grasp.p_HO, grasp.R_HO)
        targets = self.compute_targets(self.initial_memory(), GraspState(grasp.q, np.zeros(grasp.hand.n), rest), rest, None)
        return drive_allowance(grasp, settings, self._constraints, self._drives, targets)

    def _has_full_rank(self, rank_tolerance: float) -> bool:
        """Return whether every motion of the object is feasible in the posture of the grasp, with contacts that do not spin."""
        return has_full_rank(self._constraints.constraint_rows(contacts_at_rest(self.grasp))[0], rank_tolerance)

    def _constraints_with(self, lost: LostDrives | None) -> ContactConstraints:
        """Return the constraints of the contacts whose fingers have their drives."""
        return self._constraints if lost is None else self._constraints.without(lost.contacts)

    def initial_memory(self) -> ControlMemory:
        """Return the memory before the first step."""
        contacts = self.grasp.contacts
        return ControlMemory(freeze(np.zeros(6)), contacts.R_OC, freeze(np.zeros((len(contacts), 2))), None)

    def step(
        self,
        memory: ControlMemory,
        state: GraspState,
        desired: DesiredMotion,
        external: npt.ArrayLike | None = None,
        conditions: ContactConditions | None = None,
    ) -> tuple[Command, ControlMemory]:
        """Compute the command for the next period, and the memory for the next step.

        Args:
            memory: memory after the last step; `initial_memory()` before the first.
            state: as in `ObjectController.step`.
            desired: as in `ObjectController.step`.
            external: as in `ObjectController.step`.
            conditions: of the contacts in this step; as modelled by default.

        Raises:
            InvalidInput: as in `ObjectController.step`.
        """
        grasp = self.grasp
        check_joint_count(grasp.hand, state.q, desired)
        if external is not None:
            external = arrays.check_array(external, "external", (6,))
        told = desired
        if memory.torque_factors is not None:
            desired = memory.torque_factors.shift(desired, grasp.q)
        plan = self._planner.plan_contacts(memory, conditions)
        targets = self.compute_targets(memory, state, desired, external, plan.lost)
        free = self._compute_free_torques(memory, state, targets, desired, plan.lost)
        plan, forces = self._planner.solve(plan, memory, targets, free.tau_u)
        friction_memory = free.friction
        rule, warnings, stop = _integral_rule(forces), [], None
        if plan.lost is not None:
            is_moving = forces.f is not None
            if not is_moving:
                stop = state.object.p_HO if memory.stop is None else memory.stop
                targets, free, forces = self._stop(memory, state, stop, external, plan)
            warnings.append(plan.lost.message(is_moving, forces.f is not None))
        if forces.warning:
            warnings.append(forces.warning)
        f, forces_reused = forces.f, forces.f is None
        if f is None:
            f = self._planner.find_emergency_forces(plan, memory, targets, free.tau_u)
            if plan.lost is None:
                warnings.append("no forces hold the object within all limits: the last forces are reused")
        ramp = plan.ramp
        if ramp is not None and forces_reused:
            if ramp.releasing.any():
                warnings.append("the other fingers cannot hold the object: no finger lets go")
            ramp = ramp.stopped()
        result = self.compute_result(memory, state, targets, free.tau_u, f, rule)
        integral = result.integral
        if self._friction is not None and friction_memory is not None:
            hold = friction_memory, targets.error, memory.integral, integral, free.is_at_rest
            integral, friction_memory = self._friction.hold_integral(*hold)
        factors, sensitivity = None, None
        if self._learning.is_active and plan.lost is None:
            made = result._replace(integral=integral)
            factors, integral, sensitivity = self._learning.step(memory.torque_factors, grasp, state, told, targets, made)
            integral = limit_integral(integral, self._gains[2], self._integral_limits)
        if result.has_warnings or (conditions is not None and conditions.has_evidence):
            warnings += self.warnings.of_step(result.creep_distance, targets.rolling.gap, state.q, conditions)
        if targets.uncontrollable_error is not None:
            warnings += uncontrollable_warning(targets.uncontrollable_error)
        constraints, twist = self._constraints_with(plan.lost), object_motion(desired).twist
        source = CommandSource(grasp, constraints, targets, state, twist, self._drives, free.own, self._clearance, sensitivity)
        command = make_lazy_command(source, result, forces.solution, f, tuple(warnings), forces_reused)
        last_forces = memory.f if forces_reused else f
        spin = None
        if self._constraints.is_tracking_spin:
            spin = next_spin(memory.spin, memory.tip_contacts, targets.tip_contacts, targets.R_OC, self.settings.period)
        margin = self._planner.kept_margin(plan, forces)
        parts = last_forces, targets.tip_contacts, friction_memory, plan.reflex, stop, ramp, spin, margin, factors
        return command, ControlMemory(integral, targets.R_OC, result.creep, *parts)

    def _compute_free_torques(
        self, memory: ControlMemory, state: GraspState, targets: StepTargets, desired: DesiredMotion, lost: LostDrives | None
    ) -> FreeTorques:
        """Return the torques without contact forces."""
        hand = self.grasp.hand
        own = tau_u = hand.model.inverse_dynamics(state.q, state.v, targets.joint_acceleration, self.settings.gravity_H)
        friction_memory, is_at_rest = None, False
        if self._friction is not None:
            tau_friction, friction_memory, is_at_rest = self._friction.compensate(memory.friction, state, targets, desired)
            tau_u = tau_u + tau_friction
        tau_u = np.minimum(np.maximum(tau_u, self._tau_u_lower), self._tau_u_upper)
        return FreeTorques(own, tau_u if lost is None else lost.without_torques(tau_u), friction_memory, is_at_rest)

    def _stop(
        self, memory: ControlMemory, state: GraspState, position: Array, external: Array | None, plan: ContactPlan
    ) -> tuple[StepTargets, FreeTorques, MarginResult]:
        """Return targets, torques and forces that stop the object at a position, (3,) in H, m: see `lost_drives`."""
        rest = BodyMotion(position, state.object.R_HO)
        targets = self.compute_targets(dataclasses.replace(memory, integral=_NO_INTEGRAL), state, rest, external, plan.lost)
        free = self._compute_free_torques(memory, state, targets, rest, plan.lost)
        return targets, free, self._planner.solve(plan, memory, targets, free.tau_u)[1]

    def compute_targets(
        self,
        memory: ControlMemory,
        state: GraspState,
        desired: DesiredMotion,
        external: Array | None,
        lost: LostDrives | None = None,
    ) -> StepTargets:
        """Compute the accelerations of object and joints and the wrench: the step before the force solve.

        The C code computes them if it supports the object's shape, every twist is feasible and all drives are on; this method
        does in all other cases.

        Args:
            memory: as in `step`.
            state: as in `step`.
            desired: as in `step`.
            external: (6,) as in `step`, checked; None for none.
            lost: contacts and motors of fingers whose drives are off: their contacts constrain nothing. None if all are on.
        """
        compiled = None if self._compiled is None else self._compiled.compute_targets(memory, state, desired, external)
        if compiled is not None and compiled.is_complete and lost is None:
            return compiled
        grasp, settings, measured, body = self.grasp, self.settings, state.object, object_motion(desired)
        kp, kd, ki = self._gains
        error = pose_error(body, measured)
        a_H = body.acceleration + kd * (body.twist - measured.twist) + kp * error + ki * memory.integral

        if compiled is not None:
            rolling = compiled.rolling  # complete even if the targets are not
        else:
            tips = grasp.hand.model.tip_motion(state.q, state.v, self._tips)
            rolling = rolling_contacts(tips, self._radii, measured, grasp.body.shape, grasp.contacts, memory.R_OC)
        v_d, a_d, pull = self.compute_joint_targets(state.q, desired)
        posture = a_d + settings.posture_damping * (v_d - state.v) + pull  # rad/s²
        constraints = self._constraints_with(lost)
        A, B, beta = constraints.constraint_rows(rolling, None if memory.spin is None else spin_acceleration(memory.spin))
        rates = np.array([a_H[:3], a_H[3:], measured.twist[3:], settings.gravity_H]) @ measured.R_HO  # p̈, ω̇, ω and g in O
        inputs, accelerations = (A, B, beta, rates[:2].flatten(), posture), None
        if constraints.spin_compliance > 0.0:
            accelerations = compute_compliant_accelerations(*inputs, self._compliance, settings.rank_tolerance)
        elif constraints.spin_damping > 0.0:
            accelerations = compute_damped_accelerations(*inputs, constraints.damping, settings.rank_tolerance)
        if accelerations is None:
            accelerations = compute_accelerations(*inputs, self._M_factor, settings.rank_tolerance)
        if accelerations.object_acceleration is not inputs[3]:
            rates[:2] = accelerations.object_acceleration.reshape(2, 3)
            a_H = _rotate_twist(accelerations.object_acceleration, measured.R_HO)
        uncontrollable_error = None
        if accelerations.feasible_projection is not None:
            feasible_O = accelerations.feasible_projection @ _rotate_twist(error, measured.R_HO.T)
            uncontrollable_error = error - _rotate_twist(feasible_O, measured.R_HO)

        rates[0] -= rates[3]
        w = grasp.body.wrench_unchecked(rates[:3])
        if external is not None:
            w = w - external
        contacts = rolling.p_OC, rolling.R_OC, rolling.J, rolling.tip_contacts
        joint_acceleration = accelerations.joint_acceleration
        return StepTargets(error, uncontrollable_error, a_H, joint_acceleration, w, *contacts, rolling, accelerations)

    def compute_joint_targets(self, q: Array, desired: DesiredMotion) -> tuple[Array | float, Array | float, Array]:
        """Return target rates (rad/s), target accelerations (rad/s²), and the pull towards the target positions (n,), rad/s².

        The pull k_p (q_d − q) is limited to the one that brings a joint at its speed limit. A stronger pull would leave the
        motors no torque for the contact forces. Without a `GraspMotion` the target is the posture of the grasp, at rest.

        Args:
            q: (n,) measured joint positions, rad.
            desired: desired motion.
        """
        q_d, v_d, a_d = (desired.q, desired.v, desired.a) if isinstance(desired, GraspMotion) else (self.grasp.q, 0.0, 0.0)
        pull = np.clip(self.settings.posture_stiffness * (q_d - q), -self._max_posture_pull, self._max_posture_pull)
        return v_d, a_d, pull

    def compute_result(
        self, memory: ControlMemory, state: GraspState, targets: StepTargets, tau_u: Array, f: Array, rule: IntegralRule
    ) -> StepResult:
        """Compute torques, sliding and integral: the step after the force solve.

        Args:
            memory: as in `step`.
            state: as in `step`.
            targets: targets of this step. The C code computes the result if it computed them.
            tau_u: (n,) torques without contact forces, N·m.
            f: (k,) contact forces, N and N·m.
            rule: whether the integral of the pose error grows.
        """
        if self._compiled is not None and isinstance(targets, CompiledTargets) and memory.tip_contacts is not None:
            return self._compiled.compute_result(memory, memory.tip_contacts, state.q, targets, tau_u, f, rule)
        settings, hand, rolling = self.settings, self.grasp.hand, targets.rolling
        tau = np.minimum(np.maximum(tau_u + f @ targets.J, hand.torque_lower), hand.torque_upper)
        saturated = _is_outside(tau, *self._saturation_limits)
        if memory.tip_contacts is None:
            slip = settings.period * slip_velocity(rolling, state.object)  # m
        else:
            slip = slip_displacement(memory.tip_contacts, rolling.tip_contacts, rolling.R_OC)
        creep = self._creep_decay * memory.creep + slip
        creep_distance = np.hypot(creep[:, 0], creep[:, 1])  # m
        slips = max(creep_distance.tolist()) > settings.creep_limit
        lost_contact = max(rolling.gap.tolist()) > settings.contact_tolerance
        integral = memory.integral
        if rule is IntegralRule.ALWAYS or (rule is IntegralRule.UNLESS_SATURATED and not saturated):
            error = targets.error if targets.uncontrollable_error is None else targets.error - targets.uncontrollable_error
            integral = limit_integral(integral + settings.period * error, self._gains[2], self._integral_limits)
        for part in (tau, creep, creep_distance, integral):
            part.setflags(write=False)
        has_warnings = slips or lost_contact or _is_outside(state.q, hand.q_lower, hand.q_upper)
        return StepResult(tau, saturated, creep, creep_distance, integral, has_warnings)


def _integral_rule(forces: MarginResult) -> IntegralRule:
    """Return whether the integral grows. A motor at its limit does not stop it as long as the forces keep some slip margin.

    Forces with the largest margin always bring a motor to its limit, but they still supply the wrench.
    """
    if forces.f is None:
        return IntegralRule.NEVER
    return IntegralRule.ALWAYS if forces.warning and forces.margin > 0.0 else IntegralRule.UNLESS_SATURATED


def _max_posture_pull(hand: Hand, settings: ControlSettings) -> Array:
    """Return the pull towards the posture with which a joint moves at its speed limit, (n,), rad/s²."""
    speed = hand.velocity_limit  # rad/s
    return freeze(np.where(np.isfinite(speed), settings.posture_decay_rate * np.nan_to_num(speed), np.inf))


def _is_outside(x: Array, lower: Array, upper: Array) -> bool:
    """Return whether a component is not strictly between its bounds."""
    return bool(min(((x - lower) * (upper - x)).tolist()) <= 0.0)


def _rotate_twist(twist: Array, R: Array) -> Array:
    """Return a 6-vector with both halves rotated by R."""
    return np.asarray((twist.reshape(2, 3) @ R.T).ravel())
