"""Optimal forces as a differentiable function in PyTorch: `gf.torch`. Needs ``pip install "graspforce[torch]"``.

    forces = gf.torch.solve(problem, p=positions, normals=normals)
    forces.objective.backward()

The forward pass solves and certifies the problem; the backward pass is one linear solve of the optimality conditions. Tensors
may have any floating-point type and device; the computation is in double precision on the CPU. Tensors with a batch axis in
front are M problems, which the compiled kernel solves and differentiates on all cores.
"""

from __future__ import annotations

from typing import Any

from graspforce.analysis.gradients import (
    OptimalForces,
    OptimumBatch,
    data_gradient,
    is_batch,
    optimum_values,
    solve_with_data,
)
from graspforce.analysis.sensitivity import DegenerateOptima
from graspforce.core.errors import InvalidInput
from graspforce.core.optional_libraries import optional_imports
from graspforce.force.problem import ForceProblem

with optional_imports("torch"):
    import torch


def solve(
    problem: ForceProblem,
    *,
    normals: torch.Tensor | None = None,
    degenerate: DegenerateOptima = "error",
    **data: torch.Tensor,
) -> OptimalForces:
    """Return the optimal forces of a problem whose data are tensors.

    Args:
        problem: the force problem, with exact cones and the objective "torque", "force" or "sum_normal". Its data apply where
            no tensor is given.
        normals: (N, 3) inward contact normals in O, of any length; the contact frames follow from them as in `contact_frames`.
            Excludes `R`.
        degenerate: "error", or "least_squares" as in `graspforce.sensitivities`.
        data: `w` (6,), `mu` (N,), `p` (N, 3), `R` (N, 3, 3), and with a hand `tau_u`, `torque_lower`, `torque_upper` (n,) and
            `J` (k, n), in the units of `ForceProblem`. Any of them, and `normals`, may have a batch axis (M, …) in front: the
            results then have it, too.

    Raises:
        InvalidInput: no forces exist, the optimum is degenerate, or a value is not allowed.
        UnsupportedProblem: an objective or a cone without derivatives.
    """
    if normals is not None:
        if "R" in data:
            raise InvalidInput("normals", "given", "absent with R")
        data["R"] = contact_frames(normals)
    f, tau, objective, reasons = _Optimum.apply(problem, degenerate, tuple(data), *data.values())
    return OptimalForces(f, tau, objective, reasons)


def contact_frames(normals: torch.Tensor) -> torch.Tensor:
    """Return (N, 3, 3) contact frames with the tangents that `Contact` has by default: t₁ = n × e_x, or n × e_y.

    Args:
        normals: (N, 3) or (M, N, 3) inward normals, of any length but zero.
    """
    n = normals / normals.norm(dim=-1, keepdim=True)
    e_x, e_y = torch.eye(3, dtype=n.dtype, device=n.device)[:2]
    other = torch.where(n[..., :1].abs() >= 0.9, e_y, e_x)
    t1 = torch.linalg.cross(n, other)
    t1 = t1 / t1.norm(dim=-1, keepdim=True)
    return torch.stack([t1, torch.linalg.cross(n, t1), n], dim=-1)


class _Optimum(torch.autograd.Function):  # type: ignore[misc]  # its type is not read
    """The optimum as a function of its data, with the adjoint product as the backward pass."""

    @staticmethod
    def forward(ctx: Any, problem: ForceProblem, degenerate: DegenerateOptima, names: tuple[str, ...], *data: Any) -> Any:
        """Solve the problem or the batch; keep its derivatives for the backward pass."""
        arrays = {name: value.detach().cpu().numpy() for name, value in zip(names, data, strict=True)}
        if is_batch(problem, arrays):
            batch = OptimumBatch(problem, arrays, degenerate)
            ctx.answer, reasons = batch, batch.degenerate
            values = (batch.solutions.f, batch.solutions.torques, batch.solutions.objective)
        else:
            answer = solve_with_data(problem, arrays, degenerate)
            ctx.answer, reasons = answer, answer.degenerate
            values = optimum_values(answer)
        ctx.names, ctx.data = names, [(value.dtype, value.device, value.dim()) for value in data]
        like = data[0] if data else torch.zeros((), dtype=torch.float64)
        tensors = (torch.tensor(value, dtype=like.dtype, device=like.device) for value in values)
        return (*tensors, reasons)

    @staticmethod
    @torch.autograd.function.once_differentiable  # type: ignore[untyped-decorator]
    def backward(ctx: Any, f: Any, tau: Any, objective: Any, _: Any) -> Any:
        """Return the gradients of the data."""
        f, tau, objective = (value.detach().cpu().numpy().astype(float) for value in (f, tau, objective))
        if isinstance(ctx.answer, OptimumBatch):
            gradient = ctx.answer.gradient(f, tau, objective)
        else:
            gradient = data_gradient(ctx.answer, f, tau, float(objective))
        tensors = []
        for name, (kind, device, dimensions) in zip(ctx.names, ctx.data, strict=True):
            value = gradient[name]
            own = value if value.ndim == dimensions else value.sum(axis=0)  # data that all problems share
            tensors.append(torch.tensor(own, dtype=kind, device=device))
        return (None, None, None, *tensors)
