"""A control stream on the network: its states in, its commands out, on a thread of its own.

Zenoh stores the newest states in a ring. If states arrive faster than they are processed, only the newest is used: the newest
genuine one of this opening of the stream. No client can therefore delay another, however fast or slow it is.

Beside the commands, some states and their commands are published as samples for views, after the command has been sent. Copies
of all messages would cost the server and the view as much processor time as the control step.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable

import zenoh
from zenoh.handlers import RingChannel

from graspforce.service.realtime_scheduling import schedule_thread
from graspforce.service.recording.exchange import STATE, recorded
from graspforce.service.recording.recorder import Recorder
from graspforce.service.server.server_stream import ServerStream
from graspforce.service.server.stream_priorities import StreamPriority
from graspforce.service.wire import protocol
from graspforce.service.wire.reply import Reply, make_error_reply
from graspforce.service.zenoh_session import MSGPACK_ENCODING, describe_zenoh_error, read_encoding

log = logging.getLogger("graspforce.service")

_RING_SIZE = 16  # states; forged ones fill the ring beside the genuine one
_CLOSE_TIMEOUT = 0.2  # s, for the command in progress


class StreamChannel:
    """The thread of a control stream, its subscriber to states and its publisher of commands.

    Args:
        session: an open session.
        stream: the stream.
        may_answer: whether the server may still answer states, checked before each command
            (`graspforce.service.server.process_lease`).
        recorder: records the states and commands; None for none.
        priority: real-time priority of the thread; None for the scheduling of the thread which makes the channel.
    """

    def __init__(
        self,
        session: zenoh.Session,
        stream: ServerStream,
        may_answer: Callable[[], bool] = lambda: True,
        recorder: Recorder | None = None,
        *,
        priority: StreamPriority | None = None,
    ) -> None:
        key = f"{protocol.PREFIX}/streams/{stream.id}"
        self._stream, self._may_answer, self._recorder, self._priority = stream, may_answer, recorder, priority
        self._commands = session.declare_publisher(f"{key}/command", congestion_control=zenoh.CongestionControl.DROP)
        self._samples = _Samples(session, f"{key}/{protocol.SAMPLED}")
        self._states = session.declare_subscriber(f"{key}/state", RingChannel(1 if stream.key is None else _RING_SIZE))
        self._handler = self._states.handler  # here: `close` in another thread blocks this attribute for a moment
        self._thread = threading.Thread(target=self._run, name=f"stream-{stream.id}", daemon=True)
        self._thread.start()

    def close(self, is_server_closing: bool = False) -> None:
        """Accept no more states, and wait for the command in progress.

        Args:
            is_server_closing: publish the error record ``closing`` as the last message, so that the client opens the stream at
                another server.
        """
        self._states.undeclare()
        self._thread.join(_CLOSE_TIMEOUT)
        if is_server_closing:
            self._put(make_error_reply(protocol.JSON, "closing", protocol.CLOSING_MESSAGE, None, None))
        self._commands.undeclare()
        self._samples.close()

    def _run(self) -> None:
        """Publish a command for each newest state until the channel is closed."""
        schedule_thread(None if self._priority is None else self._priority.present)
        command = self._stream.command
        while True:
            try:
                sample = self._receive_genuine()
            except zenoh.ZError:  # closed
                return
            if sample is None:
                continue
            payload, encoding, received = *sample, time.perf_counter()
            reply = command(payload, encoding, received)
            if self._may_answer():
                self._put(reply)
                self._samples.offer((payload, encoding), reply, received)
            if self._recorder is not None:
                self._recorder.offer(recorded(STATE, self._stream.id, received, (payload, encoding), reply))

    def _receive_genuine(self) -> tuple[bytes, str] | None:
        """Wait for states, and return payload and encoding of the newest genuine one, or None.

        Raises:
            zenoh.ZError: the channel is closed.
        """
        handler, priority, newest = self._handler, self._priority, None
        sample: zenoh.Sample | None = handler.recv()
        while sample is not None:
            if priority is not None and priority.count_state(time.perf_counter()):
                schedule_thread(priority.present)
            payload, attachment = sample.payload.to_bytes(), sample.attachment
            if self._stream.accepts(payload, b"" if attachment is None else attachment.to_bytes()):
                newest = payload, read_encoding(sample.encoding)
            sample = handler.try_recv()
        return newest

    def _put(self, reply: Reply) -> None:
        """Publish a command or an error record."""
        try:
            self._commands.put(
                reply.payload, encoding=_zenoh_encoding(reply.encoding), attachment=self._stream.sign(reply.payload)
            )
        except zenoh.ZError as error:
            log.warning("cannot send a command of stream %s: %s", self._stream.id, describe_zenoh_error(error))


class _Samples:
    """Publishers of sampled states and commands, at most `protocol.SAMPLE_RATE` a second.

    Args:
        session: an open session.
        key: key of the samples.
    """

    def __init__(self, session: zenoh.Session, key: str) -> None:
        self._publishers = [
            session.declare_publisher(
                f"{key}/{name}", congestion_control=zenoh.CongestionControl.DROP, priority=zenoh.Priority.DATA_LOW
            )
            for name in ("state", "command")
        ]
        self._next = -math.inf  # s, on the clock `time.perf_counter`

    def offer(self, state: tuple[bytes, str], reply: Reply, now: float) -> None:
        """Publish a state and its command if a sample is due.

        Args:
            state: payload and encoding of the state.
            reply: its command.
            now: when the state arrived, on the clock `time.perf_counter`, s.
        """
        if now < self._next or not reply.ok:
            return
        self._next = max(self._next + 1.0 / protocol.SAMPLE_RATE, now)  # without drift; missed samples are skipped
        try:
            for publisher, (payload, encoding) in zip(self._publishers, (state, (reply.payload, reply.encoding)), strict=True):
                publisher.put(payload, encoding=_zenoh_encoding(encoding))
        except zenoh.ZError as error:
            log.warning("cannot send a sample of a stream: %s", describe_zenoh_error(error))

    def close(self) -> None:
        """Publish no more."""
        for publisher in self._publishers:
            publisher.undeclare()


def _zenoh_encoding(encoding: str) -> zenoh.Encoding | str:
    """Return an encoding as Zenoh takes it fastest."""
    return MSGPACK_ENCODING if encoding == protocol.MSGPACK else encoding
