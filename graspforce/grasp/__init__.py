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
    from graspforce.grasp.posture_files import RecordedPosture, load_postures
    from graspforce.grasp.posture_repair import PostureOptions
    from graspforce.grasp.search import (
        GraspClass,
        GraspMeasures,
        GraspRank,
        GraspSearchOptions,
        RankedGrasp,
        TravelLimit,
        find_grasp,
        find_grasps,
        find_link_grasp,
        measure_grasp,
        relax_idle_fingers,
        travel_limits,
    )

__all__ = [
    "Body",
    "Grasp",
    "GraspClass",
    "GraspMeasures",
    "GraspRank",
    "GraspSearchOptions",
    "LinkGrasp",
    "PostureOptions",
    "RankedGrasp",
    "RecordedPosture",
    "TravelLimit",
    "find_grasp",
    "find_grasps",
    "find_link_grasp",
    "load_postures",
    "measure_grasp",
    "relax_idle_fingers",
    "travel_limits",
]

__getattr__ = lazy_exports(
    __name__,
    {
        "Body": "graspforce.grasp.body",
        "Grasp": "graspforce.grasp.grasp",
        "GraspClass": "graspforce.grasp.search",
        "GraspMeasures": "graspforce.grasp.search",
        "GraspRank": "graspforce.grasp.search",
        "GraspSearchOptions": "graspforce.grasp.search",
        "LinkGrasp": "graspforce.grasp.link_grasp",
        "PostureOptions": "graspforce.grasp.posture_repair",
        "RecordedPosture": "graspforce.grasp.posture_files",
        "RankedGrasp": "graspforce.grasp.search",
        "TravelLimit": "graspforce.grasp.search",
        "find_grasp": "graspforce.grasp.search",
        "find_grasps": "graspforce.grasp.search",
        "find_link_grasp": "graspforce.grasp.search",
        "load_postures": "graspforce.grasp.posture_files",
        "measure_grasp": "graspforce.grasp.search",
        "relax_idle_fingers": "graspforce.grasp.search",
        "travel_limits": "graspforce.grasp.search",
    },
)
