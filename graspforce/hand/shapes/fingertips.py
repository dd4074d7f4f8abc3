"""Fingertips of a URDF: the moving links at the ends of its chains, and the centres of their pads, from their shapes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import ModelError
from graspforce.hand.descriptions.urdf import Urdf, UrdfShape
from graspforce.hand.shapes.meshes import Directories
from graspforce.hand.shapes.shape_geometry import outer_points

TIP_WORDS = ("tip", "pad", "nail", "anchor", "end", "contact")  # in names of frames at a fingertip

_DISTAL_SHARE = 0.25  # of the link's length: the part that is measured
_SMALLEST_RADIUS, _LARGEST_RADIUS = 0.002, 0.02  # m, of a fingertip


@dataclass(frozen=True, eq=False, slots=True)
class Pad:
    """The end of a finger, approximated by a sphere.

    Attributes:
        link: URDF link in whose frame the centre is given.
        centre: (3,) m.
        radius: m.
    """

    link: str
    centre: Array
    radius: float


@dataclass(frozen=True, eq=False, slots=True)
class Fingertip:
    """The last moving link of a finger.

    Attributes:
        name: name of the finger, from the names of its links and joints.
        link: URDF link that the last joint moves.
        frame: a link fixed to it whose name is that of a tip, the furthest from the joint; None if there is none.
        p_LF: (3,) position of that frame in `link`, m; zeros without one.
        pad: the pad, in `link`; None if the link has no shapes that can be read.
    """

    name: str
    link: str
    frame: str | None
    p_LF: Array
    pad: Pad | None

    @property
    def frame_offset(self) -> float:
        """Distance of the frame from the centre of the pad, m; zero if one of them is missing."""
        if self.frame is None or self.pad is None:
            return 0.0
        return float(np.linalg.norm(self.pad.centre - self.p_LF))


def find_fingertips(model: Urdf, urdf: Path, directories: Directories = ()) -> tuple[Fingertip, ...]:
    """Return the fingertips of a URDF: the moving links with shapes or a tip frame that carry no other moving link.

    Args:
        model: links and joints.
        urdf: path of the URDF, for its mesh files.
        directories: directories to search for meshes first.
    """
    moving = [joint for joint in model.joints.values() if joint.is_moving]
    last = [joint for joint in moving if not any(joint in model.chain(other.parent) for other in moving)]
    found = []
    for joint in last:
        fixed = {name: model.pose_on(joint.child, name) for name in model.fixed_links(joint.child)}
        frames = [name for name in fixed if name != joint.child and any(word in name.lower() for word in TIP_WORDS)]
        frame = max(frames, key=lambda name: float(np.linalg.norm(fixed[name][0])), default=None)
        pad = fit_pad(joint.child, model.shapes_on(joint.child), urdf, directories)
        if pad is not None or frame is not None:
            p_LF = fixed[frame][0] if frame is not None else np.zeros(3)
            found.append(Fingertip(_finger_name(model, joint.child), joint.child, frame, freeze(p_LF), pad))
    names = [tip.name for tip in found]
    return tuple(
        tip if tip.name and names.count(tip.name) == 1 else _renamed(tip, f"{tip.name or 'finger'}_{i + 1}")
        for i, tip in enumerate(found)
    )


def fit_pad(link: str, shapes: Sequence[UrdfShape], urdf: Path, directories: Directories = ()) -> Pad | None:
    """Return the sphere in the end of a link, as thick as the link's last quarter is there.

    The end is the part furthest from the link's origin, which is on its joint.

    Args:
        link: name of the link.
        shapes: its shapes, in its frame.
        urdf: path of the URDF, for its mesh files.
        directories: directories to search for meshes first.
    """
    clouds = []
    for shape in shapes:
        try:
            clouds.append(outer_points(shape, urdf, directories))
        except ModelError:
            continue  # a mesh that is not found; lint reports it
    if not clouds:
        return None
    p = np.vstack(clouds)
    far = np.linalg.norm(p, axis=1)
    d = p[far >= np.quantile(far, 0.9)].mean(axis=0)
    length = float(np.linalg.norm(d))
    if length == 0.0:
        return Pad(link, freeze(np.zeros(3)), float(np.clip(far.max(), _SMALLEST_RADIUS, _LARGEST_RADIUS)))
    d = d / length
    s = p @ d
    end = p[s >= s.max() - _DISTAL_SHARE * (s.max() - max(s.min(), 0.0))]
    _, _, axes = np.linalg.svd(np.vstack([d, np.zeros((2, 3))]))
    across = end @ axes[1:].T  # m, in the plane across d
    middle = (across.max(axis=0) + across.min(axis=0)) / 2.0
    angle = np.linspace(0.0, np.pi, 36, endpoint=False)
    widths = np.ptp(across @ np.array([np.cos(angle), np.sin(angle)]), axis=0)  # m, in 36 directions across the end
    radius = float(np.clip(widths.min() / 2.0, _SMALLEST_RADIUS, min(_LARGEST_RADIUS, float(s.max()))))
    return Pad(link, freeze(middle @ axes[1:] + (s.max() - radius) * d), radius)


def _finger_name(model: Urdf, link: str) -> str:
    """Return the usual name of a finger that the names of its links and joints contain, or an empty text."""
    own = [link, *(name for joint in reversed(model.chain(link)) if joint.is_moving for name in (joint.name, joint.child))]
    for text in own:
        for finger, words in _FINGER_WORDS.items():
            if any(word in text.lower() for word in words):
                return finger
    return ""


_FINGER_WORDS = {
    "thumb": ("thumb",),
    "index": ("index", "forefinger", "idx"),
    "middle": ("middle",),
    "ring": ("ring",),
    "little": ("little", "pinky", "pinkie"),
}


def _renamed(tip: Fingertip, name: str) -> Fingertip:
    return Fingertip(name, tip.link, tip.frame, tip.p_LF, tip.pad)
