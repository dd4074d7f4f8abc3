"""The contact forces whose wrench is nearest to a required one: for wrenches that no contact forces supply."""

from __future__ import annotations

import numpy as np

from graspforce.contact.matrices import characteristic_length
from graspforce.core.arrays import Array
from graspforce.core.errors import UnsupportedProblem
from graspforce.force.backends import registry
from graspforce.force.backends.nearest_kernel import NearestKernel
from graspforce.force.infeasibility import nearest_forces
from graspforce.force.problem import ForceProblem


class NearestForces:
    """Forces nearest to the wrench of a force problem whose numbers change. Use one in each thread.

    The forces are in their friction cones and within all limits, and their wrench has the least distance from w, with moments
    about the contacts' centroid and divided by the characteristic length. They have no certificate.

    Args:
        problem: the contacts, the motors and their limits, with exact cones. Its objective is not used.
    """

    def __init__(self, problem: ForceProblem) -> None:
        self._problem = problem
        self._kernel: NearestKernel | None = None
        if problem.actuation is not None:
            try:
                self._kernel = NearestKernel(problem)
            except UnsupportedProblem:
                registry.general_backend()  # imported now, so that the first solve in a control loop is not late

    def solve(
        self, w: Array, J: Array, tau_u: Array, p: Array, R: Array, friction: Array, normal_limits: Array
    ) -> tuple[Array, float] | None:
        """Return (k,) the forces, N and N·m, and the distance of their wrench from w, N; None if no forces are allowed.

        Args:
            w: (6,) wrench about O, in O, N and N·m.
            J: (k, n) contact Jacobian, m/rad.
            tau_u: (n,) motor torques without contact, N·m.
            p: (N, 3) contact positions in O, m.
            R: (N, 3, 3) contact frames in O.
            friction: (2, N) friction coefficients and torsional friction lengths, m.
            normal_limits: (2, N) smallest and largest normal forces, N; inf for no upper limit.
        """
        if self._kernel is not None:
            found = self._kernel.solve(w, J, tau_u, p, R, friction, normal_limits)
            if found is not None:
                return found
        problem = self._problem.replace(w=w, J=J, tau_u=tau_u, mu=friction, p=p, R=R, normal_limits=normal_limits)
        f = nearest_forces(problem, registry.general_backend().solve_program)
        if f is None:
            return None
        missing = problem.w_centred - problem.G_centred @ f
        missing[3:] /= characteristic_length(problem.contacts)
        return f, float(np.linalg.norm(missing))
