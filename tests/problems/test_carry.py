"""The sinusoidal carry: kinematics that follow the path, and forces with the path's own symmetries."""

from __future__ import annotations

import numpy as np
import pytest

import graspforce as gf
from graspforce.hand.hand import Hand
from graspforce.problems.carry import CENTRE, FINGERS, HALF_SPAN, HALF_WIDTH, CarryStep, sinusoidal_carry

HAND = Hand.load("four_finger")
GRAVITY = np.array([0.0, 0.0, -9.81])  # m/s²


@pytest.fixture(scope="module")
def carried() -> tuple[CarryStep, ...]:
    return sinusoidal_carry(HAND, steps=21)


@pytest.fixture(scope="module")
def answers(carried: tuple[CarryStep, ...]) -> list[gf.Solution]:
    return [gf.solve(step.problem) for step in carried]


def test_every_instant_is_certified_with_nonnegative_slip_margin(answers: list[gf.Solution]) -> None:
    for answer in answers:
        assert answer.status is gf.Status.OPTIMAL
        assert answer.slip_margin.min() > -1e-7  # N, the certificate's own room
        assert answer.forces_object[:, 0] @ [-1, -1, 1, 1] > 0.5  # N: all four press inwards


def test_box_and_tips_follow_the_path(carried: tuple[CarryStep, ...]) -> None:
    for step in carried:
        swing = (1 - np.cos(2 * np.pi * step.time)) / 2
        assert step.p_HO == pytest.approx([0.0, 0.012 * swing, 0.055 + 0.012 * swing], abs=1e-15)
        for name, (x, y) in zip(FINGERS, ((1, 1), (1, -1), (-1, -1), (-1, 1)), strict=True):
            p_HF, _ = HAND.tip_pose(step.q, name)
            out = HALF_WIDTH + HAND.finger(name).tip_radius
            assert p_HF == pytest.approx(step.p_HO + np.array([x * out, y * HALF_SPAN, 0.0]), abs=1e-9)


def test_rates_and_accelerations_are_the_postures_derivatives() -> None:
    """Central differences of q(t) miss v and a by O(dt²): halving dt takes the error down four times."""
    errors = []
    for steps in (21, 41, 81):
        path = sinusoidal_carry(HAND, steps=steps)
        q = np.array([step.q for step in path])
        dt = path[1].time
        v = (q[2:] - q[:-2]) / (2 * dt)
        a = (q[2:] - 2 * q[1:-1] + q[:-2]) / dt**2
        errors.append(
            (
                np.abs(v - [step.v for step in path[1:-1]]).max(),
                np.abs(a - [step.a for step in path[1:-1]]).max(),
            )
        )
    ratios = np.array(errors[:-1]) / np.array(errors[1:])
    assert (ratios > 3.6).all()
    assert (ratios < 4.4).all()


def test_wrench_is_newtons_law(carried: tuple[CarryStep, ...]) -> None:
    """m (p̈ − g), p̈ by central differences of the path, which are low by (2π dt)²/12 of it."""
    p = np.array([step.p_HO for step in carried])
    dt = carried[1].time
    acceleration = (p[2:] - 2 * p[1:-1] + p[:-2]) / dt**2
    low = (2 * np.pi * dt) ** 2 / 12
    for step, a in zip(carried[1:-1], acceleration, strict=True):
        assert step.problem.w[:3] == pytest.approx(0.15 * (a - GRAVITY), abs=1.2 * low * 0.15 * np.abs(acceleration).max())
        assert step.problem.w[3:] == pytest.approx(np.zeros(3), abs=0.0)


def test_forces_are_symmetric_about_the_middle_of_the_path(answers: list[gf.Solution]) -> None:
    """Reversed time changes v to −v; positions, accelerations and torques quadratic in v are equal (Al-Gallaf, section V)."""
    for one, other in zip(answers, reversed(answers), strict=True):
        assert one.f == pytest.approx(other.f, abs=1e-5)  # N: forces follow to the square root of the cost's 1e-8
        assert one.objective == pytest.approx(other.objective, rel=1e-8)


def test_opposite_fingers_press_equally(answers: list[gf.Solution]) -> None:
    """The hand is its own mirror image in the plane x = 0, and so is the path."""
    for answer in answers:
        for one, other in ((0, 3), (1, 2)):
            assert answer.forces_object[one] == pytest.approx(answer.forces_object[other] * [-1, 1, 1], abs=1e-5)


def test_mirrored_carry_exchanges_neighbouring_forces(answers: list[gf.Solution]) -> None:
    """Likewise in the plane y = 0: fingers 1 and 2, and 3 and 4, change places."""
    for answer, step in zip(answers[::4], sinusoidal_carry(HAND, steps=21, travel_y=-0.012)[::4], strict=True):
        mirrored = gf.solve(step.problem).forces_object[[1, 0, 3, 2]] * [1, -1, 1]
        assert answer.forces_object == pytest.approx(mirrored, abs=1e-5)


def test_weightless_still_box_needs_minimum_torque() -> None:
    """With nothing to bear the forces are zero and the motors give nothing, to the square root of the cost's 1e-8."""
    (step, _) = sinusoidal_carry(HAND, steps=2, travel_y=0.0, travel_z=0.0, gravity_H=(0.0, 0.0, 0.0))
    answer = gf.solve(step.problem)
    assert step.p_HO == pytest.approx(CENTRE, abs=0.0)
    assert answer.f == pytest.approx(np.zeros(12), abs=1e-4)
    assert answer.torques == pytest.approx(np.zeros(12), abs=1e-5)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"steps": 1}, "steps = 1: must be an integer from 2"),
        ({"period": 0.0}, "period = 0.0: must be greater than 0"),
        ({"mass": -1.0}, "mass = -1.0"),
        ({"travel_y": float("nan")}, "travel_y = nan"),
        ({"travel_z": 0.2}, "within reach of finger_1"),
        ({"friction": -0.1}, "friction = -0.1"),
        ({"gravity_H": (0.0, 1.0)}, "gravity_H = "),
    ],
)
def test_invalid_arguments_are_named(change: dict[str, object], message: str) -> None:
    with pytest.raises(gf.InvalidInput, match=message):
        sinusoidal_carry(HAND, **{"steps": 3, **change})  # type: ignore[arg-type]


def test_hand_without_the_four_fingers_is_rejected() -> None:
    hand = Hand.load("dlr_hit2")
    with pytest.raises(gf.InvalidInput, match="hand = 'dlr_hit2': must be a hand whose four fingers have three joints"):
        sinusoidal_carry(hand, steps=2)
