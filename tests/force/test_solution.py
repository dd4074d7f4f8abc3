"""A solution as text, HTML and figure."""

from __future__ import annotations

import numpy as np
import pytest
from support.random_problems import feasible_problem

import graspforce as gf
from graspforce.core.errors import InvalidInput


def pair(load: float, **changes: object) -> gf.ForceProblem:
    """Return two opposed contacts 10 cm apart that lift a load, N."""
    contacts = [gf.Contact([0, y, 0], [0, -np.sign(y), 0], 0.5, max_normal=10.0, **changes) for y in (-0.05, 0.05)]
    return gf.ForceProblem(contacts, [0, 0, load, 0, 0, 0])


def test_solution_prints_forces_margins_and_friction():
    lines = str(gf.solve(pair(4.0))).splitlines()
    assert lines[0].startswith("optimal, objective 20, structured, ")
    assert lines[1:] == [
        "  contact  normal (N)  tangential (N)  slip margin (N)  friction used (%)",
        "        0           4               2                0                100",
        "        1           4               2                0                100",
    ]


def test_moments_of_soft_contacts_have_a_column():
    solution = gf.solve(pair(4.0, model="soft", torsional_friction=0.01))
    assert "moment (N·m)" in str(solution)
    assert "moment (N·m)" in solution._repr_html_()


def test_infeasible_solution_prints_its_explanation():
    solution = gf.solve(pair(12.0), explain=False)
    assert str(solution).splitlines()[0].startswith("infeasible, ")
    assert str(solution).splitlines()[1:] == [solution.infeasibility.explanation]
    assert solution.infeasibility.explanation in solution._repr_html_()


def test_few_torques_are_printed_and_many_are_not():
    assert "torques (N·m): " in str(gf.solve(feasible_problem(1, count=4)))
    assert "torques" not in str(gf.solve(feasible_problem(1, count=8)))


def test_solution_over_the_wire_prints_the_same():
    solution = gf.solve(feasible_problem(2))
    assert str(gf.Solution.from_dict(solution.to_dict())) == str(solution)
    assert repr(solution) == f"<Solution: {str(solution).splitlines()[0]}>"


def test_solution_plots_itself():
    assert len(gf.solve(feasible_problem(3)).plot().axes) == 3
    assert len(gf.solve(pair(4.0)).plot().axes) == 2
    with pytest.raises(InvalidInput, match="infeasible"):
        gf.solve(pair(12.0), explain=False).plot()
