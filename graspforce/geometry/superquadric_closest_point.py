"""The foot of a point on a superquadric: Newton's method on the two arcs that its surface is made of.

In the octant of the point x = (a ρ α, b ρ β, c w), with (ρ, w) on the unit circle of the p₁-norm and (α, β) on that of the
p₂-norm. Of each pair the smaller number v varies, and the larger one follows:

    u = (1 − v^p)^(1/p),    du/dv = −(v/u)^(p−1),    d²u/dv² = −(p−1) v^(p−2) u^(1−2p).

Below p = 2 an arc is bent without bound where v = 0. There τ = v^(p−1) takes v's place: the slope ∂f/∂v of f = ½‖x − p‖² and
its rate ∂²f/∂v∂τ are smooth in τ, and Newton's step Δτ = −(∂²f/∂v∂τ)⁻¹ ∂f/∂v is the one that minimises f in v. It is halved
until it comes nearer. Numbers are Python's own: for one point they are quicker than arrays.
"""

from __future__ import annotations

_MAX_STEPS, _MAX_HALVINGS = 300, 40  # some five of the one and none of the other are usual; a needle of 700:1 takes a hundred
_STEP_TOLERANCE = 1e-12  # of the size: a step that is shorter has arrived
_ROUNDING_STEP = 1e-9  # of the size: f is blind to a step that is shorter, and its slopes are not
_MAX_ROUNDING_STEPS = 3  # such steps at most
_STRAIGHT_POWER = 1.0 + 1e-4  # powers below: the arc is a line, whose slope hardly changes before v is no number any more
_TINY = 1e-300
_MIN_TAU_FRACTION = 0.1  # of τ, at least, where no step may land on the end of an arc
_START_OFFSET = 1e-3  # how far from the end of an arc a search begins: by symmetry there may be a summit of f there

Point = tuple[float, float, float]
Pair = tuple[float, float]  # two numbers of a unit circle, ≥ 0


def minimise_distance(axes: Point, powers: Pair, p: Point, outer: Pair, inner: Pair, inside: bool) -> tuple[Point, float]:
    """The nearest point of the surface that lies downhill of a start, and f there, m².

    Args:
        axes: half-extents, m.
        powers: p₁ and p₂.
        p: the point, its coordinates ≥ 0, m.
        outer, inner: (ρ, w) and (α, β) of the start.
        inside: whether p is inside. Then a plane of symmetry may be a ridge of f, on which no step may land.
    """
    min_fraction = _MIN_TAU_FRACTION if inside else 0.0
    (a, b, c), (p1, p2), (px, py, pz), size = axes, powers, p, max(axes)
    first, second = _Arc(p1, outer), _Arc(p2, inner)
    x = _surface_point(axes, first.pair(first.tau), second.pair(second.tau))
    f, blind = _half_squared_distance(x, p), 0
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
        s_rests = first.tau == 0.0 and slope_s >= 0.0  # at the end of its arc, and held there
        t_rests = rho == 0.0 or (second.tau == 0.0 and slope_t >= 0.0)
        determinant = H_ss * H_tt - dt * ds * mixed * mixed
        if H_ss > 0.0 and H_tt > 0.0 and determinant > 1e-12 * H_ss * H_tt and not (s_rests or t_rests):
            step_s = (slope_t * dt * mixed - slope_s * H_tt) / determinant
            step_t = (slope_s * ds * mixed - slope_t * H_ss) / determinant
        else:  # one by one, downhill where f is hollow
            step_s = 0.0 if s_rests or H_ss == 0.0 else -slope_s / abs(H_ss)
            step_t = 0.0 if t_rests or H_tt == 0.0 else -slope_t / abs(H_tt)
        for halving in range(_MAX_HALVINGS):
            s = first.clamp(first.tau + step_s * 0.5**halving, min_fraction)
            t = second.clamp(second.tau + step_t * 0.5**halving, min_fraction)
            y = _surface_point(axes, first.pair(s), second.pair(t))
            g, moved = _half_squared_distance(y, p), max(abs(y[0] - x[0]), abs(y[1] - x[1]), abs(y[2] - x[2]))
            if g < f or moved <= _ROUNDING_STEP * size:
                break
        else:
            break  # no step comes nearer: x is the foot to rounding
        blind += g >= f
        x, f = y, g
        if moved <= _STEP_TOLERANCE * size or blind > _MAX_ROUNDING_STEPS:
            break
        first.move(s)
        second.move(t)
    return x, f


class _Arc:
    """A quarter of the unit circle of a p-norm, and a place on it: the smaller number by its τ, and whether it is the first."""

    __slots__ = ("_end", "_first", "_linear", "_p", "_straight", "tau")

    def __init__(self, p: float, pair: Pair) -> None:
        self._p = p
        self._straight = p < _STRAIGHT_POWER
        self._linear = p >= 2.0 or self._straight  # v itself is the variable
        self._end = self._tau((1.0 + 0.5 ** (1.0 / p)) / 2.0)  # beyond the middle of the arc, where u is not yet zero
        self._first = pair[0] < pair[1]
        self.tau = max(self._tau(min(pair)), self._tau(_START_OFFSET))

    def _tau(self, v: float) -> float:
        return v if self._linear else v ** (self._p - 1.0)

    def _vu(self, tau: float) -> Pair:
        v: float = tau if self._linear else tau ** (1.0 / (self._p - 1.0))
        u: float = (1.0 - v**self._p) ** (1.0 / self._p)
        return v, u

    def clamp(self, tau: float, min_fraction: float) -> float:
        return min(max(tau, min_fraction * self.tau), self._end)

    def pair(self, tau: float) -> Pair:
        v, u = self._vu(tau)
        return (v, u) if self._first else (u, v)

    def move(self, tau: float) -> None:
        """To another τ; beyond the middle of the arc it is seen from the other end."""
        v, u = self._vu(tau)
        self.tau = tau
        if v > u:
            self._first, self.tau = not self._first, self._tau(u)

    def derivatives(self) -> tuple[Pair, float, Pair, Pair]:
        """The pair, dv/dτ, the pair's d/dv, and its d²/dv² times dv/dτ."""
        p, tau = self._p, self.tau
        v, u = self._vu(tau)
        if self._linear:
            dv, slope = 1.0, -((max(v, _TINY) / u) ** (p - 1.0))
            bend = 0.0 if self._straight else -(p - 1.0) * v ** (p - 2.0) * u ** (1.0 - 2.0 * p)
        else:
            dv, slope = tau ** (1.0 / (p - 1.0) - 1.0) / (p - 1.0), -tau / u ** (p - 1.0)
            bend = -(u ** (1.0 - 2.0 * p))
        if self._first:
            return (v, u), dv, (1.0, slope), (0.0, bend)
        return (u, v), dv, (slope, 1.0), (bend, 0.0)


def _surface_point(axes: Point, outer: Pair, inner: Pair) -> Point:
    return axes[0] * outer[0] * inner[0], axes[1] * outer[0] * inner[1], axes[2] * outer[1]


def _half_squared_distance(x: Point, p: Point) -> float:
    return 0.5 * ((x[0] - p[0]) ** 2 + (x[1] - p[1]) ** 2 + (x[2] - p[2]) ** 2)
