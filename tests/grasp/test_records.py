"""Records of shapes, bodies, motions and grasps: reading inverts writing, and an error names the path of the field."""

from __future__ import annotations

import copy
import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.box_grasp import make_grasp
from support.hands import load

from graspforce.contact.motion import BodyMotion
from graspforce.core.errors import InvalidInput, UnknownName
from graspforce.geometry import Box, Cylinder, ImplicitSurface, Solid, Sphere, Superquadric
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp

GRASP = make_grasp()
R = Rotation.from_rotvec([0.4, -1.1, 0.3]).as_matrix()
SHAPES = [
    Sphere(0.03),
    Cylinder(0.02, 0.11),
    Box([0.06, 0.05, 0.04]),
    Superquadric([0.03, 0.02, 0.05], [0.4, 1.3]),
]


def as_json(record):
    """Return the record after a trip through JSON text."""
    return json.loads(json.dumps(record))


def assert_same_fields(one, other):
    """Assert that two frozen records have equal fields."""
    assert type(one) is type(other)
    for name in one.__dataclass_fields__:
        a, b = getattr(one, name), getattr(other, name)
        if hasattr(a, "__dataclass_fields__"):
            assert_same_fields(a, b)
        else:
            np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: type(shape).__name__)
def test_reading_a_shape_inverts_writing_it(shape):
    assert_same_fields(Solid.from_dict(as_json(shape.to_dict()), "shape"), shape)


def test_implicit_surface_has_no_record():
    with pytest.raises(InvalidInput, match="a function cannot be saved or sent"):
        ImplicitSurface(lambda p: float(p @ p) - 1.0, lambda p: 2.0 * p, 1.0).to_dict()


def test_reading_a_body_inverts_writing_it():
    ball = Body.solid(Sphere(0.03), 0.05)
    bare = Body(0.2, np.diag([2e-4, 3e-4, 4e-4]), [0.01, -0.02, 0.003])
    for body in (ball, bare):
        back = Body.from_dict(as_json(body.to_dict()), "body")
        assert back.mass == body.mass
        np.testing.assert_array_equal(back.inertia, body.inertia)
        np.testing.assert_array_equal(back.p_OM, body.p_OM)
        assert (back.shape is None) == (body.shape is None)


def test_inertia_defaults_to_uniform_density():
    record = {"mass": 0.05, "shape": {"type": "sphere", "radius": 0.03}}
    # 2/5 m r², the textbook's
    np.testing.assert_allclose(Body.from_dict(record, "body").inertia, 0.4 * 0.05 * 0.03**2 * np.eye(3), rtol=1e-12)


def test_motion_accepts_a_matrix_or_a_quaternion():
    motion = BodyMotion([0.1, -0.2, 0.3], R, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0], [-1.0, 0.5, 0.25, 3.0, 2.0, 1.0])
    assert_same_fields(BodyMotion.from_dict(as_json(motion.to_dict()), "desired"), motion)
    x, y, z, w = Rotation.from_matrix(R).as_quat()
    turned = BodyMotion.from_dict({"position": [0.1, -0.2, 0.3], "quaternion": [2 * w, 2 * x, 2 * y, 2 * z]}, "desired")
    np.testing.assert_allclose(turned.R_HO, R, atol=1e-15)
    np.testing.assert_array_equal(turned.twist, np.zeros(6))


def test_reading_a_grasp_inverts_writing_it():
    back = Grasp.from_dict(as_json(GRASP.to_dict()), GRASP.hand, "hold")
    assert back.fingers == GRASP.fingers
    for name in ("q", "p_HO", "R_HO"):
        np.testing.assert_array_equal(getattr(back, name), getattr(GRASP, name))
    # a normal and a tangent are normalised again on arrival: one rounding
    np.testing.assert_allclose(back.contacts.R_OC, GRASP.contacts.R_OC, atol=4e-16)
    np.testing.assert_array_equal(back.contacts.mu, GRASP.contacts.mu)


