"""The contact forces whose wrench is nearest to a required one, by the structured kernel.

    minimise   ½ ‖e‖² + ½ δ ‖tau‖²_W + ½ ρ ‖f‖²   over the contact forces f and the missing wrench e
    subject to G f + e = w, friction cones, and limits of normal forces and motor torques

with moments about the contacts' centroid and divided by the characteristic length. δ and ρ are small: they choose among forces
of equal distance. The kernel sees the positive and negative parts of e as forces of twelve more contacts without friction, and
e itself as the torques of six more motors.
"""

from __future__ import annotations

import numpy as np

from graspforce.contact.contact import wrench_bases
from graspforce.contact.matrices import characteristic_length
from graspforce.core.arrays import Array
from graspforce.core.errors import UnsupportedProblem
from graspforce.force.backends import compiled_kernel
from graspforce.force.backends.compiled_kernel import LARGEST_BLOCK, MAX_ITERATIONS, TOLERANCE
from graspforce.force.backends.margin_kernel import one_finger_arrays
from graspforce.force.problem import ForceProblem

_TORQUE_COST = 1e-6  # δ, 1/m²: small beside the missing wrench at levers of some centimetres
_FORCE_COST = 1e-8  # ρ
_PARTS = 12  # positive and negative components of e


class NearestKernel:
    """The kernel with arrays for one grasp, solved repeatedly with changed numbers. Use one in each thread.

    Args:
        problem: a problem with the same contacts and motors, with an actuation.

    Raises:
        UnsupportedProblem: the kernel was not built, or the contacts have too many force components.
    """

    def __init__(self, problem: ForceProblem) -> None:
        contacts, actuation = problem.contacts, problem.actuation
        assert actuation is not None  # the caller's duty
        k, N, n = problem.size, len(contacts), len(actuation.tau_u)
        if not compiled_kernel.is_available() or k + _PARTS > LARGEST_BLOCK:
            raise UnsupportedProblem(f"the kernel supports at most {LARGEST_BLOCK - _PARTS} force components")
        self._contacts, self._motors, self._warm = contacts, n, False
        self._unit = np.repeat([1.0, characteristic_length(contacts)], 3)  # of e, N and N·m per N
        components = [*(len(model.columns) for model in contacts.models), *([1] * _PARTS)]
        self._arrays = a = one_finger_arrays(components, n + 6)
        signs = np.concatenate([np.eye(6), -np.eye(6)])
        a["G"][:, k:] = (signs * self._unit).T
        a["J"][k:, n:] = signs
        a["lower"][:n], a["upper"][:n] = actuation.lower, actuation.upper
        a["lower"][n:], a["upper"][n:] = -np.inf, np.inf
        a["weight"][:n], a["weight"][n:] = _TORQUE_COST * actuation.weight, 1.0
        a["force_weight"][:] = _FORCE_COST
        a["max_normal"][N:] = np.inf
        self._kernel = compiled_kernel.Kernel(**a)

    def solve(
        self, w: Array, J: Array, tau_u: Array, p: Array, R: Array, friction: Array, normal_limits: Array
    ) -> tuple[Array, float] | None:
        """Return (k,) the forces and the distance of their wrench from w, N; None if the limits contradict each other.

        Args:
            w: (6,) wrench about O, in O, N and N·m.
            J: (k, n) contact Jacobian, m/rad.
            tau_u: (n,) motor torques without contact, N·m.
            p: (N, 3) contact positions in O, m.
            R: (N, 3, 3) contact frames in O.
            friction: (2, N) friction coefficients, zero for frictionless contacts, and torsional friction lengths, m.
            normal_limits: (2, N) smallest and largest normal forces, N.
        """
        a, n, k, N = self._arrays, self._motors, len(J), len(p)
        centre = p.mean(axis=0)  # m; moments about it have the smallest rounding
        a["G"][:, :k] = wrench_bases(p - centre, R).transpose(1, 0, 2).reshape(6, -1)[:, self._contacts.columns]
        a["J"][:k, :n] = J
        x, y, z = centre
        a["w"][:] = w
        a["w"][3:] -= (y * w[2] - z * w[1], z * w[0] - x * w[2], x * w[1] - y * w[0])
        a["tau_u"][:n] = tau_u
        a["min_normal"][:N], a["max_normal"][:N] = normal_limits
        a["mu"][:N], a["gamma"][:N] = friction
        status = self._kernel.solve(0, 1, TOLERANCE, MAX_ITERATIONS, self._warm)
        self._warm = True
        if status > 1:  # infeasible or failed
            return None
        f = a["f"][:k].copy()
        missing = (a["w"] - a["G"][:, :k] @ f) / self._unit  # N
        return f, float(np.linalg.norm(missing))
