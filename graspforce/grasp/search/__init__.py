"""Finding a grasp: where the fingers of a hand can hold an object, and how they must stand."""

from graspforce.grasp.search.search import find_grasp
from graspforce.grasp.search.travel import TravelLimit, travel_limits

__all__ = ["TravelLimit", "find_grasp", "travel_limits"]
