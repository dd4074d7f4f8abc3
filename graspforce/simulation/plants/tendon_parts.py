"""Tendons in MuJoCo: differentials whose joints are free, and breakaways that open and close.

A free differential (`graspforce.hand.tendon_modes.free_differentials`) has two coordinates: that of its motor, and one that
turns its joints against each other. In MuJoCo both joints move freely, and a fixed tendon with the length c₁ q₁ + c₂ q₂ is the
motor's coordinate. It has the rotor's inertia, and its tension turns both joints in the ratio of their radii.

A breakaway couples its joints until the torque on the first one exceeds the threshold. Then the gear holds the first joint, and
the motor turns the second one alone, until the motor has come back to where it opened.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt

from graspforce.core.arrays import Array, freeze
from graspforce.hand.drives.tendon import Tendon
from graspforce.hand.hand import Hand
from graspforce.simulation.plants.engine_settings import EngineSettings

CLOSED, OPEN = " follows", " is held"  # names of a breakaway's constraints, after the name of the joint


@dataclass(frozen=True, slots=True)
class FreeDifferential:
    """A differential whose joints move independently.

    Attributes:
        joints: names of both joints.
        columns: columns of the motor's coordinate and of the opposed motion in T.
        inverse: (2, 2) map from the positions of both joints, less their offsets, to the two coordinates.
    """

    joints: tuple[str, str]
    columns: tuple[int, int]
    inverse: Array


def find_free_differentials(hand: Hand) -> tuple[FreeDifferential, ...]:
    """Return the free differentials of a hand.

    Args:
        hand: the hand.
    """
    found = []
    for column, joint in enumerate(hand.joints):
        if joint.name in hand.full_joints:
            continue
        rows = np.flatnonzero(hand.T[:, column])
        motor = int(np.setdiff1d(np.flatnonzero(hand.T[rows].any(axis=0)), [column])[0])
        columns = motor, column
        names = hand.full_joints[rows[0]], hand.full_joints[rows[1]]
        found.append(FreeDifferential(names, columns, freeze(np.linalg.inv(hand.T[rows][:, list(columns)]))))
    return tuple(found)


def motor_map(hand: Hand, moving: list[str]) -> Array:
    """Return S of the motors' coordinates q = S (positions of the moving joints − q0), (n, n_moving).

    Args:
        hand: the hand.
        moving: names of the moving joints.
    """
    S = np.zeros((hand.n, len(moving)))
    for column, joint in enumerate(hand.joints):
        if joint.name in moving:
            S[column, moving.index(joint.name)] = 1.0
    for each in find_free_differentials(hand):
        rows = [moving.index(name) for name in each.joints]
        S[list(each.columns)] = 0.0
        S[np.ix_(list(each.columns), rows)] = each.inverse
    return freeze(S)


def add_differentials(spec: mujoco.MjSpec, hand: Hand) -> None:
    """Add the tendons of free differentials, with the inertias of their rotors.

    Args:
        spec: specification of the model, with the joints of the hand.
        hand: the hand.
    """
    for each in find_free_differentials(hand):
        tendon = spec.add_tendon(name=" and ".join(each.joints))
        for name, coefficient in zip(each.joints, each.inverse[0], strict=True):
            tendon.wrap_joint(name, float(coefficient))
        tendon.armature = float(hand.rotor_inertia[each.columns[0]])


def add_breakaways(spec: mujoco.MjSpec, hand: Hand, engine: EngineSettings) -> None:
    """Add the constraints with which gears hold the first joints of open breakaways; they are off.

    Args:
        spec: specification of the model, with the joints of the hand.
        hand: the hand.
        engine: settings of the engine.
    """
    for tendon in breakaways(hand):
        held = spec.add_equality(type=mujoco.mjtEq.mjEQ_JOINT, objtype=mujoco.mjtObj.mjOBJ_JOINT)
        held.name, held.name1, held.active = f"{tendon.joints[0]}{OPEN}", tendon.joints[0], False
        held.solref, held.solimp = engine.coupling_solref, [*engine.coupling_solimp, 0.5, 2.0]


def breakaways(hand: Hand) -> tuple[Tendon, ...]:
    """Return the breakaways of a hand.

    Args:
        hand: the hand.
    """
    return tuple(tendon for tendon in hand.tendons if tendon.kind == "breakaway")


class Clutches:
    """The breakaways of a hand in a plant.

    Args:
        hand: the hand.
        model: of MuJoCo.

    Attributes:
        stops: position of the motor's coordinate at which each breakaway opened, rad; None while it is closed.
        passed: torque on the first joint of each through its clutch in the last step, N·m.
    """

    def __init__(self, hand: Hand, model: mujoco.MjModel) -> None:
        self._tendons, names = breakaways(hand), [joint.name for joint in hand.joints]
        self._motors = [names.index(tendon.joints[0]) for tendon in self._tendons]
        self._offsets = [float(hand.q0[hand.full_joints.index(tendon.joints[1])]) for tendon in self._tendons]
        joints = [[model.joint(name) for name in tendon.joints] for tendon in self._tendons]
        self._q = [[int(joint.qposadr[0]) for joint in pair] for pair in joints]
        self._v = [[int(joint.dofadr[0]) for joint in pair] for pair in joints]
        self._closed = [int(model.equality(f"{tendon.joints[1]}{CLOSED}").id) for tendon in self._tendons]
        self._open = [int(model.equality(f"{tendon.joints[0]}{OPEN}").id) for tendon in self._tendons]
        self.stops: list[float | None] = [None] * len(self._tendons)
        self.passed = [0.0] * len(self._tendons)

    def correct_state(self, data: mujoco.MjData, q: Array, v: Array) -> None:
        """Set the coordinates of the motors behind open breakaways, in place.

        Args:
            data: of MuJoCo.
            q: (n,) positions, rad, in which the first joint counts as the motor's coordinate.
            v: (n,) rates, rad/s.
        """
        for k, stop in enumerate(self.stops):
            if stop is not None:
                slope, (_, second) = self._tendons[k].slope_after_stop(0), self._q[k]
                held = self._tendons[k].positions(stop, stop, self._offsets[k])[1]
                q[self._motors[k]] = stop + (data.qpos[second] - held) / slope
                v[self._motors[k]] = data.qvel[self._v[k][1]] / slope

    def apply_torques(self, data: mujoco.MjData, tau: Array) -> None:
        """Apply the torques of motors behind open breakaways to the second joints.

        Args:
            data: of MuJoCo, with the torques of closed breakaways.
            tau: (n,) torques of the motors, N·m.
        """
        for k, stop in enumerate(self.stops):
            first, second = self._v[k]
            data.qfrc_applied[second] = 0.0
            if stop is not None:
                data.qfrc_applied[first] = 0.0
                data.qfrc_applied[second] = tau[self._motors[k]] / self._tendons[k].slope_after_stop(0)

    def switch(self, model: mujoco.MjModel, data: mujoco.MjData, q: Array, tau: Array) -> None:
        """Open and close the breakaways after a step, for the next one.

        Args:
            model: of MuJoCo.
            data: of MuJoCo after the step.
            q: (n,) positions of the motors, rad.
            tau: (n,) torques of the motors in the step, N·m.
        """
        for k, tendon in enumerate(self._tendons):
            motor, before = self._motors[k], self.stops[k]
            self.passed[k] = float(tau[motor] - tendon.ratio * _constraint_force(data, self._closed[k]))
            stop = tendon.next_stop(before, float(q[motor]), self.passed[k])
            if (stop is None) != (before is None):
                data.eq_active[self._closed[k]], data.eq_active[self._open[k]] = stop is None, stop is not None
                if stop is not None:
                    model.eq_data[self._open[k], 0] = stop
            self.stops[k] = stop


def _constraint_force(data: mujoco.MjData, equality: int) -> float:
    """Return the force of an equality constraint, N·m; zero if it is off."""
    is_equality = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
    rows: npt.NDArray[np.intp] = np.flatnonzero(is_equality & (data.efc_id == equality))
    return float(data.efc_force[rows[0]]) if len(rows) else 0.0
