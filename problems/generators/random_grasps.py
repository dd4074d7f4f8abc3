"""Random grasps: contacts in all directions, forces within their limits, and fingers with a few joints."""

from __future__ import annotations

from typing import Any

import numpy as np

from graspforce.contact import friction
from graspforce.contact.contact import ContactSet
from graspforce.core.arrays import Array
from graspforce.problems.derivations.records import Record
from graspforce.problems.generators.records import contact_set, round_numbers, rounded_contact

Generator = np.random.Generator


def random_directions(rng: Generator, count: int) -> Array:
    """Return (count, 3) unit vectors, uniformly distributed."""
    v = rng.normal(size=(count, 3))
    return np.asarray(v / np.linalg.norm(v, axis=1)[:, None])


def random_contacts(
    rng: Generator,
    count: int,
    *,
    models: tuple[str, ...] = ("point",),
    friction_range: tuple[float, float] = (0.2, 1.0),
    gamma_range: tuple[float, float] = (0.002, 0.02),
    max_normal: float | None = 50.0,
    radius: float | None = None,
) -> list[Record]:
    """Return the records of contacts on a rough sphere of 2 to 8 cm radius.

    Args:
        rng: random source.
        count: number of contacts.
        models: contact models to draw from.
        friction_range: range of μ.
        gamma_range: range of γ of soft contacts, m.
        max_normal: upper limit of all normal forces, N; None for no limit.
        radius: radius of the sphere, m; random if None.
    """
    r = rng.uniform(0.02, 0.08) if radius is None else radius  # m
    records = []
    for n in random_directions(rng, count):
        more: dict[str, Any] = {}
        model = str(rng.choice(models))
        if model != "frictionless":
            more["friction"] = float(np.exp(rng.uniform(*np.log(friction_range))))
        if model != "point":
            more["model"] = model
        if model == "soft":
            more["torsional_friction"] = float(np.exp(rng.uniform(*np.log(gamma_range))))
        if max_normal is not None:
            more["max_normal"] = max_normal
        records.append(rounded_contact(r * (-n + 0.1 * rng.normal(size=3)), n, **more))
    return records


def interior_forces(rng: Generator, contacts: ContactSet, share: float, mean: float = 3.0) -> Array:
    """Return (k,) stacked forces that use at most a share of each contact's friction and normal range.

    Args:
        rng: random source.
        contacts: the contacts.
        share: largest share of friction in use, below 1; below cos(π/m), the forces are also in inner pyramids of m facets.
        mean: mean of the normal forces above their lower limit, N.
    """
    count = len(contacts)
    normals = np.minimum(contacts.min_normal + rng.exponential(mean, count) + 0.02 * mean, 0.9 * contacts.max_normal)  # N
    used = random_directions(rng, count) * (share * rng.random(count))[:, None]
    padded = np.zeros((count, 4))
    padded[:, :2] = used[:, :2] * (contacts.mu * normals)[:, None]
    padded[:, friction.F_N] = normals
    padded[:, friction.M_N] = used[:, 2] * contacts.gamma * normals
    return np.asarray(padded.ravel()[contacts.columns])


def random_hand(
    rng: Generator,
    records: list[Record],
    f: Array,
    *,
    joint_range: tuple[int, int] = (3, 3),
    lever: float = 0.05,
    torque_headroom: tuple[float, float] = (1.05, 1.5),
    random_weights: bool = False,
) -> Record:
    """Return the record of a hand with one finger for each contact and torque limits above the torques of the forces f.

    Args:
        rng: random source.
        records: records of the contacts.
        f: (k,) stacked forces, N and N·m.
        joint_range: smallest and largest number of joints of a finger.
        lever: size of the Jacobian's entries, m/rad.
        torque_headroom: range of the ratio of limits to the torques of f.
        random_weights: whether torque weights differ between joints.
    """
    contacts = contact_set(records)
    each = rng.integers(joint_range[0], joint_range[1] + 1, size=len(contacts))
    ends = np.cumsum(each)
    J = np.zeros((contacts.size, int(each.sum())))
    for row, column in enumerate(contacts.columns):
        finger = column // 4
        unit = lever if column % 4 != friction.M_N else 1.0  # m/rad, rad/rad
        J[row, ends[finger] - each[finger] : ends[finger]] = rng.normal(size=each[finger]) * unit
    J = np.array(round_numbers(J), dtype=np.float64)
    typical = lever * float(np.abs(f).max())  # N·m
    tau_u = rng.normal(size=J.shape[1]) * 0.1 * typical
    most = np.abs(tau_u + J.T @ f) * rng.uniform(*torque_headroom, size=J.shape[1]) + 0.1 * typical
    record: Record = {"jacobian": round_numbers(J), "bias_torque": round_numbers(tau_u)}
    record |= {"torque_lower": round_numbers(-most), "torque_upper": round_numbers(most)}
    if random_weights:
        record["torque_weight"] = round_numbers(rng.uniform(0.5, 2.0, size=J.shape[1]))
    return record
