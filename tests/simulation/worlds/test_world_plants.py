"""Plants of a world obey its parameters: friction of joints and contacts, mass, geometry, motors."""

from __future__ import annotations

import numpy as np
import pytest
from support.allegro_grasp import PALM_UP, three_finger_grasp
from support.control_grasps import named_grasp
from support.simulated_runs import contact_wrench, holding_torques

from graspforce import InvalidInput
from graspforce.contact.motion import BodyMotion
from graspforce.simulation import Plant, build_scene
from graspforce.simulation.plants.plant_options import PlantOptions
from graspforce.simulation.worlds.world import World
from graspforce.simulation.worlds.world_plants import PLANT_NAMES, make_plant, make_urdf_plant, make_world_plant

RING = range(8, 12)  # motors of the finger that does not touch
JOINT = 10  # one of them


def test_nominal_world_is_the_plant_of_the_grasp():
    grasp = three_finger_grasp()
    plants = make_plant(grasp, World.nominal().plant_options(grasp, PALM_UP)), Plant(build_scene(grasp, gravity_H=PALM_UP))
    torques = holding_torques(plants[1])
    for _ in range(10):
        tau = torques()
        states = [plant.step(tau) for plant in plants]
    for name in ("q", "v"):
        np.testing.assert_array_equal(getattr(states[0], name), getattr(states[1], name))
    np.testing.assert_array_equal(states[0].object.p_HO, states[1].object.p_HO)


def free_finger(**options) -> tuple[Plant, np.ndarray]:
    """Return a plant without gravity, and the torques that hold its fingers."""
    grasp = three_finger_grasp()
    plant = make_plant(grasp, PlantOptions(gravity_H=np.zeros(3), **options))
    return plant, holding_torques(plant)()


def test_joint_at_rest_stays_at_rest_below_its_friction():
    plant, tau = free_finger(coulomb=0.05, stribeck=0.02)
    tau[RING] = [0.06, -0.06, 0.06, -0.06]  # N·m, less than 0.07
    q = plant.state().q[RING]
    for _ in range(100):
        plant.step(tau)
    assert np.abs(plant.state().v[RING]).max() < 1e-5  # rad/s: the constraint is not perfectly stiff
    assert np.abs(plant.state().q[RING] - q).max() < 1e-6


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_sliding_joint_loses_its_coulomb_and_viscous_friction(sign):
    """M a = tau − friction for the joints of a free finger, at a rate where the Stribeck part is gone."""
    coulomb, viscous = 0.05, 0.01
    plant, tau = free_finger(coulomb=coulomb, stribeck=0.02, stribeck_velocity=0.05, viscous=viscous)
    hand, ring = plant.grasp.hand, list(RING)
    tau[ring] = 0.0
    tau[JOINT] = 0.2 * sign
    for _ in range(30):
        before = plant.state()
        after = plant.step(tau)
    assert sign * before.v[JOINT] > 0.5  # rad/s: ten times the Stribeck velocity
    a = (after.v - before.v) / plant.dt
    needed = hand.inverse_dynamics(before.q, before.v, a, np.zeros(3))[ring]
    friction = tau[ring] - needed
    # the fast joint: the engine takes viscous friction at the end of the step
    assert friction[ring.index(JOINT)] == pytest.approx(sign * coulomb + viscous * after.v[JOINT], rel=2e-3)


def test_motor_gives_its_gain_of_the_limited_command():
    gain = np.linspace(0.8, 1.2, 16)
    plant, tau = free_finger(torque_gain=gain)
    tau[JOINT] = 100.0
    plant.step(tau)
    np.testing.assert_allclose(plant.true_contacts().tau, gain * np.clip(tau, -0.7, 0.7))


def test_contacts_have_the_true_friction_and_pads_carry_moments():
    grasp = three_finger_grasp()
    plant = make_plant(grasp, PlantOptions(gravity_H=PALM_UP, friction=0.42, torsional_friction=0.005))
    torques = holding_torques(plant)
    for _ in range(5):
        plant.step(torques())
    true_contacts = plant.true_contacts()
    np.testing.assert_allclose(true_contacts.mu, 0.42)
    np.testing.assert_allclose(true_contacts.gamma, 0.005)
    assert np.abs(true_contacts.f[:, 3]).max() > 0.0
    assert np.all(np.abs(true_contacts.f[:, 3]) <= 0.005 * true_contacts.f[:, 2] + 1e-12)


