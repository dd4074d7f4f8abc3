"""A second plant: the hand's URDF as MuJoCo reads it, with motors, joint friction and errors of model and contacts.

It shares neither code nor model data with `scene` and `plant`, so that results can be checked in two worlds. The engine steps
without the correction of rolling contacts that `contact_bias` makes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import mujoco
import numpy as np
import numpy.typing as npt

from graspforce.contact.contact import ContactSet
from graspforce.contact.motion import BodyMotion
from graspforce.control.state import GraspState
from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.core.records import make_unchecked
from graspforce.force.problem import ForceProblem
from graspforce.force.solver import solve
from graspforce.grasp.grasp import Grasp
from graspforce.simulation.plants.link_geoms import collision_names, read_collision
from graspforce.simulation.plants.plant_interface import TrueContacts
from graspforce.simulation.plants.plant_options import PlantOptions
from graspforce.simulation.plants.urdf_model import compile_urdf
from graspforce.simulation.plants.urdf_preload import settle_contacts

_RESTING_FRICTION = 0.7  # part of the friction that the default forces may use
_AT_REST = freeze(np.zeros(6))


class UrdfPlant:
    """A hand and an object in MuJoCo, from the hand's URDF; it implements `PlantInterface`.

    Args:
        grasp: hand, object and contacts, as the controller knows them.
        options: how the plant differs from them.
        events: called with the plant at the begin of each step, in this order, to push the object or to change the plant.

    Raises:
        InvalidInput: an option has the wrong number of values; the object is no sphere, cylinder or box; or the hand cannot
            hold the object's weight.
        ModelError: MuJoCo cannot compile the URDF.
    """

    def __init__(
        self, grasp: Grasp, options: PlantOptions | None = None, *, events: Sequence[Callable[[UrdfPlant], None]] = ()
    ) -> None:
        self._grasp, self.options = grasp, options or PlantOptions()
        self.compiled = compile_urdf(grasp, self.options)
        self._events = tuple(events)
        n = grasp.hand.n
        self._coulomb, self._stribeck = self.options.per_joint("coulomb", n), self.options.per_joint("stribeck", n)
        self._stribeck_velocity = self.options.per_joint("stribeck_velocity", n)
        self._has_stribeck = bool(self._stribeck.any())
        self._gear_friction = np.zeros(n)  # N·m
        self._tip_of_geom = {geom: i for i, geom in enumerate(self.compiled.tip_geoms)}
        self._collision_names = collision_names(self.compiled.model, object=self.compiled.object_geom)
        self.reset()

    # ── state ──────────────────────────────────────────────────────────────────────────────────────────────────────────────

    @property
    def grasp(self) -> Grasp:
        """The grasp in which the plant starts."""
        return self._grasp

    @property
    def t(self) -> float:
        """Time since the reset, s."""
        return float(self.data.time)

    @property
    def dt(self) -> float:
        """Length of a step, s."""
        return self.options.dt

    def state(self) -> GraspState:
        """Return the true state: joint positions and rates of the motors, pose and twist of the object in H."""
        rows = self.compiled
        q, v = self.data.qpos[rows.q_rows], self.data.qvel[rows.v_rows]
        return make_unchecked(GraspState, q=q, v=v, object=self._object_motion())

    def _object_motion(self) -> BodyMotion:
        q, v = self.data.qpos[self.compiled.object_q :], self.data.qvel[self.compiled.object_v :]
        mujoco.mju_quat2Mat(R := np.empty(9), q[3:7])
        R_HO = R.reshape(3, 3)
        twist = np.concatenate([v[:3], R_HO @ v[3:6]])
        return make_unchecked(BodyMotion, p_HO=q[:3].copy(), R_HO=R_HO, twist=twist, acceleration=_AT_REST)

    # ── simulation ─────────────────────────────────────────────────────────────────────────────────────────────────────────

    def reset(self, f: npt.ArrayLike | None = None) -> GraspState:
        """Return to the grasp, at rest, with contacts that carry the forces f.

        Args:
            f: (k,) stacked contact forces, N and N·m. Default: the forces with least motor torque that hold the object's
                weight, with 70 % of the friction.

        Returns:
            The true state.

        Raises:
            InvalidInput: f has another shape, or is None and no forces hold the weight.
        """
        contacts = self.grasp.contacts
        f = self._resting_forces() if f is None else arrays.check_array(f, "f", (contacts.size,))
        self.model = self.compiled.model.__copy__()  # events change it
        self.data = mujoco.MjData(self.model)
        self._store_friction()
        self._p_OC = contacts.p_OC.tolist()  # the last contact point of each finger, m
        self._axes = contacts.R_OC.transpose(0, 2, 1).tolist()  # and its tangents and normal
        q, tau = settle_contacts(self.compiled, self.grasp, self.options, contacts.pad(f))
        self.data.qpos[:] = q
        self._set_friction_loss()
        self.data.ctrl[:] = tau / np.where(self.model.actuator_gainprm[:, 0] > 0.0, self.model.actuator_gainprm[:, 0], 1.0)
        mujoco.mj_forward(self.model, self.data)
        self._contacts = self._read_contacts()
        return self.state()

    def step(self, tau: npt.ArrayLike) -> GraspState:
        """Advance by dt under a torque command, which the motors limit to the hand's torques.

        Args:
            tau: (n,) commanded torques, N·m.

        Returns:
            The true state at the end of the step.

        Raises:
            InvalidInput: tau has another shape or is not finite.
        """
        self.data.ctrl[:] = arrays.check_array(tau, "tau", (self.grasp.hand.n,))
        self.data.xfrc_applied[self.compiled.object_body] = 0.0
        for event in self._events:
            event(self)
        if self._has_stribeck or self._gear_friction.any():
            self._set_friction_loss()
        mujoco.mj_step(self.model, self.data)
        self._contacts = self._read_contacts()
        return self.state()

    def true_contacts(self) -> TrueContacts:
        """Return the contacts of the last step."""
        return self._contacts

    # ── events ─────────────────────────────────────────────────────────────────────────────────────────────────────────────

    def push(self, force: npt.ArrayLike, moment: npt.ArrayLike = (0.0, 0.0, 0.0)) -> None:
        """Add a wrench on the object in this step. Events call it.

        Args:
            force: (3,) in H, N.
            moment: (3,) about O's origin, in H, N·m.
        """
        body = self.compiled.object_body
        force = arrays.check_array(force, "force", (3,))
        arm = self.data.xpos[body] - self.data.xipos[body]  # m, from the centre of mass to O
        self.data.xfrc_applied[body] += np.append(force, arrays.check_array(moment, "moment", (3,)) + np.cross(arm, force))

    def set_friction(self, mu: npt.ArrayLike) -> None:
        """Change the coefficients of friction of the contacts, from now on.

        Args:
            mu: (N,) μ ≥ 0.
        """
        pairs = list(self.compiled.pairs)
        self.model.pair_friction[pairs, :2] = arrays.check_array(mu, "mu", (len(pairs),), minimum=0.0)[:, None]
        self._store_friction()

    def set_gear_friction(self, friction: npt.ArrayLike) -> None:
        """Set Coulomb friction of the joints beside that of the options, from the next step on, such as of loaded gears.

        Args:
            friction: (n,) N·m, ≥ 0.
        """
        had_friction = bool(self._gear_friction.any())
        self._gear_friction = arrays.check_array(friction, "friction", (self.grasp.hand.n,), minimum=0.0)
        if had_friction and not self._gear_friction.any():
            self._set_friction_loss()

    def set_torque_gain(self, gain: npt.ArrayLike) -> None:
        """Change the true torques per commanded torque, from now on; zero for motors that fail.

        Args:
            gain: (n,) ≥ 0.
        """
        self.model.actuator_gainprm[:, 0] = arrays.check_array(gain, "gain", (self.grasp.hand.n,), minimum=0.0)

    # ── implementation ─────────────────────────────────────────────────────────────────────────────────────────────────────

    def _set_friction_loss(self) -> None:
        """Set the largest friction torque of each joint at its present rate."""
        rows = self.compiled.v_rows
        ratio = self.data.qvel[rows] / self._stribeck_velocity
        loss = self._coulomb + self._stribeck * np.exp(-ratio * ratio)
        self.model.dof_frictionloss[rows] = loss + self._gear_friction

    def _store_friction(self) -> None:
        """Store the friction of the contacts for `true_contacts`."""
        pairs = list(self.compiled.pairs)
        friction, condim = self.model.pair_friction[pairs], self.model.pair_dim[pairs]
        self._mu, self._gamma = freeze(friction[:, 0] * (condim >= 3)), freeze(friction[:, 2] * (condim >= 4))

    def _resting_forces(self) -> Array:
        """Return forces with least motor torque that hold the weight inside narrowed friction cones."""
        grasp, contacts = self.grasp, self.grasp.contacts
        narrow = ContactSet(
            contacts.p_OC, contacts.R_OC, contacts.models, _RESTING_FRICTION * contacts.mu, _RESTING_FRICTION * contacts.gamma,
            contacts.min_normal, contacts.max_normal,
        )  # fmt: skip
        problem = grasp.force_problem(self.options.gravity_H)
        solution = solve(ForceProblem(narrow, problem.w, problem.actuation))
        if not solution.found:
            raise InvalidInput("f", None, "given, because the hand cannot hold the object's weight in this grasp")
        return solution.f

    def _read_contacts(self) -> TrueContacts:
        """Return the contact forces of the engine, in frames on the object at the begin of the step.

        Scalar arithmetic: NumPy's overhead dominates for a few contacts.
        """
        data, body, count = self.data, self.compiled.object_body, len(self._p_OC)
        touching, depth, f = [False] * count, [0.0] * count, [(0.0, 0.0, 0.0, 0.0)] * count
        collisions = []
        if data.ncon:
            found, forces = data.contact, data.efc_force.tolist()
            R, p = data.xmat[body].tolist(), data.xpos[body].tolist()
            rows, frames, points = found.efc_address.tolist(), found.frame.tolist(), found.pos.tolist()
            sizes, distances = found.dim.tolist(), found.dist.tolist()
            for c, (first, second) in enumerate(found.geom.tolist()):
                row, tip = rows[c], self._tip_of_geom.get(first)
                if row < 0:  # a contact without force
                    continue
                if tip is None and second not in self._tip_of_geom:
                    collisions.append(read_collision(data, c, self._collision_names))
                    continue
                sign = -1.0 if tip is None else 1.0  # MuJoCo's normal points from the first geom to the second
                tip = self._tip_of_geom[second] if tip is None else tip
                on_object = [sign * x for x in _combine(frames[c], forces[row : row + min(sizes[c], 3)])]  # N, in H
                n = _rotate_back(R, [sign * x for x in frames[c][:3]])
                t1, t2 = _tangents(*n)
                force = _rotate_back(R, on_object)
                moment = forces[row + 3] if sizes[c] > 3 else 0.0  # both the normal and the moment about it change sign
                f[tip] = (_dot(t1, force), _dot(t2, force), _dot(n, force), moment)
                self._p_OC[tip] = _rotate_back(R, [x - y for x, y in zip(points[c], p, strict=True)])
                self._axes[tip] = (t1, t2, n)
                touching[tip], depth[tip] = forces[row] > 0.0, -distances[c]
        return make_unchecked(
            TrueContacts,
            t=self.t - self.dt,
            touching=np.array(touching),
            f=np.array(f),
            p_OC=np.array(self._p_OC),
            R_OC=np.array(self._axes).transpose(0, 2, 1),
            mu=self._mu,
            gamma=self._gamma,
            depth=np.array(depth),
            tau=data.actuator_force.copy(),
            collisions=tuple(each for each in collisions if each is not None),
        )


_Vector = tuple[float, float, float]


def _dot(a: _Vector, b: _Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _combine(rows: list[float], factors: list[float]) -> _Vector:
    """Return the sum of the first rows of a matrix, nine numbers, with factors."""
    x = y = z = 0.0
    for i, factor in enumerate(factors):
        x, y, z = x + factor * rows[3 * i], y + factor * rows[3 * i + 1], z + factor * rows[3 * i + 2]
    return x, y, z


def _rotate_back(R: list[float], v: Sequence[float]) -> _Vector:
    """Return Rᵀ v, with R as nine numbers row by row."""
    return (
        R[0] * v[0] + R[3] * v[1] + R[6] * v[2],
        R[1] * v[0] + R[4] * v[1] + R[7] * v[2],
        R[2] * v[0] + R[5] * v[1] + R[8] * v[2],
    )


def _tangents(x: float, y: float, z: float) -> tuple[_Vector, _Vector]:
    """Return the tangents that `Contact` has by default for an inward normal."""
    if abs(x) >= 0.9:
        length = math.hypot(x, z)
        a, b, c = -z / length, 0.0, x / length  # n × e_y
    else:
        length = math.hypot(y, z)
        a, b, c = 0.0, z / length, -y / length  # n × e_x
    return (a, b, c), (y * c - z * b, z * a - x * c, x * b - y * a)
