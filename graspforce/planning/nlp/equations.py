"""Equations that hold at every knot, with their first and second derivatives.

A set of equations is written once, as CasADi expressions of few variables, so that its derivatives are small. One mapped call
evaluates it at all knots.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca


@dataclass(frozen=True, eq=False, slots=True)
class Equations:
    """Expressions g(x, p) of n variables x and some parameters p, m in number.

    Attributes:
        name: a C identifier.
        value: (x, p) → g (m,).
        jacobian_values: (x, p) → the nonzeros of ∂g/∂x, column by column.
        lagrangian_derivatives: (x, p, λ (m,)) → ∂(λᵀg)/∂x (n,), and the nonzeros of ∂²(λᵀg)/∂x², both triangles.
        jacobian_sparsity: the pattern of ∂g/∂x.
        hessian_sparsity: the pattern of ∂²(λᵀg)/∂x².
    """

    name: str
    value: ca.Function
    jacobian_values: ca.Function
    lagrangian_derivatives: ca.Function
    jacobian_sparsity: ca.Sparsity
    hessian_sparsity: ca.Sparsity

    @property
    def row_count(self) -> int:
        """Return m, the number of expressions."""
        return int(self.value.size1_out(0))

    @property
    def parameter_count(self) -> int:
        """Return the number of parameters."""
        return int(self.value.size1_in(1))

    @property
    def variable_count(self) -> int:
        """Return n, the number of variables."""
        return int(self.value.size1_in(0))


def make_equations(name: str, x: ca.SX, p: ca.SX, g: ca.SX) -> Equations:
    """Return expressions with their derivatives.

    Args:
        name: a C identifier.
        x: (n,) variables.
        p: parameters.
        g: (m,) expressions of both.
    """
    lam = ca.SX.sym("lam", g.numel())
    jacobian = ca.jacobian(g, x)
    hessian, gradient = ca.hessian(ca.dot(lam, g), x)
    options = {"cse": True}  # eliminate common subexpressions
    return Equations(
        name,
        ca.Function(f"{name}_value", [x, p], [g], options),
        ca.Function(f"{name}_jacobian", [x, p], [jacobian.nz[:]], options),
        ca.Function(f"{name}_lagrangian", [x, p, lam], [ca.densify(gradient), hessian.nz[:]], options),
        jacobian.sparsity(),
        hessian.sparsity(),
    )
