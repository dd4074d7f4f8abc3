"""Cartesian computed torque of a held object: it follows a motion, held by forces that never leave their cones.

One step, from the measured state and the desired motion (001 (2), 000 (39)–(44), mended: J̇ q̇ where 000 (41) has J q̈):

    a    = a_d + K_d (V_d − V) + K_p e + K_i ∫e      e = (p_d − p, log(R_d Rᵀ)), in H
    w    = the wrench that the object needs for a, less what else acts on it
    q̈    : A q̈ = B a + β                              contacts roll and do not slip; the rest keeps its posture
    tau_u = M q̈ + h                                   the hand's own motion
    f    : least torques with G f = w, ‖f_t‖ ≤ μ f_n − s, all limits
    tau  = tau_u + Jᵀ f

The margin s is exact: f_n' = f_n − s/μ turns ‖f_t‖ ≤ μ f_n − s into the usual cone, with w' = w − G n s/μ and
tau_u' = tau_u + Jᵀ n s/μ, so the usual solver finds the least torques and proves them.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from graspforce.contact.contact import ContactSet
from graspforce.contact.kinematics import primitive_parameters, rolling_contacts, slip_displacement, slip_velocity
from graspforce.control.command import Command, make_lazy_command
from graspforce.control.compiled_step import CompiledStep, CompiledTargets
from graspforce.control.contact_constraints import ContactConstraints
from graspforce.control.memory import ControlMemory
from graspforce.control.mobility import MassFactor, compute_accelerations
from graspforce.control.pose_error import limit_integral, pose_error
from graspforce.control.settings import ControlSettings
from graspforce.control.state import DesiredMotion, GraspMotion, GraspState, check_joint_count, object_motion
from graspforce.control.step_data import StepResult, StepTargets
from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.compiled import native
from graspforce.force.problem import ForceProblem, Objective
from graspforce.force.solution import Solution
from graspforce.force.solver import Solver
from graspforce.grasp.grasp import Grasp
from graspforce.hand.actuation import Actuation
from graspforce.hand.hand import Hand

_SATURATION_TOLERANCE = 1e-6  # of a motor's range: nearer to its end than this, it is at its limit
_WARNING_DISTANCE, _WARNING_ANGLE = 1e-3, 0.02  # m and rad: errors that the fingers cannot take away are told from here on
_DEFAULTS = ControlSettings()


class ObjectControlLaw:
    """The law of one hold: pure but for its solvers, which keep their last answers to be faster, never to answer otherwise."""

    def __init__(self, grasp: Grasp, settings: ControlSettings) -> None:
        self.grasp, self.settings = grasp, settings
        hand = grasp.hand
        fingers = [hand.finger(name) for name in grasp.fingers]
        self._radii = np.array([finger.tip_radius or 0.0 for finger in fingers])  # m
        self._contact_joints = sorted({joint for finger in fingers for joint in finger.joints})  # by contacts
        self._tau_u_lower, self._tau_u_upper = (
            np.array(hand.torque_lower),
            np.array(hand.torque_upper),
        )  # N·m, of what holds nothing
        self._tau_u_lower[self._contact_joints], self._tau_u_upper[self._contact_joints] = -np.inf, np.inf
        near = _SATURATION_TOLERANCE * (hand.torque_upper - hand.torque_lower)  # N·m
        self._saturation_limits = np.array([hand.torque_lower + near, hand.torque_upper - near])
        self._constraints = ContactConstraints.from_contacts(grasp.contacts)
        self._tips = [hand.frame_id(name) for name in grasp.fingers]
        self._gains = tuple(settings.gains.rows())  # kp, kd and ki
        self._limits = (settings.integral_limit_linear, settings.integral_limit_angular)
        self._max_posture_pull = _max_posture_pull(hand, settings)
        self._M_factor = MassFactor.from_body(grasp.body)
        self._creep_decay = math.exp(-settings.period / settings.creep_time)
        self._margin_solvers = _margin_solvers(grasp.contacts, settings)
        self._compiled: CompiledStep | None = None
        if native is not None and primitive_parameters(grasp.body.shape) is not None:
            self._compiled = CompiledStep(
                grasp, settings, self._constraints, self._saturation_limits, self._max_posture_pull, self._creep_decay
            )

    def initial_memory(self) -> ControlMemory:
        """The memory before the first step."""
        contacts = self.grasp.contacts
        return ControlMemory(freeze(np.zeros(6)), contacts.R_OC, freeze(np.zeros((len(contacts), 2))), None)

    def step(
        self, memory: ControlMemory, state: GraspState, desired: DesiredMotion, external: Any = None
    ) -> tuple[Command, ControlMemory]:
        """The command for a state, and what the next step wants to know; arguments as in `ObjectController.step`."""
        grasp, settings, hand = self.grasp, self.settings, self.grasp.hand
        check_joint_count(hand, state.q, desired)
        if external is not None:
            external = arrays.check_array(external, "external", (6,))
        targets = self.compute_targets(memory, state, desired, external)
        tau_u = hand.model.inverse_dynamics(state.q, state.v, targets.joints, settings.gravity_H)
        tau_u = np.minimum(
            np.maximum(tau_u, self._tau_u_lower), self._tau_u_upper
        )  # fingers that hold nothing do what they can

        warnings: list[str] = []
        solution, f = self._solve_forces(targets, tau_u, warnings)
        held = f is None
        if f is None:
            f = np.zeros(grasp.contacts.size) if memory.f is None else memory.f
        result = self.compute_result(memory, state, targets, tau_u, f, held)
        if result.has_warnings:
            self._add_warnings(state.q, result.creep_distance, targets.rolling.gap, warnings)
        if targets.uncontrollable_error is not None:
            _warn_uncontrollable(targets.uncontrollable_error, warnings)
        command = make_lazy_command(
            tau=result.tau,
            f=f,
            solution=solution,
            saturated=result.saturated,
            creep=result.creep_distance,
            warnings=tuple(warnings),
            held=held,
            grasp_contacts=grasp.contacts,
            constraints=self._constraints,
            targets=targets,
            R_HO=state.object.R_HO,
        )
        left = memory.f if held else f
        return command, ControlMemory(result.integral, targets.R_OC, result.creep, left, targets.tip_contacts)

    def compute_targets(
        self, memory: ControlMemory, state: GraspState, desired: DesiredMotion, external: Array | None
    ) -> StepTargets:
        """The first half of a step: how object and joints shall move, and the wrench that it takes.

        Compiled where that knows the surface and the fingers can make every motion; otherwise as the equations stand.

        Args:
            memory, state, desired: as in `step`.
            external: (6,) as in `step`, checked; None for none.
        """
        compiled = None if self._compiled is None else self._compiled.compute_targets(memory, state, desired, external)
        if compiled is not None and compiled.is_complete:
            return compiled
        grasp, settings, now, body = self.grasp, self.settings, state.object, object_motion(desired)
        kp, kd, ki = self._gains
        error = pose_error(body, now)
        a_H = body.acceleration + kd * (body.twist - now.twist) + kp * error + ki * memory.integral

        if compiled is not None:
            rolling = compiled.rolling  # they are the same
        else:
            tips = grasp.hand.model.tip_motion(state.q, state.v, self._tips)
            rolling = rolling_contacts(tips, self._radii, now, grasp.body.shape, grasp.contacts, memory.R_OC)
        v_d, q_dd, pull = self.compute_joint_targets(state.q, desired)
        posture = q_dd + settings.posture_damping * (v_d - state.v) + pull  # rad/s²
        A, B, beta = self._constraints.constraint_rows(rolling)
        felt = np.array([a_H[:3], a_H[3:], now.twist[3:], settings.gravity_H]) @ now.R_HO  # p̈, ω̇, ω and g, in O
        accelerations = compute_accelerations(A, B, beta, felt[:2].flatten(), posture, self._M_factor, settings.least_lever)
        uncontrollable_error = None
        if accelerations.Q is not None:
            felt[:2], a_H = accelerations.object.reshape(2, 3), _rotate_twist(accelerations.object, now.R_HO)
        if accelerations.feasible_projection is not None:
            uncontrollable_error = error - _rotate_twist(
                accelerations.feasible_projection @ _rotate_twist(error, now.R_HO.T), now.R_HO
            )

        felt[0] -= felt[3]
        w = grasp.body.wrench_unchecked(felt[:3])
        if external is not None:
            w = w - external
        at = rolling.p_OC, rolling.R_OC, rolling.J, rolling.tip_contacts
        return StepTargets(error, uncontrollable_error, a_H, accelerations.joints, w, *at, rolling, accelerations)

    def compute_joint_targets(self, q: Array, desired: DesiredMotion) -> tuple[Array | float, Array | float, Array]:
        """Rates and accelerations targets of the joints, rad/s and rad/s², and the pull to where they should be, (n,) rad/s².

        The pull brings a joint at its speed limit at most: anything may be targets, and a stronger one would leave the motors
        nothing to hold the object with. Without a `GraspMotion` it is to the hold's posture.
        """
        q_d, v_d, q_dd = (desired.q, desired.v, desired.a) if isinstance(desired, GraspMotion) else (self.grasp.q, 0.0, 0.0)
        return v_d, q_dd, np.clip(self.settings.posture_stiffness * (q_d - q), -self._max_posture_pull, self._max_posture_pull)

    def compute_result(
        self, memory: ControlMemory, state: GraspState, targets: StepTargets, tau_u: Array, f: Array, held: bool
    ) -> StepResult:
        """The second half: the torques that make the forces, what slid, and the integral. Compiled where the first was.

        Args:
            memory, state: as in `step`.
            targets: the first half's.
            tau_u: (n,) what the hand's own motion takes, N·m.
            f: (k,) the forces, N and N·m.
            held: whether these are the last ones, no others having been found: the integral waits.
        """
        if self._compiled is not None and isinstance(targets, CompiledTargets) and memory.tip_contacts is not None:
            return self._compiled.compute_result(memory, memory.tip_contacts, state.q, targets, tau_u, f, not held)
        settings, hand, rolling = self.settings, self.grasp.hand, targets.rolling
        tau = np.minimum(np.maximum(tau_u + f @ targets.J, hand.torque_lower), hand.torque_upper)
        saturated = _is_outside(tau, *self._saturation_limits)
        if memory.tip_contacts is None:
            step = settings.period * slip_velocity(rolling, state.object)  # m
        else:
            step = slip_displacement(memory.tip_contacts, rolling.tip_contacts, rolling.R_OC)
        creep = self._creep_decay * memory.creep + step
        creep_distance = np.hypot(creep[:, 0], creep[:, 1])  # m
        off = max(creep_distance.tolist()) > settings.creep_limit or max(rolling.gap.tolist()) > settings.touch_gap
        integral = memory.integral
        if not (held or saturated):
            gain = targets.error if targets.uncontrollable_error is None else targets.error - targets.uncontrollable_error
            integral = limit_integral(integral + settings.period * gain, self._gains[2], self._limits)
        for part in (tau, creep, creep_distance, integral):
            part.setflags(write=False)
        has_warnings = off or _is_outside(state.q, hand.q_lower, hand.q_upper)
        return StepResult(tau, saturated, creep, creep_distance, integral, has_warnings)

    def _solve_forces(self, targets: StepTargets, tau_u: Array, warnings: list[str]) -> tuple[Solution, Array | None]:
        """The least-torque forces by the first plan that has any; None with the first plan's answer where none has."""
        first: Solution | None = None
        for margin_solver in self._margin_solvers:
            margin_terms = (
                targets.apply_slip_margin(tau_u, margin_solver.shift) if margin_solver.margin > 0.0 else (targets.w, tau_u)
            )
            solution = margin_solver.solve(self.grasp, self.settings, targets, *margin_terms)
            if solution.found:
                if margin_solver.warning:
                    warnings.append(f"no forces with the targets slip margin; {margin_solver.warning}")
                f = solution.f + margin_solver.force_offset
                f.setflags(write=False)  # parts of the command are worked out from it later
                return solution, f
            first = first or solution
        warnings.append("no forces hold the object so inside every limit: the last ones are held")
        assert first is not None  # there is always a plan
        return first, None

    def _add_warnings(self, q: Array, creep_distance: Array, gap: Array, warnings: list[str]) -> None:
        """Say which fingers slip, which do not touch, and which joints are at the end of their range."""
        for i, name in enumerate(self.grasp.fingers):
            if creep_distance[i] > self.settings.creep_limit:
                warnings.append(f"{name} slips: {1e3 * creep_distance[i]:.2f} mm over the object")
            if gap[i] > self.settings.touch_gap:
                warnings.append(f"{name} does not touch: it is {1e3 * gap[i]:.2f} mm off the object")
        hand = self.grasp.hand
        for j in self._contact_joints:
            if not hand.q_lower[j] < q[j] < hand.q_upper[j]:
                warnings.append(f"{hand.joints[j].name} is at the end of its range: {q[j]:.3f} rad")


