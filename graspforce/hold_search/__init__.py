"""Finding a grasp: where the fingers of a hand can hold an object, and how they must stand."""

from graspforce.hold_search.search import find_hold
from graspforce.hold_search.travel import Way, ways_of

__all__ = ["Way", "find_hold", "ways_of"]
