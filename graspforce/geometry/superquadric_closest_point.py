"""Closest point of a superquadric to a point: Newton's method on the two arcs that generate the surface.

In the octant of the given point, x = (a ρ α, b ρ β, c w), with (ρ, w) on the unit circle of the p₁-norm and (α, β) on that of
the p₂-norm. The smaller number v of each pair is the variable, and the larger one is a function of it:

    u = (1 − v^p)^(1/p),    du/dv = −(v/u)^(p−1),    d²u/dv² = −(p−1) v^(p−2) u^(1−2p).

For p < 2 the curvature of an arc is unbounded at v = 0, and the variable is τ = v^(p−1) instead. Both ∂f/∂v and ∂²f/∂v∂τ of
f = ½‖x − p‖² are smooth in τ. The Newton step is Δτ = −(∂²f/∂v∂τ)⁻¹ ∂f/∂v, halved until f decreases.

Scalar arithmetic: for one point, NumPy's overhead dominates.
"""

from __future__ import annotations

_MAX_STEPS, _MAX_HALVINGS = 300, 40  # about 5 and 0 are typical; an ellipsoid of 700:1 needs about 100 steps
_STEP_TOLERANCE = 1e-12  # relative to the size: a shorter step has converged
_ROUNDING_STEP = 1e-9  # relative to the size: at a shorter step, f changes by rounding only, but its slopes are significant
_MAX_ROUNDING_STEPS = 20  # largest number of such steps
_STRAIGHT_POWER = 1.0 + 1e-4  # below this power an arc is treated as a line, because v underflows before its slope changes
_TINY = 1e-300
_MIN_TAU_FRACTION = 0.1  # smallest fraction of τ after a step that may not reach the end of an arc
START_OFFSET = 1e-3  # distance of the start from the end of an arc, where f may have a maximum by symmetry

Point = tuple[float, float, float]
Pair = tuple[float, float]  # two numbers of a unit circle, ≥ 0


def minimise_distance(
    axes: Point, powers: Pair, p: Point, outer: Pair, inner: Pair, offset: float, inside: bool
) -> tuple[Point, float]:
    """Return the local minimum of the distance from p that descent reaches from a start, and f = ½‖x − p‖² there.

    Args:
        axes: half-extents, m.
        powers: p₁ and p₂.
        p: the point, with coordinates ≥ 0, m.
        outer: (ρ, w) of the start.
        inner: (α, β) of the start.
        offset: smallest v of the start; `START_OFFSET` unless the start is close to the result.
        inside: whether p is inside. If so, f may have a maximum in a plane of symmetry, and no step may end there.

    Returns:
        x, m, and f, m².
    """
    min_fraction = _MIN_TAU_FRACTION if inside else 0.0
    (a, b, c), (p1, p2), (px, py, pz), size = axes, powers, p, max(axes)
    first, second = _Arc(p1, outer, offset), _Arc(p2, inner, offset)
    x = _surface_point(axes, first.pair(first.tau), second.pair(second.tau))
    f, rounding_steps = _half_squared_distance(x, p), 0
    for _ in range(_MAX_STEPS):
        (rho, w), ds, (d_rho, d_w), (dd_rho, dd_w) = first.derivatives()
        (alpha, beta), dt, (d_alpha, d_beta), (dd_alpha, dd_beta) = second.derivatives()
        X, Y, dX, dY = a * alpha, b * beta, a * d_alpha, b * d_beta
        rx, ry, rz = rho * X - px, rho * Y - py, c * w - pz  # x − p
        along, across = rx * X + ry * Y, rx * dX + ry * dY
        slope_s, slope_t = d_rho * along + d_w * c * rz, rho * across  # ∂f/∂v of either arc
        mixed = d_rho * (rho * (X * dX + Y * dY) + across)
        H_ss = ds * (d_rho * d_rho * (X * X + Y * Y) + c * c * d_w * d_w) + dd_rho * along + dd_w * c * rz
        H_tt = dt * rho * rho * (dX * dX + dY * dY) + rho * (rx * a * dd_alpha + ry * b * dd_beta)
        s_fixed = first.tau == 0.0 and slope_s >= 0.0  # at the end of the arc, with f increasing away from it
        t_fixed = rho == 0.0 or (second.tau == 0.0 and slope_t >= 0.0)
        determinant = H_ss * H_tt - dt * ds * mixed * mixed
        if H_ss > 0.0 and H_tt > 0.0 and determinant > 1e-12 * H_ss * H_tt and not (s_fixed or t_fixed):
            step_s = (slope_t * dt * mixed - slope_s * H_tt) / determinant
            step_t = (slope_s * ds * mixed - slope_t * H_ss) / determinant
        else:  # one variable at a time, downhill where f is concave
            step_s = 0.0 if s_fixed or H_ss == 0.0 else -slope_s / abs(H_ss)
            step_t = 0.0 if t_fixed or H_tt == 0.0 else -slope_t / abs(H_tt)
        for halving in range(_MAX_HALVINGS):
            s = first.clamp(first.tau + step_s * 0.5**halving, min_fraction)
            t = second.clamp(second.tau + step_t * 0.5**halving, min_fraction)
            y = _surface_point(axes, first.pair(s), second.pair(t))
            g, moved = _half_squared_distance(y, p), max(abs(y[0] - x[0]), abs(y[1] - x[1]), abs(y[2] - x[2]))
            if g < f or moved <= _ROUNDING_STEP * size:
                break
        else:
            break  # no step decreases f: converged to rounding
        rounding_steps += g >= f
        x, f = y, g
        if moved <= _STEP_TOLERANCE * size or rounding_steps > _MAX_ROUNDING_STEPS:
            break
        first.move(s)
        second.move(t)
    return x, f


