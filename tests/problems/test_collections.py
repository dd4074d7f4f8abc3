"""The generated collections: every case in its place, every answer certified, every generator saying what its files say."""

from __future__ import annotations

import dataclasses
import importlib
import json
import math
from pathlib import Path

import numpy as np
import pytest
from support.second_solver import second_optimum

import graspforce as gf
from graspforce import problems
from graspforce.bench.library_check import infeasibility_margin, summarize_checks, verify_case
from graspforce.contact.matrices import grasp_matrix
from graspforce.force.certificate import TIGHT_TOLERANCE, certify, certify_infeasibility
from graspforce.problems.case import Case, ExpectedInfeasibility, ExpectedOptimum
from graspforce.problems.generators import boundary
from graspforce.problems.generators.grasp_classes import GRASP_CLASSES, contact_places
from graspforce.problems.generators.records import contact_set
from graspforce.problems.objects import ist_objects

GENERATED = ("batch", "hard", "infeasible", "ist", "large", "pyramid", "robust", "scaling", "soft", "trajectory", "whole-hand")
RECORDED = ("closed-loop",)  # of a simulation, whose last digits depend on the machine


def test_there_are_enough_cases_of_every_kind() -> None:
    assert set(problems.collections()) >= {*problems.TEXTBOOK, *GENERATED, *RECORDED}
    assert len(problems.names()) >= 6000
    contacts = [len(problems.load(name).problem.contacts) for name in problems.names("scaling")]
    assert (min(contacts), max(contacts)) == (3, 1000)
    assert all(problems.describe(collection) for collection in (*problems.TEXTBOOK, *GENERATED, *RECORDED))
    assert all(len(problems.load(name).problem.contacts) == 500 for name in problems.names("large"))


def test_every_case_verifies() -> None:
    """All of them: optima found again and certified to 1e-8, proofs checked by the law alone."""
    checks = [verify_case(problems.load(name)) for name in problems.names()]
    assert [check.name for check in checks if not check.is_valid] == []
    assert max(check.residual for check in checks) <= 1e-8
    assert sum(summary.optimal + summary.infeasible for summary in summarize_checks(checks)) == len(problems.names())


def test_every_generated_answer_names_its_verifiers() -> None:
    for collection in (*GENERATED, *RECORDED):
        for name in problems.names(collection):
            known = problems.load(name).expected
            if isinstance(known, ExpectedOptimum):
                assert len(set(known.verified_by)) == 2, name
                assert known.tolerance <= 1e-4
            else:
                assert known.verified_by == ("proof",), name


