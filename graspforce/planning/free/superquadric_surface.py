"""The surface of a superquadric under a rolling fingertip, in CasADi.

With the inside-outside function F of the superquadric, the inward normal at x in O is n = −∇F/‖∇F‖. The contact x of a tip of
radius r with its centre at c moves with the centre: x = c + r n(x), so that

    ẋ = (1 − r N)⁻¹ ċ,    ṅ = N ẋ,    N = ∂n/∂x

in O's axes. Source: Jaklič, Leonardis, Solina (2000) for F.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

_ROUNDING = 1e-12  # of squared coordinates relative to the axes: powers have derivatives at zero


@dataclass(frozen=True, eq=False, slots=True)
class SuperquadricSurface:
    """The surface in H, under a tip.

    Args:
        R: (3, 3) axes of the object in H.
        axes: (3,) half-axes, m.
        exponents: (2,) ε₁ and ε₂, at most 1.
        radius: of the tip, m.
    """

    R: ca.SX
    axes: ca.SX
    exponents: ca.SX
    radius: ca.SX

    def tip_to_contact(self, x: ca.SX) -> ca.SX:
        """Return r n, from the tip's centre to the contact, m.

        Args:
            x: (3,) contact from O, in H, m.
        """
        return self.radius * self.R @ self._normal(x)[0]

    def tip_to_contact_rate(self, x: ca.SX, c_d: ca.SX, omega: ca.SX) -> ca.SX:
        """Return the time derivative of r n, m/s.

        Args:
            x: (3,) contact from O, in H, m.
            c_d: (3,) rate of the tip's centre from O, in H, m/s.
            omega: (3,) angular velocity of the object in H, rad/s.
        """
        n, N = self._normal(x)
        inward = self.radius * self.R @ n
        c_d_O = self.R.T @ (c_d - ca.cross(omega, x - inward))
        n_d = N @ ca.inv_minor(ca.SX.eye(3) - self.radius * N) @ c_d_O
        return ca.cross(omega, inward) + self.radius * self.R @ n_d

    def normal(self, x: ca.SX) -> ca.SX:
        """Return n in H.

        Args:
            x: (3,) contact from O, in H, m.
        """
        return self.R @ self._normal(x)[0]

    def normal_force(self, x: ca.SX, f: ca.SX) -> ca.SX:
        """Return f_n of the scaled force f in H.

        Args:
            x: (3,) contact from O, in H, m.
            f: (3,) force.
        """
        return ca.dot(self.R @ self._normal(x)[0], f)

    def _normal(self, x_H: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return n and N in O."""
        x, (e1, e2) = ca.SX.sym("x", 3), ca.vertsplit(self.exponents)
        u = (x / self.axes) ** 2 + _ROUNDING
        F = (u[0] ** (1.0 / e2) + u[1] ** (1.0 / e2)) ** (e2 / e1) + u[2] ** (1.0 / e1)
        gradient = ca.gradient(F, x)
        n = -gradient / ca.norm_2(gradient)
        at_x = ca.substitute([n, ca.jacobian(n, x)], [x], [self.R.T @ x_H])
        return at_x[0], at_x[1]
