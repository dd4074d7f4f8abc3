"""Interior-point solvers of transcribed programs: ipopt, and fatrop, which exploits that only neighbouring knots are coupled.

Solvers are cached by the structure of their programs, so that a second move with the same fingers starts at once.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import casadi as ca
import numpy as np

from graspforce.core.arrays import Array
from graspforce.planning.nlp.iteration import OptimiserIteration
from graspforce.planning.nlp.layout import Program, ProgramStructure
from graspforce.planning.nlp.transcription import NlpFunctions, transcribe

SolverName = Literal["ipopt", "fatrop"]
IPOPT: SolverName = "ipopt"
FATROP: SolverName = "fatrop"
TOLERANCE = 1e-5  # costs about 0.05 % of the duration at 40 intervals
_CONSTRAINT_TOLERANCE = 1e-7  # of scaled equations
_MAX_ITERATIONS = 80  # typical moves take 17 to 48; some programs converge too slowly to finish
_ITERATE_TOLERANCE = 1e-5  # of scaled equations: an iterate that meets it is kept in case the solver does not converge
# The order in which solvers are tried, with the least remaining time, s. fatrop cannot be interrupted. On 21 random moves of
# shipped hands with rolling contacts ipopt solves all in 17 to 38 iterations, fatrop all except one in 18 to 48.
MIN_SECONDS: dict[SolverName, float] = {IPOPT: 0.0, FATROP: 5.0}
_EVALUATIONS = ("nlp_f", "nlp_g", "nlp_grad_f", "nlp_jac_g", "nlp_hess_l")

IterationCallback = Callable[[OptimiserIteration], bool]


@dataclass(frozen=True, eq=False, slots=True)
class OptimiserResult:
    """Unverified result of a solver.

    Args:
        x: (K + 1, size) variables at each knot.
        converged: True if the solver reports success.
        stopped: True if the callback or the time limit stopped it.
        status_text: the solver's own status.
        iterations: number of iterations.
        building_seconds: time for making the functions.
        solving_seconds: time of the solver, evaluations included.
        evaluating_seconds: time of the evaluations.
    """

    x: Array
    converged: bool
    stopped: bool
    status_text: str
    iterations: int
    building_seconds: float
    solving_seconds: float
    evaluating_seconds: float


def optimise(
    program: Program,
    x: Array,
    solver: SolverName = IPOPT,
    *,
    seconds: float = np.inf,
    callback: IterationCallback | None = None,
    tolerance: float = TOLERANCE,
) -> OptimiserResult:
    """Solve a program.

    If the solver does not converge, the result is the best iterate that meets all equations to 1e-5, or else the last one.

    Args:
        program: the program.
        x: (K + 1, size) first guess.
        solver: "ipopt" or "fatrop".
        seconds: time limit of ipopt, s; fatrop ignores it.
        callback: function called by ipopt once an iteration; it returns False to stop. An exception in it ends the search and
            is raised here.
        tolerance: of the solver, in scaled variables.
    """
    started = time.perf_counter()
    cached = _cached_solver(program.structure, solver, tolerance, program.barrier)
    built = time.perf_counter()
    functions, monitor = cached.functions, cached.monitor
    lower, upper = program.constraint_bounds(functions.steps)
    bounds = {"lbg": lower, "ubg": upper}
    bounds |= {"lbx": functions.to_solver_vector(program.lower), "ubx": functions.to_solver_vector(program.upper)}
    with cached.lock:
        monitor.begin(built + seconds, callback, lower, upper)
        found = cached.run(x0=functions.to_solver_vector(x), p=program.parameters, **bounds)
        statistics = cached.run.stats()
        stopped, raised, best = monitor.stopped, monitor.raised, monitor.best
        monitor.begin(np.inf, None, lower, upper)
    if raised is not None:
        raise raised
    success = bool(statistics["success"])
    vector = np.array(found["x"]) if success or best is None else best
    return OptimiserResult(
        x=vector.ravel()[functions.places],
        converged=success,
        stopped=stopped,
        status_text=str(statistics.get("return_status", "")),
        iterations=int(statistics.get("iter_count", 0)),
        building_seconds=built - started,
        solving_seconds=time.perf_counter() - built,
        evaluating_seconds=float(sum(statistics.get(f"t_wall_{name}", 0.0) for name in _EVALUATIONS)),
    )


class _IterationMonitor(ca.Callback):
    """CasADi callback at every iteration: stops at the deadline or on request, and keeps the best feasible iterate."""

    best: Array | None
    _g = ca.nlpsol_out().index("g")

    def __init__(self, variables: int, rows: int, parameters: int) -> None:
        ca.Callback.__init__(self)
        self._sizes = {"f": 1, "x": variables, "lam_x": variables, "g": rows, "lam_g": rows, "lam_p": parameters}
        self.begin(np.inf, None, np.zeros(rows), np.zeros(rows))
        self.construct("iteration_monitor", {})

    def begin(self, deadline: float, callback: IterationCallback | None, lower: Array, upper: Array) -> None:
        """Prepare a run: set its deadline, its callback, and the bounds of the equations."""
        self._deadline, self._callback, self._started, self._iteration = deadline, callback, time.perf_counter(), 0
        self._lower, self._upper, self._least = lower, upper, np.inf
        self.stopped, self.best = False, None
        self.raised: BaseException | None = None

    def get_n_in(self) -> int:
        """Return the number of inputs."""
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        """Return the number of outputs."""
        return 1

    def get_name_in(self, i: int) -> str:
        """Return the name of an input."""
        return str(ca.nlpsol_out(i))

    def get_name_out(self, i: int) -> str:
        """Return the name of the output."""
        return "stop"

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        """Return the pattern of an input."""
        return ca.Sparsity.dense(self._sizes[ca.nlpsol_out(i)], 1)

    def eval(self, arg: Any) -> Any:
        """Return [1] to stop the solver, [0] to continue."""
        now = time.perf_counter()
        proceed = now < self._deadline
        if proceed and self._callback is not None:
            try:
                proceed = self._callback(OptimiserIteration(self._iteration, float(arg[1]), now - self._started))
            except BaseException as error:  # CasADi would turn it into a text
                proceed, self.raised = False, error
        self._iteration += 1
        g, objective = np.array(arg[self._g]).ravel(), float(arg[1])
        if objective < self._least and max((self._lower - g).max(), (g - self._upper).max()) <= _ITERATE_TOLERANCE:
            self._least, self.best = objective, np.array(arg[0]).ravel()
        self.stopped = self.stopped or not proceed
        return [int(not proceed)]


@dataclass(frozen=True, eq=False, slots=True)
class _CachedSolver:
    """A solver for programs of one structure, used by one thread at a time."""

    run: ca.Function
    functions: NlpFunctions
    monitor: _IterationMonitor
    lock: threading.Lock


@lru_cache(maxsize=16)
def _cached_solver(structure: ProgramStructure, solver: SolverName, tolerance: float, barrier: float) -> _CachedSolver:
    """Return the solver for programs of a structure."""
    functions = transcribe(structure, staged=solver == FATROP)
    monitor = _IterationMonitor(functions.x.numel(), len(functions.equal), functions.p.numel())
    options = tolerance, barrier
    run = _fatrop(structure, functions, options) if solver == FATROP else _ipopt(functions, monitor, options)
    return _CachedSolver(run, functions, monitor, threading.Lock())


def _common_options(functions: NlpFunctions, hessian: ca.Function, gradient: ca.Function) -> dict[str, Any]:
    """Return the options of both solvers, with our derivatives in place of CasADi's."""
    x, p = functions.x, functions.p
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", len(functions.equal))
    lagrangian_gradient = functions.lagrangian_derivatives(x, p, lam_f, lam_g)[0]
    names = ["x", "p", "lam_f", "lam_g"], ["f", "g", "grad_gamma_x", "grad_gamma_p"]
    unused = ca.MX.nan(p.numel())
    values = [functions.value(x, p), functions.constraints(x, p), lagrangian_gradient, unused]
    cache = {
        "nlp_f": functions.value,
        "nlp_g": functions.constraints,
        "nlp_jac_g": functions.jacobian_values,
        "nlp_grad_f": gradient,
        "nlp_hess_l": hessian,
        "nlp_grad": ca.Function("nlp_grad", [x, p, lam_f, lam_g], values, *names),
    }
    quiet = {"calc_multipliers": False, "calc_lam_p": False, "print_time": False, "record_time": True, "error_on_fail": False}
    return {"cache": cache, **quiet}


