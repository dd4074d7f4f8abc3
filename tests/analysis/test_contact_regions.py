"""Regions of contacts: closed forms on a sphere and below a plate, edges, limits, and what the moved contacts do."""

from __future__ import annotations

import json
import time

import numpy as np
import pytest

import graspforce as gf
from graspforce.analysis.contact_regions import contact_regions
from graspforce.cli import main
from graspforce.contact.closure import is_force_closed
from graspforce.geometry import Box, Cylinder, Sphere

RADIUS, FRICTION = 0.03, 0.4


def two_soft_contacts() -> gf.ForceProblem:
    """Return two opposed soft contacts on a sphere."""
    contacts = [
        gf.Contact((0, y, 0), (0, -y, 0), FRICTION, model="soft", torsional_friction=0.005, max_normal=10.0)
        for y in (RADIUS, -RADIUS)
    ]
    return gf.ForceProblem(contacts, (0, 0, 1.0, 0, 0, 0))


def test_a_soft_contact_on_a_sphere_may_move_by_four_friction_angles_of_half_its_radius():
    """The line between the contacts stays in both cones: an arc α turns it by α/2 against both normals, so α = 2 atan μ.

    A line follows the surface by chords of the steps, shorter than the arc by α h²/24 for steps of angle h. Its end is
    found to a 64th of a step, which is 0.05 mm of 23 mm.
    """
    arc = 2.0 * np.arctan(FRICTION) * RADIUS
    found = contact_regions(two_soft_contacts(), Sphere(RADIUS), "closure", directions=4)
    for region in found.regions:
        assert set(region.ends) == {"lost"}
        np.testing.assert_allclose(region.distances, arc, rtol=5e-3)
        place = two_soft_contacts().contacts.p_OC[region.contact]
        angles = np.arccos(region.points @ place / RADIUS**2)
        np.testing.assert_allclose(angles, 2.0 * np.arctan(FRICTION), rtol=3e-3)


def test_the_ends_of_regions_separate_closed_and_open_grasps():
    problem = two_soft_contacts()
    contacts = problem.contacts
    [region, _] = contact_regions(problem, Sphere(RADIUS), "closure", directions=4).regions
    for point in region.points:
        for beyond, is_closed in ((0.99, True), (1.01, False)):
            across = point - (point @ contacts.p_OC[0]) * contacts.p_OC[0] / RADIUS**2
            angle = beyond * np.arccos(point @ contacts.p_OC[0] / RADIUS**2)
            p = np.cos(angle) * contacts.p_OC[0] + RADIUS * np.sin(angle) * across / np.linalg.norm(across)
            moved = gf.Contact(p, -p, FRICTION, model="soft", torsional_friction=0.005)
            assert is_force_closed(gf.ContactSet.stack([moved, contacts.contacts[1]])) == is_closed


def plate(load: float = 1.0) -> gf.ForceProblem:
    """Return three frictionless contacts below a plate that carry its weight, N: at (40, 0), (−20, ±30) mm."""
    places = [(0.04, 0.0, -0.01), (-0.02, 0.03, -0.01), (-0.02, -0.03, -0.01)]
    contacts = [gf.Contact(p, (0, 0, 1), model="frictionless", tangent=(1, 0, 0)) for p in places]
    return gf.ForceProblem(contacts, (0, 0, load, 0, 0, 0))


def test_the_weight_of_a_plate_stays_above_its_supports():
    """The centre must be in the triangle: the first contact may move inwards by 40 mm, and by 60 mm across.

    Across, the line from (−20, ∓30) mm through the centre meets x = 40 mm at y = ±60 mm. Outwards, the plate ends after 60 mm.
    """
    [first, *_] = contact_regions(plate(), Box((0.2, 0.2, 0.02)), directions=4, largest=0.08).regions
    assert first.ends == ("edge", "lost", "lost", "lost")
    np.testing.assert_allclose(first.distances, (0.06, 0.06, 0.04, 0.06), rtol=2e-3)


