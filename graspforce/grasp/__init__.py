"""Grasps: the held body, a hand with the contacts of its fingers, and the search for a grasp.

The names below load Pinocchio, and the search loads a solver, at first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from graspforce.core.lazy import lazy_exports

if TYPE_CHECKING:
    from graspforce.grasp.body import Body
    from graspforce.grasp.grasp import Grasp
    from graspforce.grasp.link_grasp import LinkGrasp
    from graspforce.grasp.search import GraspSearchOptions, TravelLimit, find_grasp, relax_idle_fingers, travel_limits

__all__ = [
    "Body",
    "Grasp",
    "GraspSearchOptions",
    "LinkGrasp",
    "TravelLimit",
    "find_grasp",
    "relax_idle_fingers",
    "travel_limits",
]

__getattr__ = lazy_exports(
    __name__,
    {
        "Body": "graspforce.grasp.body",
        "Grasp": "graspforce.grasp.grasp",
        "GraspSearchOptions": "graspforce.grasp.search",
        "LinkGrasp": "graspforce.grasp.link_grasp",
        "TravelLimit": "graspforce.grasp.search",
        "find_grasp": "graspforce.grasp.search",
        "relax_idle_fingers": "graspforce.grasp.search",
        "travel_limits": "graspforce.grasp.search",
    },
)
