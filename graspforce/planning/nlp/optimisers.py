"""Two interior point methods for a transcribed program: ipopt, and fatrop, which knows that knots are coupled in a row.

Solvers are kept by the structure of what they solve, so that a second move with the same fingers starts at once.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from graspforce.core.arrays import Array
from graspforce.planning.nlp.transcription import NlpFunctions, Program, ProgramStructure, transcribe

IPOPT, FATROP = "ipopt", "fatrop"
TOLERANCE = 1e-5  # costs about 0.05 % of the duration at 40 intervals; a tenth of it doubles the iterations and gains that
_CONSTRAINT_TOLERANCE = 1e-7  # of scaled equations: a nanometre of closure
_ITERATIONS = 80  # of 17 to 48 that a move takes; where contacts roll on wide faces some moves get faster for ever
_ITERATE_TOLERANCE = 1e-5  # of scaled equations: an iterate that is worth keeping when the solver does not end
_BARRIER = 0.1  # the first barrier parameter; ipopt begins as far inside the bounds, where guesses use them to the full
# Which is tried first, and with how much time left at least: fatrop does not look at the clock. On 21 random moves of shipped
# hands with contacts that roll ipopt finds all in 17 to 38 iterations, fatrop all but one in 18 to 48 that take twice as long.
MIN_SECONDS = {IPOPT: 0.0, FATROP: 5.0}
_EVALUATIONS = ("nlp_f", "nlp_g", "nlp_grad_f", "nlp_jac_g", "nlp_hess_l")


@dataclass(frozen=True, slots=True)
class OptimiserIteration:
    """How far a solver is.

    Args:
        number: from 0.
        objective: the duration over the guess's, about.
        seconds: since it began.
    """

    number: int
    objective: float
    seconds: float


@dataclass(frozen=True, eq=False, slots=True)
class OptimiserResult:
    """What a solver says; nothing here is to be trusted.

    Args:
        x: (K + 1, size) the variables at each knot.
        converged: whether the solver thinks so.
        stopped: whether it was told to stop.
        said: its own word.
        iterations: how many.
        building, solving, evaluating: seconds for the functions; for the solver, evaluations and all; for evaluations alone.
    """

    x: Array
    converged: bool
    stopped: bool
    said: str
    iterations: int
    building: float
    solving: float
    evaluating: float


def optimise(
    program: Program,
    x: Array,
    solver: str = IPOPT,
    *,
    seconds: float = np.inf,
    callback: Callable[[OptimiserIteration], bool] | None = None,
    tolerance: float = TOLERANCE,
) -> OptimiserResult:
    """Solve a program.

    Args:
        program: the program.
        x: (K + 1, size) the first guess.
        solver: ipopt or fatrop.
        seconds: after which ipopt stops; fatrop does not look at the clock.
        watch: called by ipopt once an iteration; returns whether to go on. What it raises ends the search and is raised here.
        tolerance: of the solver, on the program's scale.
    """
    started = time.perf_counter()
    structure = program.structure
    cached = _cached_solver(structure, solver, tolerance)
    built = time.perf_counter()
    t = cached.transcribed
    lower, upper = program.constraint_bounds(t.steps)
    bounds = {"lbx": t.to_solver_vector(program.lower), "ubx": t.to_solver_vector(program.upper), "lbg": lower, "ubg": upper}
    with cached.lock:
        cached.iteration_callback.begin(built + seconds, callback, lower, upper)
        found = cached.run(x0=t.to_solver_vector(x), p=program.parameters, **bounds)
        said = cached.run.stats()
        stopped, raised, best = (
            cached.iteration_callback.stopped,
            cached.iteration_callback.raised,
            cached.iteration_callback.best,
        )
        cached.iteration_callback.begin(np.inf, None, lower, upper)
    if raised is not None:
        raise raised
    done = time.perf_counter()
    evaluating = sum(said.get(f"t_wall_{name}", 0.0) for name in _EVALUATIONS)
    reached = np.array(found["x"]) if said["success"] or best is None else best
    return OptimiserResult(
        reached.ravel()[t.places],
        bool(said["success"]),
        stopped,
        str(said.get("return_status", "")),
        int(said.get("iter_count", 0)),
        built - started,
        done - built,
        float(evaluating),
    )


class _IterationCallback(ca.Callback):
    """Asked once an iteration whether to go on; keeps the best iterate that meets all equations."""

    best: Array | None
    _g = ca.nlpsol_out().index("g")

    def __init__(self, variables: int, rows: int, numbers: int) -> None:
        ca.Callback.__init__(self)
        self._sizes = {"f": 1, "x": variables, "lam_x": variables, "g": rows, "lam_g": rows, "lam_p": numbers}
        self.begin(np.inf, None, np.zeros(rows), np.zeros(rows))
        self.construct("warden", {})

    def begin(self, deadline: float, callback: Callable[[OptimiserIteration], bool] | None, lower: Array, upper: Array) -> None:
        """Before each run: when it ends, whom to ask, and the bounds of the equations."""
        self._deadline, self._callback, self._started, self._iteration = deadline, callback, time.perf_counter(), 0
        self._lower, self._upper, self._least = lower, upper, np.inf
        self.stopped, self.best = False, None
        self.raised: BaseException | None = None

    def get_n_in(self) -> int:
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        return 1

    def get_name_in(self, i: int) -> str:
        return str(ca.nlpsol_out(i))

    def get_name_out(self, i: int) -> str:
        return "stop"

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._sizes[ca.nlpsol_out(i)], 1)

    def eval(self, arg: Any) -> Any:
        now = time.perf_counter()
        going = now < self._deadline
        if going and self._callback is not None:
            try:
                going = self._callback(OptimiserIteration(self._iteration, float(arg[1]), now - self._started))
            except BaseException as error:  # CasADi would make words of it
                going, self.raised = False, error
        self._iteration += 1
        g, reached = np.array(arg[self._g]).ravel(), float(arg[1])
        if reached < self._least and max((self._lower - g).max(), (g - self._upper).max()) <= _ITERATE_TOLERANCE:
            self._least, self.best = reached, np.array(arg[0]).ravel()
        self.stopped = self.stopped or not going
        return [int(not going)]


@dataclass(frozen=True, eq=False, slots=True)
class _CachedSolver:
    """A solver that is used again, by one at a time."""

    run: ca.Function
    transcribed: NlpFunctions
    iteration_callback: _IterationCallback
    lock: threading.Lock


@lru_cache(maxsize=16)
def _cached_solver(structure: ProgramStructure, solver: str, tolerance: float) -> _CachedSolver:
    t = transcribe(structure, staged=solver == FATROP)
    iteration_callback = _IterationCallback(t.x.numel(), len(t.equal), t.p.numel())
    return _CachedSolver(_SOLVERS[solver](structure, t, iteration_callback, tolerance), t, iteration_callback, threading.Lock())


def _common(t: NlpFunctions, hessian: ca.Function, gradient: ca.Function) -> dict[str, Any]:
    """Options of both: our own derivatives in place of those that CasADi would make of the whole."""
    x, p = t.x, t.p
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", len(t.equal))
    pull = t.lagrangian_derivatives(x, p, lam_f, lam_g)[0]
    names = ["x", "p", "lam_f", "lam_g"], ["f", "g", "grad_gamma_x", "grad_gamma_p"]
    never = ca.MX.nan(p.numel())  # nobody asks for it
    both = ca.Function("nlp_grad", [x, p, lam_f, lam_g], [t.value(x, p), t.constraints(x, p), pull, never], *names)
    ours = {"nlp_f": t.value, "nlp_g": t.constraints, "nlp_jac_g": t.jacobian_values, "nlp_grad_f": gradient}
    cache = {**ours, "nlp_hess_l": hessian, "nlp_grad": both}
    quiet = {"calc_multipliers": False, "calc_lam_p": False, "print_time": False, "record_time": True, "error_on_fail": False}
    return {"cache": cache, **quiet}


def _ipopt(_: ProgramStructure, t: NlpFunctions, iteration_callback: _IterationCallback, tolerance: float) -> ca.Function:
    x, p = t.x, t.p
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", len(t.equal))
    names = ["x", "p", "lam_f", "lam_g"]
    upper = ca.triu(t.lagrangian_derivatives(x, p, lam_f, lam_g)[1])
    hessian = ca.Function("nlp_hess_l", [x, p, lam_f, lam_g], [upper], names, ["triu_hess_gamma_x_x"])
    gradient = ca.Function("nlp_grad_f", [x, p], [t.value(x, p), t.gradient(x, p)], ["x", "p"], ["f", "grad_f_x"])
    own = {
        "print_level": 0,
        "sb": "yes",
        "tol": tolerance,
        "constr_viol_tol": _CONSTRAINT_TOLERANCE,
        "max_iter": _ITERATIONS,
        "linear_solver": "mumps",
        "mumps_pivot_order": 6,  # quasi-dense minimum degree: where contacts roll a third faster than the default, and steadier
        "mumps_scaling": 0,  # the program is scaled already, and to scale it again costs a fifth
        "mumps_mem_percent": 20,  # with ten times what is needed, memory is asked of the system at every factorisation
        "min_refinement_steps": 0,  # steps are refined where their residuals ask for it
        "perturb_dec_fact": 0.1,  # the first weight against negative curvature is far too large; a third takes ten iterations
        "mu_init": _BARRIER,
        **dict.fromkeys(("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac"), _BARRIER),
    }
    options: dict[str, Any] = {**_common(t, hessian, gradient), "iteration_callback": iteration_callback, "ipopt": own}
    return ca.nlpsol("ipopt", "ipopt", t.nlp, options)


def _fatrop(structure: ProgramStructure, t: NlpFunctions, _: _IterationCallback, tolerance: float) -> ca.Function:
    layout, K = structure.layout, structure.intervals
    shape = {
        "structure_detection": "manual",
        "N": K,
        "nx": [layout.states] * (K + 1),
        "nu": [layout.algebraic + len(layout.next_values)] * K + [layout.algebraic],
        "ng": list(t.rows),
        "equality": list(t.equal),
    }
    own = {"print_level": 0, "tol": tolerance, "max_iter": _ITERATIONS, "mu_init": _BARRIER}
    options: dict[str, Any] = {**_common(t, t.lagrangian_derivatives, t.gradient), **shape, "fatrop": own}
    return ca.nlpsol("fatrop", "fatrop", t.nlp, options)


_SOLVERS: dict[str, Callable[[ProgramStructure, NlpFunctions, _IterationCallback, float], ca.Function]] = {
    IPOPT: _ipopt,
    FATROP: _fatrop,
}
