"""Search for grasps: where the fingers of a hand touch an object, and in which posture."""

from graspforce.grasp.search.enveloping import find_link_grasp
from graspforce.grasp.search.grasp_class import GraspClass
from graspforce.grasp.search.idle_fingers import relax_idle_fingers
from graspforce.grasp.search.options import GraspSearchCallback, GraspSearchOptions, GraspSearchProgress
from graspforce.grasp.search.prior import PosturePrior
from graspforce.grasp.search.search import find_grasp
from graspforce.grasp.search.several import GraspMeasures, GraspRank, RankedGrasp, find_grasps, measure_grasp
from graspforce.grasp.search.travel import TravelLimit, travel_limits

__all__ = [
    "GraspClass",
    "GraspMeasures",
    "GraspRank",
    "GraspSearchCallback",
    "GraspSearchOptions",
    "GraspSearchProgress",
    "PosturePrior",
    "RankedGrasp",
    "TravelLimit",
    "find_grasp",
    "find_grasps",
    "find_link_grasp",
    "measure_grasp",
    "relax_idle_fingers",
    "travel_limits",
]
