"""The force problem and its file: validation, defaults, round trips and printing."""

from __future__ import annotations

import copy
import json

import numpy as np
import pytest
from support.invalid_problems import VALID_PROBLEM, assert_names, invalid_records
from support.random_problems import random_problem

from graspforce import Actuation, Cone, Contact, ForceProblem, InvalidInput, Objective, load


def flat(problem: ForceProblem) -> list[np.ndarray]:
    actuation = problem.actuation
    arrays = [problem.G, problem.w, problem.contacts.mu, problem.contacts.gamma, problem.contacts.min_normal]
    arrays.append(problem.contacts.max_normal)
    return (
        arrays
        if actuation is None
        else [*arrays, actuation.J, actuation.tau_u, actuation.lower, actuation.upper, actuation.weight]
    )


@pytest.mark.parametrize("seed", range(40))
def test_file_round_trip_keeps_the_problem(seed):
    problem = random_problem(np.random.default_rng([3, seed]))
    again = ForceProblem.from_dict(json.loads(json.dumps(problem.to_dict(), allow_nan=False)))
    for before, after in zip(flat(problem), flat(again), strict=True):
        # Normalising a unit vector again may change it by one unit in the last place.
        np.testing.assert_allclose(after, before, rtol=0, atol=1e-15)
    assert (again.cone, again.objective) == (problem.cone, problem.objective)


def test_defaults_of_cone_and_objective():
    record = {k: v for k, v in VALID_PROBLEM.items() if k != "hand"}
    problem = ForceProblem.from_dict(record)
    assert (problem.cone, problem.objective) == (Cone("exact"), Objective("force"))
    with_hand = ForceProblem.from_dict(VALID_PROBLEM)
    assert with_hand.objective == Objective("torque", 0.0)
    assert with_hand.actuation.tau_u.tolist() == [0.0, 0.0]
    assert with_hand.actuation.weight.tolist() == [1.0, 1.0]
    assert with_hand.actuation.lower.tolist() == [-0.7, -np.inf]
    assert problem.contacts.max_normal.tolist() == [20.0, np.inf]


@pytest.mark.parametrize(("fault", "record"), invalid_records(), ids=[fault.name for fault, _ in invalid_records()])
def test_bad_input_names_field_value_and_what_is_allowed(fault, record):
    with pytest.raises(InvalidInput) as caught:
        ForceProblem.from_dict(record)
    assert caught.value.field == fault.field
    assert caught.value.allowed.startswith(fault.allowed)
    assert_names(str(caught.value), fault.field, fault.allowed)


def test_load_names_missing_files_and_invalid_json(tmp_path):
    with pytest.raises(InvalidInput, match=r"file = '.*none.*: must be a readable file"):
        load(tmp_path / "none.json")
    (tmp_path / "cut.json").write_text(json.dumps(VALID_PROBLEM)[:-20])
    with pytest.raises(InvalidInput, match="must be JSON"):
        load(tmp_path / "cut.json")
    (tmp_path / "deep.json").write_text("[" * 100_000)
    with pytest.raises(InvalidInput, match="must be JSON"):
        load(tmp_path / "deep.json")


def test_nan_in_json_is_reported_with_its_field(tmp_path):
    """Many programs write NaN into JSON: the error names the field, not the parser."""
    record = copy.deepcopy(VALID_PROBLEM)
    record["contacts"][1]["position"][2] = float("nan")
    (tmp_path / "nan.json").write_text(json.dumps(record))
    with pytest.raises(InvalidInput, match=r"contacts\[1\]\.position\[2\] = nan: must be a finite number"):
        load(tmp_path / "nan.json")


def test_positions_whose_moments_overflow_are_rejected():
    contacts = [Contact([1e308, 1e308, 0], [0, 1, 1], 0.5), Contact([0, 0, 1e308], [1, 1, 0], 0.5)]
    with pytest.raises(InvalidInput, match="moments do not overflow"):
        ForceProblem([contacts[0], Contact([1.7e308, -1.7e308, 1e308], [1, 1, 1], 0.5)], np.zeros(6))


