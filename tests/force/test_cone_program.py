"""The cone program equals the force problem row by row, at any forces: cost, equilibrium, limits and cones."""

from __future__ import annotations

import numpy as np
import pytest
from support.random_problems import random_problem

from graspforce import Actuation, Contact, ForceProblem, Objective
from graspforce.force.cone_program import ConicProgram, conic_program

SEEDS = range(40)
ROUNDING = {"rel": 1e-10, "abs": 1e-10}  # sums of some tens of products of numbers of order one


def random_program(seed: int) -> tuple[ForceProblem, ConicProgram, np.ndarray, np.ndarray]:
    """Return a problem, its program, random forces, and their variables x."""
    rng = np.random.default_rng([6, seed])
    problem = random_problem(rng)
    program = conic_program(problem)
    f = np.zeros(problem.size)
    f[program.component_indices] = rng.normal(size=len(program.component_indices)) * program.units[program.component_indices]
    x = f[program.component_indices] / program.units[program.component_indices]
    level = problem.cost(f) / program.units[problem.contacts.normal_rows[0]]
    return problem, program, f, np.append(x, level) if len(program.q) > len(x) else x


@pytest.mark.parametrize("seed", SEEDS)
def test_program_variables_map_to_forces_and_back(seed):
    _, program, f, x = random_program(seed)
    assert program.forces(x) == pytest.approx(f, rel=1e-14)


@pytest.mark.parametrize("seed", SEEDS)
def test_program_cost_equals_the_objective(seed):
    """½ xᵀP x + qᵀx equals the objective up to a constant; "margin" has the opposite sign."""
    problem, program, f, x = random_program(seed)
    value = program.cost_unit * (0.5 * x @ program.P @ x + program.q @ x)
    if problem.objective.type == "margin":
        value = -value
    if problem.objective.type == "torque":
        value += problem.cost(np.zeros(problem.size))
    assert value == pytest.approx(problem.cost(f), **ROUNDING)


@pytest.mark.parametrize("seed", SEEDS)
def test_equality_rows_state_equilibrium_about_the_centroid(seed):
    """The rows are the errors of force, and of moment about the contacts' centroid."""
    problem, program, f, x = random_program(seed)
    missed = (program.A @ x - program.b)[:6] * program.wrench_units
    force, moment = np.split(problem.G @ f - problem.w, 2)
    about_centroid = moment - np.cross(np.mean(problem.contacts.p_OC, axis=0), force)
    assert missed == pytest.approx(np.append(force, about_centroid), **ROUNDING)


@pytest.mark.parametrize("seed", SEEDS)
def test_slack_of_limit_rows_times_unit_is_the_slack_of_the_limit(seed):
    """Every limit has one row."""
    problem, program, f, x = random_program(seed)
    contacts, actuation, tau = problem.contacts, problem.actuation, problem.torques(f)
    rows = zip(program.limits[len(program.b) - 6 :], program.d - program.C @ x, strict=True)
    seen = set()
    for limit, slack in rows:
        if limit is None or limit.kind == "level":
            continue
        seen.add((limit.kind, limit.index, limit.sign))
        value = f[contacts.normal_rows[limit.index]] if limit.kind == "normal" else tau[limit.index]
        sides = (contacts.min_normal, contacts.max_normal) if limit.kind == "normal" else (actuation.lower, actuation.upper)
        assert slack * limit.unit == pytest.approx(limit.sign * (value - sides[limit.sign < 0][limit.index]), **ROUNDING)
    wanted = {("normal", i, -1) for i in np.flatnonzero(np.isfinite(contacts.max_normal))}
    wanted |= {("normal", i, 1) for i in np.flatnonzero((contacts.min_normal > 0) | (contacts.mu == 0))}
    if actuation is not None:
        wanted |= {("torque", j, 1) for j in np.flatnonzero(np.isfinite(actuation.lower))}
        wanted |= {("torque", j, -1) for j in np.flatnonzero(np.isfinite(actuation.upper))}
    assert seen == wanted


