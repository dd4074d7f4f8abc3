"""Minimum time as a nonlinear program: accelerations linear between knots, equations held at the knots.

    minimise T    such that    y⁺ = y + h v + h² (a/3 + a⁺/6),    v⁺ = v + h (a + a⁺)/2,    h = T/K,
                               lower ≤ g(y, v, a, z) ≤ upper at every knot,    y, v given at both ends

y are coordinates that have second derivatives, z variables that do not. The last of y may be led: their v and a are what
equations at the knots say, and y is their integral by the trapezoidal rule with its first correction, of fourth order,

    y⁺ = y + h (v + v⁺)/2 + h² (a − a⁺)/12,    which for all others is the same as the above.

Against a motion whose accelerations jump the duration is longer by order h²: by the part (a₁ + a₂)²/(6 a₁ a₂ K²) of itself
where the one jump, from a₁ to −a₂, falls on a knot, and by a third to twice that where it falls between two. The solver's
tolerance adds some 4e-4, so that more than 40 intervals gain little.

A knot's variables are (y, v, a, T, z). T is a state that stays, so that everything is coupled from knot to knot only; as one
variable for all knots it makes the factorisation half as slow again, or four times as slow, after the ordering. A step is
equations of y⁺, T⁺ and those v⁺ that are not led, in the variables of both its knots. Staged, as fatrop wants it, each knot but
the last has copies of what is ahead in its control (z, led v⁺, a⁺), and the step says what the whole next state is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import casadi as ca
import numpy as np

from graspforce.core.arrays import Array
from graspforce.planning.interpolation import Indices
from graspforce.planning.nlp.equations import Equations, equations

_END_TOLERANCE = 1e-6  # of scaled variables: ten times what solvers leave


@dataclass(frozen=True, slots=True)
class KnotLayout:
    """Where variables stand in a knot's vector (y, v, a, T, z).

    Args:
        coordinates: how many y.
        others: how many z.
        led: how many of the last y are led.
    """

    coordinates: int
    algebraic: int
    dependent: int = 0

    @property
    def states(self) -> int:
        return 3 * self.coordinates + 1

    @property
    def size(self) -> int:
        return self.states + self.algebraic

    def _from(self, first: int, which: Sequence[int] | None) -> Indices:
        return first + np.asarray(range(self.coordinates) if which is None else which, dtype=np.intp)

    def y(self, which: Sequence[int] | None = None) -> Indices:
        return self._from(0, which)

    def v(self, which: Sequence[int] | None = None) -> Indices:
        return self._from(self.coordinates, which)

    def a(self, which: Sequence[int] | None = None) -> Indices:
        return self._from(2 * self.coordinates, which)

    def part(self, kind: str) -> Indices:
        """All of y, v or a."""
        return self._from("yva".index(kind) * self.coordinates, None)

    @property
    def duration(self) -> int:
        return 3 * self.coordinates

    def z(self, which: Sequence[int]) -> Indices:
        return self._from(self.states, which)

    @property
    def propagated(self) -> Indices:
        """Of the states, those that follow from the knot before: all but a and the led v."""
        return np.delete(np.arange(self.states), self.next_values)

    @property
    def next_values(self) -> Indices:
        """The others, in whose next values a step is written."""
        return np.arange(2 * self.coordinates - self.dependent, 3 * self.coordinates)


@dataclass(frozen=True, slots=True)
class KnotEquations:
    """Equations at the knots: of which of a knot's variables.

    Args:
        equations: what holds.
        variables: n indices in a knot's vector.
        equal: m times whether it is an equation, not an inequality.
    """

    equations: Equations
    variables: tuple[int, ...]
    equal: tuple[bool, ...]


@dataclass(frozen=True, slots=True)
class ProgramStructure:
    """What is alike in many minimum-time problems: which of them may share a solver.

    Args:
        layout: a knot's variables.
        intervals: K.
        equations: what holds at every knot.
        start, goal: which of (y, v) are given at the ends.
    """

    layout: KnotLayout
    intervals: int
    equations: tuple[KnotEquations, ...]
    start: tuple[int, ...]
    goal: tuple[int, ...]


@dataclass(frozen=True, eq=False, slots=True)
class Program:
    """A minimum-time problem.

    Args:
        structure: what holds of which variables.
        numbers: for each of its equations their own, the same at all knots.
        bounds: for each of its equations the lower and upper ones.
        lower, upper: (size,) bounds of a knot's variables.
        start, goal: the values given at both ends.
        weights: (size,) of ½ w x², summed over the knots and divided by their number, beside T; small.
        smooth: likewise of ½ w (a⁺ − a)², over the steps; of what is led only where steps are staged, since
            fatrop does not converge where a control has no weight, and ipopt is a fifth slower where it has.
    """

    structure: ProgramStructure
    numbers: tuple[Array, ...]
    bounds: tuple[tuple[Array, Array], ...]
    lower: Array
    upper: Array
    start: Array
    goal: Array
    weights: Array
    smooth: float

    @property
    def parameters(self) -> Array:
        """The p of the transcribed program."""
        return np.concatenate([self.weights, [self.smooth], *self.numbers])

    def meets_end_values(self, x: Array) -> bool:
        """Whether variables (K + 1, size) begin and end where they must: what a solver gives up half way may not."""
        if not np.isfinite(x).all():
            return False
        off = x[0, list(self.structure.start)] - self.start, x[-1, list(self.structure.goal)] - self.goal
        return float(np.abs(np.concatenate(off)).max()) <= _END_TOLERANCE

    def constraint_bounds(self, propagated: int) -> tuple[Array, Array]:
        """Of g, in its order: ``stepped`` rows of the step from the knot before, then what holds at the knot."""
        steps = np.zeros(propagated)
        K = self.structure.intervals
        sides = []
        for side in (0, 1):
            held = [np.concatenate([np.zeros(0), *(both[side] for both in self.bounds)])] * (K + 1)
            rows = [part for k in range(K) for part in (steps, held[k], self.start if k == 0 else steps[:0])]
            sides.append(np.concatenate([*rows, held[K], self.goal]))
        return sides[0], sides[1]


@cache
def _step_equations(layout: KnotLayout, staged: bool) -> Equations:
    """What the next state is, of the state and what is ahead, and h/T; what is ahead itself only where it is copied."""
    n, dependent = layout.coordinates, layout.dependent
    y, v, a, a_next = (ca.SX.sym(name, n) for name in ("y", "v", "a", "a_ahead"))
    T, part, dependent_next = ca.SX.sym("T"), ca.SX.sym("part"), ca.SX.sym("led_ahead", dependent)
    h = part * T
    v_next = ca.vertcat((v + h * (a + a_next) / 2)[: n - dependent, :], dependent_next)
    after = ca.vertcat(y + h * (v + v_next) / 2 + h**2 * (a - a_next) / 12, v_next, a_next, T)
    rows = list(range(layout.states)) if staged else layout.propagated.tolist()
    word, variables = "staged" if staged else "short", ca.vertcat(y, v, a, T, dependent_next, a_next)
    return equations(f"steps_{n}_{dependent}_{word}", variables, part, after[rows])


@cache
def _end_equations(count: int) -> Equations:
    x = ca.SX.sym("x", count)
    return equations(f"ends_{count}", x, ca.SX.sym("none", 0), x)


@dataclass(frozen=True, eq=False, slots=True)
class NlpFunctions:
    """A program as functions of x, with derivatives.

    Attributes:
        x, p: the variables of all knots, and the numbers: weights, then those of each of the equations.
        places: (K + 1, size) where in x a knot's variables are.
        copies: (2, …) where in x those stand that are the same as others', and the others.
        nlp: x and p to f and g, as the solvers want it.
        value, constraints, gradient, slopes, curvature: x, p (and multipliers) to f; g; ∂f/∂x; g and ∂g/∂x; the Lagrangian's
            gradient and Hessian.
        steps: how many of g belong to each step between knots.
        rows: (K + 1,) how many of g belong to each knot, without the steps.
        equal: which of g are equations.
    """

    x: ca.MX
    p: ca.MX
    places: Indices
    copies: Indices
    nlp: dict[str, Any]
    value: ca.Function
    constraints: ca.Function
    gradient: ca.Function
    jacobian_values: ca.Function
    lagrangian_derivatives: ca.Function
    steps: int
    rows: tuple[int, ...]
    equal: tuple[bool, ...]

    def to_solver_vector(self, values: Array) -> Array:
        """The x that says at all knots what ``values`` (K + 1, size) do, or (size,) at each."""
        x = np.empty(self.x.numel())
        x[self.places] = values
        x[self.copies[0]] = x[self.copies[1]]
        return x


class _SparseSum:
    """A sparse vector or matrix that is the sum of pieces, each with its place."""

    def __init__(self, *shape: int) -> None:
        self._shape = shape if len(shape) == 2 else (*shape, 1)
        self._pieces: list[ca.MX] = []
        self._rows: list[Indices] = []
        self._columns: list[Indices] = []

    def add(self, piece: ca.MX, rows: Indices, columns: Indices | None = None) -> None:
        rows = rows.ravel(order="F")
        self._pieces.append(piece)
        self._rows.append(rows)
        self._columns.append(np.zeros_like(rows) if columns is None else columns.ravel(order="F"))

    def total(self) -> ca.MX:
        """A gathering of the pieces' entries where no two share a place, else a sparse product that adds them."""
        rows, columns = np.concatenate(self._rows), np.concatenate(self._columns)
        places, into, times = np.unique(columns * self._shape[0] + rows, return_inverse=True, return_counts=True)
        high, wide = self._shape
        sparsity = ca.Sparsity.triplet(high, wide, list(places % high), list(places // high))
        entries = ca.vertcat(*self._pieces)
        if times.max() == 1:
            return ca.MX(sparsity, entries[list(np.argsort(into))])
        adding = ca.Sparsity.triplet(len(places), len(rows), list(into), list(range(len(rows))))
        return ca.MX(sparsity, ca.mtimes(ca.DM(adding, 1.0), entries))


def transcribe(structure: ProgramStructure, staged: bool = False) -> NlpFunctions:
    """The program's functions; nothing is differentiated here, only put in its place.

    Args:
        structure: the program's.
        staged: whether each knot has copies of what is ahead, after its own variables, so that the next state is a function of
            one knot alone and every row belongs to one. Else steps are written in the variables of both knots.
    """
    layout, K = structure.layout, structure.intervals
    copied = layout.next_values if staged else layout.next_values[:0]
    x_at = (layout.size + len(copied)) * np.arange(K + 1)
    places = x_at[:, None] + np.arange(layout.size)
    copies = np.stack([layout.size + np.arange(len(copied))[:, None] + x_at[:-1], copied[:, None] + x_at[1:]])
    next_values = copies[0] if staged else layout.next_values[:, None] + x_at[1:]
    blocks, rows, equal = _place_equations(structure, x_at, next_values, staged)
    size, count = int(x_at[-1]) + layout.size, len(equal)
    x, p = ca.MX.sym("x", size), ca.MX.sym("p", layout.size + 1 + sum(each.equations.numbers for each in structure.equations))
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", count)

    last = int(x_at[K]) + layout.duration
    Q = _SparseSum(size, size)
    Q.add(ca.repmat(p[: layout.size], K + 1, 1) / (K + 1), places.T, places.T)
    smoothed = slice(None) if staged else slice(layout.dependent, layout.coordinates)
    a_now, a_next = layout.next_values[smoothed, None] + x_at[:-1], next_values[smoothed]
    for row, column, sign in ((a_now, a_now, 1.0), (a_now, a_next, -1.0), (a_next, a_now, -1.0), (a_next, a_next, 1.0)):
        Q.add(ca.repmat(sign * p[layout.size] / (K + 1), row.size, 1), row, column)
    small = Q.total()
    falls = small @ x + ca.DM(ca.Sparsity.triplet(size, 1, [last], [0]), 1.0)
    f = x[last] + 0.5 * ca.bilin(small, x, x)

    g, J, H, pull = _SparseSum(count), _SparseSum(count, size), _SparseSum(size, size), _SparseSum(size)
    for block in blocks:
        e, many = block.equations, block.columns.shape[1]
        inputs = ca.reshape(x[list(block.columns.ravel(order="F"))], e.variables, many)
        numbers = ca.repmat(ca.DM(block.numbers) if isinstance(block.numbers, float) else p[block.numbers], 1, many)
        multipliers = block.sign * ca.reshape(lam_g[list(block.rows.ravel(order="F"))], e.count, many)
        g.add(block.sign * ca.vec(e.value.map(many)(inputs, numbers)), block.rows)
        row, column = (np.array(i, dtype=np.intp) for i in e.jacobian.get_triplet())
        J.add(block.sign * ca.vec(e.jacobian_values.map(many)(inputs, numbers)), block.rows[row], block.columns[column])
        pulled, bends = e.lagrangian_derivatives.map(many)(inputs, numbers, multipliers)
        pull.add(ca.vec(pulled), block.columns)
        row, column = (np.array(i, dtype=np.intp) for i in e.hessian.get_triplet())
        H.add(ca.vec(bends), block.columns[row], block.columns[column])

    whole, jacobian_values = g.total(), J.total()
    names = ["x", "p"]
    return NlpFunctions(
        x,
        p,
        places,
        copies,
        {"x": x, "p": p, "f": f, "g": whole},
        ca.Function("nlp_f", [x, p], [f], names, ["f"]),
        ca.Function("nlp_g", [x, p], [whole], names, ["g"]),
        ca.Function("nlp_grad_f", [x, p], [falls], names, ["grad_f_x"]),
        ca.Function("nlp_jac_g", [x, p], [whole, jacobian_values], names, ["g", "jac_g_x"]),
        ca.Function(
            "nlp_hess_l",
            [x, p, lam_f, lam_g],
            [pull.total() + lam_f * falls, H.total() + lam_f * small],
            [*names, "lam_f", "lam_g"],
            ["grad_gamma_x", "hess_gamma_x_x"],
        ),
        layout.states if staged else len(layout.propagated),
        rows,
        equal,
    )


@dataclass(frozen=True, eq=False, slots=True)
class _EquationBlock:
    """Equations at some knots: the entries of x that they take and their rows of g, (n, many) and (m, many)."""

    equations: Equations
    columns: Indices
    rows: Indices
    numbers: slice | float  # in p, or the one
    sign: float


def _place_equations(
    structure: ProgramStructure, x_at: Indices, next_values: Indices, staged: bool
) -> tuple[list[_EquationBlock], tuple[int, ...], tuple[bool, ...]]:
    """The equations with their places, in the order step 0, knot 0, step 1, knot 1, …; and how many rows each knot has.

    Args:
        x_at: (K + 1,) where knots begin in x.
        ahead: (…, K) where what is ahead of each stands.
    """
    layout, K = structure.layout, structure.intervals
    counts = [each.equations.count for each in structure.equations]
    held = sum(counts)
    ends = {0: structure.start, K: structure.goal}
    rows = np.array([held + len(ends.get(k, ())) for k in range(K + 1)])
    states = np.arange(layout.states)
    follow = states if staged else layout.propagated
    propagated = len(follow)
    steps_at = np.concatenate([[0], np.cumsum(propagated + rows[:-1])])  # the last is not there
    knots_at = steps_at + propagated * (np.arange(K + 1) < K)

    of_steps = np.arange(propagated)[:, None] + steps_at[:-1]
    takes = np.concatenate([states[:, None] + x_at[:-1], next_values])
    blocks = [
        _EquationBlock(_step_equations(layout, staged), takes, of_steps, 1.0 / K, -1.0),
        _EquationBlock(_end_equations(propagated), follow[:, None] + x_at[1:], of_steps, slice(0), 1.0),
    ]
    below, taken = 0, layout.size + 1
    for each, count in zip(structure.equations, counts, strict=True):
        numbers = slice(taken, taken + each.equations.numbers)
        of_knots = np.arange(below, below + count)[:, None] + knots_at
        blocks.append(_EquationBlock(each.equations, np.array(each.variables)[:, None] + x_at, of_knots, numbers, 1.0))
        below, taken = below + count, numbers.stop
    for k, given in ends.items():
        columns, of_end = np.array(given)[:, None] + x_at[k], np.arange(held, held + len(given))[:, None] + knots_at[k]
        blocks.append(_EquationBlock(_end_equations(len(given)), columns, of_end, slice(0), 1.0))
    of_knot = [flag for each in structure.equations for flag in each.equal]
    equal = [
        flag
        for k in range(K + 1)
        for flag in (*[True] * (propagated if k < K else 0), *of_knot, *[True] * len(ends.get(k, ())))
    ]
    return blocks, tuple(rows.tolist()), tuple(equal)