def test_margin_objective_requires_a_bound():
    open_ended = [Contact([0, y, 0], [0, -np.sign(y), 0], 0.5) for y in (-1.0, 1.0)]
    with pytest.raises(InvalidInput, match="unless max_normal or torque limits bound"):
        ForceProblem(open_ended, np.zeros(6), objective=Objective("margin"))
    bare = [Contact([0, y, 0], [0, -np.sign(y), 0], model="frictionless", max_normal=5.0) for y in (-1.0, 1.0)]
    with pytest.raises(InvalidInput, match="no contact has friction"):
        ForceProblem(bare, np.zeros(6), objective=Objective("margin"))


def test_torque_law_and_cost():
    """tau = tau_u + Jᵀ f and cost ½ tauᵀW tau + ½ρ‖f‖², with values computed by hand."""
    contacts = [Contact([0, 0, -1], [0, 0, 1], 0.5), Contact([0, 0, 1], [0, 0, -1], model="frictionless")]
    J = np.array([[1, 0], [0, 2], [0.5, 0], [0, -0.25]])
    actuation = Actuation(J, tau_u=[0.1, -0.2], weight=[2.0, 3.0])
    problem = ForceProblem(contacts, np.zeros(6), actuation, objective=Objective("torque", 0.5))
    f = np.array([0.1, 0.2, 4.0, 4.0])
    assert problem.torques(f) == pytest.approx([0.1 + 0.1 + 2.0, -0.2 + 0.4 - 1.0])
    assert problem.cost(f) == pytest.approx(0.5 * (2 * 2.2**2 + 3 * 0.8**2) + 0.25 * (0.01 + 0.04 + 16 + 16))


def test_replace_changes_and_validates_the_named_values():
    problem = ForceProblem.from_dict(VALID_PROBLEM)
    moved = problem.replace(p=[[0, -0.04, 0], [0, 0.04, 0]], mu=[0.3, 0.4], w=[0, 0, 2, 0, 0, 0], tau_u=[0.1, 0.2])
    assert moved.contacts.p_OC[0, 1] == -0.04
    assert moved.contacts.mu.tolist() == [0.3, 0.4]
    assert moved.actuation.tau_u.tolist() == [0.1, 0.2]
    assert moved.actuation.J is not None
    assert np.array_equal(moved.actuation.J, problem.actuation.J)
    assert moved.G[3:] != pytest.approx(problem.G[3:])
    turned = problem.replace(R=problem.contacts.R_OC[:, :, [1, 2, 0]])
    assert turned.contacts.R_OC[0, :, 2] == pytest.approx(problem.contacts.R_OC[0, :, 0])
    for bad, field in (
        ({"mu": [0.1, -0.1]}, r"mu\[1\]"),
        ({"p": [[0, 0, 0]]}, "p"),
        ({"R": np.ones((2, 3, 3))}, r"R\[0\]"),
        ({"R": -problem.contacts.R_OC}, r"R\[0\]"),
        ({"w": [1, 2]}, "wrench"),
        ({"J": [[1.0]]}, "hand"),
    ):
        with pytest.raises(InvalidInput, match=f"^{field}"):
            problem.replace(**bad)


def test_problem_is_read_only():
    problem = ForceProblem.from_dict(VALID_PROBLEM)
    for array in (problem.w, problem.contacts.p_OC, problem.actuation.J, problem.contacts.mu):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


def test_problem_prints_its_contacts_and_wrench():
    problem = ForceProblem(
        [Contact([0, 0, 0], [0, 0, 1], 0.5), Contact([0, 0, 0.1], [0, 0, -1], 0.25, max_normal=20.0)], [1, 0, 2, 0, 0, 0]
    )
    assert str(problem).splitlines() == [
        "2 contacts, exact cones, objective force, no hand",
        "  contact  model  position in O (m)  normal in O  friction  normal force (N)",
        "        0  point  (0, 0, 0)          (0, 0, 1)         0.5  0 or more",
        "        1  point  (0, 0, 0.1)        (0, 0, -1)       0.25  0 to 20",
        "wrench to supply: force (1, 0, 2) N, moment (0, 0, 0) N·m about O",
    ]
    assert repr(problem) == "<ForceProblem: 2 contacts, exact cones, objective force, no hand>"
    assert problem._repr_html_().startswith("<table><caption>2 contacts, exact cones")
