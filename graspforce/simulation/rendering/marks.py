"""The state of a plant as images show it: joint positions, contact forces, friction cones and pushes.

A contact's friction use is ‖f_t‖ / (μ f_n): 0 on the cone's axis, 1 on its edge, where the finger slips.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from graspforce.contact import friction
from graspforce.contact.motion import BodyMotion
from graspforce.contact.use_colour import friction_use, use_colour
from graspforce.core.arrays import Array, freeze
from graspforce.simulation.plants.plant import Plant
from graspforce.simulation.plants.scene import Scene
from graspforce.simulation.plants.scene_parts import rotation_quaternion
from graspforce.simulation.recordings.recording import Recording

_HEIGHT, _MIN_HEIGHT, _MAX_HEIGHT = 0.72, 0.008, 0.03  # of cones: over the object's radius, and limits, m
_ARROW_RADIUS, _PUSH_RADIUS = 0.067, 0.11  # over the height of the cones
_PUSH_LENGTH = 2.1  # over the height of the cones
_LENGTH_EXPONENT = 0.6  # of arrows over the force: 10 times the force is 4 times as long
_TYPICAL_FORCE = 2.0  # in weights of the object: its arrow is as long as the cones are high


@dataclass(frozen=True, eq=False, slots=True)
class ContactMark:
    """One contact: the arrow of its force and its friction cone.

    Attributes:
        finger: name of the finger.
        touching: whether the finger touches.
        apex: (3,) the contact point in H, m.
        R_HC: (3, 3) contact frame in H; the third axis points into the object.
        arrow: (3,) from the contact point to the arrow's tip, in H, m.
        radius: of the arrow's shaft, m.
        height: of the cone, m.
        mu: coefficient of friction.
        f_n: normal force, N.
        slip_margin: μ f_n − ‖f_t‖, N.
        use: friction use, 0 to 1; 1 for a finger that does not touch, 0 for a contact without friction.
        colour: (3,) red, green, blue, 0 to 1.
    """

    finger: str
    touching: bool
    apex: Array
    R_HC: Array
    arrow: Array
    radius: float
    height: float
    mu: float
    f_n: float
    slip_margin: float
    use: float
    colour: Array


@dataclass(frozen=True, eq=False, slots=True)
class PushMark:
    """An external force on the object.

    Attributes:
        end: (3,) tip of the arrow, on the object's surface, in H, m.
        arrow: (3,) from the arrow's tail to its tip, in H, m.
        radius: of the arrow's shaft, m.
        force: its size, N.
    """

    end: Array
    arrow: Array
    radius: float
    force: float


@dataclass(frozen=True, eq=False, slots=True)
class LoadMark:
    """The wrench of all contacts on the object.

    Attributes:
        start: (3,) the object's origin in H, m.
        arrow: (3,) along the force, from the origin to the arrow's tip, in H, m.
        radius: of the arrow's shaft, m.
        force: size of the force, N.
        moment: size of the moment about the object's origin, N·m.
        carried: mass whose weight the force carries, kg; NaN without gravity.
    """

    start: Array
    arrow: Array
    radius: float
    force: float
    moment: float
    carried: float

    @property
    def text(self) -> str:
        """Force, moment and load in one line."""
        load = "" if np.isnan(self.carried) else f", load {1e3 * self.carried:.0f} g"
        return f"wrench {self.force:.2f} N, {1e3 * self.moment:.1f} mN·m{load}"


@dataclass(frozen=True, eq=False, slots=True)
class SceneState:
    """The state of a plant at one instant, as far as images show it.

    Attributes:
        t: time, s.
        qpos: positions of MuJoCo's joints.
        contacts: marks of the contacts, in the grasp's order.
        push: mark of the external force on the object; None without one.
        mocap: (M, 3) positions of the bodies that the plant moves, such as its floor, in H, m.
        load: mark of the wrench of all contacts; None if no finger touches.
    """

    t: float
    qpos: Array
    contacts: tuple[ContactMark, ...]
    push: PushMark | None
    mocap: Array
    load: LoadMark | None = None


def capture_state(plant: Plant) -> SceneState:
    """Return the present state of a plant.

    Args:
        plant: the plant.
    """
    contacts, motion = plant.true_contacts(), plant.object_motion()
    marks, load = contact_marks(plant.scene, contacts, motion), load_mark(plant.scene, contacts, motion)
    return SceneState(plant.t, freeze(plant.data.qpos), marks, push_mark(plant), freeze(plant.data.mocap_pos), load)


def recorded_state(scene: Scene, recording: Recording, row: int) -> SceneState:
    """Return the state of a recorded step. Pushes and the floor's motion are not recorded.

    Args:
        scene: scene of the recorded grasp.
        recording: the recording.
        row: index of the step.
    """
    contacts = RecordedContacts(*(getattr(recording, name)[row] for name in ("touching", "f", "p_OC", "R_OC", "mu", "gamma")))
    motion = BodyMotion(recording.p_HO[row], recording.R_HO[row])
    return scene_state(scene, float(recording.t[row]), recording.q[row], motion, contacts)


def scene_state(scene: Scene, t: float, q: Array, motion: BodyMotion, contacts: MarkedContacts) -> SceneState:
    """Return the state of a scene without pushes, with its floor where it is at the start.

    Args:
        scene: the scene.
        t: time, s.
        q: (n,) joint positions, rad.
        motion: pose of the object.
        contacts: forces, places and friction of the contacts.
    """
    qpos = _posture_qpos(scene, q)
    qpos[scene.object_q_address : scene.object_q_address + 7] = [*motion.p_HO, *rotation_quaternion(motion.R_HO)]
    marks, load = contact_marks(scene, contacts, motion), load_mark(scene, contacts, motion)
    return SceneState(t, freeze(qpos), marks, None, _first_mocap(scene), load)


def posture_state(scene: Scene, t: float, q: Array) -> SceneState:
    """Return the state of a hand in a posture, without contacts.

    Args:
        scene: scene of a grasp of the hand; its object is where the grasp has it.
        t: time, s.
        q: (n,) joint positions, rad.
    """
    return SceneState(t, freeze(_posture_qpos(scene, q)), (), None, _first_mocap(scene))


class MarkedContacts(Protocol):
    """Contacts that marks can show, such as those of a plant: see `TrueContacts`."""

    @property
    def touching(self) -> npt.NDArray[Any]: ...  # pragma: no cover
    @property
    def f(self) -> Array: ...  # pragma: no cover
    @property
    def p_OC(self) -> Array: ...  # pragma: no cover
    @property
    def R_OC(self) -> Array: ...  # pragma: no cover
    @property
    def mu(self) -> Array: ...  # pragma: no cover
    @property
    def gamma(self) -> Array: ...  # pragma: no cover


@dataclass(frozen=True, eq=False, slots=True)
class RecordedContacts:
    """Contacts of a recorded step: `TrueContacts` gives the meaning of the fields."""

    touching: Array
    f: Array
    p_OC: Array
    R_OC: Array
    mu: Array
    gamma: Array


def contact_marks(scene: Scene, contacts: MarkedContacts, motion: BodyMotion) -> tuple[ContactMark, ...]:
    """Return the marks of contacts, in the grasp's order.

    Args:
        scene: scene of the grasp.
        contacts: forces, places and friction of the contacts.
        motion: pose of the object.
    """
    grasp = scene.grasp
    margins = friction.slip_margin(contacts.f, contacts.mu, contacts.gamma)
    height = _cone_height(scene)
    marks = []
    for i, finger in enumerate(grasp.fingers):
        f, mu = contacts.f[i], float(contacts.mu[i])
        R_HC = motion.R_HO @ contacts.R_OC[i]
        norm, use = float(np.linalg.norm(f[:3])), friction_use(float(margins[i]), mu, float(f[2]))
        length = _arrow_length(scene, norm)
        marks.append(
            ContactMark(
                finger=finger,
                touching=bool(contacts.touching[i]),
                apex=motion.p_HO + motion.R_HO @ contacts.p_OC[i],
                R_HC=R_HC,
                arrow=R_HC @ f[:3] * (length / norm if norm > 0.0 else 0.0),
                radius=_ARROW_RADIUS * height,
                height=height,
                mu=mu,
                f_n=float(f[2]),
                slip_margin=float(margins[i]),
                use=use,
                colour=use_colour(use),
            )
        )
    return tuple(marks)


def load_mark(scene: Scene, contacts: MarkedContacts, motion: BodyMotion) -> LoadMark | None:
    """Return the mark of the wrench of all contacts on the object; None if no finger touches.

    Args:
        scene: scene of the grasp.
        contacts: forces, places and friction of the contacts.
        motion: pose of the object.
    """
    touching = np.asarray(contacts.touching, dtype=bool)
    if not touching.any():
        return None
    f, axes = contacts.f[touching], contacts.R_OC[touching]
    forces = np.einsum("nij,nj->ni", axes, f[:, :3])  # in O
    moments = np.cross(contacts.p_OC[touching], forces) + axes[:, :, 2] * f[:, 3:4]
    force = motion.R_HO @ forces.sum(axis=0)
    size, gravity = float(np.linalg.norm(force)), scene.gravity_H
    arrow = force * (_arrow_length(scene, size) / size if size > 0.0 else 0.0)
    carried = -float(force @ gravity) / float(gravity @ gravity) if gravity.any() else np.nan
    moment = float(np.linalg.norm(moments.sum(axis=0)))
    return LoadMark(freeze(motion.p_HO), freeze(arrow), _ARROW_RADIUS * _cone_height(scene), size, moment, carried)


def push_mark(plant: Plant) -> PushMark | None:
    """Return the mark of the external force on the object in the last step; None without a force.

    Args:
        plant: the plant.
    """
    force = plant.data.xfrc_applied[plant.scene.object_body, :3]
    size = float(np.linalg.norm(force))
    shape = plant.scene.grasp.body.shape
    if size == 0.0 or shape is None:
        return None
    motion, direction = plant.object_motion(), force / size
    surface = shape.project_to_surface(-motion.R_HO.T @ direction)  # the nearest to a point 1 m away on the arrow's side
    height = _cone_height(plant.scene)
    end = motion.p_HO + motion.R_HO @ surface
    return PushMark(end, _PUSH_LENGTH * height * direction, _PUSH_RADIUS * height, size)


def _posture_qpos(scene: Scene, q: Array) -> Array:
    """Return the positions of MuJoCo's joints in a posture; the object is where the scene starts.

    Data of MuJoCo, which have these positions too, take a millisecond to make.
    """
    qpos = np.array(scene.model.qpos0)
    qpos[scene.q_address] = scene.T @ q + scene.q0
    return qpos


def _first_mocap(scene: Scene) -> Array:
    """Return the positions (M, 3) of the bodies that the plant moves, where the scene starts, m."""
    return freeze(scene.model.body_pos[scene.model.body_mocapid >= 0])


def _arrow_length(scene: Scene, force: float) -> float:
    """Return the length of the arrow of a force in N, m."""
    weight = scene.grasp.body.mass * max(float(np.linalg.norm(scene.gravity_H)), 1.0)  # N
    return _cone_height(scene) * float((force / (_TYPICAL_FORCE * weight)) ** _LENGTH_EXPONENT)


def _cone_height(scene: Scene) -> float:
    """Return the height of the cones for the size of the object, m."""
    radius = float(scene.model.geom_rbound[scene.object_geom])
    return float(np.clip(_HEIGHT * radius, _MIN_HEIGHT, _MAX_HEIGHT))
