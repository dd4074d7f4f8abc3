"""The textbook cases: every answer is reached a second way, every proof is checked by the law alone."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest
from support import reference_solver

import graspforce as gf
from graspforce import problems
from graspforce.contact import friction
from graspforce.core.errors import UnknownName
from graspforce.problems import generate
from graspforce.problems.case import Case, ExpectedInfeasibility, ExpectedOptimum
from graspforce.problems.json_format import format_case

ALL = problems.names("textbook")
CASES = {name: problems.load(name) for name in ALL}
FEASIBLE = [name for name in ALL if isinstance(CASES[name].expected, ExpectedOptimum)]
INFEASIBLE = [name for name in ALL if isinstance(CASES[name].expected, ExpectedInfeasibility)]

# An objective known to 1e-8 pins the forces of a strictly convex cost to its square root.
_NORMALS = 1e-4


@pytest.mark.parametrize("name", FEASIBLE)
def test_optimum_by_solve_and_by_a_second_method(name: str) -> None:
    case, known = CASES[name], CASES[name].expected
    answer = gf.solve(case.problem)
    second, f = reference_solver.optimum(case.problem)
    assert answer.status is gf.Status.OPTIMAL
    assert answer.objective == pytest.approx(known.objective, rel=known.tolerance)
    assert second == pytest.approx(known.objective, rel=known.tolerance)
    if known.normals is not None:
        rows = case.problem.contacts.normal_rows
        room = _NORMALS * float(known.normals.max())
        assert answer.f[rows] == pytest.approx(known.normals, abs=room)
        assert f[rows] == pytest.approx(known.normals, abs=room)


@pytest.mark.parametrize("name", [name for name in FEASIBLE if CASES[name].problem.cone.type == "pyramid"])
def test_pyramids_by_a_third_solver(name: str) -> None:
    case = CASES[name]
    backend = "quadprog" if case.problem.objective.type == "force" else "highs"
    answer = gf.solve(case.problem, backend=backend)
    assert answer.backend == backend
    assert answer.objective == pytest.approx(case.expected.objective, rel=case.expected.tolerance)


@pytest.mark.parametrize("name", INFEASIBLE)
def test_infeasibility_by_solve_and_by_a_second_method(name: str) -> None:
    case = CASES[name]
    answer = gf.solve(case.problem, explain=False)
    assert answer.status is gf.Status.INFEASIBLE
    assert answer.certificate is not None
    assert answer.certificate.verified
    with pytest.raises(reference_solver.InfeasibleProblem):
        reference_solver.optimum(case.problem)


@pytest.mark.parametrize("name", INFEASIBLE)
def test_proof_holds_without_a_solver(name: str) -> None:
    """Every force inside the cones has zᵀf ≥ 0, so Gᵀy + z + E ν + J λ = 0 bounds yᵀw by the limits' terms; w exceeds it."""
    problem, proof = CASES[name].problem, CASES[name].expected.proof
    A = reference_solver.formulate(dataclasses.replace(problem, objective=gf.Objective("force"))).A
    contacts, actuation = problem.contacts, problem.actuation
    z = -A.T @ proof.y
    z[contacts.normal_rows] += proof.normal_upper - proof.normal_lower
    value = proof.y @ problem.w + proof.normal_lower @ contacts.min_normal
    value -= sum(nu * most for nu, most in zip(proof.normal_upper, contacts.max_normal, strict=True) if nu)
    if actuation is not None:
        z += actuation.J @ (proof.torque_upper - proof.torque_lower)
        value -= sum(nu * most for nu, most in zip(proof.torque_upper, actuation.upper - actuation.tau_u, strict=True) if nu)
        value += sum(nu * least for nu, least in zip(proof.torque_lower, actuation.lower - actuation.tau_u, strict=True) if nu)
    for multipliers in dataclasses.asdict(proof).items():
        assert multipliers[0] == "y" or (multipliers[1] >= 0).all()
    outside = friction.dual_violation(contacts.pad(z), contacts.mu, contacts.gamma)
    assert outside.max() <= 1e-14 * np.abs(z).max()  # rounding of sums of products
    assert value > 1e-7 * np.abs(proof.y @ problem.w)


