"""Rolling contact in C equals the reference in NumPy to rounding, at edges, corners and centres too."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.control_grasps import GRASP_NAMES, named_grasp
from support.tip_motions import HALF_EDGES, SHAPES, random_initial_contacts, random_rotations, random_tip_motion

from graspforce.contact import compiled_kinematics
from graspforce.contact.compiled_kinematics import rolling_contacts
from graspforce.contact.contact import ContactModel
from graspforce.contact.kinematics import (
    RollingContacts,
    TipContactState,
    rolling_contacts_reference,
    slip_displacement_reference,
)
from graspforce.contact.motion import BodyMotion
from graspforce.geometry import Box, Cylinder, ImplicitSurface, Sphere, Superquadric
from graspforce.geometry.shape import Shape

pytest.importorskip("graspforce.core._native", reason="the compiled module was not built: no C compiler at installation")

# The closest point's rate is a difference of coordinates, accurate to 1e-17 m, over 2e-4 s, multiplied by angular velocities:
# about 1e-13 m/s and 1e-12 m/s². All other numbers are a few products of numbers of order one.
ROUNDING = 1e-12


def random_models(rng: np.random.Generator, count: int) -> tuple[ContactModel, ...]:
    return tuple(rng.choice(np.array([ContactModel.POINT, ContactModel.SOFT, ContactModel.FRICTIONLESS], dtype=object), count))


def assert_near(ours: np.ndarray, theirs: np.ndarray, atol: float, name: str) -> None:
    """Assert that two arrays agree, relative to the largest number if that is above one."""
    assert ours.shape == theirs.shape
    np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=atol * max(1.0, np.abs(theirs).max()), err_msg=name)


def assert_same(found: RollingContacts, law: RollingContacts, atol: float = ROUNDING) -> None:
    """Assert that all arrays of two results agree."""
    for name in (field.name for field in fields(law) if field.name not in ("tip_contacts", "spin")):
        assert_near(getattr(found, name), getattr(law, name), atol, name)
    for name in (field.name for field in fields(TipContactState)):
        assert_near(getattr(found.tip_contacts, name), getattr(law.tip_contacts, name), atol, name)
    assert (found.spin is None) == (law.spin is None)
    if found.spin is not None and law.spin is not None:
        assert_near(found.spin.A, law.spin.A, atol, "spin.A")
        assert_near(found.spin.B, law.spin.B, atol, "spin.B")
        away = np.linalg.norm(law.p_OC - law.tip_contacts.p_OF, axis=1)  # m: what ṅ's velocities are divided by
        arm = np.minimum(1.0, np.where(away > 1e-9, away, 1.0))
        assert_near(found.spin.beta * arm, law.spin.beta * arm, atol, "spin.beta")


@pytest.mark.parametrize("name", SHAPES)
def test_contacts_of_any_hand_and_pose_are_those_of_the_reference(name: str) -> None:
    """One to five fingers of up to 16 joints, tips with and without a radius, all contact models, also in penetration."""
    rng = np.random.default_rng(11)
    for _ in range(150):
        count, n = int(rng.integers(1, 6)), int(rng.integers(1, 17))
        motion = BodyMotion(
            0.1 * rng.normal(size=3), random_rotations(rng, 1)[0], rng.normal(size=6) * [0.1, 0.1, 0.1, 1.0, 1.0, 1.0]
        )
        places, shape = 0.03 * rng.normal(size=(count, 3)), SHAPES[name]
        if shape is not None and np.abs(shape.phi(places)).min() < 1e-3:
            continue  # so close to the surface, the normal has fewer digits; see below
        tips = random_tip_motion(rng, motion.p_HO + places @ motion.R_HO.T, n)
        radii = rng.uniform(0.005, 0.015, count) * (rng.random(count) < 0.8)
        models = (ContactModel.POINT,) * count if rng.random() < 0.3 else random_models(rng, count)
        arguments = tips, radii, motion, shape, random_initial_contacts(rng, models), random_rotations(rng, count)
        law = rolling_contacts_reference(*arguments)
        assert_same(rolling_contacts(*arguments), law)
        assert np.abs(law.beta).max() > 1e-3  # m/s²: the convective terms matter


def critical_points(shape: Shape | None) -> list[list[float]]:
    """Return points at which the closest point is not unique or not smooth, exactly and to within rounding."""
    x, y, z = HALF_EDGES.tolist()
    if isinstance(shape, Sphere):
        places = [[0.0, 0.0, 0.0], [0.0, 0.0, -0.03], [0.03, 0.0, 0.0], [0.0, -0.0, 1e-12], [-1e-300, 0.0, 0.0]]
    elif isinstance(shape, Cylinder):
        r, h = shape.radius, shape.height / 2.0
        places = [[0.0, 0.0, 0.0], [0.0, 0.0, h], [0.0, 0.0, -h - 0.01], [r, 0.0, h], [0.0, -r, -h], [r + 0.01, 0.0, h + 0.01]]
        places += [[r - 0.01, 0.0, h - 0.01], [0.0, r - 0.01, 0.01 - h], [r, 0.0, 0.0], [r, 0.0, -0.0], [-1e-300, 0.0, 0.01]]
    else:
        places = [[0.0, 0.0, 0.0], [x, y, z], [-x, y, -z], [x + 0.01, y + 0.01, z + 0.01], [x + 0.01, -y, z], [-0.0, y, 0.0]]
        places += [[x - 0.01, y - 0.01, 0.0], [0.0, 0.01 - y, z - 0.01], [x - 0.01, y - 0.01, z - 0.01], [x, 0.0, z + 0.01]]
    return [*places, *(np.nextafter(place, toward).tolist() for place in places for toward in (0.0, 1.0, -1.0))]


@pytest.mark.parametrize("name", ["sphere", "cylinder", "disc", "box"])
def test_contacts_at_edges_corners_rims_and_centres_are_those_of_the_reference(name: str) -> None:
    """O is parallel to H, so that both forms get identical coordinates and choose the same of two equally close points."""
    rng = np.random.default_rng(12)
    places = np.array(critical_points(SHAPES[name]))
    for at_rest in (True, False):
        tips = random_tip_motion(rng, places, 4)
        twist = np.zeros(6) if at_rest else np.array([0.05, -0.02, 0.03, 0.0, 0.0, 0.0])
        tips.rates[:, :3, 4] = (
            0.0 if at_rest else rng.choice([-0.125, 0.0, 0.125], size=(len(places), 3))
        )  # m/s, exact in binary
        motion = BodyMotion(np.zeros(3), np.eye(3), twist)
        contacts = random_initial_contacts(rng, (ContactModel.SOFT,) * len(places))
        arguments = tips, np.full(len(places), 0.01), motion, SHAPES[name], contacts, random_rotations(rng, len(places))
        law = rolling_contacts_reference(*arguments)
        assert_same(rolling_contacts(*arguments), law)
        shape = SHAPES[name]
        assert shape is not None
        np.testing.assert_allclose(law.p_OC, shape.project_to_surface(places), rtol=0.0, atol=1e-16)


def test_frames_over_an_edge_and_at_the_surface_are_those_of_the_reference() -> None:
    """n has turned into the previous t₁, or the centre is too close to the surface to determine a normal."""
    rng, n = np.random.default_rng(13), 2
    for off in (0.0, 1e-17, -5e-10, 3e-10, 0.9e-9, 1.1e-9, -1e-7, 1e-7):  # m, on both sides of the tolerance
        for side in (1.0, -1.0):
            for tilt in (0.0, 1e-17, 0.9e-9, 1.1e-9, 1e-6):  # rad, likewise
                before = (Rotation.from_rotvec([tilt, 0.0, 0.0]) * Rotation.from_euler("y", side * np.pi / 2)).as_matrix()[None]
                tips = random_tip_motion(rng, np.array([[0.0, 0.0, side * (HALF_EDGES[2] + off)]]), n)
                motion, contacts = BodyMotion(np.zeros(3), np.eye(3)), random_initial_contacts(rng, (ContactModel.SOFT,))
                arguments = tips, np.array([0.01]), motion, SHAPES["box"], contacts, before
                law = rolling_contacts_reference(*arguments)
                # A direction from a length of 1e-9 m or an angle of 1e-9 rad has seven digits.
                found = rolling_contacts(*arguments)
                assert_same(found, law, 1e-6 if abs(off) < 1e-6 or tilt < 1e-6 else ROUNDING)
                assert_near(found.p_OC, law.p_OC, 1e-16, "p_OC")
                # A previous t₂ that is kept may deviate from the tangent plane by the tolerance.
                np.testing.assert_allclose(found.R_OC[0].T @ found.R_OC[0], np.eye(3), atol=1e-9)


@pytest.mark.parametrize("name", GRASP_NAMES)
def test_contacts_of_every_grasp_in_c_are_those_of_the_reference(name: str) -> None:
    grasp, rng = named_grasp(name), np.random.default_rng(14)
    radii = np.array([grasp.hand.finger(finger).tip_radius or 0.0 for finger in grasp.fingers])
    for _ in range(5):
        q, v = grasp.q + 0.02 * rng.normal(size=grasp.hand.n), 0.3 * rng.normal(size=grasp.hand.n)
        motion = BodyMotion(grasp.p_HO + 1e-3 * rng.normal(size=3), grasp.R_HO, 0.1 * rng.normal(size=6))
        arguments = (
            grasp.hand.tip_motion(q, v, grasp.fingers),
            radii,
            motion,
            grasp.body.shape,
            grasp.contacts,
            grasp.contacts.R_OC,
        )
        law = rolling_contacts_reference(*arguments)
        assert_same(rolling_contacts(*arguments), law)


def test_implicit_surfaces_and_meshes_are_not_compiled() -> None:
    assert ImplicitSurface(lambda p: p @ p - 1.0, lambda p: 2.0 * p, 1.0).primitive_parameters is None
    assert Superquadric([0.03, 0.02, 0.02], [0.5, 0.6]).primitive_parameters == ("superquadric", 0.03, 0.02, 0.02, 0.5, 0.6)
    assert Sphere(0.03).primitive_parameters == ("sphere", 0.03, 0.0, 0.0)
    assert Cylinder(0.03, 0.1).primitive_parameters == ("cylinder", 0.03, 0.05, 0.0)
    assert Box([0.02, 0.04, 0.06]).primitive_parameters == ("box", 0.01, 0.02, 0.03)


def test_slip_displacement_in_c_is_that_of_the_reference() -> None:
    rng = np.random.default_rng(15)
    for count in (1, 4):
        before, now = (
            TipContactState(rng.normal(size=(count, 3)), random_rotations(rng, count), rng.normal(size=(count, 3)))
            for _ in range(2)
        )
        R_OC = random_rotations(rng, count)
        found = compiled_kinematics.slip_displacement(before, now, R_OC)
        np.testing.assert_allclose(found, slip_displacement_reference(before, now, R_OC), rtol=0.0, atol=1e-14)
