"""Force problems that change a little from step to step, for the incremental kernel."""

from __future__ import annotations

import numpy as np

from graspforce import Actuation, Cone, ContactSet, ForceProblem, Objective
from graspforce.contact.matrices import grasp_matrix
from graspforce.core.arrays import freeze
from support.random_problems import inner_forces, random_actuation, random_contacts

CHANGEABLE = ("w", "J", "tau_u", "p", "R", "mu", "normal_limits")
MODELS = ("frictionless", "point", "soft")


def feasible_problem(rng: np.random.Generator, models: tuple[str, ...] = MODELS) -> ForceProblem:
    """Return a feasible problem with a hand, exact cones, an objective of the kernel, and O away from the contacts."""
    contacts = ContactSet.stack(random_contacts(rng, int(rng.integers(3, 8)), models))
    f = inner_forces(rng, contacts, share=0.6)
    kind = str(rng.choice(["torque", "force", "sum_normal"]))
    tight = random_actuation(rng, contacts, f)
    actuation = Actuation(tight.J, tight.tau_u, 1.5 * tight.lower, 1.5 * tight.upper, tight.weight)
    problem = ForceProblem(contacts, grasp_matrix(contacts) @ f, actuation, Cone(), Objective(kind, 1e-4 * (kind == "torque")))
    return move_origin(problem, 0.05 * rng.normal(size=3))


def move_origin(problem: ForceProblem, origin: np.ndarray) -> ForceProblem:
    """Return the same problem with the object frame's origin at another point, in O, m."""
    w = np.append(problem.w[:3], problem.w[3:] - np.cross(origin, problem.w[:3]))
    return problem.replace(p=problem.contacts.p_OC - origin, w=w)


def rotate_slightly(rng: np.random.Generator, R: np.ndarray) -> np.ndarray:
    """Return frames rotated by some milliradians, by the Cayley transform (1 − S/2)⁻¹ (1 + S/2), which is exact."""
    S = np.cross(np.eye(3), 2e-3 * rng.normal(size=(len(R), 1, 3)))
    return R @ np.linalg.solve(np.eye(3) - S / 2, np.eye(3) + S / 2)


def change_slightly(rng: np.random.Generator, problem: ForceProblem) -> dict[str, np.ndarray]:
    """Return all changeable arrays of a problem, changed by some thousandths."""
    p = problem.contacts.p_OC + 1e-5 * rng.normal(size=problem.contacts.p_OC.shape)
    R = rotate_slightly(rng, problem.contacts.R_OC)
    return {
        "w": problem.w * rng.uniform(0.998, 1.002, 6),
        "J": problem.actuation.J * rng.uniform(0.998, 1.002, problem.actuation.J.shape),
        "tau_u": problem.actuation.tau_u * rng.uniform(0.998, 1.002, len(problem.actuation.tau_u)),
        "p": p,
        "R": R,
        "mu": friction_rows(problem) * rng.uniform(0.998, 1.002, (2, len(p))),
        "normal_limits": normal_limits(problem) * rng.uniform(0.998, 1.002, (2, 1)),
    }


def friction_rows(problem: ForceProblem) -> np.ndarray:
    """Return the friction coefficients and the torsional friction lengths, (2, N)."""
    return freeze([problem.contacts.mu, problem.contacts.gamma])


def normal_limits(problem: ForceProblem) -> np.ndarray:
    """Return the smallest and the largest normal forces, (2, N), N."""
    return freeze([problem.contacts.min_normal, problem.contacts.max_normal])


def kernel_changes(**changes: object) -> list[object]:
    """Return named changes as the kernel takes them: in its order, None for arrays that stay, limits one by one."""
    limits, friction = changes.pop("normal_limits", None), changes.pop("mu", None)
    lower, upper = (None, None) if limits is None else np.asarray(limits)
    mu, gamma = (None, None) if friction is None else np.asarray(friction)
    return [*(changes.get(name) for name in ("w", "J", "tau_u", "p", "R")), mu, lower, upper, gamma]


def changeable_arrays(problem: ForceProblem) -> dict[str, np.ndarray]:
    """Return all changeable arrays of a problem."""
    contacts, actuation = problem.contacts, problem.actuation
    geometry = {"w": problem.w, "J": actuation.J, "tau_u": actuation.tau_u, "p": contacts.p_OC, "R": contacts.R_OC}
    return {**geometry, "mu": friction_rows(problem), "normal_limits": normal_limits(problem)}
