"""Certificates that hold in exact arithmetic: the exact checker agrees, and refuses what is false."""

from __future__ import annotations

import copy
import dataclasses
import json
import subprocess
import sys
from collections import Counter
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from support.other_units import in_other_units
from support.random_problems import random_problem
from typer.testing import CliRunner

pytest.importorskip("graspforce.force.backends._structured", reason="the kernel was not built: no C compiler at installation")

import graspforce as gf
from graspforce.analysis import check_proof
from graspforce.cli import app
from graspforce.core.errors import InvalidInput
from graspforce.force.certificate import certify, certify_infeasibility
from graspforce.force.problem_options import OBJECTIVE_TYPES
from graspforce.force.proof_file import digest, make_proof, write_proof


def random_problems(count: int, seed: int) -> list[gf.ForceProblem]:
    """Return random problems with all cones and objectives, in units from 1e-12 to 1e12."""
    rng, problems = np.random.default_rng(seed), []
    while len(problems) < count:
        problem = random_problem(rng, overload_probability=0.4)
        problems.append(in_other_units(problem, 10.0 ** rng.uniform(-12, 12), 10.0 ** rng.uniform(-3, 3)))
    return problems


def test_exact_checker_agrees_with_every_claim():
    optimal, infeasible = Counter(), Counter()
    for problem in random_problems(200, 31):
        solution = gf.solve(problem, explain=False)
        if solution.status is not gf.Status.FAILED:
            assert check_proof.check(make_proof(solution)) == ("optimal" if solution.found else "infeasible")
            kind = "exact" if problem.cone.type == "exact" else problem.cone.side
            counts = optimal if solution.found else infeasible
            counts.update((kind, problem.objective.type))
    assert min(optimal[name] for name in ("exact", "inner", "outer", *OBJECTIVE_TYPES)) >= 10, optimal
    assert min(infeasible[name] for name in ("exact", "inner", "outer")) >= 5, infeasible


def test_rigorous_certificates_are_tight():
    """The bounds on rounding do not change the verdict, and the gap is at least that of the plain certificate."""
    for problem in random_problems(60, 32):
        solution = gf.solve(problem, explain=False)
        if solution.status is gf.Status.OPTIMAL:
            certificate = certify(problem, solution.f, solution.multipliers, rigorous=True)
            plain = certify(problem, solution.f, solution.multipliers)
            assert certificate.is_tight
            assert certificate.primal_residual >= plain.primal_residual * (1 - 1e-6)
            assert certificate.proven.gap >= 0.0
        elif solution.status is gf.Status.INFEASIBLE:
            assert certify_infeasibility(problem, solution.multipliers, rigorous=True).certificate.verified


def test_claims_about_numbers_that_a_solver_did_not_find_are_true():
    """The bounds hold for any forces and multipliers: noise makes them larger, and the exact checker still agrees."""
    rng, gaps = np.random.default_rng(34), []
    for problem in random_problems(60, 35):
        solution = gf.solve(problem, explain=False)
        if not solution.found:
            continue
        noise = 10.0 ** rng.uniform(-15.0, -9.5)
        m = solution.multipliers
        names = ("y", "normal_lower", "normal_upper", "torque_lower", "torque_upper")
        parts = {name: getattr(m, name) * (1.0 + noise * rng.normal(size=getattr(m, name).shape)) for name in names}
        f = solution.f * (1.0 + noise * rng.normal(size=len(solution.f)))
        noisy = dataclasses.replace(solution, f=f, multipliers=dataclasses.replace(m, **parts))
        if certify(problem, f, noisy.multipliers, rigorous=True).verified:
            proof = make_proof(noisy)
            gaps.append(proof["claim"]["gap"])
            assert check_proof.check(proof) == "optimal"
    assert len(gaps) > 20


def test_nearest_infeasible_cases_of_the_library_are_proven():
    """Their loads are 1e-6 and 3e-6 beyond the boundary of the feasible ones."""
    names = [name for name in gf.problems.names("infeasible") if "near-1e-06" in name or "near-3e-06" in name]
    assert len(names) == 24
    for name in names:
        solution = gf.solve(gf.problems.load(name).problem, explain=False)
        assert check_proof.check(make_proof(solution)) == "infeasible", name


def test_far_origin_keeps_the_proof():
    """The moment about the contacts is a small difference of large numbers, which the proof sums with twice the digits."""
    problem = gf.problems.load("ring/3-force").problem
    shift = np.array([1e4, -2e4, 3e4])
    w = problem.w + np.append(np.zeros(3), np.cross(shift, problem.w[:3]))
    far = gf.ForceProblem(problem.replace(p=problem.contacts.p_OC + shift).contacts, w, objective=problem.objective)
    proof = make_proof(gf.solve(far))
    assert check_proof.check(proof) == "optimal"
    assert proof["claim"]["gap"] < 1e-7


