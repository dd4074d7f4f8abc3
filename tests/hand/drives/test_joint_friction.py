"""Joint friction: the law of Coulomb, Stribeck and viscous friction, and its values in descriptions and URDFs."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.hands import SHIPPED_HANDS, load
from support.written_hands import write_hand

from graspforce.core.errors import InvalidInput, MissingField, ModelError
from graspforce.hand.drives.joint_friction import SMOOTHING_RATE, JointFriction
from graspforce.hand.hand import Hand

FRICTION = JointFriction([0.1, 0.05], [0.02, 0.0], [0.05, 0.05], [0.003, 0.0])

rates = st.floats(-20.0, 20.0)  # rad/s


@given(rates, rates)
def test_friction_is_odd_and_dissipates(v1: float, v2: float) -> None:
    v = np.array([v1, v2])
    tau = FRICTION.torque(v)
    assert (tau * v >= 0.0).all()
    np.testing.assert_array_equal(FRICTION.torque(-v), -tau)


@given(rates)
def test_friction_is_at_most_static_plus_viscous(v: float) -> None:
    tau = np.abs(FRICTION.torque([v, v]))
    limit = FRICTION.coulomb + FRICTION.stribeck + FRICTION.viscous * abs(v)
    assert (tau <= limit * (1.0 + 1e-12)).all()  # rounding


def test_friction_far_from_zero_is_coulomb_plus_viscous() -> None:
    """At 2 rad/s, e^(−(v/v_s)²) underflows and tanh(v/ε) is 1 to rounding."""
    np.testing.assert_allclose(FRICTION.torque([2.0, -2.0]), [0.1 + 0.003 * 2.0, -0.05], rtol=1e-12)


def test_friction_is_continuous_through_zero() -> None:
    """Its slope is at most (c + s)/ε + b plus the slope of the Stribeck term, s √2 e^(−½)/v_s."""
    v = np.linspace(-0.2, 0.2, 4001)
    tau = np.array([FRICTION.torque([x, x])[0] for x in v])
    slope = 0.12 / SMOOTHING_RATE + 0.003 + 0.02 * np.sqrt(2.0) * np.exp(-0.5) / 0.05
    assert np.abs(np.diff(tau)).max() <= slope * (v[1] - v[0])
    assert FRICTION.torque([0.0, 0.0]).tolist() == [0.0, 0.0]


def test_static_friction_exceeds_coulomb_friction_at_low_rates() -> None:
    low, high = (FRICTION.torque([v, v], smoothing_rate=1e-4)[0] for v in (0.005, 0.5))
    assert low == pytest.approx(0.1 + 0.02 * np.exp(-0.01) + 0.003 * 0.005, rel=1e-12)
    assert high < low


def test_record_is_read_back() -> None:
    again = JointFriction.from_dict(json.loads(json.dumps(FRICTION.to_dict())))
    assert again.to_dict() == FRICTION.to_dict()
    with pytest.raises(MissingField, match=r"friction\.coulomb"):
        JointFriction.from_dict({})
    with pytest.raises(InvalidInput, match=r"friction\.viscous\[0\]"):
        JointFriction.from_dict({"coulomb": [0.1], "viscous": [-1.0]})


@pytest.mark.parametrize(
    ("name", "value"),
    [("coulomb", [-0.1]), ("stribeck", [0.1, 0.1]), ("stribeck_velocity", [0.0]), ("viscous", [np.nan]), ("sources", [])],
)
def test_values_out_of_range_are_named(name: str, value: list[float]) -> None:
    with pytest.raises(InvalidInput, match=f"^{name}"):
        JointFriction(**{"coulomb": [0.1], name: value})


@pytest.mark.parametrize("name", SHIPPED_HANDS)
def test_friction_of_shipped_hands_is_unknown(name: str) -> None:
    friction = load(name).friction
    assert friction.n == load(name).n
    assert not friction.known.any()
    np.testing.assert_array_equal(friction.torque(np.full(friction.n, 3.0)), 0.0)


def test_description_has_priority_over_the_urdf(tmp_path: Path) -> None:
    entry = {"joints": ["near"], "coulomb": 0.06, "stribeck": 0.01, "viscous": 0.002, "source": "identified"}
    path = write_hand(tmp_path, '<dynamics friction="0.2"/>', '<dynamics friction="0.1" damping="0.01"/>', friction=[entry])
    friction = Hand.load(path).friction
    assert friction.coulomb.tolist() == [0.06, 0.1]
    assert friction.stribeck.tolist() == [0.01, 0.0]
    assert friction.viscous.tolist() == [0.002, 0.01]
    assert friction.sources == ("identified", "URDF <dynamics>")
    assert Hand.load(path).describe()["friction"] == friction.to_dict()


@pytest.mark.parametrize("dynamics", ['friction="0.3"', 'damping="0.2"', 'damping="-0.01"'])
def test_implausible_urdf_friction_is_unknown(dynamics: str, tmp_path: Path) -> None:
    """More than half of 0.5 N·m, more than 0.5 N·m at 3 rad/s, and negative."""
    friction = Hand.load(write_hand(tmp_path, far=f"<dynamics {dynamics}/>")).friction
    assert not friction.known.any()
    assert not friction.coulomb.any()
    assert not friction.viscous.any()


def test_leader_overcomes_the_friction_of_its_follower(tmp_path: Path) -> None:
    """The power of friction is Σ τ v over all joints: with v_far = −½ v_near, c = c_near + ½ c_far and b = b_near + ¼ b_far."""
    coupling = {"follower": "far", "leader": "near", "ratio": -0.5, "source": "invented"}
    near, far = '<dynamics friction="0.04" damping="0.004"/>', '<dynamics friction="0.02" damping="0.008"/>'
    friction = Hand.load(write_hand(tmp_path, near, far, couplings=[coupling])).friction
    for v in (1.7, -0.6):
        power = 0.04 * abs(v) + 0.004 * v**2 + 0.02 * abs(0.5 * v) + 0.008 * (0.5 * v) ** 2  # W
        assert friction.torque([v])[0] * v == pytest.approx(power, rel=1e-12)


@pytest.mark.parametrize(
    ("patterns", "words"),
    [
        ([["near"], ["n*"]], "joint near must match at most one friction entry, not 2"),
        ([["middle"]], "matches no actuated joint"),
    ],
)
def test_contradictory_entries_are_named(patterns: list[list[str]], words: str, tmp_path: Path) -> None:
    entries = [{"joints": each, "coulomb": 0.1, "source": "invented"} for each in patterns]
    with pytest.raises(ModelError, match=words):
        Hand.load(write_hand(tmp_path, friction=entries))
