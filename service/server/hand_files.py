"""Description files of the served hands, which are read again when they change."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Sequence
from pathlib import Path

from graspforce.core.errors import GraspForceError
from graspforce.hand.hand import Hand

log = logging.getLogger("graspforce.service")


class HandFiles:
    """The files of hands, and when they were changed.

    Args:
        hands: as in `Server`; only paths of files are watched.
        on_change: called with each changed hand.
    """

    def __init__(self, hands: Sequence[str | os.PathLike[str] | Hand], on_change: Callable[[Hand], None]) -> None:
        self._on_change = on_change
        paths = [Path(hand) for hand in hands if not isinstance(hand, Hand)]
        self._changed = {path: _time_of(path) for path in paths if path.is_file()}

    def check(self) -> None:
        """Load the files that have changed. An invalid one is logged, and the hand stays as it was."""
        for path, known in self._changed.items():
            changed = _time_of(path)
            if changed in (known, None):
                continue
            self._changed[path] = changed
            try:
                hand = Hand.load(path)
                self._on_change(hand)
            except (GraspForceError, OSError) as error:
                log.error("%s has changed, but the hand stays as it was: %s", path, error)
            else:
                log.warning("%s has changed: new requests and streams use it", path)


def _time_of(path: Path) -> int | None:
    """Return when a file was changed, ns; None if it cannot be read."""
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return None
