"""The largest feasible slip margin: against Clarabel, for every margin of the settings, and when no forces exist."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.control_grasps import GRASP_NAMES, named_grasp
from support.control_steps import disturbed, pose_at_rest, settings_with, state_at_rest, with_contacts

from graspforce import Actuation, ForceProblem, Objective, Solver, solve
from graspforce.contact import friction
from graspforce.contact.motion import BodyMotion
from graspforce.control import Command, GraspState, ObjectController
from graspforce.control.forces.margin_solver import MARGIN_FACTOR
from graspforce.control.object_control_law import ObjectControlLaw
from graspforce.core.arrays import Array
from graspforce.grasp.grasp import Grasp

pytestmark = pytest.mark.usefixtures("arithmetic")

RESERVE = 0.1
ROUNDING = 1e-6  # relative: the certificate's tolerance of 1e-8, over the hundred newtons that motors can press with
DOWN = (0.0, 0.0, -9.81)  # m/s²
MARGINS = (0.0, 0.05, 0.2, 0.5, 1.0, 2.0, 5.0, 50.0)  # N


def command_with(grasp: Grasp, margin: float, seed: int, external: Array) -> Command:
    """Return the first command of a controller with a slip margin."""
    settings = settings_with(slip_margin=margin, friction_reserve=RESERVE)
    return ObjectController(grasp, settings).step(*disturbed(grasp, seed), external)


def kept_margin(command: Command, reserve: float = RESERVE) -> float:
    """Return the smallest margin of the planned forces with the friction reserve, N."""
    contacts = command.contacts
    return float(friction.slip_margin(contacts.pad(command.f), (1.0 - reserve) * contacts.mu, contacts.gamma).min())


def largest_margin(grasp: Grasp, seed: int, external: Array, reserve: float = RESERVE) -> float | None:
    """Return the largest feasible margin by Clarabel's own cone program, N; None if no forces exist."""
    law = ObjectControlLaw(grasp, settings_with())
    state, desired = disturbed(grasp, seed)
    targets = law.compute_targets(law.initial_memory(), state, desired, external)
    hand = grasp.hand
    tau_u = hand.inverse_dynamics(state.q, state.v, targets.joint_acceleration, law.settings.gravity_H)
    contacts = replace(grasp.contacts, p_OC=targets.p_OC, R_OC=targets.R_OC, mu=(1.0 - reserve) * grasp.contacts.mu)
    actuation = Actuation(targets.J, tau_u, hand.torque_lower, hand.torque_upper)
    problem = ForceProblem(contacts, targets.w, actuation, objective=Objective("margin"))
    solution = solve(problem, "clarabel", explain=False)
    return solution.objective if solution.found else None


def random_load(rng: np.random.Generator) -> Array:
    """Return an external wrench of 0.01 to 10 N and its moment at 2 cm."""
    return rng.normal(size=6) * [1.0, 1.0, 1.0, 0.02, 0.02, 0.02] * 10.0 ** rng.uniform(-2.0, 1.0)


@pytest.mark.parametrize("name", GRASP_NAMES)
def test_margin_is_the_wanted_one_or_the_largest_feasible_one(name: str) -> None:
    grasp, rng = named_grasp(name), np.random.default_rng(81)
    reduced = 0
    for seed in range(3):
        load = random_load(rng)
        largest = largest_margin(grasp, seed, load)
        for margin in MARGINS:
            command = command_with(grasp, margin, seed, load)
            if largest is None:
                assert command.forces_reused or "friction" in command.warnings[0]
                continue
            assert not command.forces_reused
            kept = kept_margin(command)
            scale = np.abs(command.f).max()  # N
            if margin <= MARGIN_FACTOR * largest:
                assert kept >= margin - ROUNDING * scale
                assert not any("margin" in warning for warning in command.warnings)
            else:
                assert kept >= MARGIN_FACTOR * min(margin, largest) - ROUNDING * scale
                assert kept <= largest + ROUNDING * scale
                reduced += "the largest is kept" in command.warnings[0]
            assert (np.abs(command.tau) <= grasp.hand.torque_upper * (1.0 + ROUNDING)).all()
    assert reduced >= 3


@pytest.mark.parametrize("name", GRASP_NAMES)
def test_asking_for_more_margin_never_gives_less(name: str) -> None:
    """The margin of the forces does not decrease with that of the settings, to the factor of the largest margin."""
    grasp, rng = named_grasp(name), np.random.default_rng(82)
    for seed in range(3):
        load, most = random_load(rng), 0.0
        for margin in np.sort(rng.uniform(0.0, 4.0, 8)):
            command = command_with(grasp, margin, seed, load)
            if command.forces_reused or any("without" in w or "all the friction" in w for w in command.warnings):
                continue  # the friction reserve is infeasible, whatever the margin
            kept = kept_margin(command)
            assert kept >= MARGIN_FACTOR * most - ROUNDING * np.abs(command.f).max()
            most = max(most, kept)