def _ipopt(functions: NlpFunctions, monitor: _IterationMonitor, options: tuple[float, float]) -> ca.Function:
    """Return ipopt for a transcribed program, with a tolerance and a first barrier parameter."""
    tolerance, barrier = options
    x, p = functions.x, functions.p
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", len(functions.equal))
    names = ["x", "p", "lam_f", "lam_g"]
    upper = ca.triu(functions.lagrangian_derivatives(x, p, lam_f, lam_g)[1])
    hessian = ca.Function("nlp_hess_l", [x, p, lam_f, lam_g], [upper], names, ["triu_hess_gamma_x_x"])
    value_and_gradient = [functions.value(x, p), functions.gradient(x, p)]
    gradient = ca.Function("nlp_grad_f", [x, p], value_and_gradient, ["x", "p"], ["f", "grad_f_x"])
    settings = {
        "print_level": 0,
        "sb": "yes",
        "tol": tolerance,
        "constr_viol_tol": _CONSTRAINT_TOLERANCE,
        "max_iter": _MAX_ITERATIONS,
        "linear_solver": "mumps",
        "mumps_pivot_order": 6,  # quasi-dense minimum degree: faster than the default for rolling contacts
        "mumps_scaling": 0,  # the program is scaled already
        "mumps_mem_percent": 20,  # the default makes mumps allocate memory at every factorisation
        "min_refinement_steps": 0,  # refine steps only if their residuals require it
        "perturb_dec_fact": 0.1,  # the first weight against negative curvature is too large; reduce it quickly
        "mu_init": barrier,
        **dict.fromkeys(("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac"), barrier),
    }
    given = {**_common_options(functions, hessian, gradient), "iteration_callback": monitor, "ipopt": settings}
    return ca.nlpsol("ipopt", "ipopt", functions.nlp, given)


def _fatrop(structure: ProgramStructure, functions: NlpFunctions, options: tuple[float, float]) -> ca.Function:
    """Return fatrop for a program that was transcribed in the staged form, with a tolerance and a first barrier parameter."""
    tolerance, barrier = options
    layout, K = structure.layout, structure.intervals
    shape = {
        "structure_detection": "manual",
        "N": K,
        "nx": [layout.states] * (K + 1),
        "nu": [layout.algebraic + len(layout.next_values)] * K + [layout.algebraic],
        "ng": list(functions.rows),
        "equality": list(functions.equal),
    }
    settings = {"print_level": 0, "tol": tolerance, "max_iter": _MAX_ITERATIONS, "mu_init": barrier}
    given = {**_common_options(functions, functions.lagrangian_derivatives, functions.gradient), **shape, "fatrop": settings}
    return ca.nlpsol("fatrop", "fatrop", functions.nlp, given)
