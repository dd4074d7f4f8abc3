"""Proof files: a solution's statement with all numbers that prove it, for checkers in exact arithmetic.

``analysis/check_proof.py`` is such a checker. It reads the file alone and shares no code with this package.
"""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path

import numpy as np

from graspforce.contact.contact import ContactModel
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.whole_file import replace_file
from graspforce.force.certificate import Certificate, certify, certify_infeasibility
from graspforce.force.compiled_certificate import facet_friction, pyramid_vertices, used_level
from graspforce.force.multipliers import Multipliers
from graspforce.force.problem import ForceProblem
from graspforce.force.scale import scale
from graspforce.force.solution import Solution
from graspforce.force.status import Status

SCHEMA = "graspforce/proof/1"
_COMPONENTS = {model: len(model.columns) for model in ContactModel}


def make_proof(solution: Solution) -> JsonRecord:
    """Return the record of a proof: statement, problem data, forces, multipliers and a checksum of all.

    The statement of an optimum: the forces violate the constraints by at most ``violation``, relative to ``units``, and no
    forces that satisfy all constraints, with normal forces at contacts without max_normal of a sum up to ``reach``, cost less
    than the forces by more than ``gap``. With the objective "margin", the forces also satisfy the cones that are smaller by
    ``slip_margin``, and no forces satisfy those smaller by more than ``slip_margin`` + ``gap``. Of an infeasible problem: no
    forces up to ``reach`` satisfy the constraints. Pyramids are the cones over the polygons of the proof.

    Args:
        solution: an optimal or infeasible one.

    Raises:
        InvalidInput: a solution without verdict, with an uncertainty, or whose proof does not hold in exact arithmetic.
        BackendError: graspforce was installed without a C compiler.
    """
    problem, m = solution.original_problem, solution.multipliers
    if problem.uncertainty is not None:
        raise InvalidInput("uncertainty", "given", "absent: proofs are of problems with exact data")
    if m is None or not (solution.found or solution.status is Status.INFEASIBLE):
        raise InvalidInput("solution", solution.status.value, "one with a verdict: optimal or infeasible")
    if solution.found:
        certificate = certify(problem, solution.f, m, rigorous=True)
        m = m.about(problem.contacts.centroid)
    else:
        proof = certify_infeasibility(problem, m, rigorous=True)
        certificate, m = proof.certificate, proof.multipliers.about(problem.contacts.centroid)
    if not certificate.verified or certificate.proven is None:
        raise InvalidInput("solution", solution.status.value, "one whose proof holds in exact arithmetic")
    unit = scale(problem)
    record: JsonRecord = {
        "schema": SCHEMA,
        "claim": {"status": "optimal" if solution.found else "infeasible", **certificate.proven.to_dict()},
        **_data(problem),
        "units": {"force": float(unit.force), "length": float(unit.length), "torque": unit.torque.tolist()},
        "forces": solution.f.tolist() if solution.found else None,
        "multipliers": _multipliers(problem, m, certificate),
    }
    return {**record, "digest": digest(record)}


def write_proof(solution: Solution, path: str | os.PathLike[str]) -> None:
    """Write the proof of a solution to a JSON file.

    Args:
        solution: as in `make_proof`.
        path: path of the file.

    Raises:
        InvalidInput, BackendError: as `make_proof`.
    """
    text = json.dumps(make_proof(solution), indent=1)
    with replace_file(Path(path)) as temporary:
        temporary.write_text(text + "\n")


def digest(record: JsonRecord) -> str:
    """Return the SHA-256 checksum of a proof without its digest, as JSON with sorted keys and no spaces.

    Args:
        record: the proof.
    """
    content = {name: value for name, value in record.items() if name != "digest"}
    return hashlib.sha256(json.dumps(content, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def _data(problem: ForceProblem) -> JsonRecord:
    """Return the data of the statement: contacts with their frames, wrench, hand and objective."""
    c, objective = problem.contacts, problem.objective
    polygons, facets = pyramid_vertices(problem), facet_friction(problem)
    contacts = [
        {
            "components": _COMPONENTS[c.models[i]],
            "position": c.p_OC[i].tolist(),
            "frame": c.R_OC[i].tolist(),
            "friction": float(c.mu[i]),
            "torsional_friction": float(c.gamma[i]),
            "min_normal": float(c.min_normal[i]),
            "max_normal": _limit(c.max_normal[i]),
            "polygon": polygons[i].tolist(),
            "facet_friction": float(facets[i]),
        }
        for i in range(len(c))
    ]
    return {
        "contacts": contacts,
        "wrench": problem.w.tolist(),
        "hand": None if problem.actuation is None else problem.actuation.to_dict(),
        "objective": {
            "type": objective.type,
            "force_weight": objective.force_weight,
            "moment_length": objective.moment_length,
        },
        "separate_moment": problem.cone.side == "outer",
    }


def _multipliers(problem: ForceProblem, m: Multipliers, certificate: Certificate) -> JsonRecord:
    """Return the multipliers with negative ones, and those of absent limits, set to zero."""
    assert certificate.proven is not None  # checked by the caller
    c, actuation = problem.contacts, problem.actuation
    lower, upper = np.zeros((2, len(m.torque_lower)))
    if actuation is not None:
        lower, upper = _used(m.torque_lower, actuation.lower), _used(m.torque_upper, actuation.upper)
    return {
        "point": m.point.tolist(),
        "y": m.y.tolist(),
        "normal_lower": _used(m.normal_lower, c.min_normal).tolist(),
        "normal_upper": _used(m.normal_upper, c.max_normal).tolist(),
        "torque_lower": lower.tolist(),
        "torque_upper": upper.tolist(),
        "distance": certificate.proven.distance.tolist(),
        "level": used_level(m).tolist(),
    }


def _used(multiplier: Array, limit: Array) -> Array:
    """Return multipliers, zero where they are negative or the limit is absent."""
    return np.where(np.isfinite(limit), np.maximum(multiplier, 0.0), 0.0)


def _limit(value: float) -> float | None:
    """Return a limit, None for none."""
    return float(value) if np.isfinite(value) else None
