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

from graspforce import arrays
from graspforce.actuation import Actuation
from graspforce.arrays import Array, frozen
from graspforce.contact import ContactSet
from graspforce.control.command import Command, made
from graspforce.control.compiled import laws
from graspforce.control.compiled_step import CompiledStep, WantedBlock
from graspforce.control.memory import ControlMemory
from graspforce.control.mobility import MassRoot, accelerations
from graspforce.control.pose import bounded, pose_error
from graspforce.control.rolling import closed_form, rolling_contacts, slid, sliding
from graspforce.control.settings import ControlSettings
from graspforce.control.state import Desired, GraspMotion, GraspState, body_of, fit
from graspforce.control.ties import Ties
from graspforce.control.wanted import Settled, Wanted
from graspforce.hand import Hand
from graspforce.hold import Hold
from graspforce.problem import ForceProblem, Objective
from graspforce.solution import Solution
from graspforce.solve import Solver

_AT_LIMIT = 1e-6  # of a motor's range: nearer to its end than this, it is at its limit
_FAR, _TURNED = 1e-3, 0.02  # m and rad: errors that the fingers cannot take away are told from here on
_DEFAULTS = ControlSettings()


class ObjectLaw:
    """The law of one hold: pure but for its solvers, which keep their last answers to be faster, never to answer otherwise."""

    def __init__(self, hold: Hold, settings: ControlSettings) -> None:
        self.hold, self.settings = hold, settings
        hand = hold.hand
        fingers = [hand.finger(name) for name in hold.fingers]
        self._radii = np.array([finger.tip_radius or 0.0 for finger in fingers])  # m
        self._loaded = sorted({joint for finger in fingers for joint in finger.joints})  # by contacts
        self._least, self._most = np.array(hand.torque_lower), np.array(hand.torque_upper)  # N·m, of what holds nothing
        self._least[self._loaded], self._most[self._loaded] = -np.inf, np.inf
        near = _AT_LIMIT * (hand.torque_upper - hand.torque_lower)  # N·m
        self._at_limits = np.array([hand.torque_lower + near, hand.torque_upper - near])
        self._ties = Ties.made_by(hold.contacts)
        self._tips = [hand.frame(name) for name in hold.fingers]
        self._gains = tuple(settings.gains.rows())  # kp, kd and ki
        self._limits = (settings.integral_limit_linear, settings.integral_limit_angular)
        self._reach = _reach(hand, settings)
        self._M_root = MassRoot.of(hold.body)
        self._kept_creep = math.exp(-settings.period / settings.creep_time)
        self._plans = _plans(hold.contacts, settings)
        self._compiled: CompiledStep | None = None
        if laws is not None and closed_form(hold.body.shape) is not None:
            self._compiled = CompiledStep(hold, settings, self._ties, self._at_limits, self._reach, self._kept_creep)

    def start(self) -> ControlMemory:
        """The memory before the first step."""
        contacts = self.hold.contacts
        return ControlMemory(frozen(np.zeros(6)), contacts.R_OC, frozen(np.zeros((len(contacts), 2))), None)

    def step(
        self, memory: ControlMemory, state: GraspState, desired: Desired, external: Any = None
    ) -> tuple[Command, ControlMemory]:
        """The command for a state, and what the next step wants to know; arguments as in `ObjectController.step`."""
        hold, settings, hand = self.hold, self.settings, self.hold.hand
        fit(hand, state.q, desired)
        if external is not None:
            external = arrays.array(external, "external", (6,))
        wanted = self.wanted(memory, state, desired, external)
        tau_u = hand.model.inverse_dynamics(state.q, state.v, wanted.joints, settings.gravity_H)
        tau_u = np.minimum(np.maximum(tau_u, self._least), self._most)  # fingers that hold nothing do what they can

        warnings: list[str] = []
        solution, f = self._forces(wanted, tau_u, warnings)
        held = f is None
        if f is None:
            f = np.zeros(hold.contacts.size) if memory.f is None else memory.f
        settled = self.settled(memory, state, wanted, tau_u, f, held)
        if settled.noted:
            self._watch(state.q, settled.crept, wanted.rolling.gap, warnings)
        if wanted.lost is not None:
            _regret(wanted.lost, warnings)
        command = made(
            tau=settled.tau,
            f=f,
            solution=solution,
            saturated=settled.saturated,
            creep=settled.crept,
            warnings=tuple(warnings),
            held=held,
            hold_contacts=hold.contacts,
            ties=self._ties,
            wanted=wanted,
            R_HO=state.object.R_HO,
        )
        left = memory.f if held else f
        return command, ControlMemory(settled.integral, wanted.R_OC, settled.creep, left, wanted.touched)

    def wanted(self, memory: ControlMemory, state: GraspState, desired: Desired, external: Array | None) -> Wanted:
        """The first half of a step: how object and joints shall move, and the wrench that it takes.

        Compiled where that knows the surface and the fingers can make every motion; otherwise as the equations stand.

        Args:
            memory, state, desired: as in `step`.
            external: (6,) as in `step`, checked; None for none.
        """
        compiled = None if self._compiled is None else self._compiled.wanted(memory, state, desired, external)
        if compiled is not None and compiled.whole:
            return compiled
        hold, settings, now, body = self.hold, self.settings, state.object, body_of(desired)
        kp, kd, ki = self._gains
        error = pose_error(body, now)
        a_H = body.acceleration + kd * (body.twist - now.twist) + kp * error + ki * memory.integral

        if compiled is not None:
            rolling = compiled.rolling  # they are the same
        else:
            tips = hold.hand.model.tip_motion(state.q, state.v, self._tips)
            rolling = rolling_contacts(tips, self._radii, now, hold.body.shape, hold.contacts, memory.R_OC)
        v_d, q_dd, pull = self.joints_wanted(state.q, desired)
        posture = q_dd + settings.posture_damping * (v_d - state.v) + pull  # rad/s²
        A, B, beta = self._ties.of(rolling)
        felt = np.array([a_H[:3], a_H[3:], now.twist[3:], settings.gravity_H]) @ now.R_HO  # p̈, ω̇, ω and g, in O
        moves = accelerations(A, B, beta, felt[:2].flatten(), posture, self._M_root, settings.least_lever)
        lost = None
        if moves.Q is not None:
            felt[:2], a_H = moves.object.reshape(2, 3), _turned(moves.object, now.R_HO)
        if moves.able is not None:
            lost = error - _turned(moves.able @ _turned(error, now.R_HO.T), now.R_HO)

        felt[0] -= felt[3]
        w = hold.body.wrench_at(felt[:3])
        if external is not None:
            w = w - external
        at = rolling.p_OC, rolling.R_OC, rolling.J, rolling.touched
        return Wanted(error, lost, a_H, moves.joints, w, *at, rolling, moves)

    def joints_wanted(self, q: Array, desired: Desired) -> tuple[Array | float, Array | float, Array]:
        """Rates and accelerations wanted of the joints, rad/s and rad/s², and the pull to where they should be, (n,) rad/s².

        The pull brings a joint at its speed limit at most: anything may be wanted, and a stronger one would leave the motors
        nothing to hold the object with. Without a `GraspMotion` it is to the hold's posture.
        """
        q_d, v_d, q_dd = (desired.q, desired.v, desired.a) if isinstance(desired, GraspMotion) else (self.hold.q, 0.0, 0.0)
        return v_d, q_dd, np.clip(self.settings.posture_stiffness * (q_d - q), -self._reach, self._reach)

    def settled(self, memory: ControlMemory, state: GraspState, wanted: Wanted, tau_u: Array, f: Array, held: bool) -> Settled:
        """The second half: the torques that make the forces, what slid, and the integral. Compiled where the first was.

        Args:
            memory, state: as in `step`.
            wanted: the first half's.
            tau_u: (n,) what the hand's own motion takes, N·m.
            f: (k,) the forces, N and N·m.
            held: whether these are the last ones, no others having been found: the integral waits.
        """
        if self._compiled is not None and isinstance(wanted, WantedBlock) and memory.touched is not None:
            return self._compiled.settled(memory, memory.touched, state.q, wanted, tau_u, f, not held)
        settings, hand, rolling = self.settings, self.hold.hand, wanted.rolling
        tau = np.minimum(np.maximum(tau_u + f @ wanted.J, hand.torque_lower), hand.torque_upper)
        saturated = _leaves(tau, *self._at_limits)
        if memory.touched is None:
            step = settings.period * sliding(rolling, state.object)  # m
        else:
            step = slid(memory.touched, rolling.touched, rolling.R_OC)
        creep = self._kept_creep * memory.creep + step
        crept = np.hypot(creep[:, 0], creep[:, 1])  # m
        off = max(crept.tolist()) > settings.creep_limit or max(rolling.gap.tolist()) > settings.touch_gap
        integral = memory.integral
        if not (held or saturated):
            gain = wanted.error if wanted.lost is None else wanted.error - wanted.lost
            integral = bounded(integral + settings.period * gain, self._gains[2], self._limits)
        for part in (tau, creep, crept, integral):
            part.setflags(write=False)
        noted = off or _leaves(state.q, hand.q_lower, hand.q_upper)
        return Settled(tau, saturated, creep, crept, integral, noted)

    def _forces(self, wanted: Wanted, tau_u: Array, warnings: list[str]) -> tuple[Solution, Array | None]:
        """The least-torque forces by the first plan that has any; None with the first plan's answer where none has."""
        first: Solution | None = None
        for plan in self._plans:
            tightened = wanted.tightened(tau_u, plan.shift) if plan.margin > 0.0 else (wanted.w, tau_u)
            solution = plan.solve(self.hold, self.settings, wanted, *tightened)
            if solution.found:
                if plan.said:
                    warnings.append(f"no forces with the wanted slip margin; {plan.said}")
                f = solution.f + plan.raised
                f.setflags(write=False)  # parts of the command are worked out from it later
                return solution, f
            first = first or solution
        warnings.append("no forces hold the object so inside every limit: the last ones are held")
        assert first is not None  # there is always a plan
        return first, None

    def _watch(self, q: Array, crept: Array, gap: Array, warnings: list[str]) -> None:
        """Say which fingers slip, which do not touch, and which joints are at the end of their range."""
        for i, name in enumerate(self.hold.fingers):
            if crept[i] > self.settings.creep_limit:
                warnings.append(f"{name} slips: {1e3 * crept[i]:.2f} mm over the object")
            if gap[i] > self.settings.touch_gap:
                warnings.append(f"{name} does not touch: it is {1e3 * gap[i]:.2f} mm off the object")
        hand = self.hold.hand
        for j in self._loaded:
            if not hand.q_lower[j] < q[j] < hand.q_upper[j]:
                warnings.append(f"{hand.joints[j].name} is at the end of its range: {q[j]:.3f} rad")


