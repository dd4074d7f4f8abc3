"""Protected motors: windings stay below their limits, hot fingers give load to cool ones, and a cold hand is not limited."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.allegro_grasp import PALM_UP, three_finger_grasp
from support.control_grasps import named_grasp
from support.simulated_runs import start_of

from graspforce.control import ControlSettings, OutputFeedbackController
from graspforce.control.heat_protection import HeatProtectedController, HeatSettings
from graspforce.core.errors import InvalidInput
from graspforce.estimation import Measurement
from graspforce.hand.descriptions.drive_description import ThermalDescription
from graspforce.hand.drives.drive import Drive
from graspforce.hand.heat import MotorTemperatures, ThermalModel

THERMAL = ThermalDescription(
    winding_resistance=8.0, winding_time_constant=6.0, housing_resistance=30.0, housing_time_constant=400.0,
    largest_temperature=100.0, source="invented",
)  # fmt: skip
DRIVE = Drive("current", torque_constant=0.8, resistance=5.0, thermal=THERMAL)
SETTINGS = ControlSettings(gravity_H=PALM_UP, slip_margin=2.0)


def make_grasp():
    grasp = three_finger_grasp()
    return replace(grasp, hand=grasp.hand.with_drives(DRIVE))


def hot_finger(grasp, finger: str, winding: float) -> MotorTemperatures:
    """Return temperatures with one warm finger."""
    temperatures = np.full(grasp.hand.n, 25.0)
    temperatures[list(grasp.hand.finger(finger).joints)] = winding
    return MotorTemperatures(temperatures, temperatures)


def hold(controller, grasp, steps: int, start: float = 0.0):
    """Return the last command of steps at rest in the grasp."""
    command = None
    for k in range(steps):
        command = controller.step(Measurement(start + 1e-3 * k, grasp.q), start_of(grasp))
    return command


def test_cold_motors_have_the_forces_of_the_least_copper_loss():
    grasp = make_grasp()
    protected = hold(HeatProtectedController(grasp, SETTINGS), grasp, 3)
    free_hand = grasp.hand.with_torque_weight("copper_loss")
    free = hold(OutputFeedbackController(replace(grasp, hand=free_hand), SETTINGS), grasp, 3)
    np.testing.assert_allclose(protected.f, free.f, atol=1e-6)


def test_hot_finger_gives_load_to_cool_ones():
    """Four fingers: three of them can hold the box."""
    grasp = named_grasp("four_finger box")
    grasp = replace(grasp, hand=grasp.hand.with_drives(DRIVE))
    finger = grasp.fingers[0]
    joints = list(grasp.hand.finger(finger).joints)
    heats = []
    for winding in (25.0, 80.0):
        controller = HeatProtectedController(grasp, SETTINGS, temperatures=hot_finger(grasp, finger, winding))
        command = hold(controller, grasp, 3)
        assert not command.forces_reused
        heats.append(float(np.sum(command.tau[joints] ** 2)))
    assert heats[1] < 0.95 * heats[0]


def test_temperatures_follow_the_currents_and_limits_follow_them():
    grasp = make_grasp()
    controller = HeatProtectedController(grasp, SETTINGS, heat=HeatSettings(interval=0.01, reserve=0.0))
    model = ThermalModel(grasp.hand.drives)
    command = hold(controller, grasp, 41)
    expected = model.at_rest()
    for _ in range(4):
        expected = model.step(expected, model.currents(command.tau), 0.01)
    np.testing.assert_allclose(controller.temperatures.winding, expected.winding, rtol=1e-3)
    times = controller.hold_times()
    np.testing.assert_array_equal(np.isinf(times), np.abs(command.tau) <= model.continuous_torques())


def test_measured_currents_replace_those_of_the_command():
    grasp = make_grasp()
    controller = HeatProtectedController(grasp, SETTINGS, heat=HeatSettings(interval=0.01))
    for k in range(11):
        controller.step(Measurement(1e-3 * k, grasp.q, current=np.full(grasp.hand.n, 0.5)), start_of(grasp))
    expected = 25.0 + 5.0 * 0.25 * 0.01 / (6.0 / 8.0)  # K, without loss to the housing in 10 ms
    np.testing.assert_allclose(controller.temperatures.winding, expected, rtol=1e-3)


def test_finger_to_rest_is_the_one_that_overheats_first():
    grasp = make_grasp()
    for finger in grasp.fingers:
        controller = HeatProtectedController(grasp, SETTINGS, temperatures=hot_finger(grasp, finger, 99.0))
        hold(controller, grasp, 2)
        assert controller.finger_to_rest() == finger


def test_hands_without_thermal_data_are_refused():
    with pytest.raises(InvalidInput, match="the thermal model needs it"):
        HeatProtectedController(three_finger_grasp(), SETTINGS)