class _Arc:
    """Point on a quarter of the unit circle of a p-norm: τ of the smaller number, and whether that is the first of the pair.

    Args:
        p: power of the norm.
        pair: the start, two numbers ≥ 0 on the unit circle.
        offset: smallest v of the start.
    """

    __slots__ = ("_end", "_first", "_linear", "_p", "_straight", "tau")

    def __init__(self, p: float, pair: Pair, offset: float) -> None:
        self._p = p
        self._straight = p < _STRAIGHT_POWER
        self._linear = p >= 2.0 or self._straight  # the variable is v itself
        self._end = self._tau((1.0 + 0.5 ** (1.0 / p)) / 2.0)  # beyond the middle of the arc, where u is still positive
        self._first = pair[0] < pair[1]
        self.tau = self._tau(max(min(pair), offset))

    def _tau(self, v: float) -> float:
        """Return τ of a number v."""
        return v if self._linear else v ** (self._p - 1.0)

    def _vu(self, tau: float) -> Pair:
        """Return the smaller and the larger number of the pair."""
        v: float = tau if self._linear else tau ** (1.0 / (self._p - 1.0))
        u: float = (1.0 - v**self._p) ** (1.0 / self._p)
        return v, u

    def clamp(self, tau: float, min_fraction: float) -> float:
        """Return τ limited to the arc, and to at least a fraction of its present value."""
        return min(max(tau, min_fraction * self.tau), self._end)

    def pair(self, tau: float) -> Pair:
        """Return the pair at τ, in its order."""
        v, u = self._vu(tau)
        return (v, u) if self._first else (u, v)

    def move(self, tau: float) -> None:
        """Move to another τ. Beyond the middle of the arc, the other number becomes the variable."""
        v, u = self._vu(tau)
        self.tau = tau
        if v > u:
            self._first, self.tau = not self._first, self._tau(u)

    def derivatives(self) -> tuple[Pair, float, Pair, Pair]:
        """Return the pair, dv/dτ, the derivative of the pair by v, and its second derivative times dv/dτ."""
        p, tau = self._p, self.tau
        v, u = self._vu(tau)
        if self._linear:
            dv, slope = 1.0, -((max(v, _TINY) / u) ** (p - 1.0))
            second = 0.0 if self._straight else -(p - 1.0) * v ** (p - 2.0) * u ** (1.0 - 2.0 * p)
        else:
            dv, slope = tau ** (1.0 / (p - 1.0) - 1.0) / (p - 1.0), -tau / u ** (p - 1.0)
            second = -(u ** (1.0 - 2.0 * p))
        if self._first:
            return (v, u), dv, (1.0, slope), (0.0, second)
        return (u, v), dv, (slope, 1.0), (second, 0.0)


def _surface_point(axes: Point, outer: Pair, inner: Pair) -> Point:
    """Return the point x of the surface, m."""
    return axes[0] * outer[0] * inner[0], axes[1] * outer[0] * inner[1], axes[2] * outer[1]


def _half_squared_distance(x: Point, p: Point) -> float:
    """Return f = ½‖x − p‖², m²."""
    return 0.5 * ((x[0] - p[0]) ** 2 + (x[1] - p[1]) ** 2 + (x[2] - p[2]) ** 2)
