"""Attacks of a stranger on a stream, a plan and the replies of a server: `python -m benchmarks.strangers`.

A victim drives a stream through the Python client, whose streams are authenticated. A stranger at the same server tries each
attack many times: without TLS as any program in the network, with TLS as the owner of another controller's certificate. It
knows all keys, and without TLS it reads all messages.

An *effect* is a try that changes what the server or the victim does; the last column says how the victim sees it. *Counted*
are the tries that the server or the victim refused and counted, or answered with `forbidden`. With TLS, Zenoh's access control
drops the tries.

A server that clients connect to directly refuses queryables of other sessions and tokens of servers. Behind a router without
TLS any session may declare them: there, only TLS proves to a client which server answers.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import zenoh
from scipy.spatial.transform import Rotation
from zenoh.handlers import Callback, RingChannel

from benchmarks import report_page
from benchmarks.replicas import HAND, ball_grasp
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, GraspState
from graspforce.grasp.grasp import Grasp
from graspforce.planning import FreeMove, Move
from graspforce.planning.tracking import object_task
from graspforce.service import Client, Server
from graspforce.service.client.stream import Stream
from graspforce.service.security.directory import CONTROLLER, add_client, client_settings, init_directory
from graspforce.service.wire import protocol
from graspforce.service.zenoh_session import build_configuration

TRIES = 10_000
TIMEOUT = 20.0  # s
BURST = 8  # messages between two periods of the victim: fewer than a ring holds
FORGED_TORQUE = 99.0  # N·m
FORGED_SERVER = "rogue"
_SETTLE = 0.3  # s, for declarations and messages on their way
_WAIT_FOR_REPLY = 5.0  # s
_BEGIN, _PLAN_END = 1.0, 3.0  # s, until a plan has begun, and until a cancelled one has ended


@dataclass(frozen=True, slots=True)
class Row:
    """Outcome of an attack.

    Args:
        attack: its name.
        mode: "without TLS" or "with TLS".
        tries: number of tries.
        effects: tries that had an effect.
        counted: tries that were refused and counted.
        sign: how the victim sees the effect.
    """

    attack: str
    mode: str
    tries: int
    effects: int
    counted: int
    sign: str = "–"


class Scene:
    """A server, a victim with a stream, and a stranger.

    Args:
        stack: closes all at the end.
        directory: directory of certificates; None for no TLS.
    """

    def __init__(self, stack: contextlib.ExitStack, directory: Path | None) -> None:
        self.mode = "without TLS" if directory is None else "with TLS"
        link = "tcp" if directory is None else "tls"
        self.server = stack.enter_context(Server([HAND], listen=f"{link}/127.0.0.1:0", secure=directory))
        address = self.server.addresses[0]
        self.victim = stack.enter_context(Client(address, timeout=TIMEOUT, secure=directory))
        tls = {} if directory is None else client_settings(directory, "other")
        settings = {"mode": "client", "connect/endpoints": [address], **tls}
        self.stranger = stack.enter_context(zenoh.open(build_configuration(None, {}, settings)))
        self.grasp = ball_grasp()
        self.rest = BodyMotion(self.grasp.p_HO, self.grasp.R_HO)
        self.state = GraspState(self.grasp.q, np.zeros(self.grasp.hand.n), self.rest)
        stream = self.victim.open_stream(self.grasp, ControlSettings(), validity=TIMEOUT)
        self.stream: Stream = stack.enter_context(stream)
        self.key = f"{protocol.PREFIX}/streams/{self.stream.id}"
        self.seen: dict[str, Any] = {}
        for kind in ("state", "command"):
            self.seen[kind] = self.stranger.declare_subscriber(f"{self.key}/{kind}", RingChannel(BURST))
        time.sleep(_SETTLE)
        self.step()

    def step(self) -> bool:
        """Step the victim's stream, and return whether its command is genuine.

        The server has received all that the stranger published, so that it does not take the place of the state in the ring.
        """
        self.ask(f"{protocol.PREFIX}/status", {})
        command = self.stream.step(self.state, self.rest, wait=TIMEOUT)
        return bool(np.abs(command.tau).max() < FORGED_TORQUE) and not command.late

    def outcomes(self) -> dict[str, int]:
        """Return the server's counts of the stream's states."""
        [stream] = [each for each in self.victim.status().active_streams if each.id == self.stream.id]
        return dict(stream.outcomes)

    def put(self, kind: str, payload: bytes, attachment: bytes) -> None:
        """Publish a message of the stream as the stranger."""
        self.stranger.put(f"{self.key}/{kind}", payload, encoding=protocol.MSGPACK, attachment=attachment)

    def ask(self, key: str, record: object) -> str:
        """Send a query as the stranger, and return "ok", the error code, or "none" without a reply."""
        payload = protocol.encode(record, protocol.MSGPACK)
        options = {"payload": payload, "encoding": protocol.MSGPACK, "timeout": _WAIT_FOR_REPLY}
        for reply in self.stranger.get(key, **options):
            if reply.ok is not None:
                return "ok"
            with contextlib.suppress(Exception):
                return str(protocol.decode(reply.err.payload.to_bytes(), protocol.MSGPACK)["error"])  # type: ignore[index]
        return "none"


@contextlib.contextmanager
def start_scene(tls: bool) -> Iterator[Scene]:
    """Start a server, a victim and a stranger."""
    with contextlib.ExitStack() as stack:
        directory = None
        if tls:
            directory = init_directory(Path(stack.enter_context(tempfile.TemporaryDirectory())) / "keys")
            add_client(directory, "other", CONTROLLER)
        yield Scene(stack, directory)


# ── attacks ────────────────────────────────────────────────────────────────────────────────────────────────────────────


def _attack_states(scene: Scene, tries: int, make: Callable[[int], tuple[bytes, bytes] | None], name: str) -> Row:
    """Return the outcome of states that the stranger publishes between those of the victim."""
    before, steps = scene.outcomes(), 0
    for i in range(tries):
        message = make(i)
        if message is not None:
            scene.put("state", *message)
        if i % BURST == BURST - 1:
            scene.step()
            steps += 1
    time.sleep(_SETTLE)
    after = scene.outcomes()
    counts = {each: after.get(each, 0) - before.get(each, 0) for each in ("ok", "forged", "replayed")}
    return Row(name, scene.mode, tries, counts["ok"] - steps, counts["forged"] + counts["replayed"])


def forge_states(scene: Scene, tries: int) -> Row:
    """Publish valid states with made-up codes and growing counters."""
    payload = {**_state_record(scene), "sequence": 10**9}

    def make(i: int) -> tuple[bytes, bytes]:
        return protocol.encode(payload, protocol.MSGPACK), (10**9 + i).to_bytes(8, "little") + os.urandom(16)

    return _attack_states(scene, tries, make, "forged state")


def replay_states(scene: Scene, tries: int) -> Row:
    """Publish states of the victim again, with their codes."""
    kept: list[tuple[bytes, bytes]] = [(b"", b"")]

    def make(i: int) -> tuple[bytes, bytes]:
        if (sample := scene.seen["state"].handler.try_recv()) is not None:
            kept[0] = sample.payload.to_bytes(), sample.attachment.to_bytes()
        return kept[0]

    return _attack_states(scene, tries, make, "replayed state")


def forge_commands(scene: Scene, tries: int) -> Row:
    """Publish commands with large torques."""
    return _attack_commands(scene, tries, lambda i: (10**9 + i).to_bytes(8, "little") + os.urandom(16), "forged command")


def replay_commands(scene: Scene, tries: int) -> Row:
    """Publish commands with large torques, and codes of genuine commands."""
    kept = [b"\1" * 24]

    def attachment(i: int) -> bytes:
        if (sample := scene.seen["command"].handler.try_recv()) is not None:
            kept[0] = sample.attachment.to_bytes()
        return kept[0]

    return _attack_commands(scene, tries, attachment, "command with the code of another")


def _attack_commands(scene: Scene, tries: int, attachment: Callable[[int], bytes], name: str) -> Row:
    """Return the outcome of commands that the stranger publishes between those of the server."""
    refused = scene.stream._connection.refused  # type: ignore[attr-defined]
    before, effects = sum(refused.values()), 0
    torque = [FORGED_TORQUE] * scene.grasp.hand.n
    for i in range(tries):
        record = {"sequence": scene.stream.sequence, "time": time.monotonic(), "torque": torque, "late": False}
        scene.put("command", protocol.encode(record, protocol.MSGPACK), attachment(i))
        if i % BURST == BURST - 1:
            effects += not scene.step()
    time.sleep(_SETTLE)
    scene.step()
    return Row(name, scene.mode, tries, effects, sum(refused.values()) - before)


def _attack_queries(scene: Scene, tries: int, record: Callable[[int], object], name: str) -> Row:
    """Return the outcome of queries for the victim's stream between its steps."""
    answers, lost = [], 0
    for i in range(tries):
        answers.append(scene.ask(scene.key, record(i)))
        if i % BURST == BURST - 1:
            lost += not scene.step()
    if not scene.step() or len(scene.victim.status().active_streams) != 1:
        lost = tries
    return Row(name, scene.mode, tries, max(answers.count("ok"), lost), answers.count("forbidden"))


