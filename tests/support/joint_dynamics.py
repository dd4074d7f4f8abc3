"""Forward dynamics and motions of mechanisms, for tests of the joint laws."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

GRAVITY = np.array([1.0, -4.0, -8.9])  # m/s², in a general direction


def acceleration(mechanism, q, v, tau, g) -> np.ndarray:
    """Return the forward dynamics M⁻¹ (tau − c − g)."""
    rest = np.zeros_like(q)
    M = np.transpose([mechanism.inverse_dynamics(q, rest, e, np.zeros(3)) for e in np.eye(len(q))])
    return np.linalg.solve(M, tau - mechanism.inverse_dynamics(q, v, rest, g))


def follow(mechanism, law, q, v, times, g=GRAVITY, rtol=1e-9, method="DOP853"):
    """Return (q, v) at the times under ``law(t, q, v) -> tau``, (len(times), 2, n)."""
    n = len(q)

    def rates(t, x):
        return np.concatenate([x[n:], acceleration(mechanism, x[:n], x[n:], law(t, x[:n], x[n:]), g)])

    run = solve_ivp(rates, (0.0, times[-1]), np.concatenate([q, v]), method=method, t_eval=times, rtol=rtol, atol=1e-3 * rtol)
    assert run.success, run.message
    return run.y.T.reshape(len(times), 2, n)