@pytest.mark.parametrize("name", [name for name in INFEASIBLE if CASES[name].expected.friction_factor])
def test_friction_factor_is_the_feasibility_threshold(name: str) -> None:
    case, factor = CASES[name], CASES[name].expected.friction_factor

    def rougher(by: float) -> gf.ForceProblem:
        return case.problem.replace(mu=by * case.problem.contacts.mu)

    reference_solver.optimum(rougher(factor * (1 + 1e-6)))
    with pytest.raises(reference_solver.InfeasibleProblem):
        reference_solver.optimum(rougher(factor * (1 - 1e-6)))
    assert gf.solve(case.problem).infeasibility.friction_factor == pytest.approx(factor, rel=1e-6)


@pytest.mark.parametrize("name", [name for name in INFEASIBLE if CASES[name].expected.torque_factor])
def test_torque_factor_is_the_feasibility_threshold(name: str) -> None:
    case, factor = CASES[name], CASES[name].expected.torque_factor

    def stronger(by: float) -> gf.ForceProblem:
        actuation = case.problem.actuation
        more = gf.Actuation(actuation.J, actuation.tau_u, by * actuation.lower, by * actuation.upper, actuation.weight)
        return dataclasses.replace(case.problem, actuation=more)

    reference_solver.optimum(stronger(factor * (1 + 1e-6)))
    with pytest.raises(reference_solver.InfeasibleProblem):
        reference_solver.optimum(stronger(factor * (1 - 1e-6)))
    assert gf.solve(case.problem).infeasibility.torque_factor == pytest.approx(factor, rel=1e-6)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        # Lobo et al. 1998 by two solvers, as tables print them: Σ‖f‖² is twice our cost
        ("nose-cone/5-max-normal", 0.49108896),
        ("nose-cone/6-max-normal", 0.38630774),
        ("nose-cone/5-sum-normal", 1.47397020),
        ("nose-cone/5-force", 0.65888534 / 2),
        ("nose-cone/5-inner-4", 0.681500 / 2),
        ("nose-cone/5-inner-8", 0.692335 / 2),
        ("nose-cone/5-inner-16", 0.661465 / 2),
        ("nose-cone/5-outer-4", 0.480540 / 2),
        ("nose-cone/5-outer-8", 0.635803 / 2),
        ("nose-cone/5-outer-16", 0.647455 / 2),
        ("opposed/max-normal", 50.0),
        ("opposed/force", 2525.0),
        ("ring/3-force", 5 / 6),
        ("ring/sphere-rough", 41.0920**2 / 6),
    ],
)
def test_published_values_are_reproduced(name: str, value: float) -> None:
    assert CASES[name].expected.objective == pytest.approx(value, rel=2e-6)  # six printed digits


def test_pyramids_bound_the_cone_from_both_sides() -> None:
    cost = {
        name: CASES[f"nose-cone/5-{name}"].expected.objective
        for name in ("force", "inner-16", "outer-16", "inner-4", "outer-4")
    }
    assert cost["outer-4"] < cost["outer-16"] < cost["force"] < cost["inner-16"] < cost["inner-4"]


def test_torsion_models_are_nested() -> None:
    """‖f_t‖/μ + |m|/γ ≤ f_n is inside the ellipse, which is inside the two apart."""
    inner, exact, outer = (
        CASES[f"opposed/soft-load-moment-{kind}"].expected.objective for kind in ("inner-64", "exact", "outer-64")
    )
    assert outer < exact < inner


def test_files_equal_their_derivations() -> None:
    derived = {record["name"]: record for record in generate.records()}
    assert sorted(derived) == list(ALL)
    for name in ALL:
        text = problems.text(name)
        record = json.loads(text)
        assert _same(record, derived[name]), name
        assert format_case(record) + "\n" == text, name


