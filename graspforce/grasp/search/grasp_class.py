"""Grasp classes: which fingers touch, and which of them oppose the thumb.

Pinch, tripod and quadpod state the number of fingers. The other names are those of the HANDLE project, Parameterizing and
creating new actions (undated), section 3.2, as far as fingertips make all contacts. Their contact places are assumed, from the
name and the pictures of each class.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from enum import Enum

from graspforce.core.errors import InvalidInput
from graspforce.geometry import Cylinder, Solid
from graspforce.hand.hand import Hand

_FIRST_NAMES = ("index", "first", "fore")


class GraspClass(Enum):
    """A class of grasps. `find_grasp` finds those of fingertips, and `find_link_grasp` power and lateral."""

    PINCH = "pinch"  # two fingers with soft contacts, one of them the thumb
    TRIPOD = "tripod"  # thumb and two fingers
    QUADPOD = "quadpod"  # thumb and three fingers
    TIP_PINCH = "tip-pinch"  # thumb and index finger with soft contacts, opposed
    PALMAR_PINCH = "palmar-pinch"  # thumb, opposed by two neighbouring fingers
    LATERAL_TRIPOD = "lateral-tripod"  # thumb, opposed by the index finger; a neighbour carries from another side
    WRITING_TRIPOD = "writing-tripod"  # thumb, index finger and its neighbour on the side of a cylinder
    ADDUCTION_GRIP = "adduction-grip"  # two neighbouring fingers with soft contacts, without the thumb
    PARALLEL_EXTENSION = "parallel-extension"  # thumb, opposed by three neighbouring fingers
    POWER = "power"  # palm, inner links and tips of all fingers
    LATERAL = "lateral"  # thumb against the side of the index finger


ENVELOPING_CLASSES = (GraspClass.POWER.value, GraspClass.LATERAL.value)  # names of classes with contacts beside the tips


@dataclass(frozen=True, slots=True)
class _Rule:
    """The fingers of a class.

    Attributes:
        size: number of fingers.
        has_thumb: whether the thumb is one of them.
        is_neighbours: whether the fingers beside the thumb are neighbours.
        has_first: whether the index finger is one of them.
        opposing: number of fingers that oppose the thumb.
    """

    size: int
    has_thumb: bool = True
    is_neighbours: bool = False
    has_first: bool = False
    opposing: int = 0


_RULES = {
    GraspClass.PINCH: _Rule(2),
    GraspClass.TRIPOD: _Rule(3),
    GraspClass.QUADPOD: _Rule(4),
    GraspClass.TIP_PINCH: _Rule(2, has_first=True, opposing=1),
    GraspClass.PALMAR_PINCH: _Rule(3, is_neighbours=True, opposing=2),
    GraspClass.LATERAL_TRIPOD: _Rule(3, is_neighbours=True, has_first=True, opposing=1),
    GraspClass.WRITING_TRIPOD: _Rule(3, is_neighbours=True, has_first=True),
    GraspClass.ADDUCTION_GRIP: _Rule(2, has_thumb=False, is_neighbours=True),
    GraspClass.PARALLEL_EXTENSION: _Rule(4, is_neighbours=True, opposing=3),
}


def class_finger_sets(hand: Hand, grasp_class: GraspClass, shape: Solid) -> list[tuple[int, ...]]:
    """Return the sets of fingers of a class, by indices; the thumb first.

    On a hand without a thumb, any finger counts as the thumb, and any fingers as neighbours.

    Args:
        hand: the hand.
        grasp_class: the class.
        shape: surface of the object.

    Raises:
        InvalidInput: the hand has too few fingers for the class, or the class does not apply to the shape.
    """
    if grasp_class not in _RULES:
        raise InvalidInput("grasp_class", grasp_class.value, "a class of fingertips; find_link_grasp finds this one")
    rule, names = _RULES[grasp_class], [finger.name.lower() for finger in hand.fingers]
    if grasp_class is GraspClass.WRITING_TRIPOD and not isinstance(shape, Cylinder):
        kind = type(shape).__name__.lower()
        raise InvalidInput("grasp_class", grasp_class.value, f"another class for a {kind}: this one is for cylinders")
    thumbs = [i for i, name in enumerate(names) if "thumb" in name]
    fingers = [i for i in range(len(names)) if i not in thumbs]
    first = next((i for i in fingers if any(each in names[i] for each in _FIRST_NAMES)), None)
    sets: list[tuple[int, ...]] = []
    if not rule.has_thumb:
        sets = list(itertools.pairwise(fingers)) if thumbs else list(itertools.combinations(fingers, rule.size))
    elif thumbs:
        several = itertools.combinations(fingers, rule.size - 1)
        sets = [(thumbs[0], *each) for each in several if not rule.is_neighbours or each[-1] - each[0] == len(each) - 1]
        if rule.has_first and first is not None:
            sets = [each for each in sets if each[1] == first] or [each for each in sets if first in each]
    else:
        for each in itertools.combinations(fingers, rule.size):
            sets += [(one, *(i for i in each if i != one)) for one in each] if rule.opposing else [each]
    if not sets:
        raise InvalidInput("grasp_class", grasp_class.value, f"a class for the {len(names)} fingers of {hand.name}")
    return sets


def opposing_fingers(grasp_class: GraspClass | None) -> int:
    """Return the number of fingers that oppose the thumb in a class: those after the thumb in its sets.

    Args:
        grasp_class: the class; None for any grasp.
    """
    return _RULES[grasp_class].opposing if grasp_class in _RULES else 0