@pytest.mark.parametrize(
    "collection", ["hard", "pyramid", "soft", "ist", "trajectory", "scaling", "whole-hand", "batch", "closed-loop"]
)
def test_optima_by_a_solver_that_shares_no_formula(collection: str) -> None:
    """QOCO on a formulation in SI written apart; a few cases of each collection. It is good to about 1e-6 there."""
    names = [name for name in problems.names(collection) if not name.startswith(("hard/scales", "hard/near", "hard/slippery"))]
    for name in names[:: max(1, len(names) // 12)]:
        case = problems.load(name)
        if isinstance(case.expected, ExpectedOptimum) and len(case.problem.contacts) <= 20:
            second = second_optimum(case.problem)
            assert second == pytest.approx(case.expected.objective, rel=2e-5), name


@pytest.mark.parametrize("collection", [name for name in GENERATED if name != "ist"])  # its search takes seconds: see below
def test_generators_reproduce_the_files(collection: str) -> None:
    """The same names in full; the numbers of what is quick to make, all but the last digits, which machines differ in."""
    module = importlib.import_module(f"graspforce.problems.generators.{collection.replace('-', '_')}")
    stated = {record["name"]: record for record in module.cases()}
    assert sorted(stated) == sorted(problems.names(collection))
    for name, record in stated.items():
        kept = json.loads(problems.text(name))
        expected = kept.pop("expected")
        if "expected" in record:
            assert expected["status"] == "infeasible"
        record.pop("expected", None)
        assert _near(record, kept), name


def test_whole_hand_contacts_feel_the_joints_before_their_link_only() -> None:
    """Palm contacts feel no joint, some fingers have several contacts, and shared joints move all fingers."""
    several = 0
    for name in problems.names("whole-hand"):
        problem = problems.load(name).problem
        shared, palm = {"inner": (0, 0), "palm": (0, 1), "shared": (1, 0), "shared-palm": (2, 2)}[name[11:-3]]
        moved = np.abs(problem.actuation.J) > 0.0
        rows = problem.contacts.columns // 4
        felt = np.array([moved[rows == i].any(axis=0) for i in range(len(problem.contacts))])
        on_fingers = felt[: len(felt) - palm]
        assert not felt[len(felt) - palm :].any()
        assert on_fingers[:, :shared].all()
        fingers = on_fingers[:, shared:].reshape(len(on_fingers), -1, 3)
        assert (fingers.any(axis=2).sum(axis=1) == 1).all()  # one finger each
        assert (np.diff(fingers.astype(int), axis=2) <= 0).all()  # joints from the base on
        several += int((fingers.any(axis=2).sum(axis=0) > 1).any())
    assert several > 50


def test_ist_loads_and_contacts_follow_the_table() -> None:
    """Without the search for postures: contacts on the surface, the weight borne, all classes and objects there."""
    assert len({name.split("/")[1] for name in problems.names("ist")}) == len(problems.names("ist"))
    names = set(problems.names("ist"))
    seen = set()
    for one in ist_objects():
        for grasp_class in GRASP_CLASSES:
            touching = contact_places(one, grasp_class)
            stem = f"ist/{one.title}-{grasp_class}-plus-z".replace(", ", "-").replace(" ", "-")
            assert (stem in names) == (touching is not None)
            if touching is None:
                continue
            seen.add((one.title, grasp_class))
            case = problems.load(stem)
            assert np.linalg.norm(case.problem.w[:3]) == pytest.approx(one.mass * 9.81)
            assert case.problem.w[2] < 0.0  # gravity along +z: the contacts push down
            for contact in case.problem.contacts.contacts:
                assert np.linalg.norm(one.shape.project_to_surface(contact.position) - contact.position) < 1e-9
                assert contact.normal == pytest.approx(one.shape.inward_normal(contact.position), abs=1e-6)
    assert {title for title, _ in seen} == {one.title for one in ist_objects()}
    assert {grasp_class for _, grasp_class in seen} == set(GRASP_CLASSES)
    hands = {name.rpartition("-z-")[2] for name in names if "plus-z-" in name}
    assert hands == {"four-finger", "dlr-hit2", "allegro-right"}


def test_ist_fingertips_are_at_the_contacts() -> None:
    """The motors bear f with tau = tau_u + Jᵀ f within their limits, and only touching fingers' motors feel it."""
    names = [name for name in problems.names("ist") if "plus-x-" in name]
    for name in names[::9]:
        case = problems.load(name)
        actuation = case.problem.actuation
        assert actuation is not None
        assert np.isfinite(actuation.upper).all()
        loaded = int((actuation.J != 0.0).any(axis=0).sum())
        assert 2 * len(case.problem.contacts) <= loaded <= 4 * len(case.problem.contacts)  # three or four motors a finger
        if isinstance(case.expected, ExpectedOptimum):
            answer = gf.solve(case.problem)
            assert (answer.torques <= actuation.upper + 1e-7).all()
            assert (answer.torques >= actuation.lower - 1e-7).all()


@pytest.mark.parametrize("with_hand", [False, True])
def test_boundary_loads_match_the_support_function(with_hand: bool) -> None:
    """yᵀw over all forces within the limits, sampled, never exceeds yᵀw*, and w* itself is held."""
    rng = np.random.default_rng(5)
    for _, drawn, _ in list(boundary.boundary_loads(3, 1, boundary.INSIDE_MARGINS))[int(with_hand) :: 2]:
        contacts = contact_set(drawn.contacts)
        G, y = grasp_matrix(contacts), np.array(drawn.proof["y"])
        best = y @ drawn.w
        assert best > 0.0
        normals = rng.uniform(0, 20.0, (2000, len(contacts)))
        angles, used = rng.uniform(-math.pi, math.pi, normals.shape), np.sqrt(rng.random(normals.shape))
        f = np.stack([used * contacts.mu * normals * trig(angles) for trig in (np.cos, np.sin)] + [normals], axis=-1)
        f = f.reshape(2000, -1)
        if drawn.hand is not None:
            actuation = gf.Actuation.from_dict(drawn.hand)
            tau = actuation.tau_u + f @ actuation.J
            worst = np.maximum(
                (tau - actuation.tau_u) / (actuation.upper - actuation.tau_u),
                (tau - actuation.tau_u) / (actuation.lower - actuation.tau_u),
            )
            f /= np.maximum(worst.max(axis=1), 1.0)[:, None]  # back within the motors' limits: f = 0 is inside
        assert (f @ (G.T @ y)).max() <= best * (1 + 1e-12)


def test_infeasible_boundary_cases_have_the_named_margin() -> None:
    """At the load over (1 + 2ε) there is an answer again."""
    for name in problems.names("infeasible"):
        if "near-1e-0" in name and name.endswith(("-1", "-2")):
            case = problems.load(name)
            margin = float(name.split("near-")[1][:5])
            assert isinstance(case.expected, ExpectedInfeasibility)
            held = case.problem.replace(w=case.problem.w / (1.0 + 2.0 * margin))
            assert gf.solve(held, explain=False).status is gf.Status.OPTIMAL


def test_no_case_has_both_an_optimum_and_an_infeasibility_proof() -> None:
    """Forces that miss by up to the certificate's tolerance are an answer; every proof must exclude those, too."""
    for name in problems.names():
        case = problems.load(name)
        if isinstance(case.expected, ExpectedInfeasibility):
            assert (
                infeasibility_margin(case.problem, certify_infeasibility(case.problem, case.expected.proof))
                > 2.0 * TIGHT_TOLERANCE
            ), name
            assert not gf.solve(case.problem, explain=False).found, name
        # an optimum that is found again, as another test does with every case, leaves no proof against it: see
        # `infeasibility_margin`


@pytest.mark.parametrize(
    ("name", "factor"),
    [("infeasible/near-1e-04-object-1", 1.000101), ("infeasible/near-1e-02-hand-1", 1.0101), ("infeasible/twisted-03", 2.01)],
)
@pytest.mark.parametrize("kind", ["exact", "inner"])
def test_proof_bound_is_below_every_residual(name: str, factor: float, kind: str) -> None:
    """No forces miss by less, whatever they are; and those that hold the load over a factor miss by not much more."""
    rng, problem = np.random.default_rng(11), problems.load(name).problem
    f = gf.solve(problem.replace(w=problem.w / factor), explain=False).f
    if kind == "inner":
        problem = dataclasses.replace(problem, cone=gf.Cone("pyramid", 8, "inner"))
    proof = gf.solve(problem, explain=False).infeasibility.multipliers
    least = infeasibility_margin(problem, certify_infeasibility(problem, proof))
    noise = [
        step * np.abs(f).max() * rng.normal(size=problem.size) for step in (0.0, 1e-5, 1e-4, 1e-3, 0.1, 1.0) for _ in range(20)
    ]
    misses = [certify(problem, f + one, proof).primal_residual for one in noise]
    assert 0.0 < least <= min(misses)
    if kind == "exact":  # f is on the polygon's outside by as much as the cone is
        assert min(misses) <= 300.0 * least


def test_sequences_change_little_from_step_to_step() -> None:
    """Warm starts need that: no step of a sequence changes the load by more than a fifth of its largest."""
    sequences: dict[str, list[Case]] = {}
    for name in problems.names("trajectory"):
        sequences.setdefault(name.rpartition("-")[0], []).append(problems.load(name))
    assert len(sequences) == 12
    for cases in sequences.values():
        assert len(cases) == 41
        loads = np.array([case.problem.w for case in cases])
        assert np.linalg.norm(np.diff(loads, axis=0), axis=1).max() <= 0.2 * np.linalg.norm(loads, axis=1).max()


def _near(a: object, b: object) -> bool:
    """Equal, numbers to eight of their nine digits, or as near as rounding leaves them beside the others of their list."""
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(_near(a[key], b[key]) for key in a)
    if isinstance(a, list) and isinstance(b, list):
        if len(a) == len(b) and all(isinstance(x, int | float) for x in [*a, *b]):
            x, y = np.array(a, dtype=float), np.array(b, dtype=float)
            return bool(np.abs(x - y).max(initial=0.0) <= 1e-8 * np.abs(y).max(initial=0.0))
        return len(a) == len(b) and all(_near(x, y) for x, y in zip(a, b, strict=True))
    if isinstance(a, int | float) and isinstance(b, int | float):
        return math.isclose(a, b, rel_tol=1e-8)
    return a == b


def test_readme_states_the_number_of_cases() -> None:
    text = (Path(__file__).parents[2] / "README.md").read_text()
    ours = sum(len(problems.names(collection)) for collection in (*problems.TEXTBOOK, *GENERATED, *RECORDED))
    assert f"{ours:,} force problems with proven answers" in text
