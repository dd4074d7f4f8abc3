"""Messages to the service manager systemd: ready, alive, stopping (protocol of ``sd_notify``).

Without the variable ``NOTIFY_SOCKET``, that is outside of a unit with ``Type=notify``, nothing is sent.
"""

from __future__ import annotations

import logging
import os
import socket
import time

log = logging.getLogger("graspforce.service")

_WATCHDOG_FRACTION = 0.3  # of the watchdog's time between two messages


class ServiceManager:
    """The service manager of this process."""

    def __init__(self) -> None:
        self._address = os.environ.get("NOTIFY_SOCKET", "")
        if self._address.startswith("@"):
            self._address = "\0" + self._address[1:]  # an abstract socket of Linux
        microseconds = os.environ.get("WATCHDOG_USEC", "")
        is_own = os.environ.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        self._period = int(microseconds) * 1e-6 * _WATCHDOG_FRACTION if microseconds.isdecimal() and is_own else None  # s
        self._last_alive = -float("inf")

    def ready(self, text: str) -> None:
        """Tell that the server serves.

        Args:
            text: status line of the unit.
        """
        self._send("READY=1", f"STATUS={text}")

    def stopping(self) -> None:
        """Tell that the server ends."""
        self._send("STOPPING=1")

    def is_alive_due(self) -> bool:
        """Return whether the watchdog waits for the next `alive`."""
        return self._period is not None and time.monotonic() - self._last_alive >= self._period

    def alive(self) -> None:
        """Reset the watchdog. Without this call the manager ends and restarts the process."""
        self._last_alive = time.monotonic()
        self._send("WATCHDOG=1")

    def _send(self, *lines: str) -> None:
        """Send a message, if there is a manager."""
        if not self._address:
            return
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as channel:
                channel.connect(self._address)
                channel.send("\n".join(lines).encode())
        except OSError as error:
            log.warning("cannot reach the service manager: %s", error)
