"""A step's arithmetic in C (`step.h`) for one hold, by the laws of `ObjectControlLaw`.

What is targets lies in a block, part after part; a part becomes an array when it is first asked for.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from graspforce.contact.compiled_kinematics import block_dtype, contacts_from_block, field_shapes, primitive_parameters
from graspforce.contact.kinematics import RollingContacts, TipContactState
from graspforce.control.contact_constraints import ContactConstraints
from graspforce.control.memory import ControlMemory
from graspforce.control.mobility import NO_TWISTS, Accelerations
from graspforce.control.settings import ControlSettings
from graspforce.control.state import DesiredMotion, GraspMotion, GraspState, object_motion
from graspforce.control.step_data import StepResult, StepTargets
from graspforce.core.arrays import Array, freeze
from graspforce.core.compiled import native
from graspforce.grasp.grasp import Grasp

_GRASP_POSTURE = (None, None, None)  # in place of q, v, a: those of the hold, at rest
_SATURATED, _HAS_WARNINGS = 1, 6  # signs of `Step.settle`


class CompiledStep:
    """Both halves of a step, for a hold on a surface whose nearest points have a closed form.

    Args:
        hold, settings: the controller's.
        ties: what the contacts tie.
        saturation_limits: (2, n) the torques at which motors count as at their limits, N·m.
        reach: (n,) the strongest pull on a joint towards its posture, rad/s².
        creep_decay: the part of the creep that a period leaves.
    """

    def __init__(
        self,
        grasp: Grasp,
        settings: ControlSettings,
        constraints: ContactConstraints,
        saturation_limits: Array,
        max_posture_pull: Array,
        creep_decay: float,
    ) -> None:
        hand, contacts, body, n, count = grasp.hand, grasp.contacts, grasp.body, grasp.hand.n, len(grasp.contacts)
        fingers = [hand.finger(name) for name in grasp.fingers]
        links, p_LF, R_LF = zip(*(hand.model.carrier_of(finger.tip) for finger in fingers), strict=True)
        numbers = [
            *settings.gains.rows().ravel(),
            *(settings.integral_limit_linear, settings.integral_limit_angular),
            *(settings.posture_stiffness, settings.posture_damping, settings.rank_tolerance),
            *(settings.period, creep_decay, settings.creep_limit, settings.contact_tolerance),
            *(*settings.gravity_H, body.mass, *body.inertia.ravel(), *body.p_OM),
        ]
        given: list[Any] = [
            *(
                numbers,
                [finger.tip_radius or 0.0 for finger in fingers],
                contacts.p_OC,
                contacts.R_OC,
                grasp.q,
                max_posture_pull,
                p_LF,
                R_LF,
            ),
            *(hand.model.T, [hand.torque_lower, hand.torque_upper], saturation_limits, [hand.q_lower, hand.q_upper]),
            *(
                [hand.model.joints_moving(finger.tip) for finger in fingers],
                np.array(links) + 1,
                constraints.padded_rows,
                contacts.columns,
            ),
        ]
        self._step = native.Step(primitive_parameters(body.shape), *map(freeze, given))
        self._model, self._contacts = hand.model, contacts
        first = {"error": (6,), "acceleration": (6,), "object": (6,), "w": (6,), "joints": (n,), "J": (contacts.size, n)}
        last = {"tau": (n,), "creep": (count, 2), "crept": (count,), "integral": (6,)}
        self._targets_dtype = block_dtype({**first, **field_shapes(count, n)})
        self._result_dtype = block_dtype(last)
        self._margin_size = 6 + n

    def compute_targets(
        self, memory: ControlMemory, state: GraspState, desired: DesiredMotion, external: Array | None
    ) -> CompiledTargets:
        """What is targets, of arguments as in `ObjectControlLaw.step`."""
        link_motion, now, block = self._model.link_motion(state.q, state.v), state.object, np.empty((), self._targets_dtype)
        joints, body = (
            (desired.q, desired.v, desired.a) if isinstance(desired, GraspMotion) else _GRASP_POSTURE,
            object_motion(desired),
        )
        is_complete = self._step.want(
            *(state.q, state.v, now.p_HO, now.R_HO, now.twist),
            *(body.p_HO, body.R_HO, body.twist, body.acceleration, *joints),
            *(memory.integral, memory.R_OC, external, link_motion.J, link_motion.J_rate, link_motion.link_poses, block),
        )
        block.setflags(write=False)  # commands and memories are made of its parts
        return CompiledTargets(self, block, is_complete)

    def apply_slip_margin(self, block: Any, tau_u: Array, shift: Array) -> tuple[Array, Array]:
        """As `StepTargets.tightened`, of a block that `targets` wrote."""
        both = np.empty(self._margin_size)
        self._step.tighten(block, tau_u, shift, both)
        return both[:6], both[6:]

    def compute_result(
        self,
        memory: ControlMemory,
        tip_contacts: TipContactState,
        q: Array,
        targets: CompiledTargets,
        tau_u: Array,
        f: Array,
        update_integral: bool,
    ) -> StepResult:
        """What comes of forces f, as `ObjectControlLaw` settles it.

        Args:
            memory, touched: what the last step left.
            q: (n,) where the joints are, rad.
            targets: what this one wants.
            tau_u: (n,) what the hand's own motion takes, N·m.
            f: (k,) N and N·m.
            grows: whether the integral may.
        """
        block = np.empty((), self._result_dtype)
        signs = self._step.settle(
            *(targets.block, q, tau_u, f, memory.integral, memory.creep),
            *(tip_contacts.p_OF, tip_contacts.R_OF, tip_contacts.p_OC, update_integral, block),
        )
        block.setflags(write=False)
        tau, creep, creep_distance, integral = block["tau"], block["creep"], block["crept"], block["integral"]
        return StepResult(tau, bool(signs & _SATURATED), creep, creep_distance, integral, bool(signs & _HAS_WARNINGS))

    def contacts_from_block(self, block: Any) -> RollingContacts:
        """The contacts of a block that `targets` wrote."""
        return contacts_from_block(block, self._contacts, block["J"])


def _lazy_block_field(name: str) -> Any:
    """A part of the block as an array, made when it is first asked for."""
    return cached_property(lambda targets: targets.block[name])


class CompiledTargets(StepTargets):
    """What is targets, in the block that the compiled law wrote.

    Attributes:
        block: the parts.
        whole: whether the fingers can surely make every motion; if not, only the contacts and the error count.
    """

    block: Any
    is_complete: bool
    _compiled_step: CompiledStep
    uncontrollable_error = None
    error, object_acceleration, w = _lazy_block_field("error"), _lazy_block_field("acceleration"), _lazy_block_field("w")
    rolling = cached_property(lambda targets: targets._compiled_step.contacts_from_block(targets.block))
    accelerations = cached_property(
        lambda targets: Accelerations(targets.block["object"], targets.joint_acceleration, NO_TWISTS, None, None)
    )

    def __init__(self, of: CompiledStep, block: Any, is_complete: bool) -> None:
        p_OC, always = block["p_OC"], {"joint_acceleration": block["joints"], "J": block["J"], "R_OC": block["R_OC"]}
        tip_contacts = TipContactState(block["p_OF"], block["R_OF"], p_OC)
        vars(self).update(always, _compiled_step=of, block=block, is_complete=is_complete, p_OC=p_OC, tip_contacts=tip_contacts)

    def apply_slip_margin(self, tau_u: Array, shift: Array) -> tuple[Array, Array]:
        return self._compiled_step.apply_slip_margin(self.block, tau_u, shift)
