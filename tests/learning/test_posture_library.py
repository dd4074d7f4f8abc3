"""Libraries of postures: files return what was written, and invalid tables are refused."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from support import hands

from graspforce.core.errors import InvalidInput
from graspforce.geometry import Box, Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.posture_files import load_postures
from graspforce.grasp.search import find_grasp
from graspforce.learning import PostureLibrary
from graspforce.learning.posture_library import object_size


@cache
def ball_grasp():
    return find_grasp(hands.load("leap_right"), Body.solid(Sphere(0.03), 0.05))


def library(rows=5):
    rng = np.random.default_rng(3)
    return PostureLibrary(
        ("a", "b"), rng.normal(size=(rows, 2)), tuple("uvwxy"[:rows]), rng.uniform(0.01, 0.1, (rows, 3)), None
    )


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_a_file_returns_the_library(suffix, tmp_path):
    written = library()
    written.save(tmp_path / f"postures{suffix}")
    read = PostureLibrary.load(tmp_path / f"postures{suffix}")
    assert read.joints == written.joints
    assert read.objects == written.objects
    np.testing.assert_array_equal(read.q, written.q)
    np.testing.assert_array_equal(read.sizes, written.sizes)
    assert read.poses is None


def test_postures_of_grasps_are_read_as_grasp_postures(tmp_path):
    """The table has the columns of grasp posture files, so both readers give the same posture and pose."""
    grasp = ball_grasp()
    PostureLibrary.from_grasps([grasp], ["ball"]).save(tmp_path / "grasps.csv")
    (read,) = load_postures(tmp_path / "grasps.csv", grasp.hand)
    np.testing.assert_allclose(read.q, grasp.q, atol=1e-15)
    np.testing.assert_allclose(read.p_HO, grasp.p_HO, atol=1e-15)
    np.testing.assert_allclose(read.R_HO, grasp.R_HO, atol=1e-12)  # through a quaternion


def test_the_size_of_a_ball_is_its_diameter():
    np.testing.assert_allclose(object_size(ball_grasp()), 0.06, rtol=0.01)  # of the 400 points of its hull


def test_the_size_of_a_box_contains_its_edges():
    """The extent of a box along a direction d is Σ |d_i| l_i; the squares of three perpendicular extents bound the edges."""
    grasp = find_grasp(hands.load("leap_right"), Body.solid(Box([0.04, 0.05, 0.06]), 0.05))
    size = object_size(grasp)
    assert (size >= 0.04 - 1e-3).all()
    assert (size <= np.linalg.norm([0.04, 0.05, 0.06]) + 1e-9).all()


def test_columns_are_put_in_the_order_of_the_hand():
    hand = hands.load("leap_right")
    names = [joint.name for joint in hand.joints][::-1]
    ordered = PostureLibrary((*names, "wrist"), np.arange(len(names) + 1.0)[None]).for_hand(hand)
    np.testing.assert_array_equal(ordered.q[0], np.arange(len(names))[::-1])


def test_a_missing_joint_is_named():
    hand = hands.load("leap_right")
    with pytest.raises(InvalidInput, match=f"{hand.joints[0].name} is missing"):
        library().for_hand(hand)


def test_joined_libraries_keep_what_both_have():
    both = library(2).joined(library(3))
    assert len(both) == 5
    assert both.objects == ("u", "v", "u", "v", "w")
    assert both.sizes is not None
    assert library(2).joined(PostureLibrary(("a", "b"), np.zeros((1, 2)))).sizes is None
    with pytest.raises(InvalidInput, match=r"other\.joints"):
        library().joined(PostureLibrary(("a", "c"), np.zeros((1, 2))))


@pytest.mark.parametrize(
    ("text", "message"),
    [("a,b\n1,x\n", "column b"), ("object,x\nball,1\n", "columns"), ("a,b\n1,nan\n", "finite"), ("", "columns")],
)
def test_invalid_tables_are_refused(text, message, tmp_path):
    (tmp_path / "table.csv").write_text(text)
    with pytest.raises(InvalidInput, match=message):
        PostureLibrary.load(tmp_path / "table.csv")


def test_invalid_records_are_refused():
    for arguments in ((("a", "a"), [[0.0, 1.0]]), (("x",), [[0.0]]), ((), [[]]), (("a",), [[0.0]], ("u", "v"))):
        with pytest.raises(InvalidInput):
            PostureLibrary(*arguments)
    with pytest.raises(InvalidInput, match=r"\.csv or \.parquet"):
        library().save("postures.txt")


def test_a_motion_gives_postures_without_repetitions_at_rest():
    t = np.linspace(0.0, 3.0, 3001)
    q = np.clip(t - 1.0, 0.0, 1.0)[:, None] * [1.0, 0.5]  # rest, motion from 1 s to 2 s, rest
    library = PostureLibrary.from_motion(("a", "b"), t, q, every=0.1)
    np.testing.assert_allclose(library.q[:, 0], [0.0, *np.arange(0.021, 1.0, 0.1), 1.0], atol=2e-3)
    for change in ({"every": 0.0}, {"least_change": -1.0}, {"t": t[:-1]}):
        with pytest.raises(InvalidInput):
            PostureLibrary.from_motion(**{"joints": ("a", "b"), "t": t, "q": q, **change})
