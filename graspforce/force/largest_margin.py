"""The largest slip margin that contact forces can keep: for loads that do not allow the margin that is wanted."""

from __future__ import annotations

from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput, UnsupportedProblem
from graspforce.force.backends import registry
from graspforce.force.backends.margin_kernel import MarginKernel
from graspforce.force.problem import ForceProblem
from graspforce.force.problem_options import Objective
from graspforce.force.solver import solve
from graspforce.force.status import Status


class LargestMargin:
    """Largest slip margin of a force problem whose numbers change, up to a limit. Use one in each thread.

    The margin is the largest s with ‖f_t‖ ≤ μ f_n − s at every contact with friction, within all limits. It is the solver's
    claim, without a certificate: certify the forces that keep it, by solving the problem with that margin.

    Args:
        problem: the contacts, the motors and their limits, with exact cones. Its objective is not used.
        limit: largest margin of interest, N, > 0.
    """

    def __init__(self, problem: ForceProblem, limit: float) -> None:
        self._problem, self._limit = problem, limit
        self._kernel: MarginKernel | None = None
        if problem.actuation is not None:
            try:
                self._kernel = MarginKernel(problem, limit)
            except UnsupportedProblem:
                registry.general_backend()  # imported now, so that the first solve in a control loop is not late

    def solve(
        self, w: Array, J: Array, tau_u: Array, p: Array, R: Array, friction: Array, normal_limits: Array
    ) -> float | None:
        """Return the largest margin, N; None if no forces supply the wrench, even without a margin.

        Args:
            w: (6,) wrench about O, in O, N and N·m.
            J: (k, n) contact Jacobian, m/rad.
            tau_u: (n,) motor torques without contact, N·m.
            p: (N, 3) contact positions in O, m.
            R: (N, 3, 3) contact frames in O.
            friction: (2, N) friction coefficients and torsional friction lengths, m.
            normal_limits: (2, N) smallest and largest normal forces, N; inf for no upper limit.
        """
        if not (friction[0] > 0.0).any():
            return 0.0  # frictionless contacts have no margin
        if self._kernel is not None:
            status, margin = self._kernel.solve(w, J, tau_u, p, R, friction, normal_limits)
            if status is not Status.FAILED:
                return None if status is Status.INFEASIBLE else max(margin, 0.0)
        problem = self._problem.replace(w=w, J=J, tau_u=tau_u, mu=friction, p=p, R=R, normal_limits=normal_limits)
        try:
            problem = ForceProblem(problem.contacts, problem.w, problem.actuation, objective=Objective("margin"))
        except InvalidInput:  # no limit bounds the margin: it is the limit, or 0 if the cones have no interior
            return 0.0
        try:
            solution = solve(problem, registry.general_backend().name, explain=False)
        except InvalidInput:  # no limit bounds the margin
            return self._limit
        return min(solution.objective or 0.0, self._limit) if solution.found else None
