"""Memory of the object controller between two steps."""

from __future__ import annotations

from dataclasses import dataclass

from graspforce.contact.contact import ContactSet
from graspforce.contact.kinematics import TipContactState
from graspforce.control.contacts.contact_change import ForceRamp
from graspforce.control.contacts.slip_reflex import ReflexMemory
from graspforce.control.drives.torque_factors import TorqueFactors
from graspforce.control.friction.friction_compensation import FrictionMemory
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.constants import LARGEST_MOTION
from graspforce.core.json_text import JsonRecord


@dataclass(frozen=True, eq=False, slots=True)
class ControlMemory:
    """State of the controller after a step, which the next step starts from.

    Attributes:
        integral: (6,) integral of the pose error in H, m·s and rad·s.
        R_OC: (N, 3, 3) contact frames in O.
        creep: (N, 2) recent sliding of each fingertip along t₁ and t₂, m.
        f: (k,) last certified contact forces, N and N·m; None before the first.
        tip_contacts: poses of the fingertips on the object. If None, sliding is computed from the measured velocities.
        friction: state of the compensation of joint friction; None before the first step, or without compensation.
        reflex: state of the reflex on slip; None if no contact is squeezed.
        stop: (3,) position in H at which the object is to stop after the loss of a finger, m; None if it is not to stop.
        ramp: limits of the forces of contacts that change; None if none changes.
        spin: (N, 2) angle and rate of each soft pad's spin on the object, rad and rad/s; None if no finger follows spins.
        margin: slip margin that the last forces kept, N, after a change of contacts; None if it is that of the settings.
        torque_factors: estimated errors of the drives; None before the first step, or for drives without stated errors.
    """

    integral: Array
    R_OC: Array
    creep: Array
    f: Array | None
    tip_contacts: TipContactState | None = None
    friction: FrictionMemory | None = None
    reflex: ReflexMemory | None = None
    stop: Array | None = None
    ramp: ForceRamp | None = None
    spin: Array | None = None
    margin: float | None = None
    torque_factors: TorqueFactors | None = None

    def to_dict(self) -> JsonRecord:
        """Return a plain record: `integral`, contact `frames`, `creep`, `force`, and `touched` for the tip contacts.

        It has `friction` only with a compensation of joint friction, `reflex` only after slip, `stop` only in a stop,
        `ramp` only while contacts change, `spin` only with soft pads whose spin the fingers follow, `margin` only after a
        change of contacts, until the margin of the settings is reached, and `torque_factors` only with drives that state
        errors.
        """
        parts = {"friction": self.friction, "reflex": self.reflex, "ramp": self.ramp, "torque_factors": self.torque_factors}
        return {
            "integral": self.integral.tolist(),
            "frames": self.R_OC.tolist(),
            "creep": self.creep.tolist(),
            "force": None if self.f is None else self.f.tolist(),
            "touched": None if self.tip_contacts is None else self.tip_contacts.to_dict(),
            **{name: part.to_dict() for name, part in parts.items() if part is not None},
            **{name: value.tolist() for name, value in {"stop": self.stop, "spin": self.spin}.items() if value is not None},
            **({} if self.margin is None else {"margin": self.margin}),
        }

    @classmethod
    def from_dict(cls, record: object, contacts: ContactSet, field: str = "memory") -> ControlMemory:
        """Read a memory from a plain record.

        Args:
            record: as `to_dict` returns it; all fields but `integral`, `frames` and `creep` may be absent or null.
            contacts: contacts of the grasp, which give the shapes.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        optional = ["force", "touched", "friction", "reflex", "stop", "ramp", "spin", "margin", "torque_factors"]
        values = fields.check_record(record, field, required=["integral", "frames", "creep"], optional=optional)
        count, given = len(contacts), (values.get(name) for name in optional)
        force, touched, friction, reflex, stop, ramp, spin, margin, factors = given
        return cls(
            arrays.check_array(values["integral"], f"{field}.integral", (6,), limit=LARGEST_MOTION),
            arrays.check_rotations(values["frames"], f"{field}.frames", count),
            arrays.check_array(values["creep"], f"{field}.creep", (count, 2)),
            None if force is None else arrays.check_array(force, f"{field}.force", (contacts.size,)),
            None if touched is None else TipContactState.from_dict(touched, count, f"{field}.touched"),
            None if friction is None else FrictionMemory.from_dict(friction, f"{field}.friction"),
            None if reflex is None else ReflexMemory.from_dict(reflex, count, f"{field}.reflex"),
            None if stop is None else arrays.check_array(stop, f"{field}.stop", (3,)),
            None if ramp is None else ForceRamp.from_dict(ramp, count, f"{field}.ramp"),
            None if spin is None else arrays.check_array(spin, f"{field}.spin", (count, 2)),
            None if margin is None else arrays.check_number(margin, f"{field}.margin", minimum=0.0),
            None if factors is None else TorqueFactors.from_dict(factors, f"{field}.torque_factors"),
        )