def mutations(rng: np.random.Generator, proof: dict, count: int):
    """Yield copies of a proof with one number replaced, and the path of that number."""
    places = list(number_places(proof))
    for _ in range(count):
        mutated = copy.deepcopy(proof)
        *path, last = places[rng.integers(len(places))]
        parent = mutated
        for key in path:
            parent = parent[key]
        value = parent[last]
        factor = float(rng.choice([-1.0, 0.0, 0.5, 1.0 + 1e-6, 1.0 - 1e-9, 2.0, 1e6]))
        parent[last] = value * factor if value and factor != 1.0 else value + float(rng.choice([-1.0, 1.0, 1e-6]))
        yield mutated, (*path, last)


def number_places(node, path=()):
    """Yield the paths of all numbers of a record."""
    if isinstance(node, dict):
        for key, value in node.items():
            yield from number_places(value, (*path, key))
    elif isinstance(node, list):
        for i, value in enumerate(node):
            yield from number_places(value, (*path, i))
    elif isinstance(node, int | float):
        yield path


@pytest.mark.parametrize("name", ["ring/3-force", "trajectory/carry-1-000", "infeasible/pulled-01"])
def test_mutated_proofs_are_refused(name):
    """Without a new checksum every mutation is refused."""
    proof = make_proof(gf.solve(gf.problems.load(name).problem, explain=False))
    assert check_proof.check(proof)
    rng = np.random.default_rng(33)
    for mutated, place in mutations(rng, proof, 150):
        with pytest.raises(check_proof.ProofError):
            check_proof.check(mutated)
        assert place


@pytest.mark.parametrize("name", ["ring/3-force", "trajectory/carry-1-000"])
def test_claims_that_are_too_strong_are_refused_even_with_a_new_checksum(name):
    """A smaller violation or gap than the exact one, other forces, and other data are refused by arithmetic."""
    problem = gf.problems.load(name).problem
    solution = gf.solve(problem)
    proof = make_proof(solution)

    def refused(change) -> bool:
        mutated = copy.deepcopy(proof)
        change(mutated)
        mutated["digest"] = digest(mutated)
        try:
            check_proof.check(mutated)
        except check_proof.ProofError:
            return True
        return False

    assert not refused(lambda p: None)
    assert not refused(lambda p: p["claim"].update(gap=2.0 * p["claim"]["gap"] + 1e-9))
    assert refused(lambda p: p["claim"].update(gap=0.0))
    assert refused(lambda p: p["claim"].update(violation=0.0))
    assert refused(lambda p: p["claim"].update(status="infeasible"))
    assert refused(lambda p: p["wrench"].__setitem__(2, 1.001 * p["wrench"][2]))
    assert refused(lambda p: p["forces"].__setitem__(2, 0.9 * p["forces"][2]))
    assert refused(lambda p: p["contacts"][0].update(friction=0.9 * p["contacts"][0]["friction"]))
    assert refused(lambda p: p["multipliers"]["y"].__setitem__(2, 1.1 * p["multipliers"]["y"][2]))
    assert refused(lambda p: p["multipliers"]["normal_lower"].__setitem__(0, -1.0))
    assert refused(lambda p: p.update(contacts=p["contacts"][1:]))
    assert refused(lambda p: p["forces"].__setitem__(0, "1"))
    assert refused(lambda p: p["forces"].__setitem__(0, float("nan")))


def test_exact_gap_of_a_proof_is_within_its_claim():
    """For one contact that carries its weight the gap and the violation are computed by hand."""
    contact = gf.Contact([0, 0, 0], [0, 0, 1], model="frictionless", max_normal=4.0)
    solution = gf.solve(gf.ForceProblem([contact], [0, 0, 2.0, 0, 0, 0]))
    proof = make_proof(solution)
    f, y = Fraction(float(solution.f[0])), Fraction(proof["multipliers"]["y"][2])
    lower, upper = (Fraction(proof["multipliers"][name][0]) for name in ("normal_lower", "normal_upper"))
    z = f - y - lower + upper
    gap = y * (f - 2) + z * f + lower * f + upper * (4 - f) + max(-z, Fraction(0)) * 4
    assert gap <= Fraction(proof["claim"]["gap"])
    assert abs(f - 2) <= Fraction(proof["claim"]["violation"]) * Fraction(proof["units"]["force"])
    assert Fraction(proof["claim"]["gap"]) <= gap + Fraction(1, 10**12)


def test_unsupported_statements_are_refused():
    problem = gf.problems.load("ring/3-force").problem
    uncertain = gf.ForceProblem(problem.contacts, problem.w, uncertainty=gf.Uncertainty(friction_error=0.1))
    with pytest.raises(InvalidInput, match="uncertainty"):
        make_proof(gf.solve(uncertain))


