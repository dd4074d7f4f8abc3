"""Meshes of a hand: search for files, poses on links, and contacts of meshed fingertips."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation
from support.control_grasps import FOUR_FINGERS, make_nearest_grasp
from support.hands import load

from graspforce import Hand, InvalidInput, simulation
from graspforce.contact.motion import BodyMotion
from graspforce.control import ObjectController
from graspforce.core.errors import ModelError
from graspforce.geometry import Box, Sphere
from graspforce.hand.descriptions.description import MODELS_FOLDER
from graspforce.hand.shapes import meshes
from graspforce.simulation.rendering import DisplayModel

RADIUS = 0.008  # m, of four_finger's tips
BALL = '<geometry><sphere radius="0.008"/></geometry>'
HALF_FACET = 0.06  # rad: half angle of a facet of `ball`, seen from the centre


def write_stl(path, corners):
    """Write triangles (N, 3, 3), counter-clockwise from outside, as binary STL."""
    facets = np.zeros(len(corners), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("about", "<u2")])
    facets["corners"] = corners
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(bytes(80) + np.uint32(len(corners)).tobytes() + facets.tobytes())


def hull(points):
    """Return the triangles of the convex hull of points about the origin, (N, 3, 3)."""
    triangles = points[ConvexHull(points).simplices]
    inwards = np.linalg.det(triangles) < 0.0
    triangles[inwards] = triangles[inwards, ::-1]
    return triangles


def ball(count=3000):
    """Return triangles of a sphere of radius 1 with vertices on a golden spiral."""
    i = np.arange(count)
    z, turn = 1.0 - (2 * i + 1) / count, np.pi * (1.0 + np.sqrt(5.0)) * i
    return hull(np.column_stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z]))


def hand_with(folder, collision=BALL, visual=BALL):
    """Return four_finger with other shapes at its tips; its files are written to the folder."""
    urdf = (MODELS_FOLDER / "four_finger.urdf").read_text()
    for kind, geometry in (("visual", visual), ("collision", collision)):
        before = f"<{kind}>\n      {BALL}"
        assert urdf.count(before) == 4
        urdf = urdf.replace(before, f"<{kind}>\n      {geometry}")
    folder.mkdir(exist_ok=True)
    (folder / "four_finger.urdf").write_text(urdf)
    (folder / "four_finger.json").write_text((MODELS_FOLDER / "four_finger.json").read_text())
    return Hand.load(folder / "four_finger.json")


def mesh(name, scale=None):
    return f'<geometry><mesh filename="{name}"' + (f' scale="{scale}"' if scale else "") + "/></geometry>"


def sphere_grasp(hand, shape=None):
    return make_nearest_grasp(hand, FOUR_FINGERS, shape or Sphere(0.036), [0.0, 0.0, 0.055])


# ── files ──────────────────────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize(
    ("named", "lies", "given"),
    [
        ("package://hand/meshes/tip.stl", "hand/meshes/tip.stl", []),  # the package contains the URDF
        ("package://other/meshes/tip.stl", "elsewhere/other/meshes/tip.stl", ["elsewhere"]),
        ("package://other/meshes/tip.stl", "elsewhere/other/meshes/tip.stl", ["elsewhere/other"]),
        ("package://other/meshes/tip.stl", "elsewhere/tip.stl", ["nowhere", "elsewhere"]),
        ("../meshes/tip.stl", "hand/meshes/tip.stl", []),
        ("meshes/tip.stl", "elsewhere/meshes/tip.stl", ["elsewhere"]),
        ("meshes/tip.stl", "elsewhere/tip.stl", ["elsewhere"]),
    ],
)
def test_mesh_is_found_by_its_name(named, lies, given, tmp_path):
    file, urdf = tmp_path / lies, tmp_path / "hand" / "urdf" / "hand.urdf"
    for path in (file, urdf):
        path.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(b"")
    found = meshes.find_mesh_file(named, urdf, [tmp_path / folder for folder in given])
    assert found.resolve() == file
    assert meshes.find_mesh_file(str(file), urdf) == file  # an absolute path
    assert meshes.find_mesh_file(f"file://{file}", urdf) == file


def test_given_directories_come_before_the_urdfs_package(tmp_path):
    for folder in ("hand", "mended/hand"):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "tip.stl").write_bytes(b"")
    found = meshes.find_mesh_file("package://hand/tip.stl", tmp_path / "hand" / "hand.urdf", [tmp_path / "mended"])
    assert found == tmp_path / "mended" / "hand" / "tip.stl"


def test_missing_mesh_lists_the_searched_places(tmp_path):
    hand = hand_with(tmp_path / "hand", mesh("package://tips/ball.stl"))
    with pytest.raises(
        ModelError, match=r"package://tips/ball\.stl is not found; searched: .*/there/tips/ball\.stl, .*/there/"
    ):
        hand.tip_mesh("finger_1", [tmp_path / "there"])
    with pytest.raises(ModelError, match="no place; give the directory of its package"):
        hand.tip_mesh("finger_1")


def test_meshes_of_an_installed_package_are_found():
    hand = load("allegro_right")
    found = hand.meshes()
    assert len(found) == 21  # the palm, four links and a tip for each finger
    assert {each.link for each in found} == {-1, *range(16)}
    assert all(each.file.is_file() for each in found)
    assert hand.tip_mesh("thumb").file.name == "link_15.0_tip.STL"  # its collision shape is a primitive


# ── poses ──────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_meshes_have_the_links_poses_and_their_own_scale(tmp_path):
    """Vertices are at p_HF + R_HF (p + R s v), for an asymmetric tetrahedron in mm."""
    corners = np.array([[6.0, 1.0, -2.0], [-3.0, 7.0, 0.0], [-2.0, -4.0, 5.0], [0.0, 0.0, -6.0]])  # mm
    write_stl(tmp_path / "hand" / "tip.stl", hull(corners))
    place = '<origin xyz="0.001 0.002 -0.003" rpy="0.3 -0.2 0.5"/>'
    shape = mesh("tip.stl", "0.001 0.001 0.002") + place
    hand = hand_with(tmp_path / "hand", shape, shape)
    grasp = sphere_grasp(hand)
    engine = simulation.EngineSettings(solid_links=False)  # no meshes beside those of the tips
    scene = simulation.build_scene(grasp, tip_geometry="mesh", engine=engine)
    display = DisplayModel(scene)
    R = Rotation.from_euler("xyz", [0.3, -0.2, 0.5]).as_matrix()
    for i, finger in enumerate(FOUR_FINGERS):
        p_HF, R_HF = hand.tip_pose(grasp.q, finger)
        want = p_HF + ([0.001, 0.002, -0.003] + (corners * [0.001, 0.001, 0.002]) @ R.T) @ R_HF.T
        for model, geom in ((scene.model, f"tip {finger}"), (display.model, f"hand mesh {i}")):
            data, number = mujoco.MjData(model), model.geom(geom).id
            data.qpos[scene.q_address] = scene.T @ grasp.q + scene.q0
            mujoco.mj_forward(model, data)
            which = model.geom_dataid[number]
            first, count = model.mesh_vertadr[which], model.mesh_vertnum[which]
            got = data.geom_xpos[number] + model.mesh_vert[first : first + count] @ data.geom_xmat[number].reshape(3, 3).T
            assert len(got) == 4
            order = [np.linalg.norm(want - point, axis=1).argmin() for point in got]
            np.testing.assert_allclose(got, want[order], atol=1e-8)  # m: STL has single precision
    assert scene.model.nmesh == 1  # one file, read once
    assert display.model.nmesh == 2  # and the friction cone
    for model in (scene.model, display.model):
        assert not model.geom_contype.any()  # only explicit pairs collide


def test_camera_frames_the_meshes(tmp_path):
    """A hand with a plate of 1 m at each tip: the camera moves away until the plates fit into the frame."""
    plate = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-1e-3, 1e-3)])  # m
    write_stl(tmp_path / "hand" / "plate.stl", hull(plate))
    scene = simulation.build_scene(sphere_grasp(hand_with(tmp_path / "hand", visual=mesh("plate.stl"))))
    modelled, meshed = (DisplayModel(scene, show_meshes=show_meshes) for show_meshes in (False, True))
    assert meshed.model.stat.extent > 1.5 * modelled.model.stat.extent
    assert meshed.camera.distance > 1.5 * modelled.camera.distance
    names = [meshed.model.geom(i).name for i in range(meshed.model.ngeom)]
    assert sum(name.startswith("hand mesh") for name in names) == 4
    assert not any(name.startswith("hand link") for name in names)
    without_meshes = DisplayModel(simulation.build_scene(sphere_grasp(load("four_finger")))).model
    assert any(without_meshes.geom(i).name.startswith("hand link") for i in range(without_meshes.ngeom))


# ── contact ─────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_meshed_balls_act_as_balls_to_the_size_of_a_facet(tmp_path):
    """Normals differ by less than a facet's half angle δ, depths by less than r (1 − cos δ)."""
    triangles = ball()
    middles = triangles.mean(axis=1)
    cosines = np.einsum("nij,nj->ni", triangles, middles) / np.linalg.norm(middles, axis=1)[:, None]
    assert np.arccos(cosines.min()) < HALF_FACET
    write_stl(tmp_path / "hand" / "ball.stl", triangles)
    size = f"{RADIUS} {RADIUS} {RADIUS}"
    runs = []
    for hand, tips in ((load("four_finger"), "ball"), (hand_with(tmp_path / "hand", mesh("ball.stl", size)), "mesh")):
        grasp = sphere_grasp(hand)
        plant = simulation.Plant(simulation.build_scene(grasp, tip_geometry=tips))
        constant_reference = simulation.constant_reference(BodyMotion(grasp.p_HO, grasp.R_HO))
        runs.append(simulation.simulate(plant, ObjectController(grasp), constant_reference, 0.3))
    by_ball, by_mesh = runs
    assert by_mesh.touching.all()
    assert (by_mesh.slip_margin > 0.0).all()
    assert (np.linalg.norm(by_mesh.position_error, axis=1) < 1e-4).all()  # m
    cosines = np.einsum("tni,tni->tn", by_mesh.R_OC[..., 2], by_ball.R_OC[..., 2])
    assert 1e-4 < np.arccos(np.clip(cosines, -1.0, 1.0)).max() < 2.0 * HALF_FACET  # the facets are seen
    apart = np.linalg.norm(by_mesh.p_OC[0] - by_ball.p_OC[0], axis=1)
    assert (apart < 2.0 * RADIUS * HALF_FACET).all()  # m
    normal = by_ball.f[..., 2].mean()
    np.testing.assert_allclose(by_mesh.f[-1, :, 2], by_ball.f[-1, :, 2], atol=2.0 * HALF_FACET * normal)  # N


