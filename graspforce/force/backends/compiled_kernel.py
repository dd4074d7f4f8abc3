"""The compiled kernel: its availability, its inputs from a force problem, and stacks of problems.

Without a C compiler at installation the compiled module is missing, and `Kernel` is None.
"""

from __future__ import annotations

import contextlib
import importlib
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from graspforce.contact import friction
from graspforce.contact.contact import ContactModel
from graspforce.core.arrays import Array
from graspforce.core.errors import BackendError, UnsupportedProblem
from graspforce.force.multipliers import Multipliers
from graspforce.force.problem import ForceProblem

Kernel: Any = None
IncrementalKernel: Any = None
find_fingers: Any = None
make_record: Any = None
shift_problem: Any = None
check_shifted: Any = None
report_type: Any = None  # type of a Kernel's reports
with contextlib.suppress(ImportError):  # not built: no C compiler
    _structured = importlib.import_module("graspforce.force.backends._structured")
    Kernel, IncrementalKernel = _structured.Kernel, _structured.IncrementalKernel
    find_fingers, make_record = _structured.find_fingers, _structured.make_record
    shift_problem, check_shifted = _structured.shift_problem, _structured.check_shifted
    report_type = np.dtype(list(_structured.report_fields))

TOLERANCE = 1e-9  # on scaled residuals: a tenth of the certificate's tolerance
MAX_ITERATIONS = 60
SHORT_STEP_REDUCTION = 1e-24  # of all residuals and the mean complementarity, after which short steps end
LARGEST_BLOCK = 48  # force components that share joints in a control step; larger dense blocks are slower than a sparse solver
# the arrays that a step of `IncrementalKernel` can change
CHANGEABLE = ("w", "J", "tau_u", "p", "R", "mu", "min_normal", "max_normal", "gamma")
NOT_BUILT = "graspforce was installed without a C compiler"

_INPUT_NAMES = (*CHANGEABLE, "lower", "upper", "weight", "facet", "cost")
_STACKED_NAMES = {"torque_lower": "lower", "torque_upper": "upper"}  # names of data in the kernel
_LEVELS = {"max_normal": 1, "margin": 2}  # gf_level of an objective; 0 for all others
_COMPONENTS = {model: len(model.columns) for model in ContactModel}
_EMPTY = np.zeros(0)
_NO_FACETS = (np.zeros((0, 4)), np.zeros(0, dtype=np.intc))

Indices = npt.NDArray[np.intc]


def is_available() -> bool:
    """Return whether the kernel was built when graspforce was installed."""
    return Kernel is not None


class StackedKernel:
    """A kernel bound to M problems that differ in some arrays, and to their solutions.

    Args:
        problem: the common values, with exact cones.
        rows: stacked arrays by name, as in `graspforce.force.problem_data`.

    Raises:
        UnsupportedProblem: the objective is max_normal or margin.
        BackendError: the kernel was not built.
    """

    def __init__(self, problem: ForceProblem, rows: Mapping[str, Array]) -> None:
        self._count = len(next(iter(rows.values())))
        self._problem = problem
        stacked = {_STACKED_NAMES.get(name, name): np.ascontiguousarray(row) for name, row in rows.items()}
        self._arrays = {**kernel_arrays(problem, self._count), **stacked}
        self._kernel = Kernel(**self._arrays)

    def solve(self) -> None:
        """Solve and certify all problems."""
        self._kernel.solve(0, self._count, TOLERANCE, MAX_ITERATIONS, False)
        self._kernel.certify(0, self._count)

    def solutions(self) -> tuple[Array, Array, Array, npt.NDArray[np.bool_]]:
        """Return (M, k) forces, (M, n) torques, (M, 3) certified residuals, and (M,) which solutions may be optimal."""
        report = self._arrays["report"]
        residuals = np.column_stack([report[name] for name in ("certified_primal", "certified_dual", "certified_gap")])
        return self._arrays["f"], self._arrays["tau"], residuals, report["status"] <= 1

    def store(self, i: int, f: Array, multipliers: Multipliers) -> None:
        """Replace the solution of problem i.

        Args:
            i: index of the problem.
            f: (k,) forces, N and N·m.
            multipliers: multipliers about the centroid of the problem's contacts.
        """
        m = multipliers
        values = {"f": f, "y": m.y, "nu_lower": m.normal_lower, "nu_upper": m.normal_upper}
        for name, value in {**values, "lambda_lower": m.torque_lower, "lambda_upper": m.torque_upper}.items():
            self._arrays[name][i] = value

    def adjoint(self, seeds: Mapping[str, Array]) -> tuple[dict[str, Array], Indices]:
        """Return gradients of a function of the solutions by name of the data, and (M, 2) the outcomes and their indices.

        Args:
            seeds: derivatives of the function with respect to "f" (M, k), "tau" (M, n) and "objective" (M,).
        """
        k, N, n = self._problem.size, len(self._problem.contacts), joint_count(self._problem)
        shapes = {"w": (6,), "mu": (N,), "p": (N, 3), "rotation": (N, 3)}
        shapes |= {"tau_u": (n,), "torque_lower": (n,), "torque_upper": (n,), "J": (k, n)}
        gradients = {name: np.empty((self._count, *shape)) for name, shape in shapes.items()}
        outcomes = np.zeros((self._count, 2), dtype=np.intc)
        given = (np.ascontiguousarray(seeds[name]) for name in ("f", "tau", "objective"))
        self._kernel.adjoint(0, self._count, *given, *gradients.values(), outcomes)
        return gradients, outcomes