class ObjectController:
    """Makes a held object follow a motion: call `step` once a period.

    Args:
        hold: the hand, the object, and which fingers touch it where.
        settings: gains, margins, gravity and limits.
    """

    def __init__(self, hold: Hold, settings: ControlSettings = _DEFAULTS) -> None:
        self.hold, self.settings = hold, settings
        self.reset()

    def reset(self) -> None:
        """Forget everything since the hold: integral, contacts, forces, sliding."""
        self._law = ObjectLaw(self.hold, self.settings)
        self._memory = self._law.start()

    @property
    def memory(self) -> ControlMemory:
        """What the last step left."""
        return self._memory

    def step(self, state: GraspState, desired: Desired, external: Any = None) -> Command:
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


class _Plan:
    """One way of leaving friction unused, with its own solver."""

    def __init__(self, contacts: ContactSet, margin: float, reserve: float, said: str) -> None:
        mu = contacts.mu * (1.0 - reserve)
        self.margin, self.said = margin, said
        self.shift = np.divide(margin, mu, out=np.zeros(len(mu)), where=mu > 0.0)  # N: s/μ on each normal force
        self.raised = np.zeros(contacts.size)  # N: the same where each normal force stands
        self.raised[contacts.normal_rows] = self.shift
        least, most = np.maximum(contacts.min_normal - self.shift, 0.0), contacts.max_normal - self.shift
        self.possible = bool((most >= least).all())
        self._contacts = dataclasses.replace(contacts, mu=frozen(mu), min_normal=frozen(least), max_normal=frozen(most))
        self._solver: Solver | None = None

    def solve(self, hold: Hold, settings: ControlSettings, wanted: Wanted, w: Array, tau_u: Array) -> Solution:
        """The certified answer for these numbers."""
        if self._solver is None:
            hand = hold.hand
            actuation = Actuation(wanted.J, tau_u, hand.torque_lower, hand.torque_upper, hand.torque_weight)
            problem = ForceProblem(self._contacts, w, actuation, objective=Objective("torque", settings.force_weight))
            self._solver = Solver(problem, explain=False)
        return self._solver.solve(w=w, J=wanted.J, tau_u=tau_u, p=wanted.p_OC, R=wanted.R_OC)


