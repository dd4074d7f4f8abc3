"""Images of a plant: what they show, with and without OpenGL, and the files that they are written to."""

from __future__ import annotations

import math
import sys
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from PIL import Image as PillowImage
from support.allegro_grasp import PALM_UP, three_finger_grasp
from support.hands import SHIPPED_HANDS, load

from graspforce import InvalidInput
from graspforce.contact.use_colour import use_colour
from graspforce.geometry import Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.search import GraspSearchOptions, find_grasp, relax_idle_fingers
from graspforce.simulation import Plant, Push, build_scene
from graspforce.simulation.rendering import (
    DisplayModel,
    FilmWriter,
    Overlay,
    capture_state,
    make_renderer,
    missing_display_reason,
    renderer,
)
from graspforce.simulation.rendering.camera import CameraOptions, CameraView
from graspforce.simulation.rendering.coverage import coverage, filling_camera, least_coverage, silhouette
from graspforce.simulation.rendering.mark_painter import arrow_facets, cone_facets, paint_marks
from graspforce.simulation.rendering.marks import push_mark
from graspforce.simulation.rendering.overlay import picture_size
from graspforce.simulation.rendering.software_renderer import SoftwareRenderer
from graspforce.simulation.rendering.tessellation import geom_triangles

SIZE = (320, 180)  # pixels


@pytest.fixture(scope="module")
def plant() -> Plant:
    return Plant(build_scene(three_finger_grasp(), gravity_H=PALM_UP))


@pytest.fixture(scope="module")
def display(plant) -> DisplayModel:
    return DisplayModel(plant.scene)


def without_opengl(monkeypatch):
    monkeypatch.setattr(renderer, "_GL_BACKENDS", ("none",))


# ── renderers ──────────────────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("opengl", [True, False])
def test_image_shows_hand_object_cones_and_table(plant, display, opengl, monkeypatch):
    """With OpenGL if the machine has it, and without: bluish squares, dark links, coloured cones, a light table."""
    if not opengl:
        without_opengl(monkeypatch)
    renderer_used = make_renderer(display, *SIZE)
    assert opengl or "apt-get install libegl1" in renderer_used.description
    assert opengl or "none: No module named 'mujoco.none'" in renderer_used.description
    image = renderer_used.render(capture_state(plant)).astype(int)
    assert image.shape == (180, 320, 3)
    red, green, blue = image.reshape(-1, 3).T
    assert ((blue > red + 30) & (green > red) & (blue < 235)).sum() > 100
    assert (np.maximum(red, green) > blue + 40).sum() > 50  # cones and arrows
    dark = image.max(axis=2) < 110
    assert dark.mean() > 0.05
    assert (image.min(axis=2) > 200).mean() > 0.02
    assert dark.mean() < 0.6


@pytest.mark.parametrize("opengl", [True, False])
def test_moving_object_moves_in_the_image(plant, display, opengl, monkeypatch):
    if not opengl:
        without_opengl(monkeypatch)
    renderer_used = make_renderer(display, *SIZE)
    before = renderer_used.render(capture_state(plant)).astype(int)
    moved = Plant(plant.scene)
    moved.data.qpos[moved.scene.object_q_address] += 0.02  # m
    moved.step(np.zeros(moved.scene.grasp.hand.n))
    assert (np.abs(renderer_used.render(capture_state(moved)).astype(int) - before).max(axis=2) > 20).mean() > 0.005


def test_renderers_do_not_share_opengl_objects(plant, display):
    first = make_renderer(display, *SIZE)
    before = first.render(capture_state(plant))
    second = make_renderer(display, *SIZE)
    del first
    np.testing.assert_array_equal(second.render(capture_state(plant)), before)


RADII = {
    "four_finger": 0.036,
    "ability_right": 0.03,
    "barrett": 0.03,
    "dclaw": 0.03,
    "dex3_right": 0.03,
}  # m, of balls that fit these hands
LEAST_COVER = {"ability_right": 2.0 / 3.0}  # as wide as it is high, so that its corners need room on all sides