class ObjectController:
    """Makes a held object follow a motion: call `step` once a period.

    Args:
        hold: the hand, the object, and which fingers touch it where.
        settings: gains, margins, gravity and limits.
    """

    def __init__(self, grasp: Grasp, settings: ControlSettings = _DEFAULTS) -> None:
        self.grasp, self.settings = grasp, settings
        self.reset()

    def reset(self) -> None:
        """Forget everything since the hold: integral, contacts, forces, sliding."""
        self._law = ObjectControlLaw(self.grasp, self.settings)
        self._memory = self._law.initial_memory()

    @property
    def memory(self) -> ControlMemory:
        """What the last step left."""
        return self._memory

    def step(self, state: GraspState, desired: DesiredMotion, external: Any = None) -> Command:
        """The motor torques for the next period.

        Args:
            state: the hand and the object now, as measured.
            desired: where the object should be, and its desired twist and acceleration; in a `GraspMotion` with a motion of
                the joints too, which they follow as far as the object leaves them free, instead of the hold's posture.
            external: (6,) an estimate of the wrench on the object that is neither gravity nor the fingers', about O's origin,
                in O, N and N·m; None for none.

        Raises:
            InvalidInput: a state of another hand, or numbers that are not finite.
        """
        command, self._memory = self._law.step(self._memory, state, desired, external)
        return command


