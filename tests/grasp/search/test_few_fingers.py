"""Hands with one or two fingers, and searches without a result, give words."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.faulty_hands import DESCRIPTION, whole, write_hand

from graspforce import Hand, InvalidInput
from graspforce.cli import main
from graspforce.geometry import Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.search import GraspSearchOptions, find_grasp

BALL = Body.solid(Sphere(0.02), 0.02)
PAD = {"torsional_friction": 0.003, "source": "invented"}


def test_two_fingers_without_pads_are_too_few(tmp_path: Path) -> None:
    hand = Hand.load(write_hand(tmp_path))
    with pytest.raises(InvalidInput, match="three different fingers, or two with soft pads"):
        find_grasp(hand, BALL)


def test_one_finger_is_too_few(tmp_path: Path) -> None:
    locks = [{"joint": f"right_{name}", "source": "invented"} for name in ("knuckle", "middle")]
    hand = Hand.load(write_hand(tmp_path, edit=whole(fingers=DESCRIPTION["fingers"][:1], locked=locks)))
    with pytest.raises(InvalidInput, match=r"pair with 1 finger.*two fingers at least"):
        find_grasp(hand, BALL)


def test_search_without_result_names_the_requirement_that_fails(tmp_path: Path) -> None:
    fingers = [{**finger, "pad": PAD} for finger in DESCRIPTION["fingers"]]
    hand = Hand.load(write_hand(tmp_path, edit=whole(fingers=fingers)))
    huge = Body.solid(Sphere(0.2), 0.02)
    with pytest.raises(InvalidInput, match=r"both fingers of pair can hold; best candidate: "):
        find_grasp(hand, huge, options=GraspSearchOptions(travel=0.0))


def test_command_line_says_so_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_hand(tmp_path)
    assert main(["simulate", "--hand", str(path), "--object", "sphere:0.02"]) == 1
    err = capsys.readouterr().err
    assert "two with soft pads" in err.replace("\n", " ").replace("  ", " ")
    assert "Traceback" not in err