def pressed_pair(cone: gf.Cone | None = None, model: str = "point") -> gf.ForceProblem:
    """Return two opposed contacts of at most 10 N with μ = 0.5 that bear 4 N upwards, for the largest slip margin.

    Each needs 2 N of friction: the margin is 0.5 · 10 N − 2 N with exact cones. The tangent t₂ is upwards.
    """
    torsion = {"torsional_friction": 0.01} if model == "soft" else {}
    contacts = [
        gf.Contact((0, y, 0), (0, -y, 0), 0.5, model, tangent=(1, 0, 0), max_normal=10.0, **torsion) for y in (0.05, -0.05)
    ]
    return gf.ForceProblem(contacts, (0, 0, 4.0, 0, 0, 0), cone=cone, objective=gf.Objective("margin"))


@pytest.mark.parametrize("model", ["point", "soft"])
def test_largest_slip_margin_is_proven_for_exact_cones_and_pyramids(model):
    """A facet of the square pyramid faces upwards: 0.5 cos 45° · 10 N − 2 N inside, and as the exact cone outside."""
    for cone, margin in ((None, 3.0), (gf.Cone("pyramid", 4), 5.0 * np.sqrt(0.5) - 2.0), (gf.Cone("pyramid", 4, "outer"), 3.0)):
        proof = make_proof(gf.solve(pressed_pair(cone, model)))
        assert check_proof.check(proof) == "optimal"
        assert proof["claim"]["slip_margin"] == pytest.approx(margin, abs=1e-6)
        assert 0.0 <= proof["claim"]["gap"] < 1e-6
        for change in (
            lambda p: p["claim"].update(slip_margin=p["claim"]["slip_margin"] + 1e-6),
            lambda p: p["claim"].update(gap=0.0, slip_margin=p["claim"]["slip_margin"] - 1e-3),
            lambda p: [c.update(friction=1.01 * c["friction"], polygon=c["polygon"][::-1]) for c in p["contacts"]],
        ):
            mutated = copy.deepcopy(proof)
            change(mutated)
            mutated["digest"] = digest(mutated)
            if mutated != proof:
                with pytest.raises(check_proof.ProofError):
                    check_proof.check(mutated)


def test_levels_of_the_largest_normal_force_have_a_sum_of_at_most_one():
    problem = gf.ForceProblem(gf.problems.load("ring/3-force").problem.contacts, (0, 0, 1.0, 0, 0, 0), None, None)
    solution = gf.solve(gf.ForceProblem(problem.contacts, problem.w, objective=gf.Objective("max_normal")))
    proof = make_proof(solution)
    assert check_proof.check(proof) == "optimal"
    assert sum(map(Fraction, proof["multipliers"]["level"])) <= 1
    proof["multipliers"]["level"][0] += 1e-9
    proof["digest"] = digest(proof)
    with pytest.raises(check_proof.ProofError, match="out of range"):
        check_proof.check(proof)


def test_polygons_that_are_not_about_zero_are_refused():
    """A cone over a polygon in clockwise order, or beside zero, has another dual cone than the edges give."""
    problem = gf.problems.load("ring/3-force").problem
    proof = make_proof(gf.solve(gf.ForceProblem(problem.contacts, problem.w, cone=gf.Cone("pyramid", 6))))
    assert check_proof.check(proof) == "optimal"
    for change in (lambda v: v[::-1], lambda v: [[x + 1.0, y] for x, y in v], lambda v: [[0.99 * x, 0.99 * y] for x, y in v]):
        mutated = copy.deepcopy(proof)
        mutated["contacts"][0]["polygon"] = change(mutated["contacts"][0]["polygon"])
        mutated["digest"] = digest(mutated)
        with pytest.raises(check_proof.ProofError):
            check_proof.check(mutated)


def test_numbers_that_overflow_prove_nothing():
    problem = gf.problems.load("ring/3-force").problem
    solution = gf.solve(problem)
    assert not certify(problem, np.full(problem.size, 1e200), solution.multipliers, rigorous=True).verified
    assert not certify(problem, np.full(problem.size, np.nan), solution.multipliers, rigorous=True).verified


def test_command_writes_a_proof_that_the_program_checks(tmp_path: Path):
    """The checker runs alone, without the package on its path."""
    problem, proof = tmp_path / "problem.json", tmp_path / "proof.json"
    problem.write_text(json.dumps(gf.problems.load("ring/3-force").problem.to_dict()))
    result = CliRunner().invoke(app, ["solve", str(problem), "--proof", str(proof)])
    assert result.exit_code == 0, result.output
    command = [sys.executable, "-I", "-S", check_proof.__file__, str(proof)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, "proven optimal" in done.stdout) == (0, True)
    proof.write_text(proof.read_text().replace("0.5", "0.6", 1))
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, "refused" in done.stdout) == (1, True)
    write_proof(gf.solve(gf.problems.load("infeasible/pulled-01").problem), proof)
    assert "proven infeasible" in subprocess.run(command, capture_output=True, text=True, check=True).stdout


def test_checker_has_at_most_250_lines_and_imports_the_standard_library_only():
    text = Path(check_proof.__file__).read_text()
    assert len(text.splitlines()) <= 250
    imported = [line.split()[1] for line in text.splitlines() if line.startswith(("import ", "from "))]
    assert set(imported) <= set(sys.stdlib_module_names) | {"__future__"}