def close(scene: Scene, tries: int) -> Row:
    """Close the stream, with made-up proofs in half of the tries."""
    return _attack_queries(
        scene, tries, lambda i: {"close": True, **({"proof": os.urandom(32).hex()} if i % 2 else {})}, "close"
    )


def reopen(scene: Scene, tries: int) -> Row:
    """Open the stream again, to get its key or to replace it."""
    setup = scene.stream.setup.to_dict()
    return _attack_queries(scene, tries, lambda i: setup, "open again")


def answer_queries(scene: Scene, tries: int) -> Row:
    """Answer the victim's queries in place of the server. A query that the stranger gets is an effect, too."""
    fake = protocol.encode({"error": "internal", "message": FORGED_SERVER}, protocol.JSON)
    asked: list[str] = []

    def reply(query: zenoh.Query) -> None:
        asked.append(str(query.key_expr))
        with query:
            query.reply_err(fake, encoding=protocol.JSON)

    declared = [
        scene.stranger.declare_queryable(f"{protocol.PREFIX}/{key}", Callback(reply, indirect=False), complete=True)
        for key in ("status", "solve", "streams/*", f"hands/{HAND}", "**")
    ]
    time.sleep(_SETTLE)
    effects = 0
    for _ in range(tries):
        try:
            scene.victim.query("status", {})
        except Exception:
            effects += 1
    for each in declared:
        each.undeclare()
    return Row("rogue queryable", scene.mode, tries, max(effects, len(asked)), 0)


