"""Tips at any places of a hand, such as on inner links and on the palm: fingers that share joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.hand.hand import Hand
from graspforce.hand.kinematics.coordinates import Finger

_FRAME_PREFIX = "contact tip "  # of the tip frames of these fingers: no link of a URDF has such a name


@dataclass(frozen=True, eq=False, slots=True)
class ContactTip:
    """A spherical tip that is fixed to a link.

    Attributes:
        link: name of the URDF link.
        p_H: (3,) centre of the sphere in H in the given posture, m.
        radius: of the sphere, m.
        torsional_friction: torsional friction length γ of a soft pad, m; None for a hard surface.
    """

    link: str
    p_H: Array
    radius: float
    torsional_friction: float | None = None


def add_contact_tips(hand: Hand, tips: Sequence[ContactTip], q: Array) -> tuple[Hand, tuple[str, ...]]:
    """Return a hand with a further finger for each tip, and the names of these fingers.

    The fingers take the names of their links, with a number where a name is not unique. They share the joints of the hand, and
    one on the base has none. Files and services know the hand without these fingers.

    Args:
        hand: the hand.
        tips: the tips.
        q: (n,) posture in which the tips have their places, rad.
    """
    model, poses = hand.model, hand.link_poses(q)
    taken, names, fingers = {finger.name for finger in hand.fingers}, list[str](), list[Finger]()
    frames: dict[str, tuple[str, Array]] = {}
    links = [tip.link for tip in tips]
    for tip in tips:
        is_unique = links.count(tip.link) == 1 and tip.link not in taken
        numbers = (f"{tip.link} {k}" for k in range(1, len(tips) + len(taken) + 1))
        name = tip.link if is_unique else next(name for name in numbers if name not in taken)
        taken.add(name)
        names.append(name)
        p_HL, R_HL = poses[tip.link]
        frames[_FRAME_PREFIX + name] = (tip.link, R_HL.T @ (tip.p_H - p_HL))
        moving = hand.T[model.joints_moving(tip.link) > 0.0]
        joints = tuple(np.flatnonzero((moving != 0.0).any(axis=0)).tolist())
        fingers.append(Finger(name, joints, _FRAME_PREFIX + name, tip.radius, tip.torsional_friction))
    return replace(hand, fingers=(*hand.fingers, *fingers), model=model.with_frames(frames)), tuple(names)


def own_fingers(hand: Hand) -> tuple[Finger, ...]:
    """Return the fingers of a hand without those of `add_contact_tips`.

    Args:
        hand: the hand.
    """
    return tuple(finger for finger in hand.fingers if not finger.tip.startswith(_FRAME_PREFIX))


def has_contact_tips(hand: Hand, fingers: Sequence[str]) -> bool:
    """Return whether some of a hand's fingers are those of `add_contact_tips`.

    Args:
        hand: the hand.
        fingers: names of fingers.
    """
    return not set(fingers) <= {finger.name for finger in own_fingers(hand)}


def check_fingertips(hand: Hand, fingers: Sequence[str], user: str) -> None:
    """Check that all contacts are at the tips of the hand's own fingers.

    Args:
        hand: the hand.
        fingers: name of the finger at each contact.
        user: what needs them, for the message.

    Raises:
        InvalidInput: a finger is one of `add_contact_tips`.
    """
    if has_contact_tips(hand, fingers):
        allowed = f"tips of the fingers of {hand.name}: {user} take no contacts on inner links or the palm"
        raise InvalidInput("fingers", fingers, allowed)
