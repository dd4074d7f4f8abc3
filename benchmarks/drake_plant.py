"""A plant in Drake: its own URDF parser, its own engine (SAP, point contact), the interface of the plants in MuJoCo.

Needs `pip install drake`. The contact solver: Castro, Permenter and Han (2022). Its friction is regularised: a contact with
the tangential force f_t creeps at σ w f_t δt, with σ = 0.001, the contact's inverse mass w and the engine's step δt. Drake has
no parameter for σ, and its other contact models have the same bound. Hence the engine makes 25 steps of 40 µs in each control
period of 1 ms. An object at rest in a hand then creeps by up to 1.7 µm/s instead of 44 µm/s with one step.

Torques are constant in a control period, the fall of joint friction with the rate (Stribeck) too. The reported contacts are
those of the first of its engine steps. The fingers settle with the same engine steps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from scipy.spatial.transform import Rotation

from benchmarks.drake_model import DrakeModel, build_model, check_supported, read_state, set_state, surface_pose, tip_radii
from graspforce.contact.contact import Contact
from graspforce.contact.motion import BodyMotion
from graspforce.control import GraspState
from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.grasp.grasp import Grasp
from graspforce.simulation import PlantOptions, TrueContacts

SUBSTEPS = 25  # steps of the engine in a step of the plant, which is a control period
SETTLING_TIME, JOINT_TIME_CONSTANT = 0.2, 0.01  # s
SPRING_FREQUENCY = 200.0  # rad/s, of the critically damped spring that holds the object while fingers settle


class DrakePlant:
    """A hand and an object in Drake; it implements `graspforce.simulation.PlantInterface`.

    Args:
        grasp: hand, object and contacts, as the controller knows them.
        options: how the plant differs from them. Torsional and rolling friction must be absent.
        events: called with the plant at the begin of each step, in this order.
        substeps: steps of the engine in a step of the plant.

    Raises:
        InvalidInput: an option that this plant lacks, or an object that is no sphere, cylinder or box.
    """

    def __init__(
        self,
        grasp: Grasp,
        options: PlantOptions | None = None,
        *,
        events: Sequence[Callable[[DrakePlant], None]] = (),
        substeps: int = SUBSTEPS,
    ) -> None:
        self.grasp, self.options, self._events, self._substeps = grasp, options or PlantOptions(), tuple(events), substeps
        check_supported(grasp, self.options)
        self._mu = freeze(self.options.contact_friction(grasp)[0])
        self._model = build_model(grasp, self.options, self.dt / substeps)
        self._settling = build_model(grasp, replace(self.options, coulomb=0.0, stribeck=0.0, viscous=0.0), self.dt / substeps)
        self.reset()

    @property
    def dt(self) -> float:
        """Length of a step, s."""
        return self.options.dt

    @property
    def t(self) -> float:
        """Time since the reset, s."""
        return float(self._model.root.get_time())

    def state(self) -> GraspState:
        """Return the true state."""
        return read_state(self._model)

    def reset(self, f: npt.ArrayLike | None = None) -> GraspState:
        """Return to the grasp, at rest, with contacts that carry the forces f.

        Args:
            f: (k,) stacked contact forces, N and N·m. Default: forces of the object's weight with least norm, and 1 N more
                along each normal.
        """
        contacts = self.grasp.contacts
        self._R_OC, self._p_OC = np.array(contacts.R_OC), np.array(contacts.p_OC)
        self._gain = self.options.per_joint("torque_gain", self.grasp.hand.n)
        f = self._pressing_forces() if f is None else arrays.check_array(f, "f", (contacts.size,))
        self._push = np.zeros(6)
        settled, tau = self._settle(contacts.pad(f))
        set_state(self._model, self.grasp, settled)
        self._apply(self._model, tau)
        self._contacts = self._read_contacts(settled.object, tau)
        return self.state()

    def step(self, tau: npt.ArrayLike) -> GraspState:
        """Advance by dt under a torque command, which the motors limit to the hand's torques.

        Args:
            tau: (n,) commanded torques, N·m.
        """
        hand, before = self.grasp.hand, self.state().object
        command = arrays.check_array(tau, "tau", (hand.n,))
        self._push = np.zeros(6)
        for event in self._events:
            event(self)
        applied = self._gain * np.clip(command, hand.torque_lower, hand.torque_upper)
        self._apply(self._model, applied + self._stribeck_torque(self._model))
        self._contacts = self._read_contacts(before, applied)
        self._model.advance(self._substeps)
        return self.state()

    def true_contacts(self) -> TrueContacts:
        """Return the contacts in the first of the engine's steps of the last step."""
        return self._contacts

    def push(self, force: npt.ArrayLike, moment: npt.ArrayLike = (0.0, 0.0, 0.0)) -> None:
        """Add a wrench on the object in this step: force in N, and moment about O in N·m, both in H. Events call it."""
        self._push = self._push + np.append(
            arrays.check_array(force, "force", (3,)), arrays.check_array(moment, "moment", (3,))
        )

    def set_torque_gain(self, gain: npt.ArrayLike) -> None:
        """Change the true torques per commanded torque, from now on; zero for motors that fail."""
        self._gain = arrays.check_array(gain, "gain", (self.grasp.hand.n,), minimum=0.0)

    # ── implementation ─────────────────────────────────────────────────────────────────────────────────────────────────────

    def _pressing_forces(self) -> Array:
        """Return forces that hold the weight, by least squares, with 1 N more along each normal."""
        grasp, contacts = self.grasp, self.grasp.contacts
        G = contacts.wrench_bases().transpose(1, 0, 2).reshape(6, -1)[:, contacts.columns]
        f = np.zeros(contacts.size)
        f[contacts.normal_rows] = 1.0
        w = grasp.body.wrench(BodyMotion(grasp.p_HO, grasp.R_HO), self.options.gravity_H)
        return np.asarray(f + np.linalg.pinv(G) @ (w - G @ f))

    def _apply(self, model: DrakeModel, tau: Array) -> None:
        """Fix torques and the object's wrench for the next step."""
        plant, context = model.plant, model.context
        actuation = np.zeros(plant.num_actuators())
        actuation[model.motors] = tau
        plant.get_actuation_input_port().FixValue(context, actuation)
        wrench = ExternallyAppliedSpatialForce()
        wrench.body_index, wrench.p_BoBq_B = plant.GetBodyByName("object").index(), np.zeros(3)
        wrench.F_Bq_W = SpatialForce(tau=self._push[3:], f=self._push[:3])
        plant.get_applied_spatial_force_input_port().FixValue(context, [wrench])

    def _stribeck_torque(self, model: DrakeModel) -> Array:
        """Return the torque by which sliding friction is below the brake's, at the rates at the begin of the step."""
        hand, options = self.grasp.hand, self.options
        v = model.plant.GetVelocities(model.context)[model.v_rows]
        share = 1.0 - np.exp(-np.square(v / options.per_joint("stribeck_velocity", hand.n)))
        return np.asarray(options.per_joint("stribeck", hand.n) * share * np.sign(v))

    def _settle(self, forces: Array) -> tuple[GraspState, Array]:
        """Press the fingers on the object, which a spring holds, until they rest; return the state at rest and the torques."""
        grasp, hand, model = self.grasp, self.grasp.hand, self._settling
        body = self.options.body or grasp.body
        set_state(model, grasp, GraspState(self._closed_posture(), np.zeros(hand.n), BodyMotion(grasp.p_HO, grasp.R_HO)))
        w = np.einsum("nij,nj->i", grasp.contacts.wrench_bases(), forces).reshape(2, 3) @ grasp.R_HO.T
        f = forces.ravel()[grasp.contacts.columns]
        gravity, tau = self.options.gravity_H, np.zeros(hand.n)
        for _ in range(round(SETTLING_TIME / self.dt)):
            state = read_state(model)
            motion, q = state.object, state.q
            tau = hand.gravity_torque(q, gravity) + self._jacobian(q).T @ f
            turn = Rotation.from_matrix(motion.R_HO @ grasp.R_HO.T).as_rotvec()
            k, d = SPRING_FREQUENCY**2, 2.0 * SPRING_FREQUENCY
            pull = -body.mass * (k * (motion.p_HO - grasp.p_HO) + d * motion.twist[:3] + gravity) - w[0]
            inertia = motion.R_HO @ body.inertia @ motion.R_HO.T
            arm = motion.R_HO @ body.p_OM
            twist = -inertia @ (k * turn + d * motion.twist[3:]) - np.cross(arm, body.mass * gravity) - w[1]
            self._push = np.concatenate([pull, twist])
            self._apply(model, tau - hand.mass_matrix(q) @ state.v / JOINT_TIME_CONSTANT)
            model.advance(self._substeps)
        self._push = np.zeros(6)
        state = read_state(model)
        return GraspState(state.q, np.zeros(hand.n), BodyMotion(state.object.p_HO, state.object.R_HO)), tau

    def _closed_posture(self) -> Array:
        """Return the posture whose fingertips touch the true surface, by Newton's method on the gaps."""
        grasp, options = self.grasp, self.options
        shape = (options.body or grasp.body).shape or grasp.body.shape
        assert shape is not None  # the plant was built with it
        X_HS = RigidTransform(RotationMatrix(grasp.R_HO), grasp.p_HO) @ surface_pose(options)
        q = np.array(grasp.q)
        for _ in range(8):
            centers = self._centers(q)
            surface = X_HS.multiply(shape.project_to_surface(X_HS.inverse().multiply(centers.T).T).T).T
            gaps = np.linalg.norm(surface - centers, axis=1) - tip_radii(grasp)
            if np.abs(gaps).max() < 1e-9:
                break
            q = q + np.linalg.pinv(self._jacobian(q)[grasp.contacts.normal_rows], rcond=0.01) @ gaps
        return q

    def _centers(self, q: Array) -> Array:
        """Return the true centres of the fingertips, (N, 3) in H, m."""
        tips = [self.grasp.hand.tip_pose(q, name) for name in self.grasp.fingers]
        return np.array([p + R @ offset for (p, R), offset in zip(tips, self.options.tip_offsets(self.grasp), strict=True)])

    def _jacobian(self, q: Array) -> Array:
        """Return the contact Jacobian at the true fingertips, in the frames of the grasp's contacts."""
        grasp, R_OC = self.grasp, self.grasp.contacts.R_OC
        points = (self._centers(q) - grasp.p_HO) @ grasp.R_HO + np.array(tip_radii(grasp))[:, None] * R_OC[:, :, 2]
        contacts = replace(grasp.contacts, p_OC=points)
        return grasp.hand.contact_jacobian(q, grasp.fingers, contacts, grasp.p_HO, grasp.R_HO)

    def _read_contacts(self, motion: BodyMotion, tau: Array) -> TrueContacts:
        """Return the contact forces of the coming step of the engine, in frames on the object at its begin."""
        model = self._model
        results = model.plant.get_contact_results_output_port().Eval(model.context)
        count = len(self._p_OC)
        touching, f, depth = np.zeros(count, dtype=np.bool_), np.zeros((count, 4)), np.zeros(count)
        for c in range(results.num_point_pair_contacts()):
            info = results.point_pair_contact_info(c)
            is_tip_first = int(info.bodyA_index()) in model.tips
            tip = model.tips.index(int(info.bodyA_index() if is_tip_first else info.bodyB_index()))
            sign = 1.0 if is_tip_first else -1.0  # the force acts on body B; the normal points from B to A
            n = motion.R_HO.T @ (-sign * info.point_pair().nhat_BA_W)
            p_OC = motion.R_HO.T @ (info.contact_point() - motion.p_HO)
            R_OC = Contact(p_OC, n, 0.0).R_OC
            self._p_OC[tip], self._R_OC[tip] = p_OC, R_OC
            f[tip, :3] = R_OC.T @ (motion.R_HO.T @ (sign * info.contact_force()))
            touching[tip], depth[tip] = f[tip, 2] > 0.0, info.point_pair().depth
        return TrueContacts(
            t=self.t, touching=touching, f=freeze(f), p_OC=freeze(self._p_OC), R_OC=freeze(self._R_OC), mu=self._mu,
            gamma=freeze(np.zeros(count)), depth=freeze(depth), tau=freeze(tau),
        )  # fmt: skip


def mass_matrix(plant: DrakePlant, q: Array) -> Array:
    """Return Tᵀ M T with Drake's mass matrix of all joints, (n, n), kg·m². The plant is set to the posture."""
    model, hand = plant._model, plant.grasp.hand
    set_state(model, plant.grasp, GraspState(q, np.zeros(hand.n), plant.state().object))
    M = model.plant.CalcMassMatrix(model.context)
    rows = [model.plant.GetJointByName(name).velocity_start() for name in hand.full_joints]
    return np.asarray(hand.T.T @ M[np.ix_(rows, rows)] @ hand.T)


def coupling_error(plant: DrakePlant) -> float:
    """Return the largest violation of a joint coupling, rad."""
    model, hand = plant._model, plant.grasp.hand
    rows = [model.plant.GetJointByName(name).position_start() for name in hand.full_joints]
    return float(np.abs(model.plant.GetPositions(model.context)[rows] - hand.T @ plant.state().q - hand.q0).max())
