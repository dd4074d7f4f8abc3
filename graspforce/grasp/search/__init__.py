"""Search for grasps: where the fingers of a hand touch an object, and in which posture."""

from graspforce.grasp.search.idle_fingers import relax_idle_fingers
from graspforce.grasp.search.options import GraspSearchCallback, GraspSearchOptions, GraspSearchProgress
from graspforce.grasp.search.search import find_grasp
from graspforce.grasp.search.travel import TravelLimit, travel_limits

__all__ = [
    "GraspSearchCallback",
    "GraspSearchOptions",
    "GraspSearchProgress",
    "TravelLimit",
    "find_grasp",
    "relax_idle_fingers",
    "travel_limits",
]
