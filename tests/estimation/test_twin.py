"""The twin of a hand: the share of the torques that its motors make, creep, and drift."""

from __future__ import annotations

import numpy as np
import pytest
from support.allegro_grasp import PALM_UP, three_finger_grasp
from support.box_grasp import make_grasp

from graspforce import InvalidInput, ObjectController
from graspforce.contact.matrices import grasp_matrix
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings
from graspforce.estimation.motor_share import HeldState, share_equation
from graspforce.estimation.twin import Twin, TwinSettings
from graspforce.simulation import constant_reference
from graspforce.simulation.plants.plant_options import PlantOptions
from graspforce.simulation.plants.urdf_plant import UrdfPlant

DT, GRAVITY = 2e-3, np.array([0.0, 0.0, -9.81])
GRASP = make_grasp()
QUICK = TwinSettings(window=0.3)


def states_at_rest(share: float, count: int = 30, twist=(0.0,) * 6) -> list[HeldState]:
    """Return states of a box at rest whose motors make a share of the torques; the object may have a twist in H."""
    w = GRASP.body.wrench(BodyMotion(GRASP.p_HO, GRASP.R_HO), GRAVITY)
    f = np.linalg.lstsq(grasp_matrix(GRASP.contacts), w, rcond=None)[0]
    J = GRASP.hand.contact_jacobian(GRASP.q, GRASP.fingers, GRASP.contacts, GRASP.p_HO, GRASP.R_HO)
    tau = (GRASP.hand.gravity_torque(GRASP.q, GRAVITY) + J.T @ f) / share
    rest, velocity = np.zeros(GRASP.hand.n), np.array(twist[:3])
    motions = [BodyMotion(GRASP.p_HO + k * DT * velocity, GRASP.R_HO, twist) for k in range(count)]
    return [HeldState(k * DT, GRASP.q, rest, motion, tau, GRASP.contacts) for k, motion in enumerate(motions)]


@pytest.mark.parametrize("share", [0.5, 0.8, 1.0, 1.3])
def test_the_equation_of_a_grasp_at_rest_has_the_share_as_its_solution(share):
    equation = share_equation(GRASP, states_at_rest(share), GRAVITY)
    assert equation.product / equation.information == pytest.approx(share, abs=1e-9)
    assert equation.square - share * equation.product == pytest.approx(0.0, abs=1e-9 * equation.square)
    np.testing.assert_array_equal(equation.sliding, 0.0)


def test_internal_forces_do_not_change_the_share():
    """Forces that balance each other change the torques, but the share remains."""
    states = states_at_rest(0.8)
    null = np.linalg.svd(grasp_matrix(GRASP.contacts))[2][6]
    J = GRASP.hand.contact_jacobian(GRASP.q, GRASP.fingers, GRASP.contacts, GRASP.p_HO, GRASP.R_HO)
    squeezed = [HeldState(s.t, s.q, s.v, s.object, s.tau + 3.0 * J.T @ null / 0.8, s.contacts) for s in states]
    equation = share_equation(GRASP, squeezed, GRAVITY)
    assert equation.product / equation.information == pytest.approx(0.8, abs=1e-9)


def test_creep_is_the_sliding_of_each_fingertip(monkeypatch):
    """The object sinks along H's third axis, past fingers at rest: all slide at its speed."""
    monkeypatch.setattr("graspforce.estimation.twin._MINUTE", 0.5)  # s
    speed = 1e-4  # m/s
    twin = Twin(GRASP, GRAVITY, TwinSettings(window=0.3, creep_limit=4e-5))
    readings = [twin.add(each) for each in states_at_rest(1.0, 400, (0.0, 0.0, -speed, 0.0, 0.0, 0.0))]
    last = [each for each in readings if each is not None][-1]
    np.testing.assert_allclose(last.creep, 0.5 * speed, rtol=0.02)
    assert any("creeps" in text for text in last.drifts)


def test_the_window_begins_again_after_a_gap():
    twin, states = Twin(GRASP, GRAVITY, QUICK), states_at_rest(1.0, 170)
    assert any(twin.add(each) for each in states)
    later = [HeldState(s.t + 10.0, s.q, s.v, s.object, s.tau, s.contacts) for s in states]
    taken = [twin.add(each) for each in later]
    assert not any(taken[: round(0.29 / DT)])
    assert any(taken)


def readings_of_a_run(gain: float, duration: float):
    """Return the readings of a simulated hold whose motors make `gain` of the torques."""
    grasp, gravity = three_finger_grasp(), np.array(PALM_UP, dtype=float)
    plant = UrdfPlant(grasp, PlantOptions(gravity_H=gravity, torque_gain=gain, dt=DT))
    controller = ObjectController(grasp, ControlSettings(gravity_H=gravity, period=DT))
    desired, twin = constant_reference(BodyMotion(grasp.p_HO, grasp.R_HO)), Twin(grasp, gravity, QUICK)
    state, found = plant.reset(), []
    for k in range(round(duration / DT)):
        command = controller.step(state, desired(k * DT))
        found.append(twin.add(HeldState(k * DT, state.q, state.v, state.object, command.tau, command.contacts)))
        state = plant.step(command.tau)
    return [each for each in found if each is not None]


def test_weak_motors_are_reported_and_healthy_ones_are_not():
    weak, healthy = readings_of_a_run(0.8, 0.6), readings_of_a_run(1.0, 0.6)
    assert weak[0].drifts
    assert "0.8" in weak[-1].drifts[0]
    assert weak[-1].share == pytest.approx(0.8, abs=0.02)
    assert not any(each.drifts for each in healthy)
    assert healthy[-1].share == pytest.approx(1.0, abs=0.02)


def test_minutes_are_means_of_their_readings(monkeypatch):
    monkeypatch.setattr("graspforce.estimation.twin._PIECE", 1.0)  # s: a reading each second
    monkeypatch.setattr("graspforce.estimation.twin._LONGEST_GAP", 1.0)
    twin = Twin(GRASP, GRAVITY, QUICK)
    for each in states_at_rest(0.7, 250):
        twin.add(HeldState(250.0 * each.t, each.q, each.v, each.object, each.tau, each.contacts))
    assert [round(each.share, 6) for each in twin.minutes] == [0.7, 0.7]
    assert all(each.drifts for each in twin.minutes)


def test_settings_are_checked():
    with pytest.raises(InvalidInput, match="share_limit"):
        TwinSettings(share_limit=0.0)
