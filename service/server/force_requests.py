"""Force problems of requests, and their size."""

from __future__ import annotations

import numpy as np

from graspforce.contact.contact import ContactSet
from graspforce.core import arrays
from graspforce.core.errors import RequestRefused
from graspforce.force.problem import ForceProblem
from graspforce.grasp.hand_contacts import check_contact_links
from graspforce.hand.hand import GRAVITY_PALM_UP, Hand
from graspforce.service.wire.distribute_records import DistributeRequest


def make_force_problem(hand: Hand, request: DistributeRequest) -> ForceProblem:
    """Return the force problem of a hand that holds an object.

    Args:
        hand: the hand.
        request: posture, object pose, contacts and wrench.

    Raises:
        InvalidInput: a vector does not fit the hand's joints; names the field of the request.
        UnknownName: the hand does not have a finger or link.
    """
    check_contact_links(hand, request.fingers, "contacts", ".finger")
    joint_vectors = [(request.q, "posture"), (request.v, "velocity"), (request.a, "acceleration")]
    q, v, a = (arrays.check_array(np.zeros(hand.n) if x is None else x, field, (hand.n,)) for x, field in joint_vectors)
    contacts = ContactSet.stack(request.contacts)
    tau_u = hand.inverse_dynamics(q, v, a, GRAVITY_PALM_UP if request.gravity is None else request.gravity)  # N·m
    actuation = hand.actuation(q, request.fingers, contacts, request.p_HO, request.R_HO, tau_u=tau_u)
    return ForceProblem(contacts, request.w, actuation, request.cone, request.objective, uncertainty=request.uncertainty)


def count_matrix_entries(problem: ForceProblem) -> int:
    """Return the entries of the dense matrix of all constraints: equilibrium, cones, normal forces and torques.

    Args:
        problem: the problem.
    """
    joints = 0 if problem.actuation is None else problem.actuation.J.shape[1]
    cone_rows = problem.size if problem.cone.type == "exact" else len(problem.contacts) * (problem.cone.facets + 1)
    return problem.size * (6 + cone_rows + 2 * len(problem.contacts) + 2 * joints)


def check_matrix_entries(problem: ForceProblem, most: int) -> int:
    """Return the entries of a problem's constraint matrix.

    Args:
        problem: the problem.
        most: largest allowed number.

    Raises:
        RequestRefused: there are more.
    """
    entries = count_matrix_entries(problem)
    if entries > most:
        limit = f"at most {most} are allowed; use fewer contacts, joints or facets"
        raise RequestRefused("too_large", f"the problem's constraint matrix has {entries} entries: {limit}")
    return entries