def kernel_arrays(problem: ForceProblem, count: int = 1) -> dict[str, Any]:
    """Return the arguments of a `Kernel` for a problem, with buffers for the results.

    Args:
        problem: the force problem.
        count: number of results.

    Raises:
        UnsupportedProblem: the objective is max_normal or margin.
        BackendError: the kernel was not built.
    """
    check_available()
    if level_of(problem):
        raise UnsupportedProblem(
            f"stacked problems have no objective {problem.objective.type}: their certificates in C lack it"
        )
    facets, owners = facet_rows(problem)
    *numbers, force_weight, moment_length = kernel_inputs(problem, facets)
    arrays = {name: None if x is None else np.ascontiguousarray(x) for name, x in zip(_INPUT_NAMES, numbers, strict=True)}
    n = joint_count(problem)
    if problem.actuation is None:
        arrays.update(J=np.zeros((problem.size, 0)), tau_u=_EMPTY, lower=_EMPTY, upper=_EMPTY)
    if arrays["weight"] is None:
        arrays["weight"] = np.zeros(n)
    components = np.array([_COMPONENTS[model] for model in problem.contacts.models], dtype=np.intc)
    contact_block, joint_block = np.zeros(len(components), dtype=np.intc), np.zeros(n, dtype=np.intc)
    find_fingers(components, arrays["J"], contact_block, joint_block)
    structure = {"components": components, "contact_block": contact_block, "joint_block": joint_block}
    k, N = problem.size, len(components)
    units = {"force_unit": 1, "length_unit": 1, "cost_unit": 1, "torque_unit": n}
    limits = {"nu_lower": N, "nu_upper": N, "lambda_lower": n, "lambda_upper": n}
    outputs = {**units, "f": k, "y": 6, "z": k, **limits, "tau": n}
    return {
        **structure,
        **arrays,
        **{name: np.zeros((count, width)) for name, width in outputs.items()},
        "report": np.zeros(count, dtype=report_type),
        "G": None,
        "facet_contact": owners,
        "force_weight": np.array([force_weight]),
        "moment_length": moment_length,
    }


def level_of(problem: ForceProblem) -> int:
    """Return the kind of the variable that all contacts share in the kernel: a ``gf_level``.

    Args:
        problem: the force problem.
    """
    return _LEVELS.get(problem.objective.type, 0)


def check_available() -> None:
    """Raise an error if the kernel is missing.

    Raises:
        BackendError: the kernel was not built.
    """
    if Kernel is None:
        raise BackendError(f"structured is not available: {NOT_BUILT}")


def kernel_inputs(problem: ForceProblem, facets: Array | None = None) -> tuple[Any, ...]:
    """Return the inputs of `IncrementalKernel` in the order of `_INPUT_NAMES`, then ρ of ½ρ‖f‖² and its moment length.

    Args:
        problem: the force problem.
        facets: rows of `facet_rows` for pyramids; None for exact cones.
    """
    contacts, actuation, objective = problem.contacts, problem.actuation, problem.objective
    J = tau_u = lower = upper = weight = cost = None
    force_weight = float(objective.type == "force")
    if actuation is not None:
        J, tau_u, lower, upper = actuation.J, actuation.tau_u, actuation.lower, actuation.upper
    if objective.type == "torque":
        assert actuation is not None  # validated by ForceProblem
        weight, force_weight = actuation.weight, objective.force_weight
    if objective.type == "sum_normal":
        cost = np.zeros(problem.size)
        cost[contacts.normal_rows] = 1.0
    limits = contacts.mu, contacts.min_normal, contacts.max_normal, contacts.gamma
    return (
        problem.w,
        J,
        tau_u,
        contacts.p_OC,
        contacts.R_OC,
        *limits,
        lower,
        upper,
        weight,
        facets,
        cost,
        force_weight,
        objective.moment_length,
    )


def joint_count(problem: ForceProblem) -> int:
    """Return n, the number of motors.

    Args:
        problem: the force problem.
    """
    return 0 if problem.actuation is None else problem.actuation.J.shape[1]


def facet_rows(problem: ForceProblem) -> tuple[Array, Indices]:
    """Return the rows aᵀ(f_t1, f_t2, f_n, m_n) ≤ 0 of all pyramids, and the contact of each; none for exact cones.

    Args:
        problem: the force problem.
    """
    contacts, cone = problem.contacts, problem.cone
    if cone.type == "exact":
        return _NO_FACETS
    rows, owners = [_NO_FACETS[0]], [_NO_FACETS[1]]
    mu = friction.pyramid_friction(contacts.mu, cone.facets, cone.side)
    for i in np.flatnonzero(contacts.mu > 0):
        gamma = float(contacts.gamma[i])
        a = friction.pyramid_facets(cone.facets, cone.side, gamma)
        with np.errstate(over="ignore", invalid="ignore"):  # the kernel rejects values that overflow
            moment = a[:, 2] * (mu[i] / gamma if gamma else 0.0)
        rows.append(np.column_stack([a[:, 0], a[:, 1], np.full(len(a), -mu[i]), moment]))
        owners.append(np.full(len(a), i, dtype=np.intc))
    return np.vstack(rows), np.concatenate(owners)
