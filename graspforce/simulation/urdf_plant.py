"""A second plant: the hand's URDF as MuJoCo reads it, with motors, joint friction and errors of model and contacts.

It shares neither code nor model data with `scene` and `plant`, so that results can be checked in two worlds. The engine steps
without the correction of rolling contacts that `contact_bias` makes.
"""

from __future__ import annotations

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
from graspforce.simulation.plant_interface import TrueContacts
from graspforce.simulation.plant_options import PlantOptions
from graspforce.simulation.urdf_model import compile_urdf
from graspforce.simulation.urdf_preload import settle_contacts

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
        self._tip_of_geom = np.full(self.compiled.model.ngeom, -1)
        self._tip_of_geom[list(self.compiled.tip_geoms)] = np.arange(len(grasp.fingers))
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
        self._p_OC, self._R_OC = np.array(contacts.p_OC), np.array(contacts.R_OC)
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
        if self._stribeck.any():
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
        self.model.dof_frictionloss[rows] = self._coulomb + self._stribeck * np.exp(-ratio * ratio)

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
        """Return the contact forces of the engine, in frames on the object at the begin of the step."""
        data, body, count = self.data, self.compiled.object_body, len(self._p_OC)
        R_HO, found = data.xmat[body].reshape(3, 3), data.contact
        touching, f, depth = np.zeros(count, dtype=np.bool_), np.zeros((count, 4)), np.zeros(count)
        if data.ncon:
            geoms = self._tip_of_geom[found.geom]  # of each contact: the tip, and -1 for the object
            tips, first = geoms.max(axis=1), geoms[:, 0] >= 0
            sign = np.where(first, 1.0, -1.0)  # MuJoCo's normal points from the first geom to the second
            axes = found.frame.reshape(-1, 3, 3) @ R_HO  # rows: normal and tangents in O
            components = np.arange(4)
            rows = np.minimum(found.efc_address[:, None] + components, data.nefc - 1)
            forces = np.where(components < found.dim[:, None], data.efc_force[rows], 0.0)  # normal, tangents, spin
            R_OC = _contact_frames(sign[:, None] * axes[:, 0])
            on_object = sign[:, None, None] * (forces[:, None, :3] @ axes)  # N, in O
            self._p_OC[tips], self._R_OC[tips] = (found.pos - data.xpos[body]) @ R_HO, R_OC
            f[tips, :3] = (on_object @ R_OC)[:, 0]
            f[tips, 3] = forces[:, 3]  # both the normal and the moment about it change sign
            touching[tips], depth[tips] = forces[:, 0] > 0.0, -found.dist
        return make_unchecked(
            TrueContacts,
            t=self.t - self.dt,
            touching=touching,
            f=f,
            p_OC=self._p_OC.copy(),
            R_OC=self._R_OC.copy(),
            mu=self._mu,
            gamma=self._gamma,
            depth=depth,
            tau=data.actuator_force.copy(),
        )


def _contact_frames(n: Array) -> Array:
    """Return the contact frames (M, 3, 3) of inward normals (M, 3), with the tangents that `Contact` has by default."""
    x, y, z = n.T
    R, along_x = np.zeros((len(n), 3, 3)), np.abs(x) >= 0.9
    R[:, :, 2] = n
    R[:, 0, 0] = np.where(along_x, -z, 0.0)  # n × e_y
    R[:, 1, 0] = np.where(along_x, 0.0, z)  # n × e_x
    R[:, 2, 0] = np.where(along_x, x, -y)
    R[:, :, 0] /= np.sqrt(np.vecdot(R[:, :, 0], R[:, :, 0]))[:, None]
    (t_x, t_y, t_z) = R[:, :, 0].T
    R[:, 0, 1], R[:, 1, 1], R[:, 2, 1] = y * t_z - z * t_y, z * t_x - x * t_z, x * t_y - y * t_x  # n × t₁
    return R
