"""The plant of a hand without an object: motor torques in, joint positions and rates out."""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

from graspforce.control.joints.joint_command import JointMotion
from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput, ModelError
from graspforce.hand.hand import GRAVITY_PALM_UP, Hand
from graspforce.simulation.plants.engine_settings import EngineSettings
from graspforce.simulation.plants.scene_parts import add_hand, moving_joints, set_engine_options


class FreeHandPlant:
    """A hand in MuJoCo that touches nothing, initially at rest.

    Args:
        hand: the hand.
        gravity_H: (3,) acceleration of gravity in H, m/s².
        q: (n,) start posture, rad; neutral by default.
        joint_friction: (n,) Coulomb friction of the joints, N·m; none by default.
        engine: settings of the engine.

    Raises:
        InvalidInput: a value is not finite or of the wrong shape.
        ModelError: MuJoCo cannot build the hand.
    """

    def __init__(
        self,
        hand: Hand,
        *,
        gravity_H: npt.ArrayLike = GRAVITY_PALM_UP,
        q: npt.ArrayLike | None = None,
        joint_friction: npt.ArrayLike | None = None,
        engine: EngineSettings | None = None,
    ) -> None:
        self.hand, self._engine = hand, engine or EngineSettings()
        spec = mujoco.MjSpec()
        spec.modelname = hand.name
        set_engine_options(spec, self._engine, arrays.check_array(gravity_H, "gravity_H", (3,)))
        add_hand(spec, hand, hand.tree(), self._engine)
        for joint, friction in zip(hand.joints, _checked_friction(hand, joint_friction), strict=True):
            spec.joint(joint.name).frictionloss = friction
        try:
            self.model: mujoco.MjModel = spec.compile()
        except ValueError as error:
            raise ModelError(f"{hand.name}: MuJoCo cannot build it: {error}") from None
        self.data = mujoco.MjData(self.model)
        is_moving = moving_joints(hand)
        moving = [name for name, moves in zip(hand.full_joints, is_moving, strict=True) if moves]
        joints = [self.model.joint(name).id for name in moving]
        motors = [moving.index(joint.name) for joint in hand.joints]
        self._all_q = np.array([self.model.jnt_qposadr[j] for j in joints], dtype=np.intp)
        self._motor_q = self._all_q[motors]
        self._motor_v = np.array([self.model.jnt_dofadr[j] for j in joints], dtype=np.intp)[motors]
        start = hand.neutral if q is None else arrays.check_array(q, "q", (hand.n,))
        self.data.qpos[self._all_q] = hand.T[is_moving] @ start + hand.q0[is_moving]
        mujoco.mj_forward(self.model, self.data)

    @property
    def t(self) -> float:
        """Simulated time, s."""
        return float(self.data.time)

    @property
    def dt(self) -> float:
        """Length of a step, s."""
        return self._engine.dt

    def motion(self) -> JointMotion:
        """Return the joint positions and rates."""
        return JointMotion(freeze(self.data.qpos[self._motor_q]), freeze(self.data.qvel[self._motor_v]))

    def step(self, tau: npt.ArrayLike) -> JointMotion:
        """Advance by dt under motor torques, and return the motion at the end of the step.

        Args:
            tau: (n,) torques, limited to the range of the motors, N·m.

        Raises:
            InvalidInput: a torque is not finite, or their number is wrong.
        """
        checked = arrays.check_array(tau, "tau", (self.hand.n,))
        self.data.qfrc_applied[self._motor_v] = np.clip(checked, self.hand.torque_lower, self.hand.torque_upper)
        mujoco.mj_step(self.model, self.data)
        return self.motion()


def _checked_friction(hand: Hand, joint_friction: npt.ArrayLike | None) -> Array:
    """Return the friction of the joints, N·m, checked."""
    if joint_friction is None:
        return np.zeros(hand.n)
    friction = arrays.check_array(joint_friction, "joint_friction", (hand.n,))
    if (friction < 0.0).any():
        raise InvalidInput("joint_friction", joint_friction, "at least 0")
    return friction
