"""The certificate in C: equal to the reference in Python, and safe against overflow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("graspforce.force.backends._structured", reason="the kernel was not built: no C compiler at installation")

from support.kernel_cases import CaseOptions, case_from_problem, random_case
from support.kernel_runs import INACCURATE, INFEASIBLE, OPTIMAL, bind_kernel, certified_residuals, unpack_answer
from support.random_problems import inner_forces, random_actuation, random_contacts

from graspforce import Cone, ContactSet, ForceProblem, Objective
from graspforce.force.certificate import certify, certify_infeasibility
from graspforce.force.multipliers import Multipliers


def random_problem(rng: np.random.Generator) -> ForceProblem:
    contacts = ContactSet.stack(random_contacts(rng, int(rng.integers(2, 7))))
    f = inner_forces(rng, contacts, share=0.6)
    actuation = random_actuation(rng, contacts, f) if rng.random() < 0.7 else None
    kind = str(rng.choice(["torque", "force", "sum_normal"] if actuation else ["force", "sum_normal"]))
    weight = float(rng.choice([0.0, 0.01])) if kind == "torque" else 0.0
    w = np.einsum("irc,ic->r", contacts.wrench_bases(), contacts.pad(f))  # G f
    return ForceProblem(contacts, w, actuation, Cone(), Objective(kind, weight))


def test_certificate_equals_its_reference_in_python() -> None:
    """Residuals agree for solutions, and for forces and multipliers far from a solution."""
    rng = np.random.default_rng(71)
    for _ in range(60):
        problem = random_problem(rng)
        kernel, outputs = bind_kernel(case_from_problem(problem))
        kernel.solve(0, 1, 1e-9, 60, False)
        for noise in (0.0, 1e-3, 1.0):
            for name in ("f", "y", "nu_lower", "nu_upper", "lambda_lower", "lambda_upper"):
                outputs[name][0] += noise * rng.normal(size=outputs[name].shape[1])
            kernel.certify(0, 1)
            a = unpack_answer(outputs)
            y = a.y + np.append(np.cross(problem.contacts.centroid, a.y[3:]), np.zeros(3))  # about O, from the centroid
            level = np.zeros(len(problem.contacts))
            multipliers = Multipliers(y, a.nu_lower, a.nu_upper, a.lambda_lower, a.lambda_upper, level)
            reference = certify(problem, a.f, multipliers)
            expected = [reference.primal_residual, reference.dual_residual, reference.gap]
            np.testing.assert_allclose(certified_residuals(outputs), expected, rtol=1e-9, atol=1e-13)
            np.testing.assert_allclose(a.tau, problem.torques(a.f), rtol=1e-12, atol=1e-14)


def infeasible_problem(rng: np.random.Generator) -> ForceProblem:
    """Return a problem with a wrench beyond its limits, O away from the contacts, and some normal forces without limit."""
    problem = random_problem(rng)
    limits = np.array([problem.contacts.min_normal, problem.contacts.max_normal])
    if problem.actuation is not None:
        limits[1, rng.random(len(problem.contacts)) < 0.3] = np.inf
    contacts = problem.replace(normal_limits=limits, p=problem.contacts.p_OC + 0.1 * rng.normal(size=3)).contacts
    return ForceProblem(contacts, 1e3 * rng.normal(size=6), problem.actuation, problem.cone, problem.objective)


def test_certificate_of_infeasibility_equals_its_reference_in_python() -> None:
    """Verdict, residual and value agree for proofs, for multipliers near them, and for multipliers that prove nothing."""
    rng, verdicts = np.random.default_rng(76), []
    for _ in range(100):
        problem = infeasible_problem(rng)
        kernel, outputs = bind_kernel(case_from_problem(problem))
        if kernel.solve(0, 1, 1e-9, 60, False) != INFEASIBLE:
            continue
        for noise in (0.0, 1e-12, 1e-8, 1e-3, 1.0):
            for name in ("y", "nu_lower", "nu_upper", "lambda_lower", "lambda_upper"):
                outputs[name][0] += noise * np.abs(outputs[name][0]).max(initial=0.0) * rng.normal(size=outputs[name].shape[1])
            kernel.certify(0, 1)
            a = unpack_answer(outputs)
            y = a.y + np.append(np.cross(problem.contacts.centroid, a.y[3:]), np.zeros(3))  # about O, from the centroid
            level = np.zeros(len(problem.contacts))
            multipliers = Multipliers(y, a.nu_lower, a.nu_upper, a.lambda_lower, a.lambda_upper, level)
            reference = certify_infeasibility(problem, multipliers).certificate
            primal, residual, value = certified_residuals(outputs)
            assert (primal == 0.0) == reference.verified
            # y is moved to O and back, so that z, which is zero where K* has its apex, keeps the rounding of y G
            np.testing.assert_allclose([residual, value], [reference.dual_residual, reference.gap], rtol=1e-9, atol=1e-12)
            verdicts.append(reference.verified)
    assert 100 < sum(verdicts) < len(verdicts) - 100


def test_every_optimal_solution_is_certified() -> None:
    """All residuals are within the tight tolerance of 1e-8."""
    rng = np.random.default_rng(72)
    statuses = []
    for _ in range(100):
        kernel, outputs = bind_kernel(case_from_problem(random_problem(rng)))
        statuses.append(kernel.solve(0, 1, 1e-9, 60, False))
        kernel.certify(0, 1)
        if statuses[-1] == OPTIMAL:
            assert certified_residuals(outputs).max() <= 1e-8
    assert statuses.count(OPTIMAL) >= 95
    assert INACCURATE not in statuses


def units_of_centimetres(joints: int) -> dict[str, np.ndarray]:
    return {"length_unit": np.full(1, 0.05), "torque_unit": np.full(joints, 0.05)}


def test_residuals_that_are_not_finite_become_the_largest_number() -> None:
    case = random_case(np.random.default_rng(73), 3)
    case = replace(case, units=units_of_centimetres(case.sizes[1]))
    for bad in (np.nan, np.inf, 1e300):
        kernel, outputs = bind_kernel(case)
        kernel.solve(0, 1, 1e-9, 60, False)
        outputs["f"][0, 1] = bad
        kernel.certify(0, 1)
        assert np.isfinite(certified_residuals(outputs)).all()
        assert certified_residuals(outputs).max() >= 1e6


def test_certificate_relative_to_an_infinite_cost_proves_nothing() -> None:
    """A joint without load gets a torque of 1e200 N·m after the solution. Relative to its square, every gap would be zero."""
    case = random_case(np.random.default_rng(75), 3)
    case.J[:, 0] = 0.0
    case = replace(case, units=units_of_centimetres(case.sizes[1]))
    kernel, outputs = bind_kernel(case)
    kernel.solve(0, 1, 1e-9, 60, False)
    case.tau_u[0] = 1e200
    kernel.certify(0, 1)
    assert (certified_residuals(outputs)[1:] == np.finfo(float).max).all()


def test_certificate_rejects_pyramids() -> None:
    kernel, _ = bind_kernel(random_case(np.random.default_rng(74), 3, CaseOptions(facets=4)))
    with pytest.raises(ValueError, match="exact cones, not pyramids"):
        kernel.certify(0, 1)