def test_a_region_ends_at_an_edge_of_the_surface():
    """The upper end of the cylinder is 10 mm above the contacts, which have closure up to there."""
    angles = 2 * np.pi * np.arange(3) / 3
    contacts = [
        gf.Contact((0.03 * np.cos(a), 0.03 * np.sin(a), 0), (-np.cos(a), -np.sin(a), 0), 0.6, tangent=(0, 0, 1)) for a in angles
    ]
    problem = gf.ForceProblem(contacts, (0, 0, 1.0, 0, 0, 0))
    regions = contact_regions(problem, Cylinder(0.03, 0.02), "closure", directions=4, largest=0.1).regions
    assert all(region.ends[0] == region.ends[2] == "edge" for region in regions)
    for region in regions:
        assert region.distances[[0, 2]] == pytest.approx([0.01, 0.01], rel=1e-2)


def test_forces_exist_at_the_ends_of_payload_regions_also_with_motors():
    """More load shrinks the regions; motors that can bear less do, too."""
    problem, sphere = two_soft_contacts(), Sphere(RADIUS)
    light = contact_regions(problem, sphere, directions=4)
    heavy = contact_regions(problem.replace(w=[0, 0, 6.0, 0, 0, 0]), sphere, directions=4)
    J = np.zeros((8, 6))
    J[:3, :3] = J[4:7, 3:] = 0.05 * np.eye(3)
    weak = gf.Actuation(J, lower=[-0.15] * 6, upper=[0.15] * 6)
    driven = gf.ForceProblem(problem.contacts, [0, 0, 2.0, 0, 0, 0], weak)
    tired = contact_regions(driven, sphere, directions=4)
    assert light.regions[0].radius > heavy.regions[0].radius > 0.0
    assert 0.0 < tired.regions[0].radius < light.regions[0].radius
    overloaded = contact_regions(problem.replace(w=[0, 0, 9.0, 0, 0, 0]), sphere, directions=4)
    assert all((region.distances == 0.0).all() for region in overloaded.regions)


def test_refuses_contacts_off_the_surface_and_values_out_of_range():
    problem, sphere = two_soft_contacts(), Sphere(RADIUS)
    with pytest.raises(gf.InvalidInput, match=r"contacts\[0\].*on the surface"):
        contact_regions(problem, Sphere(0.04))
    for bad in ({"kept": "balance"}, {"directions": 3}, {"largest": 0.0}):
        with pytest.raises(gf.InvalidInput):
            contact_regions(problem, sphere, **bad)
    driven = gf.ForceProblem(plate().contacts, plate().w, gf.Actuation(np.eye(3), lower=[-1.0] * 3, upper=[1.0] * 3))
    with pytest.raises(gf.InvalidInput, match="along its normal only"):
        contact_regions(driven, Box((0.2, 0.2, 0.02)))
    assert contact_regions(problem, sphere, deadline=time.perf_counter() - 1.0).regions == ()


def test_the_command_takes_a_surface_and_draws_the_regions(tmp_path, capsys):
    file, picture = tmp_path / "pair.json", tmp_path / "regions.png"
    problem = two_soft_contacts()
    file.write_text(json.dumps(problem.to_dict()))
    command = ["quality", str(file), "--regions-plot", str(picture)]
    assert main([*command, "--object", f"sphere:{RADIUS}", "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert [region["kept"] for region in record["closure_regions"]] == ["closure", "closure"]
    expected = contact_regions(problem, Sphere(RADIUS), directions=8)
    for own, region in zip(record["payload_regions"], expected.regions, strict=True):
        np.testing.assert_allclose(own["distances"], region.distances, rtol=1e-12)
    assert picture.stat().st_size > 1000
    picture.unlink()
    assert main(command) == 1
    assert "--object" in capsys.readouterr().err


def test_quality_after_its_deadline_has_no_regions():
    late = gf.quality(two_soft_contacts(), shape=Sphere(RADIUS), seconds=0.0)
    assert late.closure_regions.regions == late.payload_regions.regions == ()
    assert "shift along" not in str(late)
