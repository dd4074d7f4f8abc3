"""Seeded random force problems: all contact models, cones and objectives, feasible by construction or overloaded."""

from __future__ import annotations

import numpy as np

from graspforce import Actuation, Cone, Contact, ContactModel, ContactSet, ForceProblem, Objective
from graspforce.contact.matrices import grasp_matrix

MODELS = ("frictionless", "point", "soft")


def random_contacts(rng: np.random.Generator, count: int, models: tuple[str, ...] = MODELS) -> list[Contact]:
    """Return contacts around an object of 2 to 8 cm, with friction 0.2 to 1 and some normal-force limits."""
    radius = rng.uniform(0.02, 0.08)  # m
    bounded = rng.random() < 0.6
    contacts = []
    for _ in range(count):
        normal = rng.normal(size=3)
        normal /= np.linalg.norm(normal)
        contacts.append(
            Contact(
                position=-radius * normal + rng.normal(size=3) * 0.005,
                normal=normal * rng.uniform(0.1, 10.0),
                friction=rng.uniform(0.2, 1.0),
                model=ContactModel(rng.choice(models)),
                tangent=rng.normal(size=3),
                torsional_friction=rng.uniform(0.002, 0.02),
                min_normal=rng.choice([0.0, 0.1]),
                max_normal=rng.choice([20.0, 50.0]) if bounded else None,
            )
        )
    return contacts


def inner_forces(rng: np.random.Generator, contacts: ContactSet, share: float) -> np.ndarray:
    """Return stacked forces that use at most ``share`` of each contact's friction and normal-force range."""
    count = len(contacts)
    normals = np.minimum(contacts.min_normal + rng.exponential(3.0, count) + 0.05, 0.95 * contacts.max_normal)  # N
    direction = rng.normal(size=(count, 3))
    direction *= (share * rng.random(count) / np.linalg.norm(direction, axis=1))[:, None]
    padded = np.zeros((count, 4))
    padded[:, :2] = direction[:, :2] * (contacts.mu * normals)[:, None]
    padded[:, 2] = normals
    padded[:, 3] = direction[:, 2] * contacts.gamma * normals
    return padded.ravel()[contacts.columns]


def random_actuation(rng: np.random.Generator, contacts: ContactSet, f: np.ndarray) -> Actuation:
    """Return one finger of two to four joints per contact, with torque limits that the forces f satisfy; some are absent."""
    joints = rng.integers(2, 5, size=len(contacts))
    J = np.zeros((contacts.size, int(joints.sum())))
    ends = np.cumsum(joints)
    for row, column in enumerate(contacts.columns):
        finger = column // 4
        unit = 0.05 if column % 4 < 3 else 1.0  # m/rad, rad/rad
        J[row, ends[finger] - joints[finger] : ends[finger]] = rng.normal(size=joints[finger]) * unit
    tau_u = rng.normal(size=J.shape[1]) * 0.02  # N·m
    torque_limit = np.abs(tau_u + J.T @ f) * rng.uniform(1.001, 1.5, size=J.shape[1]) + 0.02  # N·m
    upper, lower = torque_limit.tolist(), (-torque_limit).tolist()
    for j in np.flatnonzero(rng.random(J.shape[1]) < 0.1):
        upper[j] = None
    weight = rng.uniform(0.5, 2.0, size=J.shape[1])
    return Actuation(J, tau_u, lower, upper, weight)


def random_problem(rng: np.random.Generator, overload_probability: float = 1 / 3) -> ForceProblem:
    """Return a problem of 2 to 8 contacts; half have a hand, and some require several times the load that is feasible.

    The cones are exact or pyramids, and the objective is any that the problem allows.
    """
    contacts = ContactSet.stack(random_contacts(rng, int(rng.integers(2, 9))))
    f = inner_forces(rng, contacts, share=0.6)  # inside even a four-facet inner pyramid: cos(π/4) = 0.707
    w = grasp_matrix(contacts) @ f * (rng.uniform(1.0, 30.0) if rng.random() < overload_probability else 1.0)  # N, N·m
    actuation = random_actuation(rng, contacts, f) if rng.random() < 0.5 else None
    cone = Cone() if rng.random() < 0.5 else Cone("pyramid", int(rng.integers(4, 13)), str(rng.choice(["inner", "outer"])))
    return ForceProblem(contacts, w, actuation, cone, random_objective(rng, contacts, actuation))


def random_objective(rng: np.random.Generator, contacts: ContactSet, actuation: Actuation | None) -> Objective:
    """Return any objective that the problem allows; half of the torque costs also weigh the forces."""
    kinds = ["force", "max_normal", "sum_normal"]
    if (contacts.mu > 0).any() and np.isfinite(contacts.max_normal[contacts.mu > 0]).any():
        kinds.append("margin")
    if actuation is not None:
        kinds += ["torque", "torque", "torque"]
    kind = str(rng.choice(kinds))
    return Objective(kind, float(rng.choice([0.0, 1e-4]))) if kind == "torque" else Objective(kind)


def feasible_problem(seed: int, count: int = 4, models=("point",), joints: int = 3) -> ForceProblem:
    """Return a feasible grasp with one finger per contact and torque limits that are not active."""
    rng = np.random.default_rng([30, seed])
    contacts = ContactSet.stack(random_contacts(rng, count, models))
    f = inner_forces(rng, contacts, 0.6)
    J = np.zeros((contacts.size, joints * count))
    for row, column in enumerate(contacts.columns):
        at = joints * (column // 4)
        J[row, at : at + joints] = rng.normal(size=joints) * (0.05 if column % 4 < 3 else 1.0)
    tau_u = rng.normal(size=J.shape[1]) * 0.02
    limit = np.abs(tau_u + J.T @ f) * 1.3 + 0.02
    return ForceProblem(contacts, grasp_matrix(contacts) @ f, Actuation(J, tau_u, -limit, limit))
