"""What a controller tells a hand to do, and what it found on the way."""

from __future__ import annotations

from dataclasses import dataclass

from graspforce.arrays import Array
from graspforce.contact import ContactSet
from graspforce.solution import Solution


@dataclass(frozen=True, eq=False, slots=True)
class Command:
    """The motor torques for one control period, and the forces and motion that they are meant to make.

    Attributes:
        tau: (n,) motor torques, N·m, inside the motors' limits.
        f: (k,) planned contact forces, stacked in the contact frames, N and N·m.
        contacts: the contacts where they are now, in O, with their true friction.
        w: (6,) the wrench that the contacts must supply, about O's origin, in O, N and N·m.
        acceleration: (6,) the object's commanded acceleration, as `BodyMotion.acceleration`, in H, m/s² and rad/s².
        joint_acceleration: (n,) the commanded joint accelerations, rad/s².
        error: (6,) from where the object is to where it should be, in H, m and rad.
        solution: the force problem's answer, certified. It stands for f less what the slip margin adds to each normal force.
        slip_margin: (N,) μ f_n − ‖f_t‖ of the planned forces with the true friction, N.
        saturated: whether a motor is at its limit.
        uncontrollable: (m, 6) orthonormal rows u, in H's axes: the fingers can make a twist of the object, in m/s and rad/s,
            exactly when u · twist is zero for all of them. Empty for fingers that can move their contacts every way.
        borne: (6,) the part of w, in O, N and N·m, that forces supply which load no motor: the fingers' structure bears them.
        creep: (N,) how far each fingertip has lately slid over the object, m.
        warnings: what a person should know, in sentences.
        held: whether no certified forces were found, and the last ones are held.
    """

    tau: Array
    f: Array
    contacts: ContactSet
    w: Array
    acceleration: Array
    joint_acceleration: Array
    error: Array
    solution: Solution
    slip_margin: Array
    saturated: bool
    uncontrollable: Array
    borne: Array
    creep: Array
    warnings: tuple[str, ...]
    held: bool
