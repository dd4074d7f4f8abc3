"""Equations that hold at every knot, with first and second derivatives as numbers in fixed places.

A set of equations is written once as CasADi expressions of few variables, so that its derivatives are small, and evaluated at
all knots by one mapped call. Compiled or not, it answers the same.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca


@dataclass(frozen=True, eq=False, slots=True)
class Equations:
    """m expressions g(x, p) of n variables and some numbers.

    Attributes:
        value: (x, p) → g (m,).
        slopes: (x, p) → the entries of ∂g/∂x.
        curvature: (x, p, lam (m,)) → ∂(λᵀg)/∂x (n,), and the entries of ∂²(λᵀg)/∂x², both triangles.
        jacobian, hessian: where these entries stand, column by column.
    """

    name: str
    value: ca.Function
    jacobian_values: ca.Function
    lagrangian_derivatives: ca.Function
    jacobian: ca.Sparsity
    hessian: ca.Sparsity

    @property
    def count(self) -> int:
        """m."""
        return int(self.value.size1_out(0))

    @property
    def numbers(self) -> int:
        """How many numbers p are given."""
        return int(self.value.size1_in(1))

    @property
    def variables(self) -> int:
        """n."""
        return int(self.value.size1_in(0))


def equations(name: str, x: ca.SX, p: ca.SX, g: ca.SX) -> Equations:
    """Expressions, with their derivatives.

    Args:
        name: a C identifier.
        x: (n,) the variables.
        p: the numbers that are given for each problem.
        g: (m,) expressions of both.
    """
    lam = ca.SX.sym("lam", g.numel())
    jacobian = ca.jacobian(g, x)
    hessian, gradient = ca.hessian(ca.dot(lam, g), x)
    once = {"cse": True}
    return Equations(
        name,
        ca.Function(f"{name}_value", [x, p], [g], once),
        ca.Function(f"{name}_slopes", [x, p], [jacobian.nz[:]], once),
        ca.Function(f"{name}_curvature", [x, p, lam], [ca.densify(gradient), hessian.nz[:]], once),
        jacobian.sparsity(),
        hessian.sparsity(),
    )