FAULTS = [
    (("body",), None, "hold.body", "a record"),
    (("body", "mass"), -1.0, "hold.body.mass", "greater than 0"),
    (("body", "weight"), 1.0, "hold.body.weight", "absent: the known fields are mass, inertia, centre_of_mass, shape"),
    (("body", "inertia"), [[1.0]], "hold.body.inertia", "an array of 3 × 3 numbers, not 1 × 1"),
    (("body", "inertia"), (-np.eye(3)).tolist(), "hold.body.inertia", "of principal moments that are positive"),
    (("body", "inertia"), None, "hold.body.centre_of_mass", "absent without inertia"),
    (("body", "centre_of_mass"), [0.0, float("nan"), 0.0], "hold.body.centre_of_mass[1]", "a finite number"),
    (("body", "shape"), {"type": "torus"}, "hold.body.shape.type", "one of sphere, cylinder, box, superquadric, mesh"),
    (("body", "shape"), 3, "hold.body.shape.type", "one of sphere"),
    (("body", "shape"), {"type": "sphere"}, "hold.body.shape.radius", "given"),
    (("body", "shape"), {"type": "sphere", "radius": 0.0}, "hold.body.shape.radius", "greater than 0"),
    (("body", "shape", "radius"), 1.0, "hold.body.shape.radius", "absent: the known fields are type, edges"),
    (("contacts",), [], "hold.contacts", "a list of at least 1"),
    (("contacts", 1, "friction"), -0.5, "hold.contacts[1].friction", "at least 0"),
    (("contacts", 2, "finger"), 5, "hold.contacts[2].finger", "text"),
    (("contacts", 2, "finger"), "finger_1", "hold.fingers", "4 different fingers"),
    (("posture",), [0.1], "hold.posture", "a list of 12 numbers, not 1"),
    (("object", "position"), "here", "hold.object.position", "a list of 3 numbers"),
    (("object", "rotation"), (2 * np.eye(3)).tolist(), "hold.object.rotation", "a rotation"),
    (("object", "quaternion"), [1, 0, 0, 0], "hold.object", "given with either rotation or quaternion"),
    (("object", "twist"), [0] * 6, "hold.object.twist", "absent"),
    (("hand",), "left", "hold.hand", "absent"),
]


@pytest.mark.parametrize(("path", "value", "field", "allowed"), FAULTS)
def test_error_names_the_path_of_the_field(path, value, field, allowed):
    record = copy.deepcopy(GRASP.to_dict())
    inner = record
    for step in path[:-1]:
        inner = inner[step]
    inner[path[-1]] = value
    with pytest.raises(InvalidInput) as caught:
        Grasp.from_dict(record, GRASP.hand, "hold")
    assert caught.value.field == field
    assert caught.value.allowed.startswith(allowed)


def test_error_of_an_unknown_finger_lists_the_fingers():
    record = as_json(GRASP.to_dict())
    record["contacts"][3]["finger"] = "thumb"
    with pytest.raises(UnknownName, match="finger_1, finger_2, finger_3, finger_4") as caught:
        Grasp.from_dict(record, GRASP.hand, "hold")
    assert caught.value.field == "hold.contacts[3].finger"


def test_loading_a_grasp_inverts_saving_it(tmp_path):
    GRASP.save(tmp_path / "grasp.json")
    for loaded in (Grasp.load(tmp_path / "grasp.json"), Grasp.load(tmp_path / "grasp.json", GRASP.hand)):
        assert loaded.hand.name == GRASP.hand.name
        assert loaded.fingers == GRASP.fingers
        np.testing.assert_array_equal(loaded.q, GRASP.q)
        np.testing.assert_array_equal(loaded.contacts.p_OC, GRASP.contacts.p_OC)
        assert loaded.body.to_dict() == GRASP.body.to_dict()


def test_grasp_of_another_hand_is_refused(tmp_path):
    GRASP.save(tmp_path / "grasp.json")
    with pytest.raises(InvalidInput, match="hand = 'dlr_hit2': must be four_finger, the hand of the grasp in"):
        Grasp.load(tmp_path / "grasp.json", load("dlr_hit2"))


def test_file_of_another_schema_is_refused(tmp_path):
    (tmp_path / "grasp.json").write_text('{"schema": "graspforce/plan/1", "hand": "four_finger", "grasp": {}}')
    with pytest.raises(InvalidInput, match="schema = 'graspforce/plan/1': must be one of graspforce/grasp/1"):
        Grasp.load(tmp_path / "grasp.json")
