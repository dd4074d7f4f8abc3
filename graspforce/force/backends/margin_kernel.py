"""The largest slip margin that a load allows, by the structured kernel.

    maximise   s                                over the contact forces f and 0 ≤ s ≤ limit
    subject to G f = w                          equilibrium
               ‖f_t‖ ≤ μ f_n − s                at every contact with friction; soft contacts count their moment
               min ≤ f_n ≤ max                  normal forces
               lower ≤ tau_u + Jᵀ f ≤ upper     motor torques

With f_n = f_n' + s/μ, f' is in the usual cones. The kernel sees s as the force of one more contact without friction, whose
wrench is G n/μ and whose torques are Jᵀ n/μ. The limits of the normal forces are those of one more motor for each contact.
To give the problem the unit of the limit on s, that contact has the force s + limit.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from graspforce.contact.contact import wrench_bases
from graspforce.core.arrays import Array
from graspforce.core.errors import UnsupportedProblem
from graspforce.force.backends import compiled_kernel
from graspforce.force.backends.compiled_kernel import LARGEST_BLOCK, MAX_ITERATIONS, TOLERANCE
from graspforce.force.problem import ForceProblem
from graspforce.force.status import Status

_STATUS = (Status.OPTIMAL, Status.INACCURATE, Status.INFEASIBLE, Status.FAILED)


class MarginKernel:
    """The kernel with arrays for one grasp, solved repeatedly with changed numbers. Use one in each thread.

    Args:
        problem: a problem with the same contacts and motors, with an actuation.
        limit: largest margin that is looked for, N, > 0.

    Raises:
        UnsupportedProblem: the kernel was not built, or the contacts have too many force components.
    """

    def __init__(self, problem: ForceProblem, limit: float) -> None:
        contacts, actuation = problem.contacts, problem.actuation
        assert actuation is not None  # the caller's duty
        k, N, n = problem.size, len(contacts), len(actuation.tau_u)
        if not compiled_kernel.is_available() or k + 1 > LARGEST_BLOCK:
            raise UnsupportedProblem(f"the kernel supports at most {LARGEST_BLOCK - 1} force components")
        self._contacts, self._limit, self._warm = contacts, limit, False
        self._normal_rows, self._motors = contacts.normal_rows, n
        self._arrays = one_finger_arrays([*(len(model.columns) for model in contacts.models), 1], n + N)
        a = self._arrays
        a["lower"][:n], a["upper"][:n] = actuation.lower, actuation.upper
        a["J"][self._normal_rows, n + np.arange(N)] = 1.0
        a["min_normal"][N], a["max_normal"][N], a["cost"][k] = limit, 2.0 * limit, -1.0
        self._kernel = compiled_kernel.Kernel(**a)

    def solve(
        self, w: Array, J: Array, tau_u: Array, p: Array, R: Array, friction: Array, normal_limits: Array
    ) -> tuple[Status, float]:
        """Return the status and the largest margin, N. The numbers are not checked.

        Args:
            w: (6,) wrench about O, in O, N and N·m.
            J: (k, n) contact Jacobian, m/rad.
            tau_u: (n,) motor torques without contact, N·m.
            p: (N, 3) contact positions in O, m.
            R: (N, 3, 3) contact frames in O.
            friction: (2, N) friction coefficients, zero for frictionless contacts, and torsional friction lengths, m.
            normal_limits: (2, N) smallest and largest normal forces, N.
        """
        a, n, k, N, mu = self._arrays, self._motors, len(J), len(p), friction[0]
        centre = p.mean(axis=0)  # m; moments about it have the smallest rounding
        G = a["G"]
        G[:, :k] = wrench_bases(p - centre, R).transpose(1, 0, 2).reshape(6, -1)[:, self._contacts.columns]
        share = np.divide(1.0, mu, out=np.zeros(N), where=mu > 0.0)  # N of normal force per N of margin
        G[:, k] = G[:, self._normal_rows] @ share
        a["J"][:k, :n], a["J"][k, n:] = J, share
        a["J"][k, :n] = share @ J[self._normal_rows]
        a["w"][:] = w + self._limit * G[:, k]
        x, y, z = centre
        a["w"][3:] -= (y * w[2] - z * w[1], z * w[0] - x * w[2], x * w[1] - y * w[0])
        a["tau_u"][:n], a["tau_u"][n:] = tau_u, 0.0
        a["tau_u"] -= self._limit * a["J"][k]
        a["lower"][n:] = np.where(normal_limits[0] > 0.0, normal_limits[0], -np.inf)  # f_n' ≥ 0 is a cone's own limit
        a["upper"][n:] = normal_limits[1]
        a["max_normal"][:N] = np.where(normal_limits[1] > 0.0, np.inf, 0.0)  # the kernel leaves such contacts out
        a["mu"][:N], a["gamma"][:N] = friction
        status = _STATUS[self._kernel.solve(0, 1, TOLERANCE, MAX_ITERATIONS, self._warm)]
        self._warm = True
        return status, float(a["f"][k]) - self._limit


def one_finger_arrays(components: Sequence[int], motors: int) -> dict[str, Any]:
    """Return zero arrays of a `Kernel` for contacts and motors as one finger, without limits of the normal forces.

    Args:
        components: force components of each contact.
        motors: number of motors.
    """
    N, k = len(components), sum(components)
    sizes = {"w": 6, "mu": N, "gamma": N, "min_normal": N, "max_normal": N, "tau_u": motors, "lower": motors, "upper": motors}
    sizes |= {"weight": motors, "cost": k, "force_weight": 1, "force_unit": 1, "length_unit": 1, "cost_unit": 1}
    sizes |= {"torque_unit": motors, "f": k, "y": 6, "z": k, "nu_lower": N, "nu_upper": N}
    sizes |= {"lambda_lower": motors, "lambda_upper": motors, "tau": motors}
    arrays = {name: np.zeros(size) for name, size in sizes.items()}
    arrays["max_normal"][:] = np.inf
    return {
        **arrays,
        "components": np.array(components, dtype=np.intc),
        "contact_block": np.zeros(N, dtype=np.intc),
        "joint_block": np.zeros(motors, dtype=np.intc),
        "facet_contact": np.zeros(0, dtype=np.intc),
        "facet": np.zeros((0, 4)),
        "p": None,
        "R": None,
        "G": np.zeros((6, k)),
        "J": np.zeros((k, motors)),
        "report": np.zeros(1, dtype=compiled_kernel.report_type),
    }
