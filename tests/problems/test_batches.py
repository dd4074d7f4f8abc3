"""Tests of the batches of ten thousand problems: their answers, and the cases made of their first members."""

from __future__ import annotations

import numpy as np
import pytest

import graspforce as gf
from graspforce import problems
from graspforce.bench.library_check import infeasibility_margin, verify_case
from graspforce.core.errors import UnknownName
from graspforce.force.certificate import TIGHT_TOLERANCE, certify_infeasibility
from graspforce.problems.batches import TOLERANCE
from graspforce.problems.generators.batch import CASES, COUNT, KINDS, make_batch

BATCHES = {kind: problems.load_batch(kind) for kind in KINDS}


@pytest.mark.parametrize("kind", KINDS)
def test_every_40th_answer_is_found_again(kind: str) -> None:
    batch = BATCHES[kind]
    assert len(batch) == COUNT == 10_000
    for i in range(0, COUNT, 40):
        check = verify_case(batch.case(i))
        assert check.is_valid, i
        assert check.residual <= 1e-8


def test_loads_that_exceed_the_normal_forces_are_proven_infeasible() -> None:
    for kind, batch in BATCHES.items():
        infeasible = np.flatnonzero(np.isnan(batch.objectives))
        assert (len(infeasible) > 500) == (kind == "limits")
        assert not batch.proofs[~np.isnan(batch.objectives)].any()
        for i in infeasible[::10]:
            case = batch.case(int(i))
            proof = certify_infeasibility(case.problem, case.expected.proof)
            assert proof.certificate.verified
            assert infeasibility_margin(case.problem, proof) > 2.0 * TIGHT_TOLERANCE


@pytest.mark.parametrize("kind", KINDS)
def test_first_members_are_cases_of_the_library(kind: str) -> None:
    batch = BATCHES[kind]
    names = [name for name in problems.names("batch") if name.startswith(f"batch/{kind}-")]
    assert len(names) == CASES
    for i in range(0, CASES, 7):
        member, case = batch.case(i), problems.load(names[i])
        assert member.name == case.name
        assert member.problem.to_dict() == case.problem.to_dict()
        assert member.expected.status == case.expected.status
        if isinstance(case.expected, problems.ExpectedOptimum):
            assert member.expected.objective == pytest.approx(case.expected.objective, rel=TOLERANCE)


@pytest.mark.parametrize("kind", KINDS)
def test_generator_makes_the_stored_loads(kind: str) -> None:
    """But for the last digits of sines, which machines differ in and which may move a load by one unit."""
    units = np.abs(make_batch(kind).loads * problems.batches.UNITS - BATCHES[kind].wrenches) / problems.batches.UNITS
    assert units.max() <= 1.0
    assert np.count_nonzero(units) <= 10


def test_members_beyond_the_batch_are_rejected() -> None:
    with pytest.raises(gf.InvalidInput, match="index = 10000: must be 0 to 9999"):
        BATCHES["force"].case(COUNT)
    with pytest.raises(UnknownName, match="force"):
        problems.load_batch("forces")
