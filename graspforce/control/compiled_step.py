"""A control step in C (`csrc/include/graspforce/control_step.h`), for one grasp.

`ObjectControlLaw` is the reference implementation. The C code owns the layout of its outputs. A step writes them to one block
of memory, whose fields become arrays at their first access.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any

import numpy as np

from graspforce.contact.compiled_kinematics import contacts_from_block, primitive_parameters
from graspforce.contact.kinematics import RollingContacts, TipContactState
from graspforce.control.contacts.contact_constraints import ContactConstraints
from graspforce.control.contacts.mobility import NO_TWISTS, SPIN_COMPLIANCE_START, SPIN_DAMPING_START, Accelerations
from graspforce.control.contacts.pad_spin import spin_acceleration
from graspforce.control.memory import ControlMemory
from graspforce.control.settings import ControlSettings
from graspforce.control.state import DesiredMotion, GraspMotion, GraspState, object_motion
from graspforce.control.step_data import IntegralRule, StepResult, StepTargets
from graspforce.core.arrays import Array
from graspforce.core.compiled import Block, native, new_block
from graspforce.core.lazy_field import LazyField
from graspforce.grasp.grasp import Grasp

JointRows = tuple[Array | None, Array | None, Array | None]
_GRASP_POSTURE: JointRows = (None, None, None)  # desired joint motion: the posture of the grasp, at rest


def step_parameters(
    grasp: Grasp,
    settings: ControlSettings,
    constraints: ContactConstraints,
    saturation_limits: Array,
    integral_limits: tuple[float, float],
    max_posture_pull: Array,
    creep_decay: float,
) -> dict[str, Any]:
    """Return the numbers of a grasp and of the settings, by the names of `gf_controlled_grasp` in `control_step.h`.

    Args:
        grasp: hand, object and contacts.
        settings: settings of the controller.
        constraints: kinematic constraints of the contacts.
        saturation_limits: (2, n) torques from which a motor counts as saturated, N·m.
        integral_limits: largest linear and angular acceleration from the integral, m/s² and rad/s².
        max_posture_pull: (n,) largest acceleration towards the posture, rad/s².
        creep_decay: factor of the sliding after one period.
    """
    hand, contacts, body = grasp.hand, grasp.contacts, grasp.body
    fingers = [hand.finger(name) for name in grasp.fingers]
    links, p_LF, R_LF = zip(*(hand.model.carrier_of(finger.tip) for finger in fingers), strict=True)
    kp, kd, ki = settings.gains.rows()
    return {
        "posture_stiffness": settings.posture_stiffness,
        "posture_damping": settings.posture_damping,
        "rank_tolerance": settings.rank_tolerance,
        "spin_damping": constraints.spin_damping,
        "spin_damping_start": SPIN_DAMPING_START,
        "spin_compliance": constraints.spin_compliance,
        "spin_compliance_start": SPIN_COMPLIANCE_START,
        "period": settings.period,
        "creep_decay": creep_decay,
        "creep_limit": settings.creep_limit,
        "contact_tolerance": settings.contact_tolerance,
        "mass": body.mass,
        "kp": kp,
        "kd": kd,
        "ki": ki,
        "integral_limits": np.array(integral_limits),
        "gravity_H": settings.gravity_H,
        "inertia": body.inertia,
        "p_OM": body.p_OM,
        "radii": np.array([finger.tip_radius or 0.0 for finger in fingers]),
        "p_OC": contacts.p_OC,
        "R_OC": contacts.R_OC,
        "q": grasp.q,
        "max_posture_pull": max_posture_pull,
        "p_LF": np.array(p_LF),
        "R_LF": np.array(R_LF),
        "T": hand.model.T,
        "torque_limits": np.array([hand.torque_lower, hand.torque_upper]),
        "saturation_limits": saturation_limits,
        "q_limits": np.array([hand.q_lower, hand.q_upper]),
        "surface": primitive_parameters(body.shape),
        "tip_links": np.array(links, dtype=np.intc) + 1,  # the model counts links after the base
        "moves_tip": np.array([hand.model.joints_moving(finger.tip) for finger in fingers], dtype=np.bool_),
        "constraint_rows": constraints.padded_rows.astype(np.intc),
        "force_rows": np.array(contacts.columns, dtype=np.intc),
    }


class CompiledStep:
    """Compiled control step, for an object whose shape the C code supports.

    Args:
        grasp: hand, object and contacts.
        parameters: numbers of the grasp and of the settings, see `step_parameters`.

    Attributes:
        step: the `ControlStep` of the C code.
    """

    def __init__(self, grasp: Grasp, parameters: Mapping[str, Any]) -> None:
        hand = grasp.hand
        self.step = native.ControlStep(**parameters)
        self._model, self._contacts, self._n = hand.model, grasp.contacts, hand.n
        self._posture = _GRASP_POSTURE
        self._targets_dtype: np.dtype[np.void] = np.dtype(self.step.targets_layout)
        self._result_dtype: np.dtype[np.void] = np.dtype(self.step.result_layout)

    def at_posture(self, q: Array) -> CompiledStep:
        """Return the step for the same contacts with another posture of the grasp.

        Args:
            q: (n,) joint positions, rad.
        """
        other, rest = copy.copy(self), np.zeros(self._n)
        other._posture = q, rest, rest
        return other

    def compute_targets(
        self, memory: ControlMemory, state: GraspState, desired: DesiredMotion, external: Array | None
    ) -> CompiledTargets:
        """Compute the targets of a step.

        Args:
            memory: as in `ObjectControlLaw.compute_targets`.
            state: as in `ObjectControlLaw.compute_targets`.
            desired: as in `ObjectControlLaw.compute_targets`.
            external: as in `ObjectControlLaw.compute_targets`.
        """
        link_motion, measured, body = self._model.link_motion(state.q, state.v), state.object, object_motion(desired)
        q_d, v_d, a_d = self.desired_joints(desired)
        block = self.new_targets()
        is_complete = self.step.compute_targets(
            q=state.q,
            v=state.v,
            p_HO=measured.p_HO,
            R_HO=measured.R_HO,
            twist=measured.twist,
            p_d=body.p_HO,
            R_d=body.R_HO,
            twist_d=body.twist,
            acceleration_d=body.acceleration,
            integral=memory.integral,
            R_OC_last=memory.R_OC,
            joint_twists=link_motion.J,
            joint_twist_rates=link_motion.J_rate,
            q_d=q_d,
            v_d=v_d,
            a_d=a_d,
            external=external,
            spin_acceleration=None if memory.spin is None else spin_acceleration(memory.spin),
            link_poses=link_motion.link_poses,
            targets=block,
        )
        block.setflags(write=False)  # commands and memories share its arrays
        return CompiledTargets(self, block, is_complete)

    def apply_slip_margin(self, block: Block, tau_u: Array, shift: Array) -> tuple[Array, Array]:
        """Return the shifted wrench and torques, as `StepTargets.apply_slip_margin`.

        Args:
            block: targets of the step.
            tau_u: (n,) torques without contact forces, N·m.
            shift: (N,) shift s/μ of each normal force, N.
        """
        w, tau = np.empty(6), np.empty(self._n)
        self.step.apply_slip_margin(targets=block, tau_u=tau_u, shift=shift, w_shifted=w, tau_shifted=tau)
        return w, tau

    def compute_result(
        self,
        memory: ControlMemory,
        last: TipContactState,
        q: Array,
        targets: CompiledTargets,
        tau_u: Array,
        f: Array,
        rule: IntegralRule,
    ) -> StepResult:
        """Compute torques, sliding and integral of a step.

        Args:
            memory: memory after the last step.
            last: its tip contacts.
            q: (n,) measured joint positions, rad.
            targets: targets of this step.
            tau_u: (n,) torques without contact forces, N·m.
            f: (k,) contact forces, N and N·m.
            rule: whether the integral grows.
        """
        block = self.new_result()
        flags = self.step.compute_result(
            q=q,
            tau_u=tau_u,
            f=f,
            integral=memory.integral,
            creep=memory.creep,
            p_OF=last.p_OF,
            R_OF=last.R_OF,
            p_OC=last.p_OC,
            targets=targets.block,
            integral_rule=rule,
            result=block,
        )
        block.setflags(write=False)
        return self.read_result(block, flags)

    def new_targets(self) -> Block:
        """Return a block for the targets of a step."""
        return new_block(self._targets_dtype)

    def new_result(self) -> Block:
        """Return a block for the result of a step."""
        return new_block(self._result_dtype)

    def desired_joints(self, desired: DesiredMotion) -> JointRows:
        """Return desired positions, rates and accelerations of the joints, each (n,) or None for those of the grasp at rest.

        Args:
            desired: desired motion.
        """
        return (desired.q, desired.v, desired.a) if isinstance(desired, GraspMotion) else self._posture

    def read_result(self, block: Block, flags: int) -> StepResult:
        """Return the result in a block.

        Args:
            block: the result, as the C code wrote it.
            flags: that the C code returned.
        """
        return StepResult(
            tau=block["tau"],
            saturated=bool(flags & native.SATURATED),
            creep=block["creep"],
            creep_distance=block["creep_distance"],
            integral=block["integral"],
            has_warnings=bool(flags & (native.CONTACT_LOST | native.JOINT_LIMIT)),
        )

    def contacts_from_block(self, block: Block) -> RollingContacts:
        """Return the contacts in a block of targets.

        Args:
            block: targets of the step.
        """
        return contacts_from_block(block, self._contacts, block["J"])


def _block_field(name: str) -> LazyField[Array]:
    """Return a field of the block that becomes an array at its first access."""
    return LazyField(lambda targets: targets.block[name])


class CompiledTargets(StepTargets):
    """Step targets in the block that the C code wrote.

    Attributes:
        block: all fields of the targets.
        is_complete: whether every twist is feasible; if not, only the contacts and the error are valid.
    """

    block: Block
    is_complete: bool
    _compiled_step: CompiledStep
    uncontrollable_error = None
    error, object_acceleration, w = _block_field("error"), _block_field("acceleration_H"), _block_field("w")
    rolling = LazyField(lambda targets: targets._compiled_step.contacts_from_block(targets.block))
    accelerations = LazyField(
        lambda targets: Accelerations(targets.block["acceleration_O"], targets.joint_acceleration, NO_TWISTS, None, None)
    )

    def __init__(self, compiled_step: CompiledStep, block: Block, is_complete: bool) -> None:
        p_OC = block["p_OC"]
        vars(self).update(
            _compiled_step=compiled_step,
            block=block,
            is_complete=is_complete,
            joint_acceleration=block["joint_acceleration"],
            J=block["J"],
            p_OC=p_OC,
            R_OC=block["R_OC"],
            tip_contacts=TipContactState(block["p_OF"], block["R_OF"], p_OC),
        )

    @property
    def velocity_rows(self) -> tuple[Array, Array]:
        """A (3 N, n) and B (3 N, 6): contact velocities (t₁, t₂, n) per joint rate and per twist of the object in O."""
        return self.block["A"], self.block["B"]

    def apply_slip_margin(self, tau_u: Array, shift: Array) -> tuple[Array, Array]:
        """Return the shifted wrench and torques.

        Args:
            tau_u: (n,) torques without contact forces, N·m.
            shift: (N,) shift s/μ of each normal force, N.
        """
        return self._compiled_step.apply_slip_margin(self.block, tau_u, shift)
