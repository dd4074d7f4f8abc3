"""The command ``graspforce view`` without a file: show a running stream in a web browser, as a monitor of the service."""

from __future__ import annotations

import gc
import os
import time
import webbrowser
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from rich.console import Console

from graspforce.browser import StreamView, ViewAddress
from graspforce.cli.interruption import Interruption
from graspforce.cli.json_output import put_result
from graspforce.cli.running_streams import is_stream_open, load_named
from graspforce.cli.shown_streams import shown_stream
from graspforce.core.printable import escape_controls
from graspforce.service import Client
from graspforce.service.client.stream_monitor import StreamMonitor

_RATE = 30.0  # pictures per second
_SILENCE = 1.0  # s without states, after which to ask whether the stream is open
_WAIT = 0.5  # s, between two questions for an open stream
_SHOWN_CHARACTERS = 8  # of the stream's id
_NICENESS = 5  # of this process: streams have priority if processors are short
_TIMEOUT = 5.0  # s, for answers of the service


@dataclass(frozen=True, slots=True)
class StreamViewOptions:
    """The stream that the command's options describe.

    Args:
        connect: Zenoh endpoint of the service; None for the default.
        stream: id of the stream; None for the first one that is open, and the next one after its end.
        hands: names or description files of hands that replace shipped ones.
        address: where the page is served.
        opens_page: whether to open the page in the default browser.
        secure: directory with certificates; None without TLS.
    """

    connect: str | None
    stream: str | None
    hands: Sequence[str]
    address: ViewAddress
    opens_page: bool = False
    secure: str | os.PathLike[str] | None = None


def run(options: StreamViewOptions, console: Console, duration: float = np.inf) -> None:
    """Show streams, one after another, until Ctrl-C. A named stream is shown until it ends.

    Args:
        options: the service and its stream.
        console: shows the addresses.
        duration: time after which this ends, s.

    Raises:
        ServiceError: no service, or the named stream is not open.
        InvalidInput: the named stream cannot be shown.
        MissingLibrary: viser is not installed.
    """
    role = {} if options.secure is None else {"secure": options.secure, "name": "monitor"}
    if hasattr(os, "nice"):
        os.nice(_NICENESS)
    end, opens_page = time.monotonic() + duration, options.opens_page
    with Client(options.connect, timeout=_TIMEOUT, **role) as client, Interruption() as interruption:  # type: ignore[arg-type]
        if options.stream is None and not client.status().active_streams:
            console.print("Waiting for a stream.")

        def goes_on() -> bool:
            return not interruption.is_requested and time.monotonic() < end

        while goes_on():
            if options.stream is None and not client.status().active_streams:
                time.sleep(_WAIT)
                continue
            id = options.stream or client.status().active_streams[0].id
            shown = _Shown(client, id, options)
            try:
                console.print(f"View of stream {escape_controls(id)}: {shown.view.url}", soft_wrap=True, markup=False)
                put_result(console, {"url": shown.view.url, "stream": id})
                if opens_page:
                    webbrowser.open(shown.view.url)
                    opens_page = False
                while goes_on() and shown.advance():
                    pass
            finally:
                shown.close()
            if options.stream is not None:
                return


class _Shown:
    """A stream that is shown."""

    def __init__(self, client: Client, id: str, options: StreamViewOptions) -> None:
        self._client = client
        self._monitor: StreamMonitor = client.monitor_stream(id, sampled=True)
        setup = self._monitor.read_any_setup(load_named(options.hands, self._monitor.hand_name))
        self._stream = shown_stream(setup)
        client_name, _, own = id.rpartition("/")
        short = own if len(own) <= _SHOWN_CHARACTERS else f"{own[:_SHOWN_CHARACTERS]}…"
        title = f"{setup.hand.name}, stream {escape_controls(f'{client_name}/{short}' if client_name else short)}"
        self.view = StreamView(self._stream.display, title, self._stream.charts, options.address)
        self._last, self._start = time.monotonic(), np.nan
        self._due = self._last  # when the next picture is due
        gc.freeze()  # collections then pass over what does not change: a tenth of a second each

    def advance(self) -> bool:
        """Show the newest step, wait until the next picture is due, and return whether the stream is open."""
        now = time.monotonic()
        step = self._monitor.take_newest()
        if step is not None:
            self._last = now
            self._start = step.state.time if np.isnan(self._start) else self._start
            self.view.show(*self._stream.show(step, self._start))
        elif now - self._last > _SILENCE:
            self._last = now
            if not is_stream_open(self._client, self._monitor.id):
                return False
            self.view.note("no states")
        self.view.update()
        self._due = max(self._due + 1.0 / _RATE, now)  # without drift; missed pictures are skipped
        time.sleep(max(self._due - time.monotonic(), 0.0))
        return True

    def close(self) -> None:
        """Close the page."""
        self._monitor.close()
        self.view.close()
