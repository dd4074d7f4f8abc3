"""Grasps with contacts on inner links, on the palm, and several on one finger."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from support.hands import load

import graspforce as gf
from graspforce.contact.matrices import grasp_matrix
from graspforce.control import ObjectController, write_controller
from graspforce.core.errors import InvalidInput, UnknownName
from graspforce.force.problem import ForceProblem
from graspforce.force.status import Status
from graspforce.geometry import Sphere
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.link_grasp import LinkGrasp
from graspforce.grasp.search import find_grasp
from graspforce.planning.task import GraspTask
from graspforce.service.server.force_requests import make_force_problem
from graspforce.service.wire.control_records import StreamSetup
from graspforce.service.wire.distribute_records import DistributeRequest
from graspforce.simulation import UrdfPlant, build_scene

BODY = gf.Body.solid(Sphere(0.03), 0.05)
STEP = 1e-6  # s


@pytest.fixture(scope="module")
def tips() -> Grasp:
    return find_grasp(load("dlr_hit2"), BODY, friction=0.7)


def surface_contact(grasp: Grasp, direction: list[float], model: str = "point") -> gf.Contact:
    """Return a contact of the ball in a direction of H, from its centre."""
    d = grasp.R_HO.T @ (np.array(direction) / np.linalg.norm(direction))
    return gf.Contact(0.03 * d, -d, 0.7, model, torsional_friction=0.003 if model == "soft" else None, max_normal=20.0)


@pytest.fixture(scope="module")
def enveloping(tips: Grasp) -> LinkGrasp:
    """Three fingertips, a second contact on the finger of the first, and the palm below."""
    prefix = tips.fingers[1]
    extra = [surface_contact(tips, [0.3, 0.2, -0.9], "soft"), surface_contact(tips, [0.0, 0.0, -1.0])]
    return LinkGrasp.from_grasp(tips, extra, [f"{prefix}_link_2", "palm"])


def test_contacts_at_the_tips_are_those_of_a_fingertip_grasp(tips: Grasp) -> None:
    same = LinkGrasp.from_grasp(tips)
    by_links = LinkGrasp(
        tips.hand, BODY, [tips.hand.finger(f).tip for f in tips.fingers], tips.contacts, tips.q, tips.p_HO, tips.R_HO
    )
    for grasp in (same, by_links):
        np.testing.assert_array_equal(grasp.actuation().J, tips.actuation().J)
        np.testing.assert_array_equal(grasp.force_problem().w, tips.force_problem().w)


def test_jacobian_is_the_velocity_of_the_material_points(enveloping: LinkGrasp) -> None:
    """J v against a difference of the positions of points that are fixed to the links, for all contacts."""
    hand, v = enveloping.hand, np.random.default_rng(4).normal(size=enveloping.hand.n)
    J, contacts = enveloping.actuation().J, enveloping.contacts
    rates = contacts.pad(J @ v)
    for i, name in enumerate(enveloping.links):
        link = hand.finger(name).tip if name in [finger.name for finger in hand.fingers] else name
        p_H = enveloping.p_HO + enveloping.R_HO @ contacts.p_OC[i]
        (p_0, R_0), (p_1, R_1), (p_2, R_2) = (hand.link_poses(enveloping.q + s * v)[link] for s in (0.0, STEP, -STEP))
        local = R_0.T @ (p_H - p_0)
        velocity = ((p_1 + R_1 @ local) - (p_2 + R_2 @ local)) / (2.0 * STEP)
        # second order, 1e-12 times third derivatives; and rounding, 1e-17/1e-6
        np.testing.assert_allclose(rates[i, :3], (enveloping.R_HO @ contacts.R_OC[i]).T @ velocity, atol=1e-9)


def test_links_load_only_the_joints_before_them(enveloping: LinkGrasp) -> None:
    hand, J, rows = enveloping.hand, enveloping.actuation().J, enveloping.contacts.pad
    loads = [np.abs(rows(column)).max(axis=1) for column in J.T]  # (n, N)
    inner, palm = 3, 4
    finger = hand.finger(enveloping.links[1])
    assert [loads[j][inner] > 1e-6 for j in finger.joints] == [True, True, False]  # joint 3 is beyond link 2
    assert all(loads[j][palm] == 0.0 for j in range(hand.n))
    others = [j for j in range(hand.n) if j not in finger.joints]
    assert all(loads[j][inner] == 0.0 for j in others)


def test_forces_are_certified_and_torques_add_up(enveloping: LinkGrasp) -> None:
    problem = enveloping.force_problem()
    solution = gf.solve(problem)
    assert solution.status is Status.OPTIMAL
    assert solution.certificate.verified
    # the torques from each contact alone, with its own Jacobian
    pose, total = (enveloping.p_HO, enveloping.R_HO), np.array(problem.actuation.tau_u)
    for link, contact, f in zip(enveloping.links, enveloping.contacts.contacts, solution.forces, strict=True):
        one = gf.ContactSet.stack([contact])
        total += enveloping.hand.contact_jacobian(enveloping.q, [link], one, *pose).T @ f
    np.testing.assert_allclose(solution.torques, total, atol=1e-12)


def test_further_contacts_never_cost_torque(tips: Grasp, enveloping: LinkGrasp) -> None:
    """Zero forces at the further contacts are allowed, so the optimum cannot rise. A palm below bears the weight alone."""
    fewer, more = gf.solve(tips.force_problem()), gf.solve(enveloping.force_problem())
    assert more.objective <= fewer.objective * (1.0 + 1e-6)
    palm = LinkGrasp(
        tips.hand, BODY, ["palm"], gf.ContactSet.stack([surface_contact(tips, [0.0, 0.0, -1.0])]), tips.q, tips.p_HO, tips.R_HO
    )
    resting = gf.solve(palm.force_problem())
    assert resting.status is Status.OPTIMAL
    np.testing.assert_allclose(resting.torques, palm.hand.gravity_torque(palm.q), atol=1e-12)
    assert np.linalg.norm(resting.forces[0]) == pytest.approx(0.05 * 9.81, rel=1e-9)


def test_impossible_load_is_proven_infeasible(tips: Grasp) -> None:
    """A palm above the ball cannot pull it up."""
    above = LinkGrasp(
        tips.hand, BODY, ["palm"], gf.ContactSet.stack([surface_contact(tips, [0.0, 0.0, 1.0])]), tips.q, tips.p_HO, tips.R_HO
    )
    solution = gf.solve(above.force_problem())
    assert solution.status is Status.INFEASIBLE
    assert solution.certificate.verified


def test_record_returns_the_grasp(enveloping: LinkGrasp) -> None:
    record = json.loads(json.dumps(enveloping.to_dict()))
    again = LinkGrasp.from_dict(record, enveloping.hand)
    assert again.to_dict() == enveloping.to_dict()
    assert again.links == enveloping.links


def test_distribute_request_accepts_links(enveloping: LinkGrasp) -> None:
    request = DistributeRequest(
        enveloping.q,
        enveloping.contacts.contacts,
        enveloping.links,
        enveloping.p_HO,
        enveloping.R_HO,
        enveloping.force_problem().w,
    )
    problem = make_force_problem(enveloping.hand, DistributeRequest.from_dict(request.to_dict()))
    assert isinstance(problem, ForceProblem)
    np.testing.assert_allclose(problem.actuation.J, enveloping.actuation().J, atol=1e-15)
    np.testing.assert_allclose(problem.G, grasp_matrix(enveloping.contacts), atol=1e-15)


def test_error_for_an_unknown_link_names_it(tips: Grasp) -> None:
    with pytest.raises(UnknownName, match=r"links\[3\] = 'toe': must be one of thumb, .*palm"):
        LinkGrasp.from_grasp(tips, [surface_contact(tips, [0.0, 0.0, -1.0])], ["toe"])
    with pytest.raises(InvalidInput, match=r"links = .*must be 3 names of links"):
        LinkGrasp(tips.hand, BODY, ["palm"], tips.contacts, tips.q, tips.p_HO, tips.R_HO)


def test_grasp_for_control_has_the_same_contacts_forces_and_tips(tips: Grasp, enveloping: LinkGrasp) -> None:
    grasp = enveloping.as_grasp()
    assert grasp.fingers == enveloping.links  # all names are unique here
    assert grasp.contact_errors().max() < 1e-12  # m
    np.testing.assert_allclose(grasp.actuation().J, enveloping.actuation().J, atol=1e-15)
    assert grasp.with_pads().contacts.models == enveloping.contacts.models
    for name in tips.fingers:
        assert grasp.hand.finger(name) == tips.hand.finger(name)
    twice = LinkGrasp.from_grasp(tips, [tips.contacts.contacts[0]], [tips.fingers[0]]).as_grasp()
    assert len(set(twice.fingers)) == len(tips.fingers) + 1
    assert twice.contact_errors().max() < 1e-5  # m, as near as the search put the fingertips


def test_files_plans_and_c_controllers_refuse_such_contacts_with_the_reason(enveloping: LinkGrasp, tmp_path: Path) -> None:
    grasp = enveloping.as_grasp()
    with pytest.raises(InvalidInput, match="files and streams of a Grasp take no contacts on inner links or the palm"):
        grasp.save(tmp_path / "grasp.json")
    with pytest.raises(InvalidInput, match="plans take no contacts on inner links or the palm"):
        GraspTask(grasp.hand, grasp.body, grasp.contacts, grasp.fingers)
    with pytest.raises(InvalidInput, match="C controllers take no contacts on inner links or the palm"):
        write_controller(grasp, tmp_path)
    enveloping.save(tmp_path / "links.json")
    with pytest.raises(InvalidInput, match=r"link_grasp/1.*must be one of graspforce/grasp/1"):
        Grasp.load(tmp_path / "links.json")


def test_control_plants_and_streams_name_the_conversion(enveloping: LinkGrasp) -> None:
    for make in (ObjectController, StreamSetup, build_scene, UrdfPlant):
        with pytest.raises(InvalidInput, match=r"grasp = 'LinkGrasp': must be a Grasp; LinkGrasp\.as_grasp returns one"):
            make(enveloping)
    with pytest.raises(InvalidInput, match="streams take no contacts on inner links or the palm"):
        StreamSetup(enveloping.as_grasp())
