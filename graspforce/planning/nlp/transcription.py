"""Transcription of a minimum-time program into functions with derivatives in fixed places, for a nonlinear solver.

T is a state that stays constant, so that only neighbouring knots are coupled; one variable for all knots would slow the
factorisation down. A step consists of equations of y⁺, T⁺ and the independent v⁺, in the variables of both its knots. fatrop
needs the staged form. There every knot except the last has copies of the next values (dependent v⁺ and a⁺) in its control, and
a step gives the whole next state.

The duration exceeds that of a motion with steps in acceleration by order h². For one step, from a₁ to −a₂, at a knot, the
relative excess is (a₁ + a₂)²/(6 a₁ a₂ K²). Between two knots it is a third to twice that. The solver's tolerance adds about
4e-4, so that more than 40 intervals gain little.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import casadi as ca
import numpy as np

from graspforce.core.arrays import Array
from graspforce.planning.interpolation import Indices
from graspforce.planning.nlp.equations import Equations, make_equations
from graspforce.planning.nlp.layout import KnotLayout, ProgramStructure


@dataclass(frozen=True, eq=False, slots=True)
class NlpFunctions:
    """A program as functions of x, with derivatives.

    Attributes:
        x: variables of all knots.
        p: parameters: weights, then those of each set of equations.
        places: (K + 1, size) places in x of each knot's variables.
        copies: (2, …) places in x of the copies, and of the variables that they equal.
        nlp: x and p to f and g, as CasADi's solvers take it.
        value: (x, p) → f.
        constraints: (x, p) → g.
        gradient: (x, p) → ∂f/∂x.
        jacobian_values: (x, p) → g and ∂g/∂x.
        lagrangian_derivatives: (x, p, λ_f, λ_g) → gradient and Hessian of the Lagrangian.
        steps: number of rows of g of each step between knots.
        rows: (K + 1,) number of rows of g of each knot, without the steps.
        equal: for each row of g, True for an equality.
    """

    x: ca.MX
    p: ca.MX
    places: Indices
    copies: Indices
    nlp: dict[str, ca.MX]
    value: ca.Function
    constraints: ca.Function
    gradient: ca.Function
    jacobian_values: ca.Function
    lagrangian_derivatives: ca.Function
    steps: int
    rows: tuple[int, ...]
    equal: tuple[bool, ...]

    def to_solver_vector(self, values: Array) -> Array:
        """Return the solver's vector x.

        Args:
            values: (K + 1, size) variables at each knot, or (size,) for all knots.
        """
        x = np.empty(self.x.numel())
        x[self.places] = values
        x[self.copies[0]] = x[self.copies[1]]
        return x


def transcribe(structure: ProgramStructure, staged: bool = False) -> NlpFunctions:
    """Return a program's functions. Nothing is differentiated here: derivatives of the equations go to their places.

    Args:
        structure: the program's structure.
        staged: True to give each knot copies of the next values, after its own variables, so that the next state is a function
            of one knot. False to write steps in the variables of both knots.
    """
    place = _places(structure, staged)
    equations = [each.equations for each in structure.equations]
    x = ca.MX.sym("x", place.x_size)
    p = ca.MX.sym("p", structure.layout.size + 1 + sum(each.parameter_count for each in equations))
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", len(place.equal))
    last_T = int(place.knots[-1, structure.layout.duration])
    Q = _quadratic_cost(structure, place, p, staged)
    f = x[last_T] + 0.5 * ca.bilin(Q, x, x)
    f_gradient = Q @ x + ca.DM(ca.Sparsity.triplet(place.x_size, 1, [last_T], [0]), 1.0)
    g, J, gradient, H = _constraints(place, x, p, lam_g)
    names = ["x", "p"]
    return NlpFunctions(
        x=x,
        p=p,
        places=place.knots,
        copies=place.copies,
        nlp={"x": x, "p": p, "f": f, "g": g},
        value=ca.Function("nlp_f", [x, p], [f], names, ["f"]),
        constraints=ca.Function("nlp_g", [x, p], [g], names, ["g"]),
        gradient=ca.Function("nlp_grad_f", [x, p], [f_gradient], names, ["grad_f_x"]),
        jacobian_values=ca.Function("nlp_jac_g", [x, p], [g, J], names, ["g", "jac_g_x"]),
        lagrangian_derivatives=ca.Function(
            "nlp_hess_l",
            [x, p, lam_f, lam_g],
            [gradient + lam_f * f_gradient, H + lam_f * Q],
            [*names, "lam_f", "lam_g"],
            ["grad_gamma_x", "hess_gamma_x_x"],
        ),
        steps=structure.layout.states if staged else len(structure.layout.propagated),
        rows=place.rows,
        equal=place.equal,
    )


@dataclass(frozen=True, eq=False, slots=True)
class _EquationBlock:
    """Equations at some knots.

    Args:
        equations: the equations.
        columns: (n, count) places of their variables in x.
        rows: (m, count) their places in g.
        parameters: places in p, or the one parameter.
        sign: factor of the equations in g.
    """

    equations: Equations
    columns: Indices
    rows: Indices
    parameters: slice | float
    sign: float


@dataclass(frozen=True, eq=False, slots=True)
class _Places:
    """Places of variables and equations in x and g.

    Args:
        knots: (K + 1, size) places in x of each knot's variables.
        copies: (2, …) places in x of the copies, and of the variables that they equal.
        next_values: (…, K) places in x of the next values of each step.
        blocks: the equations.
        rows: (K + 1,) number of rows of g of each knot, without the steps.
        equal: for each row of g, True for an equality.
        x_size: number of all variables.
    """

    knots: Indices
    copies: Indices
    next_values: Indices
    blocks: list[_EquationBlock]
    rows: tuple[int, ...]
    equal: tuple[bool, ...]
    x_size: int


class _SparseSum:
    """A sparse vector or matrix that is the sum of pieces, each with its places."""

    def __init__(self, *shape: int) -> None:
        self._shape = shape if len(shape) == 2 else (*shape, 1)
        self._pieces: list[ca.MX] = []
        self._rows: list[Indices] = []
        self._columns: list[Indices] = []

    def add(self, piece: ca.MX, rows: Indices, columns: Indices | None = None) -> None:
        """Add a vector of entries at their places, column by column."""
        rows = rows.ravel(order="F")
        self._pieces.append(piece)
        self._rows.append(rows)
        self._columns.append(np.zeros_like(rows) if columns is None else columns.ravel(order="F"))

    def total(self) -> ca.MX:
        """Return the sum: a permutation of the entries if no two share a place, else a product with a sparse matrix."""
        rows, columns = np.concatenate(self._rows), np.concatenate(self._columns)
        height, width = self._shape
        places, place_of, counts = np.unique(columns * height + rows, return_inverse=True, return_counts=True)
        sparsity = ca.Sparsity.triplet(height, width, list(places % height), list(places // height))
        entries = ca.vertcat(*self._pieces)
        if counts.max() == 1:
            return ca.MX(sparsity, entries[list(np.argsort(place_of))])
        summation = ca.Sparsity.triplet(len(places), len(rows), list(place_of), list(range(len(rows))))
        return ca.MX(sparsity, ca.mtimes(ca.DM(summation, 1.0), entries))


def _quadratic_cost(structure: ProgramStructure, place: _Places, p: ca.MX, staged: bool) -> ca.MX:
    """Return the matrix Q of the small cost ½ xᵀ Q x: weights of variables, and of steps in acceleration."""
    layout, K = structure.layout, structure.intervals
    Q = _SparseSum(place.x_size, place.x_size)
    Q.add(ca.repmat(p[: layout.size], K + 1, 1) / (K + 1), place.knots.T, place.knots.T)
    smoothed = slice(None) if staged else slice(layout.dependent, layout.coordinates)
    a_now, a_next = place.knots[:-1, layout.next_values[smoothed]].T, place.next_values[smoothed]
    for row, column, sign in ((a_now, a_now, 1.0), (a_now, a_next, -1.0), (a_next, a_now, -1.0), (a_next, a_next, 1.0)):
        Q.add(ca.repmat(sign * p[layout.size] / (K + 1), row.size, 1), row, column)
    return Q.total()


def _constraints(place: _Places, x: ca.MX, p: ca.MX, lam_g: ca.MX) -> tuple[ca.MX, ca.MX, ca.MX, ca.MX]:
    """Return g, ∂g/∂x, and the gradient and Hessian of λᵀg, assembled from mapped calls of the equations."""
    size, count = place.x_size, len(place.equal)
    g, J, H, gradient = _SparseSum(count), _SparseSum(count, size), _SparseSum(size, size), _SparseSum(size)
    for block in place.blocks:
        e, many = block.equations, block.columns.shape[1]
        inputs = ca.reshape(x[list(block.columns.ravel(order="F"))], e.variable_count, many)
        values = ca.DM(block.parameters) if isinstance(block.parameters, float) else p[block.parameters]
        parameters = ca.repmat(values, 1, many)
        multipliers = block.sign * ca.reshape(lam_g[list(block.rows.ravel(order="F"))], e.row_count, many)
        g.add(block.sign * ca.vec(e.value.map(many)(inputs, parameters)), block.rows)
        row, column = (np.array(i, dtype=np.intp) for i in e.jacobian_sparsity.get_triplet())
        J.add(block.sign * ca.vec(e.jacobian_values.map(many)(inputs, parameters)), block.rows[row], block.columns[column])
        slopes, curvatures = e.lagrangian_derivatives.map(many)(inputs, parameters, multipliers)
        gradient.add(ca.vec(slopes), block.columns)
        row, column = (np.array(i, dtype=np.intp) for i in e.hessian_sparsity.get_triplet())
        H.add(ca.vec(curvatures), block.columns[row], block.columns[column])
    return g.total(), J.total(), gradient.total(), H.total()


def _places(structure: ProgramStructure, staged: bool) -> _Places:
    """Return the places of variables and equations."""
    layout, K = structure.layout, structure.intervals
    copied = layout.next_values if staged else layout.next_values[:0]
    knot_starts = (layout.size + len(copied)) * np.arange(K + 1)
    knots = knot_starts[:, None] + np.arange(layout.size)
    copies = np.stack([layout.size + np.arange(len(copied))[:, None] + knot_starts[:-1], copied[:, None] + knot_starts[1:]])
    next_values = copies[0] if staged else layout.next_values[:, None] + knot_starts[1:]
    counts = [each.equations.row_count for each in structure.equations]
    ends = {0: structure.start, K: structure.goal}
    rows = tuple(sum(counts) + len(ends.get(k, ())) for k in range(K + 1))
    blocks = list(_equation_blocks(structure, knots, next_values, rows, staged))
    equal = _equality_flags(structure, rows, staged)
    return _Places(knots, copies, next_values, blocks, rows, equal, int(knot_starts[-1]) + layout.size)


def _equation_blocks(
    structure: ProgramStructure, knots: Indices, next_values: Indices, rows: tuple[int, ...], staged: bool
) -> Iterator[_EquationBlock]:
    """Yield the equations with their places, whose rows are in the order step 0, knot 0, step 1, knot 1, …"""
    layout, K = structure.layout, structure.intervals
    step_size = layout.states if staged else len(layout.propagated)
    next_states = np.arange(layout.states) if staged else layout.propagated
    step_starts = np.concatenate([[0], np.cumsum(step_size + np.array(rows[:-1]))])  # the last one has no step
    knot_starts = step_starts + step_size * (np.arange(K + 1) < K)

    step_rows = np.arange(step_size)[:, None] + step_starts[:-1]
    columns = np.concatenate([knots[:-1, : layout.states].T, next_values])
    yield _EquationBlock(_step_equations(layout, staged), columns, step_rows, 1.0 / K, -1.0)
    yield _EquationBlock(_value_equations(step_size), knots[1:, next_states].T, step_rows, slice(0), 1.0)
    row, parameter = 0, layout.size + 1
    for each in structure.equations:
        count, end = each.equations.row_count, parameter + each.equations.parameter_count
        knot_rows = np.arange(row, row + count)[:, None] + knot_starts
        yield _EquationBlock(each.equations, knots[:, list(each.variables)].T, knot_rows, slice(parameter, end), 1.0)
        row, parameter = row + count, end
    for k, given in ((0, structure.start), (K, structure.goal)):
        end_rows = np.arange(row, row + len(given))[:, None] + knot_starts[k]
        yield _EquationBlock(_value_equations(len(given)), knots[k, list(given)][:, None], end_rows, slice(0), 1.0)


def _equality_flags(structure: ProgramStructure, rows: tuple[int, ...], staged: bool) -> tuple[bool, ...]:
    """Return for each row of g whether it is an equality."""
    K, layout = structure.intervals, structure.layout
    step = [True] * (layout.states if staged else len(layout.propagated))
    at_knot = [flag for each in structure.equations for flag in each.equal]
    return tuple(
        flag for k in range(K + 1) for flag in (*(step if k < K else ()), *at_knot, *[True] * (rows[k] - len(at_knot)))
    )


@cache
def _step_equations(layout: KnotLayout, staged: bool) -> Equations:
    """Return the next state as a function of the state and the next values; the parameter is h/T."""
    n, dependent = layout.coordinates, layout.dependent
    y, v, a, a_next = (ca.SX.sym(name, n) for name in ("y", "v", "a", "a_next"))
    T, part, dependent_next = ca.SX.sym("T"), ca.SX.sym("part"), ca.SX.sym("dependent_next", dependent)
    h = part * T
    v_next = ca.vertcat((v + h * (a + a_next) / 2)[: n - dependent, :], dependent_next)
    after = ca.vertcat(y + h * (v + v_next) / 2 + h**2 * (a - a_next) / 12, v_next, a_next, T)
    rows = list(range(layout.states)) if staged else layout.propagated.tolist()
    form, variables = "staged" if staged else "short", ca.vertcat(y, v, a, T, dependent_next, a_next)
    return make_equations(f"steps_{n}_{dependent}_{form}", variables, part, after[rows])


@cache
def _value_equations(count: int) -> Equations:
    """Return the values of ``count`` variables."""
    x = ca.SX.sym("x", count)
    return make_equations(f"values_{count}", x, ca.SX.sym("none", 0), x)
