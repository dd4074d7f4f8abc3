"""Requests of a client: each is sent as a query, and gets the first answer, or an exception that explains why there is none."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterable, Iterator, Mapping

import zenoh
from zenoh.handlers import RingChannel

from graspforce.core import arrays
from graspforce.core.errors import RequestRefused, ServiceError
from graspforce.core.json_text import JsonRecord
from graspforce.planning import ProgressCallback
from graspforce.service.client.replies import read_replies, report_progress
from graspforce.service.client.server_presence import ServerPresence
from graspforce.service.wire import protocol
from graspforce.service.wire.protocol import Envelope
from graspforce.service.zenoh_session import MAX_MESSAGE_BYTES, describe_zenoh_error

_REOPEN_TIMEOUT = 0.5  # s, of an attempt to open a stream again: the lease of a replica
_PLAN_TRANSFER_TIME = 5.0  # s beyond the budget for the answer, which has some hundred kilobytes


class Requests:
    """Sender of a client's requests. Thread-safe.

    Args:
        session: an open session.
        presence: the servers that are alive.
        codec: encoding of the requests.
        timeout: default time to wait for an answer, s.
    """

    def __init__(self, session: zenoh.Session, presence: ServerPresence, codec: str, timeout: float) -> None:
        self._session, self._presence, self._codec, self._timeout = session, presence, codec, timeout
        self._sequence = itertools.count(1)

    def ask(
        self,
        key: str,
        record: Mapping[str, object],
        backend: str | None = None,
        budget: float | None = None,
        timeout: float | None = None,
    ) -> JsonRecord:
        """Return the answer to a request to any key; see `Client.query`.

        Args:
            key: key after the prefix.
            record: the request without its envelope.
            backend: name of the solver; None for the server's choice.
            budget: time in which the answer is useful, s; None for the timeout.
            timeout: time to wait for the answer, s; None for the default.
        """
        timeout = self._timeout if timeout is None else arrays.check_number(timeout, "timeout", above=0.0)
        if budget is not None:
            arrays.check_number(budget, "budget", above=0.0)
        sequence = next(self._sequence)

        def send(remaining: float) -> Iterable[zenoh.Reply]:
            envelope = Envelope(sequence, remaining if budget is None else min(budget, remaining), backend)
            return self._send_query(key, protocol.encode(envelope.wrap(record), self._codec), remaining)

        return self._first_answer(key, send, sequence, timeout)

    def ask_stream(self, key: str, record: JsonRecord) -> JsonRecord:
        """Open a stream at the nearest server, or close it or ask for its setup wherever it is, and return the answer.

        Args:
            key: key of the stream, or of its setup, after the prefix.
            record: the request without its envelope.
        """
        sequence = next(self._sequence)
        # The proofs of a repeated opening: its server may be frozen, and the next attempt reaches another one.
        is_repeated = "close" not in record and len(record.get("proof", ())) > 1
        timeout = min(self._timeout, _REOPEN_TIMEOUT) if is_repeated else self._timeout
        is_anywhere = "close" in record or key.startswith("setups/")
        target = zenoh.QueryTarget.ALL if is_anywhere else zenoh.QueryTarget.BEST_MATCHING

        def send(remaining: float) -> Iterable[zenoh.Reply]:
            payload = protocol.encode(Envelope(sequence, remaining).wrap(record), self._codec)
            return self._send_query(key, payload, remaining, target)

        return self._first_answer(key, send, sequence, timeout)

    def ask_job(
        self,
        key: str,
        record: JsonRecord,
        budget: float,
        cancel: Callable[[], None],
        callback: ProgressCallback | None = None,
    ) -> JsonRecord:
        """Send a request to a planning process and return its answer. The server stops the work if this call ends early.

        Args:
            key: key after the prefix.
            record: the request, with its id.
            budget: time for the work, s.
            cancel: function that stops the work.
            callback: called with the progress; may be None.
        """
        timeout = arrays.check_number(budget, "budget", above=0.0) + max(self._timeout, _PLAN_TRANSFER_TIME)
        sequence, job_key = next(self._sequence), f"{protocol.PREFIX}/plans/{record['id']}"
        token = self._session.liveliness().declare_token(f"{job_key}/asker")  # the server stops when it disappears
        try:
            samples = self._session.declare_subscriber(f"{job_key}/progress", RingChannel(1))

            def send(remaining: float) -> Iterable[zenoh.Reply]:
                envelope = Envelope(sequence, remaining / timeout * budget)
                replies = self._send_query(key, protocol.encode(envelope.wrap(record), self._codec), remaining)
                return report_progress(replies, samples, callback, cancel)

            try:
                return self._first_answer(key, send, sequence, timeout)
            finally:
                samples.undeclare()
        finally:
            token.undeclare()

    def _send_query(
        self, key: str, payload: bytes, timeout: float, target: zenoh.QueryTarget = zenoh.QueryTarget.BEST_MATCHING
    ) -> zenoh.Handler[zenoh.Reply]:
        """Send a query and return the channel of its replies.

        Raises:
            RequestRefused: the payload is too large.
            ServiceError: the client is closed, or the key is not allowed.
        """
        if len(payload) > MAX_MESSAGE_BYTES:  # the server's Zenoh would drop it without a reply
            message = f"the payload has {len(payload)} bytes: at most {MAX_MESSAGE_BYTES} are allowed"
            raise RequestRefused("too_large", message)
        try:
            return self._session.get(
                f"{protocol.PREFIX}/{key}",
                payload=payload,
                encoding=self._codec,
                attachment=str(self._session.zid()).encode(),  # the server schedules requests by session
                timeout=timeout,
                target=target,
                consolidation=zenoh.ConsolidationMode.NONE,  # deliver the first answer without waiting for further servers
            )
        except zenoh.ZError as error:
            raise ServiceError(f"cannot ask for {key}: {describe_zenoh_error(error)}") from None

    def _replies_of_servers(self, send: Callable[[float], Iterable[zenoh.Reply]], timeout: float) -> Iterator[zenoh.Reply]:
        """Send a query and yield the replies of servers; those of other sessions are dropped.

        Without a router, servers are connected directly. Behind a router any session may answer; only TLS prevents it. The
        sessions that are connected before the query count as well, because a server may reply and disconnect at once.
        """
        info = self._session.info
        had_router, peers = bool(info.routers_zid()), info.peers_zid()
        for reply in send(timeout):
            replier = reply.replier_id  # None for errors of Zenoh itself
            if replier is None or had_router or replier.zid in peers or info.routers_zid() or replier.zid in info.peers_zid():
                yield reply

    def _first_answer(
        self, key: str, send: Callable[[float], Iterable[zenoh.Reply]], sequence: int, timeout: float
    ) -> JsonRecord:
        """Return the first answer, or raise the exception that explains why there is none.

        Args:
            key: key of the query after the prefix, for messages.
            send: function that sends the query with a timeout in s, and returns its replies. It is called again, once, if there
                are none, or the server is closing: another one may answer.
            sequence: sequence number of the query.
            timeout: time for all answers, s.
        """
        deadline = time.monotonic() + timeout
        self._presence.note_request()
        answer = read_replies(self._replies_of_servers(send, timeout), sequence, timeout)
        if not isinstance(answer, dict) and self._presence.wait_for_replica(deadline):
            again = self._replies_of_servers(send, deadline - time.monotonic())
            answer = read_replies(again, sequence, timeout) or answer
        if not isinstance(answer, dict):
            raise answer or self._presence.explain_missing_answer(key)
        self._presence.note_answer()
        return answer
