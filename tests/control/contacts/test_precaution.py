"""Precaution: a small squeeze of all contacts at once, which decays, adds nothing to the reflex, and yields to limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.allegro_grasp import PALM_UP, three_finger_grasp
from support.control_grasps import named_grasp
from support.control_steps import pose_at_rest, settings_with, state_at_rest

from graspforce import InvalidInput
from graspforce.contact.motion import BodyMotion
from graspforce.control import Command, ControlMemory, ControlSettings, OutputFeedbackController
from graspforce.control.contacts.contact_conditions import ContactConditions
from graspforce.control.contacts.slip_reflex import PRECAUTION_SHARE, PRECAUTION_TIME, ReflexMemory, SlipReflex
from graspforce.control.object_control_law import ObjectControlLaw
from graspforce.estimation import Measurement, SensorModel
from graspforce.grasp.grasp import Grasp

pytestmark = pytest.mark.usefixtures("arithmetic")

GRASPS = ["allegro_right sphere", "four_finger box", "dlr_hit2 sphere"]
SQUEEZE = 0.3
RISE = PRECAUTION_SHARE * SQUEEZE
DUE = ContactConditions(is_precaution_due=True)
STILL = ContactConditions()
SOLVER = 1e-6  # relative: the certificate's tolerance is 1e-8 of some newtons


class Steps:
    """Steps of the control law at rest, one after the other."""

    def __init__(self, grasp: Grasp, settings: ControlSettings) -> None:
        self.grasp, self.law = grasp, ObjectControlLaw(grasp, settings)
        self.memory = self.law.initial_memory()

    def next(self, conditions: ContactConditions | None = None) -> Command:
        state, desired = state_at_rest(self.grasp), pose_at_rest(self.grasp)
        command, self.memory = self.law.step(self.memory, state, desired, None, conditions)
        return command

    def normals(self, command: Command) -> np.ndarray:
        return command.f[self.grasp.contacts.normal_rows]


@pytest.mark.parametrize("name", GRASPS)
def test_precaution_raises_normal_forces_in_the_same_period_within_its_bound(name: str) -> None:
    """Contacts that use all of their friction press 1 + g/2 times as hard for the same tangential force, and no harder."""
    steps = Steps(named_grasp(name), settings_with(reflex_squeeze=SQUEEZE))
    before = steps.next()
    after = steps.next(DUE)
    share = steps.normals(after).sum() / steps.normals(before).sum()
    assert 1.0 + 0.3 * RISE < share < 1.0 + 1.3 * RISE  # the weight's share of tangential forces changes with the forces
    assert after.solution.found
    assert not after.warnings
    np.testing.assert_allclose(after.w, before.w, atol=1e-9)


def test_precaution_stays_while_requested_and_decays_afterwards() -> None:
    grasp = named_grasp("four_finger box")
    steps = Steps(grasp, settings_with(reflex_squeeze=SQUEEZE))
    modelled = steps.next()
    steps.next(DUE)
    first = steps.memory.reflex.precaution
    assert (first >= RISE - SOLVER).all()
    for _ in range(20):
        steps.next(DUE)
        np.testing.assert_array_equal(steps.memory.reflex.precaution, first)
    for k in range(1, 101):
        steps.next()
        np.testing.assert_allclose(steps.memory.reflex.precaution, first * np.exp(-k * 1e-3 / PRECAUTION_TIME), rtol=1e-9)
    assert (steps.memory.reflex.precaution < 0.15 * first).all()  # exp(−2)
    for _ in range(300):
        command = steps.next()
    assert steps.memory.reflex is None  # exp(−8) is negligible
    np.testing.assert_allclose(command.f, modelled.f, atol=1e-4)


def test_repeated_requests_do_not_add_up() -> None:
    """Each request starts from the forces without any squeeze, so that flickering requests stay at the same bound."""
    steps = Steps(named_grasp("four_finger box"), settings_with(reflex_squeeze=SQUEEZE))
    steps.next()
    steps.next(DUE)
    first = steps.memory.reflex.precaution
    for k in range(200):
        steps.next(DUE if k % 2 else STILL)
        assert (steps.memory.reflex.precaution <= first * (1.0 + 1e-3)).all()  # forces between two requests are rounded


def test_slip_squeezes_as_much_after_a_precaution_as_without() -> None:
    """Contacts that use all of their friction, and others, get the level of the reflex alone."""
    grasp = named_grasp("four_finger box")
    slipping = ContactConditions([True] * 4)
    plain, careful = (Steps(grasp, settings_with(reflex_squeeze=SQUEEZE)) for _ in range(2))
    plain.next()
    careful.next()
    careful.next(DUE)
    expected, found = plain.next(slipping), careful.next(slipping)
    np.testing.assert_allclose(careful.memory.reflex.level, plain.memory.reflex.level, rtol=1e-4)
    np.testing.assert_allclose(found.f, expected.f, atol=1e-4)


def test_precaution_does_not_exceed_torque_limits() -> None:
    """Motors that have 1 % more torque than the plan needs keep the whole slip margin: the step has no precaution."""
    grasp = named_grasp("four_finger box")
    need = np.abs(Steps(grasp, settings_with(reflex_squeeze=SQUEEZE)).next().tau)
    weak = replace(grasp, hand=grasp.hand.with_torque_limits(1.01 * need + 1e-4))
    steps = Steps(weak, settings_with(reflex_squeeze=SQUEEZE))
    before = steps.next()
    after = steps.next(DUE)
    assert not after.warnings
    np.testing.assert_allclose(after.f, before.f, atol=1e-5)  # the cost is flat, and the start of the solver differs
    assert steps.memory.reflex is None


def test_no_precaution_without_a_reflex() -> None:
    plain, careful = (Steps(named_grasp("four_finger box"), settings_with(reflex_squeeze=0.0)) for _ in range(2))
    plain.next()
    careful.next()
    np.testing.assert_array_equal(careful.next(DUE).f, plain.next().f)


def test_contacts_without_friction_have_no_precaution() -> None:
    grasp = named_grasp("four_finger box")
    memory = SlipReflex(grasp.contacts, settings_with(), 0.3).step(None, None, np.array([0.7, 0.0, 0.7, 0.7]), None, True)
    np.testing.assert_allclose(memory.precaution, [RISE, 0.0, RISE, RISE])


def test_precaution_is_saved_with_the_memory() -> None:
    steps = Steps(named_grasp("four_finger box"), settings_with())
    steps.next()
    steps.next(DUE)
    memory = ControlMemory.from_dict(steps.memory.to_dict(), steps.grasp.contacts)
    assert np.array_equal(memory.reflex.precaution, steps.memory.reflex.precaution)
    assert memory.reflex.is_due
    record = steps.memory.reflex.to_dict()
    with pytest.raises(InvalidInput, match=r"reflex.precaution"):
        ReflexMemory.from_dict({**record, "precaution": [-1.0] * 4}, 4)
    with pytest.raises(InvalidInput, match=r"reflex.is_due"):
        ReflexMemory.from_dict({**record, "is_due": 1}, 4)
    kept = memory.reflex.for_contacts([2, 0], 1)
    np.testing.assert_array_equal(kept.precaution, [*memory.reflex.precaution[[2, 0]], 0.0])
    assert ContactConditions.from_dict(DUE.to_dict()).to_dict() == {}


@pytest.mark.parametrize("has_tips", [False, True])
def test_an_unexpected_force_squeezes_in_the_next_period_with_fingertip_sensors_only(has_tips: bool) -> None:
    """A fingertip force of 1 N beyond that of the torques, with 0.02 N of noise, is no noise."""
    grasp, rng = three_finger_grasp(), np.random.default_rng(3)
    sensors = SensorModel(encoder_noise=1e-4, torque_noise=1e-3, tip_force_noise=0.02 if has_tips else None)
    controller = OutputFeedbackController(grasp, ControlSettings(gravity_H=PALM_UP), sensors)
    desired, command, due = BodyMotion(grasp.p_HO, grasp.R_HO), None, []
    for k in range(320):
        tips = None
        if has_tips:
            f_H = np.zeros((3, 3))
            if command is not None:
                f_H = np.einsum("ij,njk,nk->ni", grasp.R_HO, command.contacts.R_OC, grasp.contacts.pad(command.f)[:, :3])
            f_H[0, 2] += 1.0 if k >= 300 else 0.0
            tips = np.pad(f_H + 0.02 * rng.normal(size=(3, 3)), ((0, 0), (0, 3)))
        measured = Measurement(k * 1e-3, grasp.q + 1e-4 * rng.normal(size=grasp.hand.n), tip_wrench=tips)
        command = controller.step(measured, desired)
        due.append(controller.monitor is not None and controller.monitor.is_precaution_due)
        reflex = controller._control.memory.control.reflex
        assert (reflex is not None and reflex.precaution is not None) or not due[-1]
    assert not any(due[:300])
    assert due[300] == has_tips
