"""The four angles of a finger that `segment_finger` takes, from the joint positions of a hand.

A finger's flexion joints have axes parallel to that of its last joint in the neutral posture; the others move it sideways.
Of the flexion joints, the last one is the distal–intermediate one, the first one the metacarpal–proximal one, and the one
before the last the proximal–intermediate one, if there are three. Flexion is positive: the direction from zero in which a joint
has the longer range.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.geometry.rotations import rotation_exp
from graspforce.hand.hand import Hand
from graspforce.hand.kinematics.kinematic_tree import KinematicTree, Link

_PARALLEL = 0.9  # |cos| of the angle between the axes of two flexion joints, at least
_DISTAL, _PROXIMAL, _SIDEWAYS, _METACARPAL = range(4)  # columns


def finger_angles(hand: Hand, finger: str, q: npt.ArrayLike) -> Array:
    """Return the angles of a finger, (T, 4), rad: distal–intermediate, proximal–intermediate, sideways, metacarpal–proximal.

    A finger with two flexion joints has zeros in the second column. Further sideways joints add to the third column, and
    further flexion joints to the second one.

    Args:
        hand: the hand.
        finger: name of the finger.
        q: (T, n) positions of the actuated joints, rad.

    Raises:
        UnknownName: the hand has no such finger.
        InvalidInput: another shape.
    """
    q = arrays.check_array(q, "q", (None, hand.n))
    tree = hand.tree()
    links, tips = tree.links, {tip.finger: tip.link for tip in tree.tips}
    own = _own_links(tree, tips[hand.finger(finger).name])
    axes = _axes(links, hand.T @ hand.neutral + hand.q0)[own]
    flexion = np.abs(axes @ axes[-1]) >= _PARALLEL
    full = q @ hand.T.T + hand.q0  # (T, n_full), positions of all joints
    angles = np.zeros((len(q), 4))
    bending = [link for link, bends in zip(own, flexion, strict=True) if bends]
    for link, bends in zip(own, flexion, strict=True):
        if not bends:
            angles[:, _SIDEWAYS] += full[:, link]
            continue
        sign = 1.0 if links[link].upper >= -links[link].lower else -1.0
        place = _DISTAL if link == bending[-1] else _METACARPAL if link == bending[0] else _PROXIMAL
        angles[:, place] += sign * full[:, link]
    return freeze(angles)


def _own_links(tree: KinematicTree, tip: int) -> list[int]:
    """Return the links from the hand's base to a tip's link that carry no other fingertip."""
    chains = {each.link: _chain(tree.links, each.link) for each in tree.tips}
    others = {link for end, chain in chains.items() if end != tip for link in chain}
    return [link for link in chains[tip] if link not in others]


def _chain(links: Sequence[Link], link: int) -> list[int]:
    """Return the links from the hand's base to a link."""
    return [] if link < 0 else [*_chain(links, links[link].parent), link]


def _axes(links: Sequence[Link], positions: Array) -> Array:
    """Return the axes of all joints in H at positions (n_full,), (n_full, 3)."""
    R: list[Array] = []
    for link, x in zip(links, positions, strict=True):
        before = np.eye(3) if link.parent < 0 else R[link.parent]
        R.append(before @ link.R_PL @ (np.eye(3) if link.is_prismatic else rotation_exp(link.axis * x)))
    return np.array([turn @ link.axis for turn, link in zip(R, links, strict=True)])
