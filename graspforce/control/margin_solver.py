"""Force problems of the controller: one solver for each slip margin that it tries.

A slip margin s is exact: the shift f_n' = f_n − s/μ turns ‖f_t‖ ≤ μ f_n − s into the usual cone ‖f_t‖ ≤ μ f_n', with
w' = w − G n s/μ and tau_u' = tau_u + Jᵀ n s/μ. So the usual solver finds and certifies the forces of least torque.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from graspforce.control.settings import ControlSettings
from graspforce.control.step_data import StepTargets
from graspforce.core.arrays import Array, freeze
from graspforce.force.problem import ForceProblem
from graspforce.force.problem_options import Objective
from graspforce.force.solution import Solution
from graspforce.force.solver import Solver
from graspforce.grasp.grasp import Grasp
from graspforce.hand.actuation import Actuation


class MarginSolver:
    """Force solver for one slip margin and one friction reserve.

    Args:
        grasp: hand, object and contacts.
        settings: settings of the controller; margin and reserve are replaced by the next two.
        margin: slip margin s, N.
        reserve: fraction of μ that the forces leave unused.
        warning: text for the command if the controller falls back to this solver; empty for none.

    Attributes:
        is_feasible: whether the limits of the normal forces leave room for the margin.
    """

    def __init__(self, grasp: Grasp, settings: ControlSettings, margin: float, reserve: float, warning: str = "") -> None:
        contacts = grasp.contacts
        mu = contacts.mu * (1.0 - reserve)
        self.margin, self.warning = margin, warning
        self._shift = np.divide(margin, mu, out=np.zeros(len(mu)), where=mu > 0.0)  # N: s/μ of each normal force
        self._force_offset = np.zeros(contacts.size)  # N: the shift in the rows of f
        self._force_offset[contacts.normal_rows] = self._shift
        lower, upper = np.maximum(contacts.min_normal - self._shift, 0.0), contacts.max_normal - self._shift
        self.is_feasible = bool((upper >= lower).all())
        self._contacts = dataclasses.replace(contacts, mu=freeze(mu), min_normal=freeze(lower), max_normal=freeze(upper))
        self._hand, self._force_weight = grasp.hand, settings.force_weight
        self._solver: Solver | None = None

    def solve(self, targets: StepTargets, tau_u: Array) -> tuple[Solution, Array | None]:
        """Return the certified solution of the shifted problem, and the contact forces (k,) in N and N·m.

        The forces are None if there is no certified solution.

        Args:
            targets: targets of this step.
            tau_u: (n,) torques without contact forces, N·m.
        """
        w, tau_u = targets.apply_slip_margin(tau_u, self._shift) if self.margin > 0.0 else (targets.w, tau_u)
        if self._solver is None:
            hand = self._hand
            actuation = Actuation(targets.J, tau_u, hand.torque_lower, hand.torque_upper, hand.torque_weight)
            problem = ForceProblem(self._contacts, w, actuation, objective=Objective("torque", self._force_weight))
            self._solver = Solver(problem, explain=False)
        solution = self._solver.solve(w=w, J=targets.J, tau_u=tau_u, p=targets.p_OC, R=targets.R_OC)
        if not solution.found:
            return solution, None
        f = solution.f + self._force_offset
        f.setflags(write=False)  # the command and the next memory share it
        return solution, f


def make_margin_solvers(grasp: Grasp, settings: ControlSettings) -> tuple[MarginSolver, ...]:
    """Return the solvers in the order in which the controller tries them.

    They keep the whole margin, half of it, none of it, and last not even the friction reserve.

    Args:
        grasp: hand, object and contacts.
        settings: settings of the controller.
    """
    margin, reserve = settings.slip_margin, settings.friction_reserve
    levels = [
        (margin, reserve, ""),
        (margin / 2.0, reserve, f"half of it is kept, {margin / 2.0:.3g} N"),
        (0.0, reserve, f"only the friction reserve is kept, {100.0 * reserve:.3g} %"),
        (0.0, 0.0, "none of it is kept; the forces use all the friction"),
    ]
    solvers, seen = [], set()
    for level_margin, level_reserve, kept in levels:
        warning = kept and f"the full slip margin is infeasible: {kept}"
        solver = MarginSolver(grasp, settings, level_margin, level_reserve, warning)
        if solver.is_feasible and (level_margin, level_reserve) not in seen:
            solvers.append(solver)
        seen.add((level_margin, level_reserve))
    return tuple(solvers)
