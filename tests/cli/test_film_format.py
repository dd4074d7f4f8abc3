"""Size, rate and viewpoint of films."""

from __future__ import annotations

import math

import numpy as np
import pytest
from PIL import Image
from support.allegro_grasp import PALM_UP, three_finger_grasp

from graspforce import InvalidInput
from graspforce.cli import main
from graspforce.cli.film_format import FilmFormat, parse_film_format
from graspforce.simulation import build_scene
from graspforce.simulation.rendering import CameraOptions, DisplayModel, FilmWriter


def test_the_options_are_read():
    assert parse_film_format(None, None, None) == FilmFormat()
    assert parse_film_format("640x360", 10.0, "-30,20") == FilmFormat((640, 360), 10.0, -30.0, 20.0, 640)


@pytest.mark.parametrize(
    ("size", "rate", "camera", "option"),
    [
        ("640", None, None, "--film-size"),
        ("640x", None, None, "--film-size"),
        ("641x360", None, None, "--film-size"),
        ("8x8", None, None, "--film-size"),
        ("9000x64", None, None, "--film-size"),
        (None, 0.0, None, "--fps"),
        (None, 1e3, None, "--fps"),
        (None, math.nan, None, "--fps"),
        (None, None, "30", "--film-camera"),
        (None, None, "30,high", "--film-camera"),
        (None, None, "nan,10", "--film-camera"),
        (None, None, "0,90", "--film-camera"),
    ],
)
def test_wrong_options_are_named(size, rate, camera, option):
    with pytest.raises(InvalidInput, match=option):
        parse_film_format(size, rate, camera)


def test_the_camera_turns_about_the_vertical_axis():
    """The camera at an azimuth is the usual one, turned about the vertical axis, at the elevation."""
    scene, usual = (
        build_scene(three_finger_grasp(), gravity_H=PALM_UP),
        CameraOptions(elevation=math.radians(10.0), aspect=1280.0 / 576.0),
    )
    turned = FilmFormat(azimuth=50.0, elevation=10.0).camera(usual)
    assert turned.aspect == pytest.approx(1280.0 / 576.0)  # above the strip
    before, now = (DisplayModel(scene, camera=each).camera for each in (usual, turned))
    assert before.azimuth + math.radians(50.0) == pytest.approx(now.azimuth)
    _, axes = now.pose(0.0)
    assert math.degrees(math.asin(axes[:, 2] @ now.vertical[2])) == pytest.approx(10.0)


@pytest.mark.parametrize(("rate", "frames"), [(None, 15), (5.0, 5)])
def test_animations_have_the_rate_and_the_width_of_the_format(rate, frames, tmp_path):
    path = tmp_path / "film.webp"
    with FilmWriter(path, None, rate, 320) as writer:
        for k in range(round(writer.rate)):
            writer.add(np.full((360, 640, 3), 10 * k, dtype=np.uint8))
    with Image.open(path) as film:
        assert film.size == (320, 180)
        assert film.n_frames == frames
        film.load()
        assert film.info["duration"] == round(1000.0 / frames)


def test_the_command_writes_a_film_of_the_format(tmp_path, capsys):
    path = tmp_path / "run.webp"
    options = ["--duration", "0.1", "--video", str(path), "--film-size", "256x144", "--fps", "20", "--film-camera", "20,30"]
    assert main(["simulate", "--hand", "four_finger", *options]) == 0
    with Image.open(path) as film:
        assert film.size == (256, 144)
        assert film.n_frames == 3


def test_simulations_of_worlds_write_films_of_the_given_size(tmp_path, capsys):
    given = ["simulate", "--world", "real", "--duration", "0.02", "--reference", "still", "--film-size", "160x96"]
    main([*given, "--frames", str(tmp_path / "frames")])
    assert "% of the frame." in capsys.readouterr().out
    frames = sorted((tmp_path / "frames").glob("*.png"))
    assert frames
    with Image.open(frames[0]) as image:
        assert image.size == (160, 96)
