"""Values that the shell completes: names of hands, objects, solvers, cases and collections.

Each function takes the beginning of a word and returns the names with that beginning. The shell calls them while somebody
types, so they read names only.
"""

from __future__ import annotations


def complete_hand(incomplete: str) -> list[str]:
    """Return the hands that ship.

    Args:
        incomplete: begin of the name.
    """
    from graspforce.hand.descriptions.description import shipped_hands

    return _beginning(shipped_hands(), incomplete)


def complete_object(incomplete: str) -> list[str]:
    """Return the named objects, and the beginnings of shapes.

    Args:
        incomplete: begin of the name.
    """
    from graspforce.problems import objects

    return _beginning(
        [*(each.name for each in objects.ist_objects()), "sphere:", "cylinder:", "box:", "superquadric:", "mesh:"], incomplete
    )


def complete_backend(incomplete: str) -> list[str]:
    """Return the installed solvers.

    Args:
        incomplete: begin of the name.
    """
    from graspforce.force.backends.registry import available_backends

    return _beginning(available_backends(), incomplete)


def complete_case(incomplete: str) -> list[str]:
    """Return the cases of the problem library.

    Args:
        incomplete: begin of the name.
    """
    from graspforce import problems

    return _beginning(problems.names(), incomplete)


def complete_collection(incomplete: str) -> list[str]:
    """Return the collections of the problem library.

    Args:
        incomplete: begin of the name.
    """
    from graspforce import problems

    return _beginning(sorted({name.partition("/")[0] for name in problems.names()}), incomplete)


def _beginning(names: list[str] | tuple[str, ...], incomplete: str) -> list[str]:
    """Return the names with a beginning."""
    return [name for name in names if name.startswith(incomplete)]