def _plans(contacts: ContactSet, settings: ControlSettings) -> tuple[_Plan, ...]:
    """What is tried, in order: the wanted margin, half of it, none, and friction to its end."""
    margin, reserve = settings.slip_margin, settings.friction_reserve
    wanted = [
        (margin, reserve, ""),
        (margin / 2.0, reserve, f"half of it is kept, {margin / 2.0:.3g} N"),
        (0.0, reserve, f"only the reserve of friction is kept, {100.0 * reserve:.3g} %"),
        (0.0, 0.0, "nothing is kept: the contacts are at the end of their friction"),
    ]
    plans, seen = [], set()
    for m, r, said in wanted:
        plan = _Plan(contacts, m, r, said)
        if plan.possible and (m, r) not in seen:
            plans.append(plan)
        seen.add((m, r))
    return tuple(plans)


def _reach(hand: Hand, settings: ControlSettings) -> Array:
    """(n,) the strongest pull on a joint towards its posture, rad/s²: with it the joint comes at its speed limit."""
    fastest = hand.velocity_limit  # rad/s
    return frozen(np.where(np.isfinite(fastest), settings.posture_braking * np.nan_to_num(fastest), np.inf))


def _regret(stays: Array, warnings: list[str]) -> None:
    """Say what of the error no motion of the fingers can take away."""
    off, turned = math.hypot(*stays[:3]), math.hypot(*stays[3:])  # m and rad
    if off > _FAR or turned > _TURNED:
        left = f"{1e3 * off:.2f} mm and {math.degrees(turned):.2f}° stay"
        warnings.append(f"the fingers cannot make all of this motion without slipping: {left}")


def _leaves(x: Array, low: Array, high: Array) -> bool:
    """Whether some number is not between its bounds."""
    return bool(min(((x - low) * (high - x)).tolist()) <= 0.0)


def _turned(twist: Array, R: Array) -> Array:
    """Both halves of a 6-vector, turned by R."""
    return np.asarray((twist.reshape(2, 3) @ R.T).ravel())
