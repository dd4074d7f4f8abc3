"""The kinematic tree of a hand as plain numbers, for building the same hand in another engine."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from graspforce.core.arrays import Array
from graspforce.geometry.vectors import skew


@dataclass(frozen=True, eq=False, slots=True)
class Link:
    """A moving link with everything fixed to it, and the joint that moves it. Frames: P parent link, L this link.

    At joint position x, the link's frame is at p_PL with axes R_PL exp(x â), a the joint axis. A prismatic joint translates
    it by x R_PL a instead.

    Attributes:
        joint: name of the joint; links have the order of `Hand.full_joints`.
        parent: index of the parent link, -1 for the hand's base H; always smaller than the link's own index.
        p_PL: (3,) position of L in P at joint position zero, m.
        R_PL: (3, 3) axes of L in P at joint position zero.
        axis: (3,) unit vector of the joint in L.
        is_prismatic: whether the joint translates the link.
        mass: kg.
        p_LM: (3,) centre of mass in L, m.
        inertia: (3, 3) about the centre of mass, in L's axes, kg·m².
        lower: least joint position, rad (prismatic: m).
        upper: largest joint position, rad (prismatic: m).
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
    """The tip frame F of a finger on a link L.

    Attributes:
        finger: name of the finger.
        link: index of the link.
        p_LF: (3,) position of F in L, m.
        R_LF: (3, 3) axes of F in L.
        radius: radius of the sphere about F's origin, m; None if the description gives none.
    """

    finger: str
    link: int
    p_LF: Array
    R_LF: Array
    radius: float | None


@dataclass(frozen=True, eq=False, slots=True)
class Mesh:
    """A mesh file on a link L.

    Attributes:
        urdf_link: name of the URDF link that has the mesh; several URDF links can be fixed to one moving link.
        link: index of the moving link, -1 for the hand's base H.
        file: path of the mesh file, which is not opened.
        scale: (3,) factors from the file's coordinates S to metres.
        p_LS: (3,) position of S in L, m.
        R_LS: (3, 3) axes of S in L.
    """

    urdf_link: str
    link: int
    file: Path
    scale: Array
    p_LS: Array
    R_LS: Array


@dataclass(frozen=True, eq=False, slots=True)
class KinematicTree:
    """The links of a hand, base first, and its fingertips. Rotor inertias belong to the motors and are not included."""

    links: tuple[Link, ...]
    tips: tuple[Tip, ...]

    def poses_along(self, q_full: Array) -> tuple[Array, Array]:
        """Return the poses of all L links in M postures.

        Args:
            q_full: (M, n_full) positions of all joints, rad.

        Returns:
            Positions (M, L, 3), m, and axes (M, L, 3, 3), in H.
        """
        M, L = len(q_full), len(self.links)
        p, R = np.empty((M, L, 3)), np.empty((M, L, 3, 3))
        sines, cosines = np.sin(q_full)[:, :, None, None], np.cos(q_full)[:, :, None, None]
        for i, link in enumerate(self.links):
            p_PL, R_PL, K = link.p_PL, link.R_PL, skew(link.axis)
            if link.is_prismatic:
                p_PL = p_PL + q_full[:, i, None] * (R_PL @ link.axis)
            else:
                R_PL = R_PL + sines[:, i] * (R_PL @ K) + (1.0 - cosines[:, i]) * (R_PL @ K @ K)  # Rodrigues' formula
            if link.parent < 0:
                p[:, i], R[:, i] = p_PL, R_PL
            else:
                R_P = R[:, link.parent]
                p[:, i] = p[:, link.parent] + (R_P @ p_PL[..., None])[..., 0]
                R[:, i] = R_P @ R_PL
        return p, R
