"""Optimal forces as a differentiable function in JAX: `gf.jax`. Needs ``pip install "graspforce[jax]"``.

    gradient = jax.grad(lambda p: gf.jax.solve(problem, p=p).objective)(positions)

The solver runs on the CPU in double precision, as a callback, also within `jax.jit` and `jax.vmap`; a mapped axis is solved
and differentiated by the compiled kernel on all cores. Enable double precision
with ``jax.config.update("jax_enable_x64", True)``; otherwise JAX rounds data and results to single precision.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from graspforce.analysis.gradients import (
    OptimalForces,
    OptimumBatch,
    data_gradient,
    optimum_values,
    solve_with_data,
)
from graspforce.analysis.sensitivity import DegenerateOptima
from graspforce.core.errors import InvalidInput
from graspforce.core.optional_libraries import optional_imports
from graspforce.force.problem import ForceProblem
from graspforce.force.problem_data import data_shapes

with optional_imports("jax"):
    import jax
    import jax.numpy as jnp


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
    n = normals / jnp.linalg.norm(normals, axis=-1, keepdims=True)
    e_x, e_y = jnp.eye(3, dtype=n.dtype)[:2]
    t1 = jnp.cross(n, jnp.where(jnp.abs(n[..., :1]) >= 0.9, e_y, e_x))
    t1 = t1 / jnp.linalg.norm(t1, axis=-1, keepdims=True)
    return jnp.stack([t1, jnp.cross(n, t1), n], axis=-1)


@partial(jax.custom_vjp, nondiff_argnums=(0, 1))
def _optimum(problem: ForceProblem, degenerate: DegenerateOptima, data: dict[str, Any]) -> Any:
    """Return f, tau and the objective."""

    def run(values: dict[str, Any]) -> Any:
        """Solve on the CPU."""
        arrays, batch = _flat(problem, values)
        if batch:
            found = OptimumBatch(problem, arrays, degenerate).solutions
            return _unflat((found.f, found.torques, found.objective), batch, kind)
        return _unflat(optimum_values(solve_with_data(problem, arrays, degenerate)), batch, kind)

    kind = jnp.result_type(float)
    n = 0 if problem.actuation is None else len(problem.actuation.tau_u)
    shapes = tuple(jax.ShapeDtypeStruct(shape, kind) for shape in ((problem.size,), (n,), ()))
    return jax.pure_callback(run, shapes, data, vmap_method="broadcast_all")


def _forward(problem: ForceProblem, degenerate: DegenerateOptima, data: dict[str, Any]) -> Any:
    """Return the optimum, and its data for the backward pass."""
    return _optimum(problem, degenerate, data), data


def _backward(problem: ForceProblem, degenerate: DegenerateOptima, data: dict[str, Any], price: Any) -> Any:
    """Return the gradients of the data. The problem is solved again: callbacks pass arrays only."""

    def run(values: dict[str, Any], f: Any, tau: Any, objective: Any) -> Any:
        """Return the adjoint product on the CPU."""
        arrays, batch = _flat(problem, values)
        f, tau, objective = (np.asarray(seed, dtype=float) for seed in (f, tau, objective))
        if batch:
            f, tau, objective = (seed.reshape((-1, *seed.shape[len(batch) :])) for seed in (f, tau, objective))
            gradient = OptimumBatch(problem, arrays, degenerate).gradient(f, tau, objective)
        else:
            gradient = data_gradient(solve_with_data(problem, arrays, degenerate), f, tau, float(objective))
        return {name: _unflat((gradient[name],), batch, value.dtype)[0] for name, value in values.items()}

    shapes = {name: jax.ShapeDtypeStruct(value.shape, value.dtype) for name, value in data.items()}
    return (jax.pure_callback(run, shapes, data, *price, vmap_method="broadcast_all"),)


def _flat(problem: ForceProblem, values: dict[str, Any]) -> tuple[dict[str, Any], tuple[int, ...]]:
    """Return arrays of JAX as arrays of NumPy with at most one batch axis, and the batch axes of `jax.vmap`."""
    shapes = data_shapes(problem)
    batch: tuple[int, ...] = ()
    arrays = {name: np.asarray(value, dtype=float) for name, value in values.items()}
    for name, value in arrays.items():
        batch = value.shape[: value.ndim - len(shapes[name])] if name in shapes else batch
    if not batch:
        return arrays, ()
    return {name: value.reshape((-1, *value.shape[len(batch) :])) for name, value in arrays.items()}, batch


def _unflat(values: tuple[Any, ...], batch: tuple[int, ...], kind: Any) -> tuple[Any, ...]:
    """Return results with the batch axes of `jax.vmap`, in the type of JAX."""
    return tuple(value.astype(kind).reshape((*batch, *value.shape[bool(batch) :])) for value in values)


_optimum.defvjp(_forward, _backward)