def test_contacts_carry_the_true_weight_at_the_true_centre_of_mass():
    """Newton and Euler: the contacts' wrench, less the weight at the true centre, gives the object's acceleration."""
    grasp = three_finger_grasp()
    world = World(mass_factor=2.0, centre_offset=[0.0, 0.006, -0.008])
    options = world.plant_options(grasp, PALM_UP)
    plant = make_plant(grasp, options)
    before = plant.object_motion()
    after = plant.step(holding_torques(plant)()).object  # from rest, so that no rotation in the step matters
    a = (after.twist - before.twist) / plant.dt
    needed = options.body.wrench(BodyMotion(before.p_HO, before.R_HO, before.twist, a), PALM_UP)
    np.testing.assert_allclose(contact_wrench(plant), needed, atol=1e-6)


def test_fingertips_are_displaced_and_touch_at_the_start():
    grasp = three_finger_grasp()
    options = World(tip_offset=3e-3, seed=2).plant_options(grasp, PALM_UP)
    plant = make_plant(grasp, options)
    assert plant.true_contacts().touching.all()
    q = plant.state().q
    for i, finger in enumerate(grasp.fingers):
        p, R = grasp.hand.tip_pose(q, finger)
        centre = plant.data.geom_xpos[plant.scene.tip_geoms[i]]
        np.testing.assert_allclose(centre - p, R @ options.tip_offset[i], atol=1e-12)


@pytest.mark.parametrize("name", ["four_finger sphere", "four_finger box", "allegro_right cylinder"])
@pytest.mark.parametrize("plant", PLANT_NAMES)
def test_all_fingers_carry_their_force_at_the_start_of_random_worlds(name, plant):
    """Fingers with three joints move far where their normal is nearly out of their reach; 5 mm off is the greatest error."""
    grasp = named_grasp(name)
    f = np.zeros(grasp.contacts.size)
    f[grasp.contacts.normal_rows] = 2.0  # N
    for seed in range(4):
        world = World.real(seed)
        made = make_world_plant(world, grasp, name=plant)
        made.reset(f)
        contacts = made.true_contacts()
        assert contacts.touching.all(), seed
        assert np.abs(contacts.f[:, 2] - 2.0).max() < 0.8, seed  # N: joints give way to tangential forces of the first step


@pytest.mark.parametrize("plant", PLANT_NAMES)
def test_fingertip_on_an_edge_presses_along_the_line_to_its_centre(plant):
    """The object moves below a fingertip until its centre is beyond an edge; a ball then touches the edge."""
    grasp = named_grasp("four_finger box")
    f = np.zeros(grasp.contacts.size)
    f[grasp.contacts.normal_rows] = 1.0  # N
    half = grasp.body.shape.edges / 2.0
    inside = np.where(grasp.contacts.R_OC[0, :, 2].round() == 0.0, half - np.abs(grasp.contacts.p_OC[0]), np.inf)
    axis = int(inside.argmin())  # the nearest edge of the first finger
    side = np.sign(grasp.contacts.p_OC[0, axis])
    offset = np.zeros(3)
    offset[axis] = -side * (inside[axis] + 1e-3)  # m
    options = PlantOptions(shape_offset=offset)
    made = make_plant(grasp, options) if plant == "links" else make_urdf_plant(grasp, options)
    made.reset(f)
    contacts = made.true_contacts()
    n, told = contacts.R_OC[0, :, 2], grasp.contacts.R_OC[0, :, 2]
    assert contacts.touching.all()
    assert n[axis] * side < -0.01  # towards the inside of the object, over the edge
    assert 0.9 < n @ told < 1.0
    np.testing.assert_allclose(contacts.p_OC[0, axis], offset[axis] + side * half[axis], atol=1e-4)


def test_fingertips_that_do_not_reach_the_object_are_rejected():
    grasp = three_finger_grasp()
    with pytest.raises(InvalidInput, match=r"so small that (index|middle|thumb) reaches the object"):
        make_world_plant(World(tip_offset=0.5), grasp, PALM_UP)


def test_surface_of_the_object_is_displaced_and_turned():
    grasp = three_finger_grasp()
    options = PlantOptions(gravity_H=PALM_UP, shape_offset=[1e-3, 0.0, 0.0], shape_turn=[0.0, 0.0, 0.1])
    plant = make_plant(grasp, options)
    p, R = (plant.data.geom_xpos, plant.data.geom_xmat)
    geom = plant.scene.object_geom
    np.testing.assert_allclose(p[geom] - grasp.p_HO, [1e-3, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(
        R[geom].reshape(3, 3), [[np.cos(0.1), -np.sin(0.1), 0], [np.sin(0.1), np.cos(0.1), 0], [0, 0, 1]]
    )
    np.testing.assert_allclose(plant.object_motion().p_HO, grasp.p_HO)  # O itself is where it was told
    assert plant.true_contacts().touching.all()