def forge_tokens(scene: Scene, tries: int) -> Row:
    """Declare tokens of servers that do not exist."""
    effects = 0
    for i in range(tries):
        token = scene.stranger.liveliness().declare_token(f"{protocol.PREFIX}/alive/{FORGED_SERVER}-{i}")
        if i % 100 == 0:
            time.sleep(0.01)
            effects += 100 * any(each.startswith(FORGED_SERVER) for each in scene.victim.servers())
        token.undeclare()
    sign = "`Client.servers` lists it" if effects else "–"
    return Row("forged token of a server", scene.mode, tries, min(effects, tries), 0, sign)


def cancel_plans(scene: Scene, tries: int) -> Row:
    """Cancel the victim's plan by its id, and end forged tokens of its client."""
    id, key = scene.victim._named_id("plan"), f"{protocol.PREFIX}/plans/"
    answers: list[Any] = []
    move = _free_move(scene.grasp)
    thread = threading.Thread(target=lambda: answers.append(scene.victim.plan(move, budget=TIMEOUT, id="plan")))
    thread.start()
    start, k = time.monotonic(), 0
    while k < tries or time.monotonic() - start < _BEGIN:
        scene.stranger.put(f"{key}{id}/cancel", b"")
        scene.stranger.liveliness().declare_token(f"{key}{id}/asker").undeclare()
        k += 1
    thread.join(_PLAN_END)
    is_planning = thread.is_alive()
    scene.victim.cancel("plan")
    thread.join()
    stopped = not is_planning and bool(getattr(answers[0], "stopped", True))
    return Row("cancel", scene.mode, k, k if stopped else 0, 0, "`stopped` in the answer" if stopped else "–")


