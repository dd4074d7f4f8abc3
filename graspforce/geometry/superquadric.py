"""The superquadric: ellipsoid, and all between box, cylinder and double cone."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.core.records import set_fields
from graspforce.geometry.shape import SURFACE_TOLERANCE, Solid, check_positive
from graspforce.geometry.superquadric_closest_point import minimise_distance

_GRID_SIDE = np.linspace(0.0, 1.0, 33)  # of a grid so fine that each nearest-point basin of an octant holds one of its points
_POLE_RADIUS = 1e-3  # ρ that is as good as none


@dataclass(frozen=True, eq=False, slots=True)
class _OctantGrid:
    """Places of an octant: points x (33, 33, 3), m, and their (ρ, w) and (α, β) as in `superquadric_foot`."""

    x: Array
    outer: Array
    inner: Array


@dataclass(frozen=True, eq=False, slots=True)
class Superquadric(Solid):
    """(|x/a|^(2/e2) + |y/b|^(2/e2))^(e2/e1) + |z/c|^(2/e1) = 1. Jaklič, Leonardis and Solina (2000).

    For exponents up to 2 it is convex, and its left side to the power e1/2 is a norm ψ: with p-norms N_p of two numbers,

        ψ(x) = N_{2/e1}( N_{2/e2}(|x/a|, |y/b|), |z/c| ),        φ = size · (ψ − 1).

    The gradient of a norm does not vanish where ψ = 1, so there is a normal in the axis planes too, where the textbook form
    (unrolled by trigonometric powers) divides by zero; except for kinks: the edges of e = 2. The curvature in an axis plane
    is zero for e < 1 and infinite for e > 1. Volume and inertia: the same book, by beta functions.

    Args:
        axes: (a, b, c) half-extents along x, y and z, m, > 0.
        exponents: (e1, e2), 0 < e ≤ 2; e1 shapes every plane through z, e2 the sections across z. One is round, towards zero
            square, two is a straight-sided rhombus.
    """

    axes: Array
    exponents: Array
    _grid: _OctantGrid = field(init=False, repr=False)
    _places_without_normal: ClassVar[str] = "on an edge, at a tip or at the centre"

    def __post_init__(self) -> None:
        set_fields(self, axes=check_positive(self.axes, "axes"))
        set_fields(self, exponents=arrays.check_array(self.exponents, "exponents", (2,)))
        for i in np.flatnonzero((self.exponents <= 0.0) | (self.exponents > 2.0)):
            raise InvalidInput(f"exponents[{i}]", float(self.exponents[i]), "above 0 and at most 2, where it is convex")
        set_fields(self, _grid=self._make_grid())

    def _make_grid(self) -> _OctantGrid:
        p1, p2 = 2.0 / self.exponents
        across, up = np.meshgrid(_GRID_SIDE, _GRID_SIDE, indexing="ij")
        inner = np.stack([1.0 - across, across], axis=-1)
        inner /= _p_norm(inner[..., 0], inner[..., 1], p2)[..., None]
        outer = np.stack([np.maximum(1.0 - up, _POLE_RADIUS), up], axis=-1)
        outer /= _p_norm(outer[..., 0], outer[..., 1], p1)[..., None]
        x = self.axes * np.concatenate([outer[..., :1] * inner, outer[..., 1:]], axis=-1)
        return _OctantGrid(freeze(x), freeze(outer), freeze(inner))

    @property
    def _largest_half_extent(self) -> float:
        return float(self.axes.max())

    @property
    def volume(self) -> float:
        e1, e2 = self.exponents
        return float(2.0 * self.axes.prod() * e1 * e2 * _beta(e1 / 2.0, e1 + 1.0) * _beta(e2 / 2.0, e2 / 2.0 + 1.0))

    @property
    def _mean_squares(self) -> Array:
        e1, e2 = self.exponents
        slices, section = _beta(e1 / 2.0, e1 + 1.0), _beta(e2 / 2.0, e2 / 2.0 + 1.0)
        across = _beta(e1 / 2.0, 2.0 * e1 + 1.0) / slices * _beta(1.5 * e2, e2 / 2.0) / (4.0 * section)
        along = _beta(1.5 * e1, e1 + 1.0) / slices
        return np.asarray(self.axes**2 * [across, across, along])

    def _norms(self, p: Array) -> tuple[Array, Array, Array]:
        """(N, 3) u = |x|/axes, (N,) ρ = N_{2/e2}(u_x, u_y) and (N,) ψ."""
        u = np.abs(p) / self.axes
        rho = _p_norm(u[:, 0], u[:, 1], 2.0 / self.exponents[1])
        return u, rho, _p_norm(rho, u[:, 2], 2.0 / self.exponents[0])

    def _phi(self, p: Array) -> Array:
        return np.asarray(self._largest_half_extent * (self._norms(p)[2] - 1.0))

    def _gradient(self, p: Array) -> Array:
        p1, p2 = 2.0 / self.exponents
        u, rho, psi = self._norms(p)
        outer = np.stack([_ratio(rho, psi), _ratio(rho, psi), _ratio(u[:, 2], psi)], axis=1) ** (p1 - 1.0)
        inner = np.stack([_ratio(u[:, 0], rho), _ratio(u[:, 1], rho), np.ones(len(p))], axis=1) ** (p2 - 1.0)
        kink = (psi == 0.0) | ((p1 == 1.0) & ((rho <= SURFACE_TOLERANCE) | (u[:, 2] <= SURFACE_TOLERANCE)))
        kink |= (p2 == 1.0) & (rho > SURFACE_TOLERANCE) & (u[:, :2].min(axis=1) <= SURFACE_TOLERANCE)
        return np.where(kink[:, None], 0.0, self._largest_half_extent * outer * inner * np.sign(p) / self.axes)

    def _hessian(self, p: Array) -> Array:
        p1, p2 = 2.0 / self.exponents
        u, rho, psi = self._norms(p)
        pole = rho == 0.0
        x, y = (np.where(pole, 0.5 ** (1.0 / p2), _ratio(u[:, i], rho)) for i in (0, 1))  # at a pole any direction serves
        r, z = _ratio(rho, psi), _ratio(u[:, 2], psi)
        zero = np.zeros(len(p))
        with np.errstate(divide="ignore", invalid="ignore"):  # infinite curvature, for the caller to refuse
            # ∂²ψ = N_ρρ ∇ρ∇ρᵀ + N_ρz (∇ρ e_zᵀ + e_z ∇ρᵀ) + N_zz e_z e_zᵀ + N_ρ ∂²ρ, all in u
            d_rho = np.stack([x ** (p2 - 1.0), y ** (p2 - 1.0), zero], axis=1)
            e_z = np.array([0.0, 0.0, 1.0])
            N_rr = (p1 - 1.0) * r ** (p1 - 2.0) * z**p1 / psi
            N_rz = -(p1 - 1.0) * (r * z) ** (p1 - 1.0) / psi
            N_zz = (p1 - 1.0) * z ** (p1 - 2.0) * r**p1 / psi
            bend = (p2 - 1.0) * r ** (p1 - 2.0) / psi  # N_ρ/ρ, the factor of ∂²ρ
            H = N_rr[:, None, None] * d_rho[:, :, None] * d_rho[:, None, :]
            H += N_rz[:, None, None] * (d_rho[:, :, None] * e_z + e_z[:, None] * d_rho[:, None, :])
            H[:, 2, 2] += N_zz
            H[:, 0, 0] += bend * x ** (p2 - 2.0) * y**p2
            H[:, 1, 1] += bend * y ** (p2 - 2.0) * x**p2
            H[:, 0, 1] -= bend * (x * y) ** (p2 - 1.0)
            H[:, 1, 0] = H[:, 0, 1]
        if p1 == 2.0 and p2 != 2.0:
            H[pole] = np.nan  # there the curvature depends on the direction in which one comes
        sign = np.where(p < 0.0, -1.0, 1.0) / self.axes
        return np.asarray(self._largest_half_extent * H * sign[:, :, None] * sign[:, None, :])

    def closest_points(self, p: Array) -> Array:
        inside = self._norms(p)[2] < 1.0
        return np.array([self._closest_point(point, within) for point, within in zip(p, inside, strict=True)]).reshape(p.shape)

    def _closest_point(self, p: Array, inside: np.bool_) -> Array:
        """The nearest point, by descent in p's octant, where symmetry puts it.

        From outside there is one minimum, and the nearest point of a grid leads to it; from inside the surface there may be
        several, and every minimum on the grid is followed. At worst it is placed to the root of rounding of its distance.
        """
        grid, there = self._grid, np.abs(p)
        cost = ((grid.x - there) ** 2).sum(axis=-1)
        if inside:
            around = np.pad(cost, 1, constant_values=np.inf)
            low = cost <= np.lib.stride_tricks.sliding_window_view(around, (3, 3)).min(axis=(2, 3))
            starts = list(zip(grid.outer[low].tolist(), grid.inner[low].tolist(), strict=True))
        else:
            best = np.unravel_index(cost.argmin(), cost.shape)
            outer, inner = grid.outer[best], grid.inner[best]
            if outer[0] < _POLE_RADIUS and there[:2].any():  # at a pole the grid's own direction says nothing
                u = there[:2] / self.axes[:2]
                inner = u / _p_norm(u[0], u[1], 2.0 / self.exponents[1])
            starts = [(outer.tolist(), inner.tolist())]
        axes, (p1, p2) = self.axes.tolist(), (2.0 / self.exponents).tolist()
        found = [minimise_distance(axes, (p1, p2), there.tolist(), outer, inner, bool(inside)) for outer, inner in starts]
        return np.copysign(min(found, key=lambda closest: closest[1])[0], p)


def _p_norm(a: Array, b: Array, p: float) -> Array:
    """(a^p + b^p)^(1/p) for a, b ≥ 0, without overflow."""
    largest = np.maximum(a, b)
    return np.asarray(largest * (_ratio(a, largest) ** p + _ratio(b, largest) ** p) ** (1.0 / p))


def _ratio(a: Array, b: Array) -> Array:
    """a/b, zero where b is zero."""
    return np.asarray(np.divide(a, b, out=np.zeros_like(a), where=b > 0.0))


def _beta(x: Any, y: Any) -> float:
    """Euler's B(x, y) = Γ(x) Γ(y)/Γ(x + y)."""
    return math.exp(math.lgamma(x) + math.lgamma(y) - math.lgamma(x + y))
