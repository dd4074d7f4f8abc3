"""Changes of contacts while the state is estimated from measurements: forces, estimate and object move without a jump."""

from __future__ import annotations

import numpy as np
import pytest
from support.control_grasps import named_grasp
from support.control_steps import pose_at_rest, settings_with, state_at_rest

from graspforce.control import ContactChange, ControlSettings, GraspMotion, ObjectController, OutputFeedbackController
from graspforce.core.errors import InvalidInput, UnknownName
from graspforce.estimation import Measurement, SensorModel
from graspforce.simulation import Plant, build_scene

RATE = 40.0  # N/s
PERIOD = 1e-3  # s
GRASP = named_grasp("four_finger sphere")
FINGER = GRASP.fingers[1]


class Loop:
    """A plant and a controller from its joint positions, with encoder noise."""

    def __init__(self, noise: float, **options) -> None:
        sensors, settings = SensorModel(encoder_noise=noise), settings_with(slip_margin=0.2)
        if noise:
            settings = ControlSettings.for_sensors(sensors, settings).settings
        self.plant = Plant(build_scene(GRASP, gravity_H=settings.gravity_H))
        self.controller = OutputFeedbackController(GRASP, settings, sensors, **options)
        self.rng, self.noise, self.commands = np.random.default_rng(2), noise, []
        self.q = np.array(GRASP.q)  # desired posture

    def run(self, steps: int) -> None:
        """Hold the object for some periods."""
        rest = np.zeros(len(self.q))
        for _ in range(steps):
            state = self.plant.state()
            measurement = Measurement(self.plant.t, state.q + self.noise * self.rng.standard_normal(len(state.q)))
            desired = GraspMotion(pose_at_rest(GRASP), self.q, rest, rest)
            self.commands.append(self.controller.step(measurement, desired))
            self.plant.step(self.commands[-1].tau)

    def finish_change(self) -> None:
        """Run until no contact changes any more."""
        for _ in range(100):
            self.run(20)
            if not self.controller.is_changing:
                return
        raise AssertionError("the change takes more than 2 s")

    @property
    def estimation_error(self) -> float:
        """Distance between estimated and true position of the object, m."""
        return float(np.linalg.norm(self.controller.estimate.object.p_HO - self.plant.state().object.p_HO))

    @property
    def displacement(self) -> float:
        """Distance of the object from its desired position, m."""
        return float(np.linalg.norm(self.plant.state().object.p_HO - GRASP.p_HO))


@pytest.mark.parametrize(("noise", "allowed"), [(0.0, 2e-5), (2e-4, 2e-4)])
def test_finger_lets_go_and_joins_again_while_the_object_rests(noise: float, allowed: float) -> None:
    """Contacts yield by 20 µm per newton; noise of 0.2 mrad is 20 µm at a fingertip, and the estimate keeps that of a start."""
    loop = Loop(noise)
    loop.run(50)
    contact = loop.controller.grasp.contacts.contacts[1]
    loop.controller.change_contacts(ContactChange(release=[FINGER], force_rate=RATE))
    loop.finish_change()
    assert FINGER not in loop.controller.grasp.fingers
    assert len(loop.controller.estimate.gap) == 3
    loop.run(50)
    loop.controller.change_contacts(ContactChange(add={FINGER: contact}, force_rate=RATE))
    assert loop.controller.grasp.fingers[-1] == FINGER
    loop.finish_change()
    loop.run(100)
    assert len(loop.controller.estimate.gap) == 4
    assert all(not command.forces_reused for command in loop.commands)
    assert loop.plant.true_contacts().touching.all()
    assert loop.estimation_error < allowed
    assert loop.displacement < 2.0 * allowed


def test_torques_change_by_a_bounded_amount() -> None:
    """As from exact states: the normal forces move by the rate times the period, up to eight times it at the ends."""
    loop = Loop(0.0)
    loop.run(50)
    contact, first = loop.controller.grasp.contacts.contacts[1], len(loop.commands)
    for change in (ContactChange(release=[FINGER], force_rate=RATE), ContactChange(add={FINGER: contact}, force_rate=RATE)):
        loop.controller.change_contacts(change)
        loop.finish_change()
    torques = np.array([command.tau for command in loop.commands[first:]])
    levers = np.abs(GRASP.actuation().J).sum(axis=0).max()  # m
    assert np.abs(np.diff(torques, axis=0)).max() <= 8.0 * RATE * PERIOD * levers


def test_first_commands_of_a_change_are_those_from_exact_states() -> None:
    settings = settings_with(slip_margin=0.2)
    exact, measured = ObjectController(GRASP, settings), OutputFeedbackController(GRASP, settings)
    state, desired = state_at_rest(GRASP), pose_at_rest(GRASP)
    change = ContactChange(release=[FINGER], force_rate=RATE)
    exact.step(state, desired)
    measured.step(Measurement(0.0, GRASP.q), desired)
    exact.change_contacts(change, state)
    measured.change_contacts(change)
    steps = 0
    while exact.is_changing:
        steps += 1
        one, other = exact.step(state, desired), measured.step(Measurement(steps * PERIOD, GRASP.q), desired)
        np.testing.assert_allclose(other.f, one.f, atol=1e-4)  # N; the estimated pose is exact to nanometres
        assert measured.is_changing == exact.is_changing
    assert measured.grasp.fingers == exact.grasp.fingers


def test_monitor_continues_with_the_contacts_that_are_left() -> None:
    loop = Loop(0.0, monitored=True)
    loop.run(50)
    loop.controller.change_contacts(ContactChange(release=[FINGER], force_rate=RATE))
    loop.finish_change()
    loop.run(50)
    assert len(loop.controller.monitor.slip.slipping) == 3
    assert not loop.controller.monitor.slip.slipping.any()


def test_reset_returns_to_the_contacts_of_the_start() -> None:
    loop = Loop(0.0)
    loop.run(5)
    loop.controller.change_contacts(ContactChange(release=[FINGER]))
    loop.run(5)
    loop.controller.reset()
    assert loop.controller.grasp.fingers == GRASP.fingers
    assert not loop.controller.is_changing


def test_impossible_changes_are_refused() -> None:
    loop = Loop(0.0)
    with pytest.raises(InvalidInput, match="after the first step"):
        loop.controller.change_contacts(ContactChange(release=[FINGER]))
    loop.run(2)
    with pytest.raises(UnknownName):
        loop.controller.change_contacts(ContactChange(release=["thumb"]))
    with pytest.raises(InvalidInput, match="one contact must be left"):
        loop.controller.change_contacts(ContactChange(release=list(GRASP.fingers)))
    loop.controller.change_contacts(ContactChange(release=[FINGER]))
    with pytest.raises(InvalidInput):
        loop.controller.change_contacts(ContactChange(release=[GRASP.fingers[0]]))
    with pytest.raises(InvalidInput, match="let go or join"):
        loop.controller.continue_with(GRASP)