@pytest.mark.parametrize("seed", SEEDS)
def test_margin_of_cone_rows_is_the_slip_margin(seed):
    """The margins are in force units; for "margin" they are smaller by s."""
    problem, program, f, x = random_program(seed)
    force = program.units[problem.contacts.normal_rows[0]]
    margins = problem.cone_margins(f)[problem.contacts.mu > 0]
    if problem.objective.type == "margin":
        margins = margins - problem.cost(f)
    if problem.cone.type == "exact":
        parts = np.split(program.r - program.S @ x, np.cumsum(program.cones)[:-1])
        found = [part[0] - np.linalg.norm(part[1:]) for part in parts if len(part)]
    else:
        last = 1 if problem.objective.type == "margin" else 0  # the row s ≥ 0
        facets = [
            slack
            for limit, slack in zip(program.limits[len(program.b) - 6 :], program.d - program.C @ x, strict=True)
            if limit is None
        ]
        facets = np.array(facets[: len(facets) - last])
        found, at = [], 0
        for gamma in problem.contacts.gamma[problem.contacts.mu > 0]:
            inner, outer = (2 * problem.cone.facets, problem.cone.facets + 2) if gamma > 0 else (problem.cone.facets,) * 2
            count = inner if problem.cone.side == "inner" else outer
            found.append(facets[at : at + count].min())
            at += count
        assert at == len(facets)
    assert force * np.array(found) == pytest.approx(margins, **ROUNDING)


def test_components_that_must_be_zero_have_no_variable():
    contacts = [
        Contact([0, 0, -1], [0, 0, 1], 0.0),
        Contact([0, 0, 1], [0, 0, -1], 0.5, "soft", torsional_friction=0.0),
        Contact([1, 0, 0], [-1, 0, 0], 0.5, max_normal=0.0),
        Contact([-1, 0, 0], [1, 0, 0], 0.0, "soft", torsional_friction=0.1),
    ]
    program = conic_program(ForceProblem(contacts, [0, 0, 1, 0, 0, 0]))
    # f_n of the first; all but m_n of the second; f_n of the third, which a row fixes at zero; f_n and m_n of the last
    assert program.component_indices.tolist() == [2, 3, 4, 5, 9, 12, 13]


def test_equal_limits_are_one_equality():
    contacts = [Contact([0, y, 0], [0, -np.sign(y), 0], 0.5, min_normal=2.0, max_normal=2.0) for y in (-1.0, 1.0)]
    actuation = Actuation(np.eye(6, 1, -2) * 0.1, lower=[0.2], upper=[0.2])
    program = conic_program(ForceProblem(contacts, np.zeros(6), actuation, objective=Objective("force")))
    assert [(limit.kind, limit.index, limit.sign) for limit in program.limits] == [
        ("normal", 0, 0),
        ("normal", 1, 0),
        ("torque", 0, 0),
    ]
    assert program.A.shape == (9, 6)
    assert len(program.d) == 0


def test_rows_are_of_unit_size_whatever_the_units():
    """A solver's absolute tolerance then means the same for a micro-gripper and for a crane."""
    for length, force in ((1e-4, 1e-3), (1.0, 1.0), (10.0, 1e5)):
        contacts = [Contact([0, y * length, 0], [0, -np.sign(y), 0], 0.5) for y in (-1.0, 1.0)]
        actuation = Actuation(np.ones((6, 2)) * length, lower=[-force * length] * 2, upper=[force * length] * 2)
        program = conic_program(ForceProblem(contacts, [0, 0, force, 0, 0, 0], actuation))
        reference = conic_program(
            ForceProblem(
                [Contact([0, y, 0], [0, -np.sign(y), 0], 0.5) for y in (-1.0, 1.0)],
                [0, 0, 1, 0, 0, 0],
                Actuation(np.ones((6, 2)), lower=[-1, -1], upper=[1, 1]),
            )
        )
        for name in ("P", "q", "A", "b", "C", "d", "S", "r"):
            assert getattr(program, name) == pytest.approx(getattr(reference, name), rel=1e-12, abs=1e-15)
