"""Optimal forces as a differentiable function in JAX: `gf.jax`. Needs ``pip install "graspforce[jax]"``.

    gradient = jax.grad(lambda p: gf.jax.solve(problem, p=p).objective)(positions)

The solver runs on the CPU in double precision, as a callback, also within `jax.jit` and `jax.vmap`. Enable double precision
with ``jax.config.update("jax_enable_x64", True)``; otherwise JAX rounds data and results to single precision.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import numpy as np

from graspforce.analysis.gradients import data_gradient, solve_with_data
from graspforce.analysis.sensitivity import DegenerateOptima
from graspforce.core.errors import InvalidInput
from graspforce.core.optional_libraries import optional_imports
from graspforce.force.problem import ForceProblem

with optional_imports("jax"):
    import jax
    import jax.numpy as jnp


class OptimalForces(NamedTuple):
    """An optimum as JAX arrays.

    Args:
        f: (k,) stacked contact forces in the contact frames, N and N·m.
        tau: (n,) motor torques, N·m; empty without a hand.
        objective: value of the objective.
    """

    f: jax.Array
    tau: jax.Array
    objective: jax.Array


def solve(
    problem: ForceProblem,
    *,
    normals: jax.Array | None = None,
    degenerate: DegenerateOptima = "error",
    **data: jax.Array,
) -> OptimalForces:
    """Return the optimal forces of a problem whose data are JAX arrays.

    JAX raises the errors of the solver as its own error of callbacks, with the same text.

    Args:
        problem: the force problem, with exact cones and the objective "torque", "force" or "sum_normal". Its data apply where
            no array is given.
        normals: (N, 3) inward contact normals in O, of any length; the contact frames follow from them as in `contact_frames`.
            Excludes `R`.
        degenerate: "error", or "least_squares" as in `graspforce.sensitivities`.
        data: `w` (6,), `mu` (N,), `p` (N, 3), `R` (N, 3, 3), and with a hand `tau_u`, `torque_lower`, `torque_upper` (n,) and
            `J` (k, n), in the units of `ForceProblem`.

    Raises:
        InvalidInput: `normals` with `R`.
    """
    if normals is not None:
        if "R" in data:
            raise InvalidInput("normals", "given", "absent with R")
        data["R"] = contact_frames(normals)
    return OptimalForces(*_optimum(problem, degenerate, {name: jnp.asarray(value) for name, value in data.items()}))


def contact_frames(normals: jax.Array) -> jax.Array:
    """Return (N, 3, 3) contact frames with the tangents that `Contact` has by default: t₁ = n × e_x, or n × e_y.

    Args:
        normals: (N, 3) inward normals, of any length but zero.
    """
    n = normals / jnp.linalg.norm(normals, axis=1, keepdims=True)
    e_x, e_y = jnp.eye(3, dtype=n.dtype)[:2]
    t1 = jnp.cross(n, jnp.where(jnp.abs(n[:, :1]) >= 0.9, e_y, e_x))
    t1 = t1 / jnp.linalg.norm(t1, axis=1, keepdims=True)
    return jnp.stack([t1, jnp.cross(n, t1), n], axis=2)


@partial(jax.custom_vjp, nondiff_argnums=(0, 1))
def _optimum(problem: ForceProblem, degenerate: DegenerateOptima, data: dict[str, Any]) -> Any:
    """Return f, tau and the objective."""

    def run(values: dict[str, Any]) -> Any:
        """Solve on the CPU."""
        optimum = solve_with_data(problem, _numpy(values), degenerate).optimum
        results = (optimum.f, optimum.problem.torques(optimum.f), np.array(optimum.problem.cost(optimum.f)))
        return tuple(value.astype(kind) for value in results)

    kind = jnp.result_type(float)
    n = 0 if problem.actuation is None else len(problem.actuation.tau_u)
    shapes = tuple(jax.ShapeDtypeStruct(shape, kind) for shape in ((problem.size,), (n,), ()))
    return jax.pure_callback(run, shapes, data, vmap_method="sequential")


def _forward(problem: ForceProblem, degenerate: DegenerateOptima, data: dict[str, Any]) -> Any:
    """Return the optimum, and its data for the backward pass."""
    return _optimum(problem, degenerate, data), data


def _backward(problem: ForceProblem, degenerate: DegenerateOptima, data: dict[str, Any], price: Any) -> Any:
    """Return the gradients of the data. The problem is solved again: callbacks pass arrays only."""

    def run(values: dict[str, Any], f: Any, tau: Any, objective: Any) -> Any:
        """Return the adjoint product on the CPU."""
        answer = solve_with_data(problem, _numpy(values), degenerate)
        gradient = data_gradient(answer, np.asarray(f, float), np.asarray(tau, float), float(objective))
        return {name: gradient[name].astype(value.dtype) for name, value in values.items()}

    shapes = {name: jax.ShapeDtypeStruct(value.shape, value.dtype) for name, value in data.items()}
    return (jax.pure_callback(run, shapes, data, *price, vmap_method="sequential"),)


def _numpy(values: dict[str, Any]) -> dict[str, Any]:
    """Return arrays of JAX as arrays of NumPy."""
    return {name: np.asarray(value, dtype=float) for name, value in values.items()}


_optimum.defvjp(_forward, _backward)