@pytest.mark.parametrize(("name", "size"), [(name, RADII.get(name, 0.02)) for name in SHIPPED_HANDS])
def test_hand_and_object_fill_the_frame(name, size):
    """Their box, projected, lies inside the frame and covers three quarters of its width or of its height."""
    hand, gravity_H = load(name), (0.0, 0.0, -9.81)
    body, options = Body.solid(Sphere(size), 0.03), GraspSearchOptions(travel=0.0)
    grasp = find_grasp(hand, body, friction=0.7, gravity_H=gravity_H, options=options)
    low, high = hand_box(build_scene(relax_idle_fingers(grasp), gravity_H=gravity_H))
    assert (low >= 0.0).all()
    assert (high <= 1.0).all()
    assert (high - low).max() > LEAST_COVER.get(name, 0.75)


def test_radius_of_the_view_brings_the_camera_nearer_to_the_object(plant):
    distances = []
    for radius in (0.05, 0.1, math.inf):
        camera = DisplayModel(plant.scene, camera=CameraOptions(radius=radius)).camera
        distances.append(np.linalg.norm(camera.pose(0.0)[0] - plant.scene.grasp.p_HO))
    assert distances[0] < distances[1] < distances[2]
    assert distances[0] < 0.5 * distances[2]


def test_hand_of_make_run_fills_a_third_of_the_frame():
    gravity_H = (0.0, 0.0, -9.81)
    body = Body.solid(Sphere(0.033), 0.06)
    grasp = find_grasp(load("allegro_right"), body, friction=0.7, gravity_H=gravity_H, seed=7)  # as in the Makefile
    low, high = hand_box(build_scene(relax_idle_fingers(grasp), gravity_H=gravity_H))
    assert np.prod(high - low) > 1.0 / 3.0


def hand_box(scene) -> tuple[np.ndarray, np.ndarray]:
    """Return the least and the largest image coordinates of hand and object, as parts of the frame's width and height."""
    display = DisplayModel(scene)
    display.update(capture_state(Plant(scene)))
    model, data = display.model, display.data
    view, corners = display.view(1600, 900), []
    for i in range(model.ngeom):
        if model.geom(i).name.startswith(("hand", "object")):
            local = geom_triangles(model, i).reshape(-1, 3)
            corners.append(view.project(local @ data.geom_xmat[i].reshape(3, 3).T + data.geom_xpos[i]))
    pixels = np.concatenate(corners) / [1600, 900]
    return pixels.min(axis=0), pixels.max(axis=0)


def test_display_model_follows_the_plant_and_leaves_it_alone(plant, display):
    before = plant.data.qpos.copy()
    display.update(capture_state(plant))
    for link in plant.scene.grasp.hand.tree().links:
        np.testing.assert_allclose(display.data.body(link.joint).xpos, plant.data.body(link.joint).xpos, atol=1e-12)
    np.testing.assert_array_equal(plant.data.qpos, before)
    for i in plant.scene.tip_geoms:  # collision shapes are hidden
        name = plant.model.geom(i).name
        assert display.model.geom_group[display.model.geom(name).id] == 4


