"""Finding a grasp: where the fingers of a hand can hold an object, and how they must stand."""

from graspforce.hold_search.search import find_hold

__all__ = ["find_hold"]
