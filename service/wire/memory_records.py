"""Memory of the controller on the wire: typed structs, whose arrays are lists or binary."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

from graspforce.contact.kinematics import TipContactState
from graspforce.control import ControlMemory
from graspforce.control.contacts.contact_change import ForceRamp
from graspforce.control.contacts.slip_reflex import ReflexMemory
from graspforce.control.drives.torque_factors import TorqueFactors
from graspforce.control.friction.friction_compensation import FrictionMemory
from graspforce.core.arrays import Array

WireVector = bytes | list[float]  # (n,)
WireMatrix = bytes | list[list[float]]  # (m, n), by rows
WireMatrices = bytes | list[list[list[float]]]  # (m, n, k)


class TipContactRecord(msgspec.Struct, forbid_unknown_fields=True):
    """The wire form of `TipContactState`, in O.

    Args:
        tips: positions of the tip frames, m.
        tip_frames: rotation matrices of the tip frames.
        positions: contact points, m.
    """

    tips: WireMatrix
    tip_frames: WireMatrices
    positions: WireMatrix

    @classmethod
    def pack(cls, tip_contacts: TipContactState, binary: bool = False) -> TipContactRecord:
        """Return the wire form of tip contacts.

        Args:
            tip_contacts: positions and frames of the tips and contacts.
            binary: True for binary arrays, False for lists.
        """
        write = np.ndarray.tobytes if binary else np.ndarray.tolist
        return cls(write(tip_contacts.p_OF), write(tip_contacts.R_OF), write(tip_contacts.p_OC))

    def unpack(self) -> TipContactState:
        """Return the tip contacts. The values are not checked: they come from the server."""
        return TipContactState(to_array(self.tips, -1, 3), to_array(self.tip_frames, -1, 3, 3), to_array(self.positions, -1, 3))


class ControlMemoryRecord(msgspec.Struct, forbid_unknown_fields=True, omit_defaults=True):
    """The wire form of `ControlMemory`. Pass on the memory of the last reply.

    Args:
        integral: integral of the pose error, m·s and rad·s.
        frames: contact frames in O, by rows.
        creep: recent sliding of each contact along both tangents, m.
        force: stacked contact forces, N and N·m.
        touched: fingertips and contacts of the step.
        friction: state of the friction observer.
        reflex: state of the reflex on slip.
        stop: state of a safe stop.
        ramp: limits of the normal forces of contacts that change.
        spin: rotation of the pads about their normals.
        margin: slip margin that the last forces kept, N, after a change of contacts.
        torque_factors: estimated errors of the drives.
    """

    integral: WireVector
    frames: WireMatrices
    creep: WireMatrix
    force: WireVector | None = None
    touched: TipContactRecord | None = None
    friction: dict[str, Any] | None = None
    reflex: dict[str, Any] | None = None
    stop: WireVector | None = None
    ramp: dict[str, Any] | None = None
    spin: WireMatrix | None = None
    margin: float | None = None
    torque_factors: dict[str, Any] | None = None

    @classmethod
    def pack(cls, memory: ControlMemory, binary: bool = False) -> ControlMemoryRecord:
        """Return the wire form of a memory.

        Args:
            memory: memory after a control step.
            binary: True for binary arrays, False for lists.
        """
        write = np.ndarray.tobytes if binary else np.ndarray.tolist
        force = None if memory.f is None else write(memory.f)
        tips = None if memory.tip_contacts is None else TipContactRecord.pack(memory.tip_contacts, binary)
        friction = None if memory.friction is None else memory.friction.to_dict()
        reflex = None if memory.reflex is None else memory.reflex.to_dict()
        stop = None if memory.stop is None else write(memory.stop)
        ramp = None if memory.ramp is None else memory.ramp.to_dict()
        spin = None if memory.spin is None else write(memory.spin)
        factors = None if memory.torque_factors is None else memory.torque_factors.to_dict()
        arrays = write(memory.integral), write(memory.R_OC), write(memory.creep)
        return cls(*arrays, force, tips, friction, reflex, stop, ramp, spin, memory.margin, factors)

    def unpack(self) -> ControlMemory:
        """Return the memory. The values are not checked: they come from the server."""
        force = None if self.force is None else to_array(self.force)
        tips = None if self.touched is None else self.touched.unpack()
        frames, creep = to_array(self.frames, -1, 3, 3), to_array(self.creep, -1, 2)
        friction = None if self.friction is None else FrictionMemory.from_dict(self.friction)
        reflex = None if self.reflex is None else ReflexMemory.from_dict(self.reflex, len(frames))
        stop = None if self.stop is None else to_array(self.stop)
        ramp = None if self.ramp is None else ForceRamp.from_dict(self.ramp, len(frames))
        spin = None if self.spin is None else to_array(self.spin, -1, 2)
        factors = None if self.torque_factors is None else TorqueFactors.from_dict(self.torque_factors)
        parts = force, tips, friction, reflex, stop, ramp, spin, self.margin, factors
        return ControlMemory(to_array(self.integral), frames, creep, *parts)


def to_array(values: Any, *shape: int) -> Array:
    """Return the array of a list, or of the bytes of its float64 numbers.

    Args:
        values: the list, or the bytes.
        shape: shape of the array; by default (n,).
    """
    numbers = np.frombuffer(values) if type(values) is bytes else np.array(values, dtype=np.float64)
    return numbers.reshape(shape) if shape else numbers