def test_flat_tip_on_a_flat_face_has_one_contact(tmp_path):
    """The controller models one contact; a patch of four would carry moments that the model lacks."""
    half = RADIUS * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    write_stl(tmp_path / "hand" / "cube.stl", hull(half))
    grasp = sphere_grasp(hand_with(tmp_path / "hand", mesh("cube.stl")), Box([0.06, 0.06, 0.05]))
    plant = simulation.Plant(simulation.build_scene(grasp, tip_geometry="mesh"))
    assert plant.true_contacts().touching.all()
    assert plant.data.ncon == 4


# ── errors ─────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_unusable_tip_meshes_are_rejected_by_name(tmp_path):
    with pytest.raises(ModelError, match=r"finger_1_tip must have exactly one mesh, but .*four_finger\.urdf gives 0"):
        simulation.build_scene(sphere_grasp(load("four_finger")), tip_geometry="mesh")
    with pytest.raises(InvalidInput, match="tip_geometry = 'cube': must be one of ball, mesh"):
        simulation.build_scene(sphere_grasp(load("four_finger")), tip_geometry="cube")
    (tmp_path / "hand").mkdir()
    for name, text in (("tip.dae", "reads meshes from .stl, .obj, .msh, not from .dae"), ("tip.stl", "MuJoCo cannot build it")):
        (tmp_path / "hand" / name).write_text("solid ascii\nendsolid\n")
        with pytest.raises(ModelError, match=text):
            simulation.build_scene(sphere_grasp(hand_with(tmp_path / "hand", mesh(name))), tip_geometry="mesh")
