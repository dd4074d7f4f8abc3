"""The objects of Table 1 of 004."""

from __future__ import annotations

import math

import numpy as np
import pytest

from graspforce.problems.objects import DENSITIES, ist_objects

OBJECTS = ist_objects()
SPANS = {  # mm: what the fingers span, read off the table by hand
    "big green ball": 86,
    "medium green ball": 64,
    "small white ball": 54,
    "big red cylinder, top": 76,
    "big red cylinder, side": 76,
    "medium green cylinder, top": 38,
    "medium green cylinder, side": 38,
    "small red cylinder, top": 27,
    "small red cylinder, side": 27,
    "pen, side": 12,
    "small purple cube": 30,
    "large blue box, long side": 77,
    "large blue box, short side": 39,
    "medium orange box, long side": 60,
    "medium orange box, short side": 30,
    "small red box, long side": 60,
    "small red box, short side": 14,
    "small red box, medium side": 29,
    "large yellow box, short side": 38,
    "large yellow box, long side": 80,
}


def test_ist_objects_match_the_published_table() -> None:
    assert len({one.name for one in OBJECTS}) == 12
    assert {one.title: pytest.approx(1e3 * one.span, rel=1e-9) for one in OBJECTS} == SPANS


def test_masses_and_inertias_match_textbook_formulas() -> None:
    known = {one.title: one for one in OBJECTS}
    ball, pen, box = known["medium green ball"], known["pen, side"], known["small red box, medium side"]
    assert ball.mass == pytest.approx(1100 * math.pi / 6 * 0.064**3)
    assert ball.inertia == pytest.approx(np.eye(3) * 0.4 * ball.mass * 0.032**2)
    assert pen.mass == pytest.approx(2700 * math.pi * 0.006**2 * 0.150)
    across = pen.mass * (3 * 0.006**2 + 0.150**2) / 12
    assert pen.inertia == pytest.approx(np.diag([across, across, pen.mass * 0.006**2 / 2]))
    assert box.mass == pytest.approx(700 * 0.060 * 0.014 * 0.029)
    x, y, z = 0.060**2, 0.014**2, 0.029**2
    assert box.inertia == pytest.approx(box.mass / 12 * np.diag([y + z, x + z, x + y]))


@pytest.mark.parametrize("one", OBJECTS, ids=lambda one: one.title)
def test_object_frames_are_at_the_centre_of_mass(one) -> None:
    assert one.material in DENSITIES
    assert (one.com == 0.0).all()
    for axis in (one.closing_axis, one.approach):
        assert np.linalg.norm(axis) == 1.0
    assert one.closing_axis @ one.approach == 0.0  # the fingers close across the direction in which the hand comes
    for side in (1.0, -1.0):
        p = one.shape.project_to_surface(side * one.closing_axis)
        assert one.shape.inward_normal(p) == pytest.approx(-side * one.closing_axis, abs=1e-12)
    principal = np.linalg.eigvalsh(one.inertia)
    assert 0.0 < principal[2] < principal[0] + principal[1]