def test_margin_of_a_box_follows_from_the_largest_normal_force() -> None:
    """Four fingers with 2 N at most: μ (1 − reserve) 2 N = 1.26 N of friction, less a quarter of the weight each."""
    grasp = with_contacts(named_grasp("four_finger box"), max_normal=2.0)
    largest = 0.7 * (1.0 - RESERVE) * 2.0 - 0.05 * 9.81 / 4.0  # N
    for margin in (1.0, 1.2, 1.6, 1e3):
        settings = settings_with(slip_margin=margin, friction_reserve=RESERVE, gravity_H=DOWN)
        command = ObjectController(grasp, settings).step(state_at_rest(grasp), pose_at_rest(grasp))
        assert kept_margin(command) == pytest.approx(min(margin, MARGIN_FACTOR * largest), rel=1e-6)
        assert len(command.warnings) == (margin > largest)
        if margin > largest:
            kept = f"{MARGIN_FACTOR * largest:.3g} N"
            assert command.warnings == (f"the full slip margin is infeasible: the largest is kept, {kept}",)


def test_friction_reserve_is_given_up_last() -> None:
    """A pull that needs more than 90 % of the friction leaves the largest margin of the whole friction."""
    grasp = with_contacts(named_grasp("four_finger box"), max_normal=2.0)
    state, desired = state_at_rest(grasp), pose_at_rest(grasp)
    for share, note in ((0.95, "without the friction reserve"), (1.0 - 1e-9, "without the friction reserve"), (1.01, None)):
        pull = share * 4.0 * 0.7 * 2.0 - 0.05 * 9.81  # N: the weight counts too
        settings = settings_with(friction_reserve=RESERVE, gravity_H=DOWN)
        command = ObjectController(grasp, settings).step(state, desired, [0, 0, -pull, 0, 0, 0])
        if note is None:
            assert command.forces_reused
            continue
        assert note in command.warnings[0]
        expected = MARGIN_FACTOR * (1.0 - share) * 0.7 * 2.0  # N
        assert kept_margin(command, reserve=0.0) == pytest.approx(expected, abs=ROUNDING)


def test_margin_depends_on_this_step_only() -> None:
    """After steps with too large loads, or without forces, a step gives the forces of a new controller."""
    grasp = named_grasp("allegro_right sphere")
    state, desired = disturbed(grasp, 4)
    loads = [np.array([0.0, 0.0, -load, 0.0, 0.0, 0.0]) for load in (0.0, 1.0, 3.0, 100.0, 0.1, 100.0, 3.0, 0.0)]
    for margin in (0.0, 0.5, 4.0):
        law = ObjectControlLaw(grasp, settings_with(slip_margin=margin))
        for load in loads:
            command, _ = law.step(law.initial_memory(), state, desired, load)
            new = ObjectController(grasp, law.settings).step(state, desired, load)
            assert command.forces_reused == new.forces_reused
            assert command.warnings == new.warnings
            # The cost is certified to 1e-8, the forces to its root. At the largest margin they have no other choice.
            np.testing.assert_allclose(command.f, new.f, atol=2e-4 * max(1.0, float(np.abs(new.f).max())))


def test_step_after_one_without_forces_solves_one_problem(monkeypatch: pytest.MonkeyPatch) -> None:
    grasp, solved = named_grasp("allegro_right sphere"), []
    own_solve = Solver.solve

    def counted(solver: Solver, **changes: Array) -> object:
        solved.append(1)
        return own_solve(solver, **changes)

    monkeypatch.setattr(Solver, "solve", counted)
    controller = ObjectController(grasp, settings_with())
    pull = np.array([0.0, 0.0, -100.0, 0.0, 0.0, 0.0])
    counts = []
    for load in (0.0, 1.0, 1.0, 1.0, 0.0, 0.0):
        solved.clear()
        command = controller.step(state_at_rest(grasp), pose_at_rest(grasp), load * pull)
        assert command.forces_reused == (load > 0.0)
        assert command.solution.found == (load == 0.0)
        counts.append(len(solved))
    # with forces: one; the first without: with and without margin; then one; the first with forces again: two
    assert counts == [1, 2, 1, 1, 2, 1]


def test_integral_grows_at_the_largest_margin_until_none_is_left() -> None:
    """The largest margin always brings a motor to its limit, but the forces still supply the wrench."""
    grasp, state = named_grasp("allegro_right sphere"), state_at_rest(named_grasp("allegro_right sphere"))
    for compiled in (True, False):
        for margin, load, grows in ((0.5, 0.0, True), (50.0, 0.0, True), (50.0, 100.0, False)):
            law = ObjectControlLaw(grasp, settings_with(slip_margin=margin))
            if not compiled:
                law._compiled = None
            memory = law.initial_memory()
            moved = BodyMotion(state.object.p_HO + 1e-4, state.object.R_HO)
            for _ in range(2):
                before = memory.integral
                command, memory = law.step(
                    memory, GraspState(state.q, state.v, moved), pose_at_rest(grasp), [0, 0, -load, 0, 0, 0]
                )
                assert command.saturated == (margin > 1.0 and load == 0.0)
                assert (np.abs(memory.integral[:3] - before[:3]) > 1e-8).all() == grows  # 1e-4 m for 1 ms
