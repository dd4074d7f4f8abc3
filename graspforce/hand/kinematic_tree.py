"""A hand's links as plain numbers: what another engine needs to build the same hand. Source: the URDF, read by Pinocchio."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from graspforce.core.arrays import Array


@dataclass(frozen=True, eq=False, slots=True)
class Link:
    """A moving link, with all that is fixed to it, and the joint that moves it. Frames: P the parent link's, L the link's own.

    At joint position x the link stands at p_PL, turned by R_PL and then by x about ``axis``; a sliding joint moves it by x
    along ``axis`` instead.

    Attributes:
        joint: the joint's name; the links stand in the order of `Hand.full_joints`.
        parent: index of the parent link, -1 for the hand's base H; always smaller than the link's own.
        p_PL, R_PL: (3,) m and (3, 3), the link's place on its parent at joint position zero.
        axis: (3,) the joint's unit vector, in L.
        slides: whether the joint is prismatic.
        mass: kg.
        p_LM: (3,) the centre of mass, m.
        inertia: (3, 3) about the centre of mass, in L's axes, kg·m².
        lower, upper: the joint's own position limits, rad (sliding: m).
    """

    joint: str
    parent: int
    p_PL: Array
    R_PL: Array
    axis: Array
    is_prismatic: bool
    mass: float
    p_LM: Array
    inertia: Array
    lower: float
    upper: float


@dataclass(frozen=True, eq=False, slots=True)
class Tip:
    """A finger's tip frame F on a link.

    Attributes:
        finger: its name.
        link: index of the link that carries it.
        p_LF, R_LF: (3,) m and (3, 3), F's place on the link.
        radius: of the ball about F's origin, m; None where the hand's description gives none.
    """

    finger: str
    link: int
    p_LF: Array
    R_LF: Array
    radius: float | None


@dataclass(frozen=True, eq=False, slots=True)
class Mesh:
    """A mesh that belongs to a link.

    Attributes:
        part: the URDF's name of what it shows: several of its links may be fixed to one that moves.
        link: index of the moving link that it is fixed to, -1 for the hand's base H.
        file: where it lies; nobody has opened it.
        scale: (3,) by how much its own coordinates grow to become m.
        p_LS, R_LS: (3,) m and (3, 3), the place of its own coordinates S on the link.
    """

    urdf_link: str
    link: int
    file: Path
    scale: Array
    p_LS: Array
    R_LS: Array


@dataclass(frozen=True, eq=False, slots=True)
class KinematicTree:
    """The links of a hand, base first, and its fingertips. Rotors' inertias are not in it: they belong to the motors."""

    links: tuple[Link, ...]
    tips: tuple[Tip, ...]
