"""Queries from the network: each is put into the queue of its class, on Zenoh's receiving thread, which never waits."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import zenoh
from zenoh.handlers import Callback

from graspforce.service.server.client_sessions import ClientSessions
from graspforce.service.server.limits import ServerLimits
from graspforce.service.server.work_queues import (
    QUERY_BYTES,
    CancelRequest,
    CostClass,
    QueuedQuery,
    WorkQueues,
    cost_class,
)
from graspforce.service.wire import protocol
from graspforce.service.wire.schemas.catalogue import SCHEMA

_STREAM_KEYS = ("streams/*", "streams/*/*", "setups/*", "setups/*/*")


class QueryIntake:
    """Queryables and subscribers of a server. Its methods do not call Zenoh, apart from `declare`.

    Args:
        queues: queues of the queries.
        sessions: the clients.
        limits: limits on requests.
        keys: served keys after the prefix, without those of streams and schemas.
        is_waking: whether queries may be old, because the process was frozen; those for streams then get no answer.
    """

    def __init__(
        self,
        queues: WorkQueues,
        sessions: ClientSessions,
        limits: ServerLimits,
        keys: Sequence[str],
        is_waking: Callable[[], bool],
    ) -> None:
        self._queues, self._sessions, self._limits, self._is_waking = queues, sessions, limits, is_waking
        self._keys = tuple(keys)
        self._full_keys = frozenset(f"{protocol.PREFIX}/{key}" for key in self._keys)
        known = (*self._keys, f"{SCHEMA}/**", *_STREAM_KEYS)
        self._known_keys = [zenoh.KeyExpr(f"{protocol.PREFIX}/{key}") for key in known]

    def declare(self, session: zenoh.Session) -> list[Any]:
        """Declare queryables and subscribers, and return them.

        Args:
            session: an open session.
        """

        def declare(key: str, on_query: Callable[[zenoh.Query], None], complete: bool = True) -> zenoh.Queryable[None]:
            # Of several servers with a complete queryable for a key, Zenoh asks one. Incomplete ones are a fallback.
            callback = Callback(on_query, indirect=False)
            return session.declare_queryable(f"{protocol.PREFIX}/{key}", callback, complete=complete)

        declared: list[Any] = []
        for key in self._keys:
            declared.append(declare(key, partial(self.receive, key)))
        unknown = Callback(self._receive_unknown, indirect=False)
        declared.append(session.declare_queryable(f"{protocol.NAMESPACE}/**", unknown, complete=False))
        declared += [declare(key, self._receive_stream_request) for key in _STREAM_KEYS]
        declared.append(declare(f"{SCHEMA}/**", self._receive_schema_query))
        cancel = Callback(self._receive_cancel, indirect=False)
        declared.append(session.declare_subscriber(f"{protocol.PREFIX}/plans/**/cancel", cancel))
        liveliness = Callback(self._receive_asker_liveliness, indirect=False)
        declared.append(session.liveliness().declare_subscriber(f"{protocol.PREFIX}/plans/**/asker", liveliness))
        return declared

    def receive(self, key: str, query: zenoh.Query, cost: CostClass | None = None) -> None:
        """Put a query into the queue of its class, or into the refusal queue.

        Args:
            key: its key after the prefix.
            query: the query.
            cost: its class; by default that of its key and size.
        """
        attachment, size = query.attachment, len(query.payload or b"")
        client = self._sessions.identify(b"" if attachment is None else attachment.to_bytes())
        cost = cost or cost_class(key, size)
        item = QueuedQuery(key, query, time.perf_counter(), client, cost, QUERY_BYTES + size)
        if size > self._limits.payload:
            self._queues.refuse(item)
        else:
            self._queues.offer(item)

    def _receive_unknown(self, query: zenoh.Query) -> None:
        """Put a query that no other queryable answers into the status queue: an unknown key, hand or version."""
        asked, known = query.key_expr, self._known_keys
        text = str(asked)
        if text in self._full_keys:  # most queries: Zenoh calls this function for each of them, too
            return
        key = text.removeprefix(f"{protocol.PREFIX}/")
        is_own = key.startswith(("streams/", "setups/", SCHEMA)) and any(each.intersects(asked) for each in known[-5:])
        if is_own:
            return
        if "*" not in key or not any(each.intersects(asked) for each in known):
            self.receive(key, query, CostClass.STATUS)

    def _receive_stream_request(self, query: zenoh.Query) -> None:
        """Put a query that opens or closes a stream, or asks for its setup, into its queue."""
        key = str(query.key_expr).removeprefix(f"{protocol.PREFIX}/")
        if "*" not in key and not self._is_waking():
            self.receive(key, query)

    def _receive_schema_query(self, query: zenoh.Query) -> None:
        """Put a query for schemas into the status queue."""
        key = str(query.key_expr).removeprefix(f"{protocol.PREFIX}/")
        if key.startswith(SCHEMA):
            self.receive(key, query)

    def _receive_cancel(self, sample: zenoh.Sample) -> None:
        """Put the cancellation of a plan into the plan queue."""
        id = str(sample.key_expr).removeprefix(f"{protocol.PREFIX}/plans/").rpartition("/")[0]
        self._queues.plans.offer(CancelRequest(id))

    def _receive_asker_liveliness(self, sample: zenoh.Sample) -> None:
        """Cancel the plan of a client that has disconnected."""
        if sample.kind == zenoh.SampleKind.DELETE:
            self._receive_cancel(sample)