def _free_move(grasp: Grasp) -> Move:
    """Return a move of an object by some millimetres."""
    p_HO = grasp.p_HO + np.array([[0.0, 0.0, 0.0], [0.002, 0.0, 0.003]])
    goal = Rotation.from_rotvec([0.05, 0.0, 0.0]).as_matrix() @ grasp.R_HO
    return FreeMove(object_task(grasp, ControlSettings()), p_HO, np.array([grasp.R_HO, goal]), q_start=grasp.q)


def _state_record(scene: Scene) -> dict[str, object]:
    """Return the record of a valid state of the victim's stream."""
    return {"sequence": 0, "time": time.monotonic(), "state": scene.state.to_dict(), "desired": scene.rest.to_dict()}


ATTACKS: dict[str, Callable[[Scene, int], Row]] = {
    "states": forge_states,
    "replay": replay_states,
    "commands": forge_commands,
    "codes": replay_commands,
    "close": close,
    "reopen": reopen,
    "tokens": forge_tokens,
    "queryable": answer_queries,
    "cancel": cancel_plans,
}
VISIBLE = ("tokens", "cancel")  # attacks that have an effect without TLS, which the victim sees


def refuse_certificates(tries: int) -> list[Row]:
    """Connect to a server with TLS without a certificate, and with one of another authority."""
    rows = []
    with contextlib.ExitStack() as stack:
        root = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        own, foreign = init_directory(root / "keys"), init_directory(root / "foreign")
        server = stack.enter_context(Server([HAND], listen="tls/127.0.0.1:0", secure=own))
        anonymous = {"transport/link/tls/root_ca_certificate": str((own / "ca.pem").resolve())}
        for name, tls in (
            ("no certificate", anonymous),
            ("certificate of another authority", client_settings(foreign, CONTROLLER)),
        ):
            settings = {"mode": "client", "connect/endpoints": server.addresses, "connect/timeout_ms": 0, **tls}
            effects = 0
            for _ in range(tries):
                with contextlib.suppress(zenoh.ZError):
                    zenoh.open(build_configuration(None, {}, settings)).close()
                    effects += 1
            rows.append(Row(name, "with TLS", tries, effects, tries - effects))
    return rows


def measure(tries: int, tls: bool) -> list[Row]:
    """Return the outcomes of all attacks in one mode."""
    with start_scene(tls) as scene:
        return [attack(scene, tries) for attack in ATTACKS.values()]


def _show(rows: list[Row], save: Path | None) -> None:
    """Print the table and write the page."""
    head = ("attack", "mode", "tries", "effects", "counted", "sign of an effect")
    cells = [(row.attack, row.mode, str(row.tries), str(row.effects), str(row.counted), row.sign) for row in rows]
    report_page.publish("Strangers at a server", __doc__, head, cells, save, text_columns=2)


def main() -> None:
    """Measure, print the table and write the page."""
    parser = report_page.parser("strangers", __doc__)
    parser.add_argument("--tries", type=int, default=TRIES, help="tries of each attack (default: 10000)")
    options = parser.parse_args()
    rows = [row for tls in (False, True) for row in measure(options.tries, tls)]
    _show(rows + refuse_certificates(max(options.tries // 100, 1)), options.save)


if __name__ == "__main__":
    main()
