"""The request to distribute forces on the wire."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from support.service_requests import distribute_request

from graspforce.contact.contact import Contact
from graspforce.core.errors import InvalidInput
from graspforce.force.problem_options import Cone, Objective
from graspforce.hand.hand import Hand
from graspforce.service import DistributeRequest


@pytest.fixture(scope="module")
def request_record():
    return {**distribute_request(Hand.load("four_finger")).to_dict(), "gravity": [0.0, 9.81, 0.0], "velocity": [0.1] * 12}


def test_distribute_request_survives_the_wire(request_record):
    cone, objective = Cone("pyramid", 5, "outer"), Objective("sum_normal")
    errors = {"uncertainty": {"friction_error": [0.1], "mass_error": 0.2}}
    for change in ({}, errors, {"acceleration": [0.2] * 12, "cone": cone.to_dict(), "objective": objective.to_dict()}):
        record = {**request_record, **change}
        request = DistributeRequest.from_dict(record)
        back = request.to_dict()
        for was, now in zip(record["contacts"], back.pop("contacts"), strict=True):
            assert now["finger"] == was["finger"]
            for axis in ("position", "normal", "tangent"):  # normals are normalised again
                np.testing.assert_allclose(now[axis], was[axis], rtol=0, atol=1e-15)
        assert back == {name: value for name, value in record.items() if name != "contacts"}
    assert (request.cone, request.objective) == (cone, objective)


@given(quaternion=st.tuples(*[st.floats(-2.0, 2.0)] * 4).filter(lambda q: max(map(abs, q)) > 1e-150))
def test_quaternion_equals_its_rotation_matrix(request_record, quaternion):
    w, *xyz = np.array(quaternion) / max(map(abs, quaternion))
    body = {"position": request_record["object"]["position"], "quaternion": list(quaternion)}
    request = DistributeRequest.from_dict({**request_record, "object": body})
    # R = 1 + 2 w S + 2 S² with S = S(xyz), of the unit quaternion
    w, xyz = w / math.hypot(w, *xyz), np.array(xyz) / math.hypot(w, *xyz)
    S = np.array([[0, -xyz[2], xyz[1]], [xyz[2], 0, -xyz[0]], [-xyz[1], xyz[0], 0]])
    np.testing.assert_allclose(request.R_HO, np.eye(3) + 2 * w * S + 2 * S @ S, atol=1e-14)  # rounding of a few products


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"posture": None}, "posture"),
        ({"posture": [0.1, math.nan]}, "posture[1]"),
        ({"object": 3}, "object"),
        ({"object": {"position": [0, 0, 0]}}, "object"),
        ({"object": {"position": [0, 0], "quaternion": [1, 0, 0, 0]}}, "object.position"),
        ({"object": {"position": [0, 0, 0], "quaternion": [0, 0, 0, 0]}}, "object.quaternion"),
        ({"object": {"position": [0, 0, 0], "rotation": np.diag([1, 1, -1]).tolist()}}, "object.rotation"),
        ({"object": {"position": [0, 0, 0], "rotation": np.full((3, 3), 1e300).tolist()}}, "object.rotation"),
        ({"object": {"position": [0, 0, 0], "rotation": [[1, 0, 0], [0, 1, 1e-4], [0, 0, 1]]}}, "object.rotation"),
        ({"contacts": []}, "contacts"),
        ({"contacts": [5]}, "contacts[0]"),
        ({"contacts": [{"position": [0, 0, 0], "normal": [0, 0, 1], "friction": 1}]}, "contacts[0].finger"),
        ({"contacts": [{"position": [0, 0, 0], "normal": [0, 0, 1], "friction": 1, "finger": 2}]}, "contacts[0].finger"),
        ({"contacts": [{"position": [0, 0, 0], "normal": [0, 0, 1], "friction": -1, "finger": "a"}]}, "contacts[0].friction"),
        ({"contacts": [{"position": [0, 0, 0], "normal": [0, 0, 1], "tip": 1, "finger": "a"}]}, "contacts[0].tip"),
        ({"wrench": [1]}, "wrench"),
        ({"gravity": [0, -9.81]}, "gravity"),
        ({"velocity": "fast"}, "velocity"),
        ({"acceleration": [math.inf]}, "acceleration[0]"),
        ({"cone": {"type": "pyramid", "side": "left"}}, "cone.side"),
        ({"objective": {"type": "power"}}, "objective.type"),
        ({"torques": []}, "torques"),
    ],
)
def test_invalid_distribute_request_names_its_field(request_record, change, field):
    with pytest.raises(InvalidInput) as caught:
        DistributeRequest.from_dict({**request_record, **change})
    assert caught.value.field == field


def test_contacts_and_fingers_must_have_equal_number():
    contact = Contact([0, 0, 0], [0, 0, 1], friction=0.5)
    with pytest.raises(InvalidInput, match="one finger for each of 1 contacts"):
        DistributeRequest([0.0], (contact,), ("a", "b"), [0, 0, 0], np.eye(3), [0.0] * 6)


def test_rotation_with_seven_digits_is_accepted():
    R = Rotation.from_rotvec([0.4, 0.1, -0.7]).as_matrix().round(7)  # as typed by hand
    contact = Contact([0, 0, 0], [0, 0, 1], friction=0.5)
    np.testing.assert_array_equal(DistributeRequest([0.0], (contact,), ("a",), [0, 0, 0], R, [0.0] * 6).R_HO, R)
