"""Layout of a knot's variables, and the structure and data of a minimum-time program.

    minimise T    such that    y⁺ = y + h v + h² (a/3 + a⁺/6),    v⁺ = v + h (a + a⁺)/2

Here h = T/K, and y and v are given at both ends. At every knot, lower ≤ g(y, v, a, z) ≤ upper.

Accelerations are linear between knots. The variables of a knot are (y, v, a, T, z): coordinates y with two derivatives, and
algebraic variables z. The trailing coordinates may be dependent: equations at each knot fix their v and a, and y is their
integral by the corrected trapezoidal rule, which for all others is the same as the rule above:

    y⁺ = y + h (v + v⁺)/2 + h² (a − a⁺)/12
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from graspforce.core.arrays import Array
from graspforce.planning.interpolation import Indices
from graspforce.planning.nlp.equations import Equations

DEFAULT_BARRIER = 0.1
_END_TOLERANCE = 1e-6  # of scaled variables; solvers meet end values to a tenth of it


@dataclass(frozen=True, slots=True)
class KnotLayout:
    """Places of the variables in a knot's vector (y, v, a, T, z).

    Args:
        coordinates: number of coordinates y.
        algebraic: number of variables z.
        dependent: number of trailing coordinates that are dependent.
    """

    coordinates: int
    algebraic: int
    dependent: int = 0

    @property
    def states(self) -> int:
        """Return the number of variables y, v, a and T."""
        return 3 * self.coordinates + 1

    @property
    def size(self) -> int:
        """Return the number of all variables."""
        return self.states + self.algebraic

    @property
    def duration(self) -> int:
        """Return the place of T."""
        return 3 * self.coordinates

    def part(self, kind: str) -> Indices:
        """Return the places of all y, v or a.

        Args:
            kind: "y", "v" or "a".
        """
        return "yva".index(kind) * self.coordinates + np.arange(self.coordinates, dtype=np.intp)

    def z(self, which: Sequence[int]) -> Indices:
        """Return the places of some algebraic variables.

        Args:
            which: variables by their index in z.
        """
        return self.states + np.asarray(which, dtype=np.intp)

    @property
    def propagated(self) -> Indices:
        """Return the places of the states that follow from the knot before: all except a and the dependent v."""
        return np.delete(np.arange(self.states), self.next_values)

    @property
    def next_values(self) -> Indices:
        """Return the places of the dependent v and of a, whose next values a step depends on."""
        return np.arange(2 * self.coordinates - self.dependent, 3 * self.coordinates)


@dataclass(frozen=True, slots=True)
class KnotEquations:
    """Equations at the knots, and the variables that they take.

    Args:
        equations: the equations.
        variables: n places in a knot's vector.
        equal: for each of the m rows, True for an equality and False for an inequality.
    """

    equations: Equations
    variables: tuple[int, ...]
    equal: tuple[bool, ...]


@dataclass(frozen=True, slots=True)
class ProgramStructure:
    """Structure of minimum-time programs; programs with the same structure share a solver.

    Args:
        layout: a knot's variables.
        intervals: number of intervals K.
        equations: the equations at every knot.
        start: places of (y, v) given at the start.
        goal: places of (y, v) given at the goal.
    """

    layout: KnotLayout
    intervals: int
    equations: tuple[KnotEquations, ...]
    start: tuple[int, ...]
    goal: tuple[int, ...]


@dataclass(frozen=True, eq=False, slots=True)
class Program:
    """A minimum-time program.

    Args:
        structure: its structure.
        parameter_values: parameters of each of its equations, the same at all knots.
        bounds: lower and upper bounds of each of its equations.
        lower: (size,) lower bounds of a knot's variables.
        upper: (size,) upper bounds of a knot's variables.
        start: values given at the start.
        goal: values given at the goal.
        weights: (size,) weights w of ½ w x², averaged over the knots, beside T; small.
        step_weight: weight w of ½ w (a⁺ − a)², likewise over the steps. Dependent coordinates are included only in staged
            programs: fatrop does not converge without a weight on every control.
        barrier: first barrier parameter of the solvers; they start as far inside the bounds, since guesses lie on them.
    """

    structure: ProgramStructure
    parameter_values: tuple[Array, ...]
    bounds: tuple[tuple[Array, Array], ...]
    lower: Array
    upper: Array
    start: Array
    goal: Array
    weights: Array
    step_weight: float
    barrier: float = DEFAULT_BARRIER

    @property
    def parameters(self) -> Array:
        """Return the parameters p of the transcribed program."""
        return np.concatenate([self.weights, [self.step_weight], *self.parameter_values])

    def meets_end_values(self, x: Array) -> bool:
        """Return whether variables are finite and have the given values at both ends.

        Args:
            x: (K + 1, size) variables at each knot.
        """
        if not np.isfinite(x).all():
            return False
        errors = x[0, list(self.structure.start)] - self.start, x[-1, list(self.structure.goal)] - self.goal
        return float(np.abs(np.concatenate(errors)).max()) <= _END_TOLERANCE

    def constraint_bounds(self, propagated: int) -> tuple[Array, Array]:
        """Return the lower and upper bounds of the transcribed constraints.

        Args:
            propagated: number of rows of a step.
        """
        steps = np.zeros(propagated)
        K = self.structure.intervals
        sides = []
        for side in (0, 1):
            at_knot = [np.concatenate([np.zeros(0), *(both[side] for both in self.bounds)])] * (K + 1)
            rows = [part for k in range(K) for part in (steps, at_knot[k], self.start if k == 0 else steps[:0])]
            sides.append(np.concatenate([*rows, at_knot[K], self.goal]))
        return sides[0], sides[1]
