"""Problems without a solution: infeasibility proofs, and invalid numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("graspforce.force.backends._structured", reason="the kernel was not built: no C compiler at installation")

from support.kernel_cases import CaseOptions, case_without_hand, random_case
from support.kernel_checks import dual_value, largest_load_factor, proof_margin, smallest_multiplier
from support.kernel_runs import FAILED, INFEASIBLE, OPTIMAL, bind_kernel, solve

KINDS = {
    "point": CaseOptions(),
    "soft": CaseOptions(models=(4,)),
    "mixed": CaseOptions(models=(1, 3, 4), joints=(2, 3, 4, 5)),
    "several contacts per finger": CaseOptions(contacts=(1, 2, 3), joints=(3, 4)),
    "missing limits": CaseOptions(unlimited=0.5),
    "fixed normal force and torque": CaseOptions(pinned=0.3, clamped=0.5, contacts=(1, 2), models=(1, 3, 4)),
}


@pytest.mark.parametrize("excess", [1e-4, 1e-2, 9.0])
@pytest.mark.parametrize("kind", KINDS)
def test_overload_is_proven_infeasible(kind: str, excess: float) -> None:
    """A load beyond the largest one that Clarabel finds is infeasible, and the multipliers prove it by themselves."""
    proven, rng = 0, np.random.default_rng(21)
    for case in [random_case(rng, int(rng.integers(3, 7)), KINDS[kind]) for _ in range(10)]:
        load = largest_load_factor(case)
        if not 1.0 <= load < 1e3:  # unbounded
            continue
        overloaded = replace(case, w=(1 + excess) * load * case.w)
        answer = solve(overloaded)
        if kind == "missing limits" and excess < 1e-3 and answer.status == FAILED:
            continue  # forces are unbounded, so a small excess may have no proof at finite precision
        assert answer.status == INFEASIBLE
        assert np.isnan(answer.f).all()
        assert smallest_multiplier(answer) >= 0.0
        assert dual_value(overloaded, answer) == pytest.approx(1.0, rel=1e-6)
        assert proof_margin(overloaded, answer) > 0.9
        proven += 1
        within = replace(case, w=(1 + 0.99 * (load - 1)) * case.w)  # between the load of the case and the largest load
        assert solve(within).status == OPTIMAL
    assert proven >= 5


@pytest.mark.parametrize("offset", [1e-3, 0.1])
@pytest.mark.parametrize("limit", [100.0, np.inf])
def test_wrench_outside_the_range_of_G_is_proven_infeasible(offset: float, limit: float) -> None:
    """Two point contacts resist no moment about the line between them."""
    case = case_without_hand([[0, -2, 0], [0, 2, 0]], [[0, 1, 0], [0, -1, 0]], 0.1, [0, 0, 10, 0, offset, 0], limit=limit)
    answer = solve(case)
    assert answer.status == INFEASIBLE
    assert proof_margin(case, answer) > 0.9


def test_contradicting_limits_are_proven_infeasible() -> None:
    """Crossed limits, and an overloaded motor that no contact force can relieve."""
    case = random_case(np.random.default_rng(22), 4)
    crossed = replace(case, min_normal=np.full(4, 2.0), max_normal=np.full(4, 1.0))
    torques = replace(case, lower=case.upper + 1.0)
    stuck = replace(case, J=case.J * (np.arange(12) > 0), tau_u=np.where(np.arange(12) == 0, 99.0, case.tau_u))
    for broken in (crossed, torques, stuck):
        answer = solve(broken)
        assert answer.status == INFEASIBLE
        assert proof_margin(broken, answer) > 0.9


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300])
@pytest.mark.parametrize("name", ["G", "w", "mu", "min_normal", "J", "tau_u", "weight", "cost", "force_weight"])
def test_non_finite_and_huge_numbers_return_failed(name: str, bad: float) -> None:
    """The iterations stay bounded, and the workspace solves the next problem as usual."""
    case = random_case(np.random.default_rng(41), 4)
    spoilt = getattr(case, name).copy()
    spoilt[tuple(np.argwhere(np.ones_like(spoilt) if name != "J" else case.J)[0])] = bad
    kernel, outputs = bind_kernel(case, **{name: spoilt})
    assert kernel.solve(0, 1, 1e-9, 60, False) in ((FAILED, INFEASIBLE) if bad == 1e300 else (FAILED,))
    assert outputs["report"]["iterations"][0] <= 60
    kernel, outputs = bind_kernel(case, count=2, **{name: np.stack([spoilt, getattr(case, name)])})
    kernel.solve(0, 2, 1e-9, 60, True)
    assert outputs["report"]["status"][1] == OPTIMAL
    np.testing.assert_allclose(outputs["f"][1], solve(case).f)


@pytest.mark.parametrize("name", ["mu", "weight", "force_weight"])
def test_negative_coefficients_return_failed(name: str) -> None:
    case = random_case(np.random.default_rng(42), 4)
    assert solve(replace(case, **{name: getattr(case, name) - 5.0})).status == FAILED