class _MarginSolver:
    """One way of leaving friction unused, with its own solver."""

    def __init__(self, contacts: ContactSet, margin: float, reserve: float, warning: str) -> None:
        mu = contacts.mu * (1.0 - reserve)
        self.margin, self.warning = margin, warning
        self.shift = np.divide(margin, mu, out=np.zeros(len(mu)), where=mu > 0.0)  # N: s/μ on each normal force
        self.force_offset = np.zeros(contacts.size)  # N: the same where each normal force stands
        self.force_offset[contacts.normal_rows] = self.shift
        least, most = np.maximum(contacts.min_normal - self.shift, 0.0), contacts.max_normal - self.shift
        self.is_possible = bool((most >= least).all())
        self._contacts = dataclasses.replace(contacts, mu=freeze(mu), min_normal=freeze(least), max_normal=freeze(most))
        self._solver: Solver | None = None

    def solve(self, grasp: Grasp, settings: ControlSettings, targets: StepTargets, w: Array, tau_u: Array) -> Solution:
        """The certified answer for these numbers."""
        if self._solver is None:
            hand = grasp.hand
            actuation = Actuation(targets.J, tau_u, hand.torque_lower, hand.torque_upper, hand.torque_weight)
            problem = ForceProblem(self._contacts, w, actuation, objective=Objective("torque", settings.force_weight))
            self._solver = Solver(problem, explain=False)
        return self._solver.solve(w=w, J=targets.J, tau_u=tau_u, p=targets.p_OC, R=targets.R_OC)


