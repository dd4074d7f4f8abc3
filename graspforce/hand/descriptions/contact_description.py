"""Pairs of links that may touch, in a hand's description file."""

from __future__ import annotations

from fnmatch import fnmatchcase

import msgspec

HELD_OBJECT = "object"  # name of the held object in pairs


class AllowedContact(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Links that may touch, such as a finger that rests against the palm. Neighbours in the chain may always touch.

    Attributes:
        links: two shell patterns of URDF link names, such as ``*_proximal``; "object" stands for the held object.
        source: why they may touch.
    """

    links: tuple[str, str]
    source: str

    def covers(self, first: str, second: str) -> bool:
        """Return whether the patterns match two names, in any order.

        Args:
            first: name of a URDF link, or "object".
            second: name of the other.
        """
        one, other = self.links
        return any(fnmatchcase(a, one) and fnmatchcase(b, other) for a, b in ((first, second), (second, first)))
