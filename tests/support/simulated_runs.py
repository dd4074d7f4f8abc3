"""Runs, plants and torques for the tests of the simulation."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from graspforce import Contact, ContactSet
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, GraspState, ObjectController
from graspforce.geometry import Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.simulation import EngineSettings, Plant, Recording, build_scene, constant_reference, simulate
from graspforce.simulation.plants.plant_interface import TrueContacts
from support.allegro_grasp import PALM_UP, three_finger_grasp
from support.hands import load

SETTINGS = ControlSettings(gravity_H=PALM_UP)


def start_of(grasp) -> BodyMotion:
    return BodyMotion(grasp.p_HO, grasp.R_HO)


def simulate_three_fingers(
    reference=None, duration=0.5, settings=SETTINGS, body=None, sensors=None, disturbances=()
) -> Recording:
    """Run the three-finger grasp in closed loop; by default the object stays still."""
    grasp = three_finger_grasp()
    plant = Plant(build_scene(grasp, gravity_H=PALM_UP, body=body), disturbances=disturbances)
    return simulate(
        plant, ObjectController(grasp, settings), reference or constant_reference(start_of(grasp)), duration, sensors=sensors
    )


def replay(recording: Recording) -> Iterator[tuple[GraspState, TrueContacts]]:
    """Generate the state at the begin and the contacts of each recorded step."""
    r = recording
    for k, t in enumerate(r.t):
        state = GraspState(r.q[k], r.v[k], BodyMotion(r.p_HO[k], r.R_HO[k], r.twist[k]))
        rows = (getattr(r, name)[k] for name in ("f", "p_OC", "R_OC", "mu", "gamma", "depth", "tau"))
        yield state, TrueContacts(t, r.touching[k] > 0.0, *rows)


def free_body_plant(hand: str = "four_finger", **options) -> Plant:
    """Return a plant without gravity whose object is out of the fingers' reach, and whose links never touch."""
    inertia = np.array([[2e-5, 1e-6, 0.0], [1e-6, 3e-5, -2e-6], [0.0, -2e-6, 4e-5]])
    body = Body(0.1, inertia, [0.004, -0.003, 0.006], Sphere(0.01))
    contacts = ContactSet.stack([Contact([0.01, 0.0, 0.0], [-1.0, 0.0, 0.0], 0.5)])
    R_HO = Rotation.from_rotvec([0.3, -0.5, 0.8]).as_matrix()
    model = load(hand)
    grasp = Grasp(model, body, (model.fingers[0].name,), contacts, model.neutral, [0.0, 0.0, 0.6], R_HO)
    return Plant(build_scene(grasp, gravity_H=np.zeros(3), engine=EngineSettings(solid_links=False)), **options)


def holding_torques(plant: Plant) -> Callable[[], np.ndarray]:
    """Return a function that computes torques for the present contact forces, with joint damping."""
    grasp = plant.scene.grasp
    f = plant.true_contacts().f.ravel()[grasp.contacts.columns]

    def torques() -> np.ndarray:
        state = plant.state()
        J = grasp.hand.contact_jacobian(state.q, grasp.fingers, grasp.contacts, state.object.p_HO, state.object.R_HO)
        return grasp.hand.gravity_torque(state.q, plant.scene.gravity_H) + J.T @ f - 0.02 * state.v

    return torques


def contact_wrench(plant: Plant) -> np.ndarray:
    """Return the wrench of the plant's contact forces about O's origin, in O."""
    true_contacts, grasp = plant.true_contacts(), plant.scene.grasp
    n = len(grasp.contacts)
    contacts = ContactSet(
        true_contacts.p_OC,
        true_contacts.R_OC,
        grasp.contacts.models,
        true_contacts.mu,
        true_contacts.gamma,
        np.zeros(n),
        np.full(n, np.inf),
    )
    return np.einsum("nij,nj->i", contacts.wrench_bases(), true_contacts.f)
