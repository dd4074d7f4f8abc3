"""Links and palm in the plant: they stop the object and one another, and runs report their contacts."""

from __future__ import annotations

from functools import lru_cache

import pytest
from support.hands import SHIPPED_HANDS, load

from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, ObjectController
from graspforce.geometry import Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search import find_grasp
from graspforce.hand.collision import HandCollision
from graspforce.simulation import Plant, Recording, UrdfPlant, build_scene, linear_reference, simulate
from graspforce.simulation.plants.link_geoms import LINK_PREFIX


@lru_cache
def ball_grasp() -> Grasp:
    return find_grasp(load("four_finger"), Body.solid(Sphere(0.03), mass=0.05), friction=0.7)


def palm_depth(grasp: Grasp, recording: Recording) -> float:
    """Return the largest penetration of ball and palm in a run, m, by the hand's own collision shapes."""
    collision = HandCollision(grasp.hand)
    depths = []
    for q, p, R in zip(recording.q[::20], recording.p_HO[::20], recording.R_HO[::20], strict=True):
        gaps = collision.object_gaps(q, grasp.body.shape, p, R)  # type: ignore[arg-type]
        depths.append(-next(gap.distance for gap in gaps if gap.first == "palm"))
    return max(depths)


@pytest.mark.parametrize("plant", ["scene", "urdf"])
def test_palm_stops_a_ball_that_the_fingers_push_into_it(plant: str) -> None:
    """The reference ends 9 mm inside the palm; the engine's contact gives way by less than a millimetre."""
    grasp = ball_grasp()
    made = Plant(build_scene(grasp)) if plant == "scene" else UrdfPlant(grasp)
    reference = linear_reference(BodyMotion(grasp.p_HO, grasp.R_HO), [0.0, 0.0, -0.03], 1.0)
    recording = simulate(made, ObjectController(grasp, ControlSettings(slip_margin=0.5)), reference, 0.5)
    assert palm_depth(grasp, recording) < 1e-3
    t, first, second, force = recording.collisions[0]
    assert {first, second} == {"palm", "object"}
    assert 0.2 < t < 0.5
    assert force > 0.0
    assert recording.since(t + 1e-6).collisions == recording.collisions[1:]


def test_runs_without_collisions_report_none_and_recordings_keep_them(tmp_path) -> None:  # type: ignore[no-untyped-def]
    grasp = ball_grasp()
    reference = linear_reference(BodyMotion(grasp.p_HO, grasp.R_HO), [0.0, 0.0, 0.002], 0.1)
    recording = simulate(Plant(build_scene(grasp)), ObjectController(grasp, ControlSettings()), reference, 0.05)
    assert recording.collisions == ()
    hit = Recording(**{**vars(recording), "collisions": ((0.01, "palm", "object", 2.5),)})
    hit.save(tmp_path / "run.npz")
    assert Recording.load(tmp_path / "run.npz").collisions == hit.collisions


@pytest.mark.parametrize("name", SHIPPED_HANDS)
def test_geoms_are_where_the_collision_shapes_are(name: str) -> None:
    """Distances of all pairs in MuJoCo equal those of coal: another engine on the same shapes."""
    import mujoco

    hand = load(name)
    grasp = find_grasp(hand, Body.solid(Sphere(0.03 if name != "parallel_jaws" else 0.02), mass=0.02), friction=0.9)
    scene = build_scene(grasp)
    model, data = scene.model, mujoco.MjData(scene.model)
    data.qpos[scene.q_address] = scene.T @ grasp.q + scene.q0
    mujoco.mj_kinematics(model, data)
    collision = HandCollision(hand)
    geoms = [model.geom(f"{LINK_PREFIX}{i} {body.name}").id for i, body in enumerate(collision.bodies)]
    gaps = {(gap.first, gap.second): gap.distance for gap in reversed(collision.link_gaps(grasp.q))}
    checked = 0
    for i, j in collision.pairs:
        expected = gaps[collision.bodies[i].name, collision.bodies[j].name]
        if expected < 0.03:
            distance = mujoco.mj_geomDistance(model, data, geoms[i], geoms[j], 0.1, None)
            assert distance >= expected - 1e-5  # several shapes of one link: the nearest counts
            checked += distance == pytest.approx(expected, abs=1e-5)
    assert checked > 0 or not any(gap < 0.03 for gap in gaps.values())