@pytest.mark.skipif(sys.platform != "linux", reason="DISPLAY is for X11 alone")
def test_missing_display_has_a_reason(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert "DISPLAY" in missing_display_reason()
    monkeypatch.setenv("DISPLAY", ":4242")  # nothing listens there
    assert ":4242" in missing_display_reason()


@pytest.mark.parametrize("kind", ["SPHERE", "ELLIPSOID", "CAPSULE", "CYLINDER", "BOX"])
def test_triangles_of_a_geom_close_its_volume(kind):
    """The divergence theorem: Σ a·(b × c)/6 is the volume, to 2 % for round surfaces; outward normals make it positive."""
    size = np.array([0.02, 0.03, 0.04])
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(type=getattr(mujoco.mjtGeom, f"mjGEOM_{kind}"), size=size)
    a, b, c = geom_triangles(spec.compile(), 0).swapaxes(0, 1)
    x, y, z = size
    ball = 4.0 / 3.0 * np.pi * x**3
    volume = {
        "SPHERE": ball, "ELLIPSOID": 4.0 / 3.0 * np.pi * x * y * z, "CAPSULE": ball + 2.0 * np.pi * x**2 * y,
        "CYLINDER": 2.0 * np.pi * x**2 * y, "BOX": 8.0 * x * y * z,
    }[kind]  # fmt: skip
    assert np.einsum("ni,ni->", a, np.cross(b, c)) / 6.0 == pytest.approx(volume, rel=0.02)


# ── marks ──────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_marks_are_the_plants_contacts(plant):
    contacts, motion = plant.true_contacts(), plant.object_motion()
    marks = capture_state(plant).contacts
    assert [mark.finger for mark in marks] == list(plant.scene.grasp.fingers)
    for i, mark in enumerate(marks):
        f = contacts.f[i]
        np.testing.assert_allclose(mark.apex, motion.p_HO + motion.R_HO @ contacts.p_OC[i])
        np.testing.assert_allclose(np.cross(mark.arrow, motion.R_HO @ contacts.R_OC[i] @ f[:3]), 0.0, atol=1e-12)
        assert mark.use == pytest.approx(np.hypot(f[0], f[1]) / (contacts.mu[i] * f[2]))
        assert mark.slip_margin == pytest.approx(contacts.mu[i] * f[2] - np.hypot(f[0], f[1]))
    assert push_mark(plant) is None


def test_push_ends_on_the_object(plant):
    pushed = Plant(plant.scene, disturbances=[Push([0.0, 0.3, 0.0], 0.0, 1.0)])
    pushed.step(plant.true_contacts().tau)
    mark = push_mark(pushed)
    assert mark.force == pytest.approx(0.3)
    np.testing.assert_allclose(np.cross(mark.arrow, [0.0, 1.0, 0.0]), 0.0, atol=1e-12)
    shape, motion = plant.scene.grasp.body.shape, pushed.object_motion()
    local = motion.R_HO.T @ (mark.end - motion.p_HO)
    assert shape.phi(local) == pytest.approx(0.0, abs=1e-9)
    assert local @ motion.R_HO.T @ mark.arrow < 0.0  # it comes from outside


def test_use_colour_goes_from_green_to_red():
    low, high = use_colour(0.0), use_colour(1.0)
    assert low[1] > low[0]
    assert high[0] > 3.0 * high[1]
    np.testing.assert_array_equal(use_colour(0.2), low)


def test_painted_cone_covers_the_forces_that_do_not_slip(plant):
    """The rim lies on the cone ‖f_t‖ = μ f_n; facets pass through the apex and face away from the axis."""
    mark = capture_state(plant).contacts[0]
    (base, n), *sides = cone_facets(mark)
    np.testing.assert_allclose(n, mark.R_HC[:, 2])
    local = (base - mark.apex) @ mark.R_HC
    np.testing.assert_allclose(np.hypot(local[:, 0], local[:, 1]), mark.mu * local[:, 2])
    for corners, normal in sides:
        np.testing.assert_allclose((corners - mark.apex) @ normal, 0.0, atol=2e-4)  # m, chords of the rim
        assert (corners.mean(axis=0) - mark.apex - mark.height / 2.0 * n) @ normal > 0.0
    assert arrow_facets(mark.apex, np.zeros(3), 0.001) == []


def test_marks_are_painted_where_the_camera_sees_them(plant):
    mark = capture_state(plant).contacts[0]
    x, y, n = mark.R_HC.T
    middle = mark.apex + 0.6 * mark.height * n
    view = CameraView(middle + 0.3 * x, np.column_stack([y, n, x]), 400, 300)  # from the side
    np.testing.assert_allclose(view.project(middle[None])[0], [200.0, 150.0])
    blank = np.full((300, 400, 3), 255, np.uint8)
    painted = paint_marks(blank, view, [mark])
    assert (painted[150, 200] != 255).any()
    assert (painted[0] == 255).all()
    np.testing.assert_array_equal(paint_marks(blank, view, []), blank)


# ── overlay and files ──────────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("is_compact", [True, False])
@pytest.mark.parametrize("title", ["Allegro hand", "Four fingers of three joints in two opposing pairs"])
def test_overlay_has_captions_above_and_a_strip_below(plant, is_compact, title):
    width, height = picture_size(640, 360)
    image = np.full((height, width, 3), 100, np.uint8)
    overlay = Overlay(title, "a test, 30 × slower", 640, 360, is_compact=is_compact, slow_motion=30.0)
    state = capture_state(plant)
    for k in range(3):
        painted = overlay.paint(image, replace(state, t=0.1 * k), 1e-5)
    assert painted.shape == (360, 640, 3)
    strip, top = painted[height:], height // 2
    np.testing.assert_array_equal(painted[top:height], image[top:])
    assert (painted[:top] != image[:top]).any(axis=2).mean() < 0.75  # the captions leave the picture free
    assert (painted[:top].max(axis=2) < 80).sum() > 100  # their dark text
    assert (strip.mean(axis=2) < 100).mean() > 0.7  # dark
    for part in np.array_split(strip, len(state.contacts), axis=1):
        assert (part.max(axis=2) > 200).sum() > 20  # a text for each contact


FILMED = ("allegro_right", "dlr_hit2", "leap_right")


@pytest.mark.parametrize("name", FILMED)
def test_hand_and_object_fill_a_third_of_the_frames_of_films(name):
    """Measured in pixels of the silhouette, at five times of the camera's swing; the contacts are in the picture."""
    gravity_H = (0.0, 0.0, -9.81)
    grasp = find_grasp(load(name), Body.solid(Sphere(0.03), 0.05), friction=0.7, gravity_H=gravity_H)
    size = picture_size(1280, 720)
    scene = build_scene(relax_idle_fingers(grasp), gravity_H=gravity_H)
    display = DisplayModel(scene, camera=CameraOptions(aspect=size[0] / size[1], swing=0.3, period=4.0))
    state = capture_state(Plant(scene))
    display.update(state)
    share = size[1] / 720
    display.camera = filling_camera(display, 0.35 / share, *size)
    parts = []
    for t in np.linspace(0.0, 4.0, 5):
        display.update(replace(state, t=t))
        parts.append(coverage(display, *size))
        assert share * parts[-1] > 1.0 / 3.0
        places = display.view(*size).project(display.contact_points) / size
        assert ((places > 0.0) & (places < 1.0)).all()
    film = [replace(state, t=t) for t in np.linspace(0.0, 4.0, 5)]
    assert least_coverage(display, film, *size) == min(parts)


def test_silhouette_is_where_the_image_shows_hand_and_object(plant, display):
    """The software renderer draws the same triangles, over a background without them."""
    state = capture_state(plant)
    image = SoftwareRenderer(display, 320, 180, "").render(state)
    mask = silhouette(display, display.view(320, 180))
    assert 0.05 < mask.mean() < 0.8
    dark = image.max(axis=2) < 90  # links; the background is light
    assert (dark & mask).sum() > 0.97 * dark.sum()


@pytest.mark.parametrize(("suffix", "rate"), [(".mp4", 30), (".gif", 15), (".webp", 15)])
def test_film_has_its_rate_and_size(tmp_path, suffix, rate):
    path = tmp_path / "new" / f"film{suffix}"
    with FilmWriter(path, None) as writer:
        for k in range(rate // 2):
            writer.add(np.full((180, 320, 3), 10 * k, np.uint8))
    assert (writer.rate, writer.count) == (rate, rate // 2)
    assert path.stat().st_size > 100
    if suffix != ".mp4":
        with PillowImage.open(path) as film:
            assert (film.n_frames, film.size) == (writer.count, (320, 180))


def test_unknown_film_is_refused(tmp_path):
    with pytest.raises(InvalidInput, match=r"film\.mp4, film\.webp or film\.gif"):
        FilmWriter(tmp_path / "film.txt", None)
