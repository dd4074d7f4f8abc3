"""A glove leads running streams of a server: the object follows the operator with certified forces, and a free hand too."""

from __future__ import annotations

import numpy as np
import pytest
from support.control_requests import GRASP, HAND
from support.gloves import operator_frames, operator_of, pose_frames
from support.servers import ANY_LOCAL_PORT, TIMEOUT

from graspforce.cli.stream_controller import JointStreamController, StreamController
from graspforce.contact import friction
from graspforce.control import ControlSettings
from graspforce.control.joints.joint_controller import JointController
from graspforce.hand.hand import GRAVITY_PALM_UP
from graspforce.learning import GloveApproach, GloveHold, GloveReference, RecordedFrames, TeleoperationLimits
from graspforce.service import Client, JointStreamSetup, Server
from graspforce.simulation import Plant, build_scene, simulate
from graspforce.simulation.free_hand.free_plant import FreeHandPlant
from graspforce.simulation.free_hand.joint_run import run_joints

RATE = 60.0  # Hz, of the glove
VALIDITY = 10.0  # s: the plant waits for each command
OPERATOR = operator_of(HAND)


@pytest.fixture(scope="module")
def client():
    with Server([HAND], listen=ANY_LOCAL_PORT) as server, Client(server.addresses[0], timeout=TIMEOUT) as connected:
        yield connected


def test_a_held_object_follows_a_noisy_glove_with_certified_forces(client):
    """The glove asks for far more than the travel; noise is 1 % of the range of each joint in each frame."""
    up = -np.asarray(GRAVITY_PALM_UP) / np.linalg.norm(GRAVITY_PALM_UP)
    travel, heights = 0.003, 0.008 * np.sin(np.pi * np.linspace(0, 1, 36))  # m, within 0.6 s
    frames = RecordedFrames(pose_frames(GRASP, [height * up for height in heights]), RATE)
    margins, certified = [], []
    plant = Plant(build_scene(GRASP, gravity_H=GRAVITY_PALM_UP))
    hold = GloveReference(GloveHold(GRASP, OPERATOR, TeleoperationLimits(travel=travel)), frames, plant.dt)

    def observe(plant, command):
        contacts = plant.true_contacts()
        margins.append(friction.slip_margin(contacts.f, contacts.mu, contacts.gamma).min())
        certified.append(not command.forces_reused)

    with client.open_stream(GRASP, ControlSettings(gravity_H=GRAVITY_PALM_UP), validity=VALIDITY) as stream:
        recording = simulate(plant, StreamController(stream), hold, frames.duration, on_step=observe)
    assert hold.taken == len(heights)
    assert all(certified)
    assert min(margins) >= 0.0
    assert recording.touching.all()
    lifts = (recording.p_HO - GRASP.p_HO) @ up
    assert 0.5 * travel < lifts.max() < travel + 5e-4


def test_a_free_hand_follows_a_glove(client):
    goal = HAND.neutral + 0.2 * (HAND.q_upper - HAND.neutral)
    postures = [HAND.neutral + min(s, 1.0) * (goal - HAND.neutral) for s in np.linspace(0, 2, 60)]
    frames = RecordedFrames(operator_frames(HAND, postures, noise=0.001), RATE)
    plant = FreeHandPlant(HAND)
    approach = GloveReference(GloveApproach(HAND, OPERATOR), frames, plant.dt)
    setup = JointStreamSetup(JointController.with_frequency(HAND, "computed_torque", 10.0), plant.dt, VALIDITY)
    with client.open_joint_stream(setup) as stream:
        run = run_joints(plant, JointStreamController(stream), approach, frames.duration)
    assert approach.taken == len(postures)
    np.testing.assert_allclose(run.q[-1], run.q_desired[-1], atol=np.radians(1.0))
    errors = [HAND.tip_pose(run.q[-1], each.name)[0] - HAND.tip_pose(goal, each.name)[0] for each in HAND.fingers]
    assert np.linalg.norm(errors, axis=1).max() < 0.004  # m