def _same(a: object, b: object) -> bool:
    """Equal, numbers to 14 digits: machines differ in the last digit of a sine."""
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(_same(a[key], b[key]) for key in a)
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(_same(x, y) for x, y in zip(a, b, strict=True))
    if isinstance(a, int | float) and isinstance(b, int | float):
        return math.isclose(a, b, rel_tol=1e-14, abs_tol=1e-15)
    return a == b


def test_names_load_their_cases() -> None:
    assert problems.TEXTBOOK == ("fixture", "nose-cone", "opposed", "ring")
    for name in ALL:
        assert CASES[name].name == name
        assert CASES[name].source.endswith((".", ".)"))
        assert gf.ForceProblem.from_dict(json.loads(problems.text(name))).name == name


@pytest.mark.parametrize("name", ["nose-cone/7-force", "nose-cone", "", "../case", None, 5])
def test_unknown_name_error_points_to_the_list(name: object) -> None:
    known = r"problems list` prints all names; the collections are batch, .*fixture, .*ring"
    with pytest.raises(UnknownName, match=known) as caught:
        problems.load(name)  # type: ignore[arg-type]
    assert caught.value.value == name


def test_unknown_name_error_suggests_close_names() -> None:
    with pytest.raises(UnknownName, match=r"one of .*nose-cone/5-force"):
        problems.load("nose-cone/7-force")
    with pytest.raises(UnknownName, match=r"one of textbook, batch, .*fixture, "):
        problems.names("nosecone")


@pytest.mark.parametrize("name", ["opposed/torque-limit", "nose-cone/5-torque-arms", "fixture/table", "opposed/soft-moment"])
def test_record_returns_the_same_case(name: str) -> None:
    once = CASES[name].to_dict()
    again = Case.from_dict(json.loads(json.dumps(once))).to_dict()
    assert _same(once, again)
    assert once["expected"] == json.loads(problems.text(name))["expected"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"expected": None}, "expected = None: must be a record"),
        ({"expected": {}}, "expected.status = None: must be one of optimal, infeasible"),
        ({"expected": {"status": "failed"}}, "expected.status = 'failed'"),
        ({"expected": {"status": "optimal", "tolerance": 1e-6}}, "Missing field 'expected.objective'"),
        ({"expected": {"status": "optimal", "objective": 1.0, "tolerance": 0}}, "expected.tolerance = 0: must be"),
        (
            {"expected": {"status": "optimal", "objective": 1, "tolerance": 1, "proof": {}}},
            "Unknown field 'expected.proof'; known fields: ",
        ),
        (
            {"expected": {"status": "optimal", "objective": 1, "tolerance": 1, "normals": [1, 2, 3]}},
            r"expected.normals = \[1, 2, 3\]: must be a list of 2 numbers",
        ),
        (
            {"expected": {"status": "infeasible", "tolerance": 1, "proof": {"z": [1]}}},
            "Unknown field 'expected.proof.z'; known fields: ",
        ),
        (
            {"expected": {"status": "infeasible", "tolerance": 1, "proof": {"y": [1]}}},
            r"expected.proof.y = \[1\]: must be a list of 6",
        ),
        (
            {"expected": {"status": "infeasible", "tolerance": 1, "proof": {}, "friction_factor": 0.5}},
            "expected.friction_factor = 0.5: must be at least 1",
        ),
        ({"wrench": [0]}, r"wrench = \[0\]"),
    ],
)
def test_bad_case_files_are_named_field_by_field(change: dict[str, object], message: str) -> None:
    record = {**json.loads(problems.text("opposed/force")), **change}
    with pytest.raises(gf.InvalidInput, match=message):
        Case.from_dict(record)


def test_case_without_expected_is_rejected() -> None:
    with pytest.raises(gf.InvalidInput, match="Missing field 'expected': a case needs its known solution"):
        Case.from_dict(CASES["opposed/force"].problem.to_dict())


def test_data_hash_depends_on_every_case() -> None:
    whole = problems.data_hash()
    assert len(whole) == 64
    assert whole == problems.data_hash()
    assert len({whole, *(problems.data_hash(name) for name in problems.collections())}) == len(problems.collections()) + 1