def _margin_solvers(contacts: ContactSet, settings: ControlSettings) -> tuple[_MarginSolver, ...]:
    """What is tried, in order: the targets margin, half of it, none, and friction to its end."""
    margin, reserve = settings.slip_margin, settings.friction_reserve
    targets = [
        (margin, reserve, ""),
        (margin / 2.0, reserve, f"half of it is kept, {margin / 2.0:.3g} N"),
        (0.0, reserve, f"only the reserve of friction is kept, {100.0 * reserve:.3g} %"),
        (0.0, 0.0, "nothing is kept: the contacts are at the end of their friction"),
    ]
    margin_solvers, seen = [], set()
    for m, r, warning in targets:
        margin_solver = _MarginSolver(contacts, m, r, warning)
        if margin_solver.is_possible and (m, r) not in seen:
            margin_solvers.append(margin_solver)
        seen.add((m, r))
    return tuple(margin_solvers)


def _max_posture_pull(hand: Hand, settings: ControlSettings) -> Array:
    """(n,) the strongest pull on a joint towards its posture, rad/s²: with it the joint comes at its speed limit."""
    fastest = hand.velocity_limit  # rad/s
    return freeze(np.where(np.isfinite(fastest), settings.posture_decay_rate * np.nan_to_num(fastest), np.inf))


def _warn_uncontrollable(stays: Array, warnings: list[str]) -> None:
    """Say what of the error no motion of the fingers can take away."""
    off, turned = math.hypot(*stays[:3]), math.hypot(*stays[3:])  # m and rad
    if off > _WARNING_DISTANCE or turned > _WARNING_ANGLE:
        left = f"{1e3 * off:.2f} mm and {math.degrees(turned):.2f}° stay"
        warnings.append(f"the fingers cannot make all of this motion without slipping: {left}")


def _is_outside(x: Array, low: Array, high: Array) -> bool:
    """Whether some number is not between its bounds."""
    return bool(min(((x - low) * (high - x)).tolist()) <= 0.0)


def _rotate_twist(twist: Array, R: Array) -> Array:
    """Both halves of a 6-vector, turned by R."""
    return np.asarray((twist.reshape(2, 3) @ R.T).ravel())
