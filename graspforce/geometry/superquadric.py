"""Superquadric: ellipsoids, and the shapes between box, cylinder and double cone."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.core.records import set_fields
from graspforce.geometry.shape import SURFACE_TOLERANCE, Solid, SurfaceParameters
from graspforce.geometry.superquadric_closest_point import START_OFFSET, Pair, minimise_distance

_GRID_SIDE = np.linspace(0.0, 1.0, 33)  # fine enough to start in every basin of attraction of an octant
_POLE_RADIUS = 1e-3  # smaller ρ count as a pole
_NEAR_SURFACE = 1.01  # below this ψ, the radial projection is a better start than a grid point


@dataclass(frozen=True, eq=False, slots=True)
class _OctantGrid:
    """Grid of start points on an octant of the surface.

    Attributes:
        x: (33, 33, 3) points, m.
        outer: (33, 33, 2) their (ρ, w) as in `superquadric_closest_point`.
        inner: (33, 33, 2) their (α, β).
    """

    x: Array
    outer: Array
    inner: Array


@dataclass(frozen=True, eq=False, slots=True)
class Superquadric(Solid):
    """Superquadric: (|x/a|^(2/e2) + |y/b|^(2/e2))^(e2/e1) + |z/c|^(2/e1) = 1.

    For exponents up to 2 it is convex, and the left side to the power e1/2 is a norm ψ. With the p-norms N_p of two numbers,

        ψ(x) = N_{2/e1}( N_{2/e2}(|x/a|, |y/b|), |z/c| ),        φ = max(a, b, c) · (ψ − 1).

    The gradient of a norm does not vanish where ψ = 1. So the normal also exists in the axis planes, where the textbook form
    with trigonometric powers divides by zero. It does not exist on the edges of e = 2. In an axis plane the curvature is zero
    for e < 1 and infinite for e > 1. Volume and inertia are beta functions. Source: Jaklič, Leonardis and Solina (2000).

    Args:
        axes: (3,) half-extents a, b and c along x, y and z, m, > 0.
        exponents: (2,) e1 and e2, 0 < e ≤ 2. e1 shapes the sections through the z axis, e2 the sections orthogonal to it.
            A section is round at 1, approaches a square towards 0, and is a rhombus at 2.

    Raises:
        InvalidInput: an axis or exponent is out of range.
    """

    axes: Array
    exponents: Array
    _grid: _OctantGrid = field(init=False, repr=False)
    _places_without_normal: ClassVar[str] = "on an edge, at a tip or at the centre"

    if TYPE_CHECKING:  # the constructor accepts more types than the fields have

        def __init__(self, axes: npt.ArrayLike, exponents: npt.ArrayLike) -> None: ...

    def __post_init__(self) -> None:
        exponents = arrays.check_array(self.exponents, "exponents", (2,))
        for i in np.flatnonzero((exponents <= 0.0) | (exponents > 2.0)):
            raise InvalidInput(f"exponents[{i}]", float(exponents[i]), "greater than 0 and at most 2, so that it is convex")
        set_fields(self, axes=arrays.check_array(self.axes, "axes", (3,), above=0.0), exponents=exponents)
        set_fields(self, _grid=self._make_grid())

    def _make_grid(self) -> _OctantGrid:
        """Return the grid of start points for `closest_points`."""
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
    def primitive_parameters(self) -> SurfaceParameters:
        a, b, c = self.axes.tolist()
        e1, e2 = self.exponents.tolist()
        return "superquadric", a, b, c, e1, e2

    @property
    def volume(self) -> float:
        e1, e2 = self.exponents
        return float(2.0 * self.axes.prod() * e1 * e2 * _beta(e1 / 2.0, e1 + 1.0) * _beta(e2 / 2.0, e2 / 2.0 + 1.0))

    @property
    def _mean_products(self) -> Array:
        e1, e2 = self.exponents
        slices, section = _beta(e1 / 2.0, e1 + 1.0), _beta(e2 / 2.0, e2 / 2.0 + 1.0)
        across = _beta(e1 / 2.0, 2.0 * e1 + 1.0) / slices * _beta(1.5 * e2, e2 / 2.0) / (4.0 * section)
        along = _beta(1.5 * e1, e1 + 1.0) / slices
        return np.diag(self.axes**2 * [across, across, along])

    def _norms(self, p: Array) -> tuple[Array, Array, Array]:
        """Return u = |x|/axes (N, 3), ρ = N_{2/e2}(u_x, u_y) (N,) and ψ (N,)."""
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
        x, y = (np.where(pole, 0.5 ** (1.0 / p2), _ratio(u[:, i], rho)) for i in (0, 1))  # any direction at a pole
        r, z = _ratio(rho, psi), _ratio(u[:, 2], psi)
        zero = np.zeros(len(p))
        with np.errstate(divide="ignore", invalid="ignore"):  # the caller rejects infinite curvature
            # ∂²ψ = N_ρρ ∇ρ∇ρᵀ + N_ρz (∇ρ e_zᵀ + e_z ∇ρᵀ) + N_zz e_z e_zᵀ + N_ρ ∂²ρ, all in u
            d_rho = np.stack([x ** (p2 - 1.0), y ** (p2 - 1.0), zero], axis=1)
            e_z = np.array([0.0, 0.0, 1.0])
            N_rr = (p1 - 1.0) * r ** (p1 - 2.0) * z**p1 / psi
            N_rz = -(p1 - 1.0) * (r * z) ** (p1 - 1.0) / psi
            N_zz = (p1 - 1.0) * z ** (p1 - 2.0) * r**p1 / psi
            factor = (p2 - 1.0) * r ** (p1 - 2.0) / psi  # N_ρ/ρ, the factor of ∂²ρ
            H = N_rr[:, None, None] * d_rho[:, :, None] * d_rho[:, None, :]
            H += N_rz[:, None, None] * (d_rho[:, :, None] * e_z + e_z[:, None] * d_rho[:, None, :])
            H[:, 2, 2] += N_zz
            H[:, 0, 0] += factor * x ** (p2 - 2.0) * y**p2
            H[:, 1, 1] += factor * y ** (p2 - 2.0) * x**p2
            H[:, 0, 1] -= factor * (x * y) ** (p2 - 1.0)
            H[:, 1, 0] = H[:, 0, 1]
        if p1 == 2.0 and p2 != 2.0:
            H[pole] = np.nan  # the limit of the curvature depends on the direction
        sign = np.where(p < 0.0, -1.0, 1.0) / self.axes
        return np.asarray(self._largest_half_extent * H * sign[:, :, None] * sign[:, None, :])

    def closest_points(self, p: Array) -> Array:
        u, rho, psi = self._norms(p)
        points = [self._closest_point(p[i], u[i], float(rho[i]), float(psi[i])) for i in range(len(p))]
        return np.array(points).reshape(p.shape)

    def _closest_point(self, p: Array, u: Array, rho: float, psi: float) -> Array:
        """Return the closest point, by descent in the octant of p; by symmetry it is there.

        From outside, the distance has one minimum. The search starts at the radial projection of a point that is close to the
        surface, and otherwise at the closest grid point. From inside the distance may have several minima, and a search starts
        at each minimum on the grid. In the worst case the distance is accurate to rounding, and the position to the square root
        of that.

        Args:
            p: (3,) the point, m.
            u: (3,) |p|/axes.
            rho: N_{2/e2}(u_x, u_y).
            psi: ψ(p).
        """
        mirrored = np.abs(p)
        offset = START_OFFSET
        if psi < 1.0:
            starts = self._minima_on_grid(mirrored)
        elif psi < _NEAR_SURFACE and rho > 0.0:
            starts, offset = [((rho / psi, float(u[2]) / psi), (float(u[0]) / rho, float(u[1]) / rho))], 0.0
        else:
            starts = [self._closest_on_grid(mirrored, u, rho)]
        axes, (p1, p2) = self.axes.tolist(), (2.0 / self.exponents).tolist()
        found = [minimise_distance(axes, (p1, p2), mirrored.tolist(), *start, offset, psi < 1.0) for start in starts]
        return np.copysign(min(found, key=lambda closest: closest[1])[0], p)

    def _minima_on_grid(self, p: Array) -> list[tuple[Pair, Pair]]:
        """Return (ρ, w) and (α, β) of all local minima of the distance from p on the grid."""
        cost = ((self._grid.x - p) ** 2).sum(axis=-1)
        padded = np.pad(cost, 1, constant_values=np.inf)
        is_minimum = cost <= np.lib.stride_tricks.sliding_window_view(padded, (3, 3)).min(axis=(2, 3))
        return list(zip(self._grid.outer[is_minimum].tolist(), self._grid.inner[is_minimum].tolist(), strict=True))

    def _closest_on_grid(self, p: Array, u: Array, rho: float) -> tuple[Pair, Pair]:
        """Return (ρ, w) and (α, β) of the grid point that is closest to p."""
        cost = ((self._grid.x - p) ** 2).sum(axis=-1)
        best = np.unravel_index(cost.argmin(), cost.shape)
        outer, inner = self._grid.outer[best], self._grid.inner[best]
        if outer[0] < _POLE_RADIUS and rho > 0.0:  # at a pole the direction of the grid point is arbitrary
            inner = u[:2] / rho
        return (float(outer[0]), float(outer[1])), (float(inner[0]), float(inner[1]))


def _p_norm(a: Array, b: Array, p: float) -> Array:
    """Return (a^p + b^p)^(1/p) for a, b ≥ 0, without overflow."""
    largest = np.maximum(a, b)
    return np.asarray(largest * (_ratio(a, largest) ** p + _ratio(b, largest) ** p) ** (1.0 / p))


def _ratio(a: Array, b: Array) -> Array:
    """Return a/b, or zero where b is zero."""
    return np.asarray(np.divide(a, b, out=np.zeros_like(a), where=b > 0.0))


def _beta(x: float, y: float) -> float:
    """Return the beta function B(x, y) = Γ(x) Γ(y)/Γ(x + y)."""
    return math.exp(math.lgamma(x) + math.lgamma(y) - math.lgamma(x + y))
