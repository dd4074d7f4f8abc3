"""Control law whose usual steps are one call of C (`csrc/include/graspforce/controller.h`).

A step is usual if its forces keep the slip margin of the settings, if every twist of the object is feasible, if no contact is
changing, and if the conditions of the contacts do not affect the forces. All other steps, and hands, contacts and settings that
the C code does not support, are those of `ObjectControlLaw`, the reference implementation. The results are equal to the
accuracy of the force solver.

A control loop waits between its steps, and the caches of the processor get cold. One call of C then needs far less memory and
time than the many calls of a step in Python.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import numpy.typing as npt

from graspforce.control.command import Command, CommandSource, make_lazy_command
from graspforce.control.compiled_step import CompiledTargets
from graspforce.control.contacts.contact_conditions import ContactConditions
from graspforce.control.forces.margin_solver import MarginSolver
from graspforce.control.memory import ControlMemory
from graspforce.control.object_control_law import ObjectControlLaw
from graspforce.control.pose_error import limit_integral
from graspforce.control.settings import ControlSettings
from graspforce.control.state import DesiredMotion, GraspState, check_joint_count, object_motion
from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.compiled import Block, new_block, whole_step
from graspforce.force.backends.compiled_kernel import make_record
from graspforce.force.backends.registry import preferred_backend
from graspforce.force.certificate import Certificate
from graspforce.force.multipliers import Multipliers
from graspforce.force.problem import ForceProblem
from graspforce.force.solution import LazySolution
from graspforce.grasp.grasp import Grasp
from graspforce.hand.hand import Hand

_BACKEND = "structured"  # solver of the C code
_PAUSE = 10  # steps of the reference after one that was not usual, because such steps follow each other
_NO_TIPS = (None, None, None)  # before the first step
_SOLUTION_FIELDS = ("backend", "iterations", "seconds", "data")


class CompiledControlLaw(ObjectControlLaw):
    """Control law of one grasp, as `ObjectControlLaw`. Its usual steps are one call of C.

    Args:
        grasp: hand, object and contacts.
        settings: gains, margins, gravity and limits.
    """

    def __init__(self, grasp: Grasp, settings: ControlSettings) -> None:
        super().__init__(grasp, settings)
        self._whole_step: Any = None
        self._pause, self._is_warm = 0, False  # steps until the C code is tried again; whether its solver has a start
        self._forces_dtype = np.dtype(np.void)
        if self._is_supported:
            self._whole_step = _make_whole_step(self)
            self._forces_dtype = np.dtype(self._whole_step.forces_layout)

    @property
    def _is_supported(self) -> bool:
        """Whether the C code computes usual steps of this grasp with these settings."""
        if whole_step is None or self._compiled is None or preferred_backend().name != _BACKEND:
            return False
        has_estimates = self._friction is not None or self._constraints.is_tracking_spin
        return not has_estimates and self.force_solver.has_plain_problem

    def step(
        self,
        memory: ControlMemory,
        state: GraspState,
        desired: DesiredMotion,
        external: npt.ArrayLike | None = None,
        conditions: ContactConditions | None = None,
    ) -> tuple[Command, ControlMemory]:
        """Compute the command for the next period, and the memory for the next step, as `ObjectControlLaw.step`."""
        self._pause = max(self._pause - 1, 0)
        is_plain = conditions is None or not conditions.affects_forces
        if self._whole_step is not None and is_plain and self._pause == 0 and _is_usual(memory):
            if conditions is not None:
                conditions.check(self.grasp)
            found = self._take_whole_step(memory, state, desired, external, conditions)
            if found is None:
                self._pause = _PAUSE
            elif self._is_warm:
                return found
            else:
                self._is_warm = True  # the first step starts both solvers, and is that of the reference
        return super().step(memory, state, desired, external, conditions)

    def usual_step(self, memory: ControlMemory) -> Any:
        """Return the `WholeStep` in C if the next step may be usual; None if it is that of the reference.

        Args:
            memory: memory after the last step.
        """
        # `step` counts the pause down before it looks at it.
        is_ready = self._is_warm and self._pause <= 1 and not self._learning.is_active and _is_usual(memory)
        return self._whole_step if is_ready else None

    def _take_whole_step(
        self,
        memory: ControlMemory,
        state: GraspState,
        desired: DesiredMotion,
        external: npt.ArrayLike | None,
        conditions: ContactConditions | None = None,
    ) -> tuple[Command, ControlMemory] | None:
        """Return command and memory of a step in C; None if it finds no certified forces with the full margin."""
        compiled, tips, measured, told = self._compiled, memory.tip_contacts, state.object, desired
        if compiled is None:
            return None
        check_joint_count(self.grasp.hand, state.q, desired)
        if memory.torque_factors is not None:
            desired = memory.torque_factors.shift(desired, self.grasp.q)
        body = object_motion(desired)
        if external is not None:
            external = arrays.check_array(external, "external", (6,))
        blocks = compiled.new_targets(), new_block(self._forces_dtype), compiled.new_result()
        start = time.perf_counter()
        made = self._whole_step.step(
            *(state.q, state.v, measured.p_HO, measured.R_HO, measured.twist),
            *(body.p_HO, body.R_HO, body.twist, body.acceleration),
            *(memory.integral, memory.R_OC, memory.creep),
            *(_NO_TIPS if tips is None else (tips.p_OF, tips.R_OF, tips.p_OC)),
            *(*compiled.desired_joints(desired), external),
            *blocks,
        )
        if made is None:
            return None
        seconds = time.perf_counter() - start  # of the whole step
        for block in blocks:
            block.setflags(write=False)  # commands and memories share their arrays
        (flags, iterations), forces = made, blocks[1]
        targets, result, f = CompiledTargets(compiled, blocks[0], True), compiled.read_result(blocks[2], flags), forces["f"]
        warnings: tuple[str, ...] = ()
        if result.has_warnings or (conditions is not None and conditions.has_evidence):
            warnings = self.warnings.of_step(result.creep_distance, targets.rolling.gap, state.q, conditions)
        integral, factors, sensitivity = result.integral, None, None
        if self._learning.is_active:
            inputs = memory.torque_factors, self.grasp, state, told, targets, result
            factors, integral, sensitivity = self._learning.step(*inputs)
            integral = limit_integral(integral, self._gains[2], self._integral_limits)
        data = StepForces(self.force_solver, targets, forces)
        solution = make_record(LazySolution, _SOLUTION_FIELDS, _BACKEND, iterations, seconds, data)
        own = self.grasp, self._constraints, targets, state, body.twist, self._drives, forces["own"], self._clearance
        command = make_lazy_command(CommandSource(*own, sensitivity), result, solution, f, warnings, False)
        parts = integral, targets.R_OC, result.creep, f, targets.tip_contacts
        return command, ControlMemory(*parts, torque_factors=factors)


class StepForces:
    """The force problem of a step in C and its certified optimum, decoded on demand; see `SolutionData`.

    Args:
        solver: solver of the reference implementation, which makes the problem.
        targets: targets of the step.
        block: forces, multipliers and residuals as the C code wrote them.
    """

    __slots__ = ("_block", "_solver", "_targets")

    def __init__(self, solver: MarginSolver, targets: CompiledTargets, block: Block) -> None:
        self._solver, self._targets, self._block = solver, targets, block

    def problem(self) -> ForceProblem:
        """Return the problem whose cones keep the slip margin."""
        return self._solver.full_problem(self._targets, self._block["tau_u"])

    def forces(self) -> Array:
        """Return (k,) the contact forces of this problem, without the shift of the slip margin, N and N·m."""
        return arrays.freeze(self._block["f"] - self._solver.full_force_offset)

    def torques(self) -> Array:
        """Return (n,) the motor torques of this problem, N·m."""
        return np.asarray(self._block["tau"])

    def multipliers(self) -> Multipliers:
        """Return the multipliers of the optimum."""
        block, contacts = self._block, self.problem().contacts
        limits = block["nu_lower"], block["nu_upper"], block["lambda_lower"], block["lambda_upper"]
        return Multipliers(block["y"], *limits, arrays.freeze(np.zeros(len(contacts))), contacts.centroid)

    def certificate(self) -> Certificate:
        """Return the certificate that was computed in C."""
        return Certificate.from_residuals(*self._block["residuals"].tolist())


def _is_usual(memory: ControlMemory) -> bool:
    """Return whether a step after this memory may be usual: there is neither reflex, nor stop, nor change of contacts."""
    return memory.reflex is None and memory.ramp is None and memory.margin is None and memory.stop is None


def _make_whole_step(law: CompiledControlLaw) -> Any:
    """Return the step in C of a law that it supports."""
    grasp, solver, compiled = law.grasp, law.force_solver, law._compiled
    hand, limits = grasp.hand, solver.limits[0]
    assert compiled is not None  # checked by `_is_supported`
    components = np.bincount(grasp.contacts.columns // 4).astype(np.intc)
    numbers = hand.T, hand.q0, hand.rotor_inertia, hand.force_weight, law.free_torque_limits
    return whole_step.WholeStep(
        *(compiled.step, components, solver.margin, law.settings.force_weight, _link_rows(hand)),
        *(np.array(each, dtype=float) for each in (*numbers, *limits.friction, limits.normal)),
    )


def _link_rows(hand: Hand) -> Array:
    """Return the links of a hand as rows of numbers, (n_full, 30), as `WholeStep` in C takes them."""
    fields = ("parent", "is_prismatic", "p_PL", "R_PL", "axis", "mass", "p_LM", "inertia")
    links = hand.model.tree(()).links
    return np.array([np.hstack([np.ravel(getattr(link, name)) for name in fields]) for link in links], dtype=float)
