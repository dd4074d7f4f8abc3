"""The checks of found grasps: true for a grasp that holds, false for one that does not; and the meshes of the benchmark."""

from __future__ import annotations

from dataclasses import asdict, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from benchmarks.lifecycle import foreign, search
from benchmarks.lifecycle.grasp_checks import bears_weight, is_closed, penetration
from benchmarks.lifecycle.lump_meshes import Lump, lumps
from graspforce.contact.contact import ContactSet
from graspforce.core.errors import InvalidInput
from graspforce.core.result_file import ResultFile, read_results
from graspforce.geometry import Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search import find_grasp
from graspforce.hand.hand import Hand

GRAVITIES = 9.81 * np.vstack([np.eye(3), -np.eye(3)])


@cache
def found() -> Grasp:
    return find_grasp(Hand.load("allegro_right"), Body.solid(Sphere(0.03), 0.05), friction=0.7)


def with_friction(grasp: Grasp, friction: float) -> Grasp:
    contacts = [replace(each, friction=friction) for each in grasp.contacts.contacts]
    return replace(grasp, contacts=ContactSet.stack(contacts))


def test_found_grasp_passes_every_check() -> None:
    assert penetration(found()) <= 1e-4  # m
    assert is_closed(found())
    assert all(bears_weight(found(), g) for g in GRAVITIES)


def test_grasp_without_friction_is_not_closed() -> None:
    slippery = with_friction(found(), 0.0)
    assert not is_closed(slippery)


def test_opened_grasp_bears_no_weight() -> None:
    """Contacts on one half of the ball can push only away from it."""
    grasp = found()
    contacts = [
        replace(each, position=(0.001 * i, 0.0, -0.03), normal=(0.0, 0.0, 1.0), tangent=(1.0, 0.0, 0.0))
        for i, each in enumerate(grasp.contacts.contacts)
    ]
    opened = replace(grasp, contacts=ContactSet.stack(contacts))
    assert not is_closed(opened)
    assert not all(bears_weight(opened, g) for g in GRAVITIES)


def test_weight_beyond_the_motors_is_not_borne() -> None:
    assert not bears_weight(found(), 1e3 * GRAVITIES[0])


@pytest.mark.parametrize("is_mesh", [False, True])
def test_object_in_the_palm_penetrates(is_mesh: bool) -> None:
    lump = lumps()[0]
    body = Body.solid(lump.mesh if is_mesh else Sphere(0.03), 0.05)
    inside = replace(found(), p_HO=np.zeros(3), body=body)
    assert penetration(inside, lump.layers if is_mesh else ()) > 1e-3  # m


@pytest.mark.parametrize("lump", lumps(), ids=lambda lump: lump.name)
def test_mesh_is_closed_of_the_stated_size_and_filled_by_its_layers(lump: Lump) -> None:
    """`TriangleMesh` refuses a surface that is not closed. Layers of equal outline have exactly the mesh's volume."""
    largest = float(np.ptp(lump.mesh.vertices, axis=0).max())
    assert 0.040 <= largest <= 0.090 + 1e-9  # m
    layers = sum(ConvexHull(layer).volume for layer in lump.layers)
    assert lump.mesh.volume == pytest.approx(layers, rel=1e-3)


def test_page_counts_a_grasp_with_a_failed_check_as_failure() -> None:
    good = search.SearchRecord("dlr_hit2", "mesh", "pear", "any", "", 1.0, 0.0, True, 6)
    assert good.is_good
    for change in ({"seconds": 3.1}, {"penetration": 2e-4}, {"is_closed": False}, {"directions": 5}, {"fault": "none"}):
        assert not replace(good, **change).is_good  # type: ignore[arg-type]


def test_page_states_the_shares_and_the_messages_of_failures(tmp_path: Path) -> None:
    path = tmp_path / "search.jsonl"
    good = search.SearchRecord("dlr_hit2", "mesh", "pear", "any", "", 1.0, 0.0, True, 6)
    with ResultFile(path, search.SCHEMA, {}) as file:
        for record in (
            good,
            good,
            replace(good, penetration=2e-4),
            replace(good, fault="body = 3: must be large; best candidate: a and b overlap"),
        ):
            file.append(asdict(record))
    page = search.page(path)
    assert "| dlr_hit2 | any | 4 | 75 % (3 of 4) | 67 % (2 of 3) | 100 % (3 of 3) | 100 % (3 of 3) | 50 % (2 of 4) |" in page
    assert "- 1 × penetration: dlr_hit2 any (1)" in page
    assert "- 1 × best candidate: a and b overlap: dlr_hit2 any (1)" in page


def test_posture_page_counts_each_reason_of_a_refusal(tmp_path: Path) -> None:
    path = tmp_path / "foreign.jsonl"
    with ResultFile(path, foreign.SCHEMA, {}) as file:
        file.append(asdict(foreign.PostureRecord("dlr_hit2", "ball", "", is_closed=True)))
        file.append(asdict(foreign.PostureRecord("dlr_hit2", "ball", "a and b overlap by 2.0 mm; c moves 6.0 mm, more than")))
        file.append(asdict(foreign.PostureRecord("dlr_hit2", "ball", "something else")))
    page = foreign.page(path)
    assert "| dlr_hit2 | 3 | 1 | 2 | 1 |" in page
    for line in ("- 1 × two links, or a link and the object, overlap", "- 1 × the repair moves a tip too far", "- 1 × other"):
        assert line in page


def test_merged_records_hold_each_case_once_and_need_equal_conditions(tmp_path: Path) -> None:
    def record(name: str) -> dict[str, object]:
        return asdict(search.SearchRecord("leap_right", "IST", name, "pinch", "", 1.0, 0.0, True, 6))

    paths = [tmp_path / f"{k}.jsonl" for k in range(3)]
    for path, names, mass in zip(paths, (("ball", "pen"), ("pen", "cube"), ("can",)), (0.05, 0.05, 0.06), strict=True):
        with ResultFile(path, search.SCHEMA, {"mass": mass}) as file:
            for name in names:
                file.append(record(name))
    with ResultFile(paths[0], search.SCHEMA, {"mass": 0.05}) as file:
        done = {search.SearchRecord(**each).case for each in file.records if isinstance(each, dict)}
        search.merge(file, read_results(paths[1], search.SCHEMA), done)
        search.merge(file, read_results(paths[1], search.SCHEMA), done)
        with pytest.raises(InvalidInput, match="conditions"):
            search.merge(file, read_results(paths[2], search.SCHEMA), done)
    merged = read_results(paths[0], search.SCHEMA)[1]
    assert [each["name"] for each in merged if isinstance(each, dict)] == ["ball", "pen", "cube"]
