"""Power grasps with contacts on inner links and the palm, found once."""

from __future__ import annotations

from functools import cache

import graspforce as gf
from graspforce.geometry import Sphere
from graspforce.grasp.link_grasp import LinkGrasp
from graspforce.grasp.search import find_link_grasp
from support.hands import load


@cache
def power_grasp(hand_name: str) -> LinkGrasp:
    """Return a power grasp of a ball of 50 g and 60 mm, with a friction of 0.6."""
    return find_link_grasp(load(hand_name), gf.Body.solid(Sphere(0.03), 0.05), "power", friction=0.6)
