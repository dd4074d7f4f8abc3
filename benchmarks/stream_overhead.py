"""Server time of a control stream without Zenoh, over its control step: `python -m benchmarks.stream_overhead`.

A state goes from bytes through decoding, plausibility, control step and bound of the torque's step to the bytes of the
command, as in the server. Two control steps on the same states stand beside it, in the same process: `ObjectController.step`,
the reference in Python, and `CompiledControlLaw.step`, which streams with exact states use. All take turns in bursts at 1 kHz,
so that a drift of the machine's speed and cold caches affect them equally. The ratios are those of the medians over both
steps. With authentication, the code of the state is checked and the command is signed, too: clients of this package do so.

The Allegro hand holds a sphere with three fingers. Clients of this package send binary arrays. "All fields" adds desired joint
motions and an external wrench. "Sensor noise" adds 0.3 mrad to the joint positions and 0.3 mm to the object's position
(standard deviations): most commands then warn of slip.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks import report_page
from benchmarks.control_stream import allegro_grasp, state_sequence
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, DesiredMotion, GraspMotion, GraspState, ObjectController
from graspforce.control.compiled_control_law import CompiledControlLaw
from graspforce.grasp.grasp import Grasp
from graspforce.service import StreamSetup, StreamState
from graspforce.service.server.server_stream import ServerStream
from graspforce.service.wire import protocol
from graspforce.service.wire.stream_authentication import STATE, MessageSigner

BURST, WARM_UP, PERIOD = 50, 10, 1e-3  # states, states that are not timed, and s
HEAD = (
    *("state", "bytes in", "bytes out", "control step µs", "in C µs", "server µs", "ratios"),
    *("with authentication µs", "ratios "),
)


class Subject(NamedTuple):
    """A kind of state.

    Attributes:
        name: name in the table.
        is_full: whether it has desired joint motion and an external wrench.
        is_binary: whether its arrays are binary.
        codec: its encoding.
        noise: standard deviation of the measured joint positions and of the object's position, rad and m.
    """

    name: str
    is_full: bool
    is_binary: bool
    codec: str
    noise: float = 0.0


SUBJECTS = (
    Subject("MessagePack, binary arrays", False, True, protocol.MSGPACK),
    Subject("MessagePack, binary arrays, all fields", True, True, protocol.MSGPACK),
    Subject("MessagePack, binary arrays, sensor noise", False, True, protocol.MSGPACK, noise=3e-4),
    Subject("MessagePack, lists", False, False, protocol.MSGPACK),
    Subject("JSON", False, False, protocol.JSON),
)


def make_states(grasp: Grasp, subject: Subject) -> list[StreamState]:
    """Return the states of a burst."""
    rest, states, rng = np.zeros(grasp.hand.n), [], np.random.default_rng(0)
    for i, (exact, motion) in enumerate(state_sequence(grasp, BURST)):
        body, noise = exact.object, subject.noise
        body = BodyMotion(body.p_HO + noise * rng.normal(size=3), body.R_HO, body.twist)
        state = GraspState(exact.q + noise * rng.normal(size=grasp.hand.n), exact.v, body)
        desired: DesiredMotion = GraspMotion(motion, grasp.q, rest, rest) if subject.is_full else motion
        states.append(StreamState(i, 0.0, state, desired, np.full(6, 1e-3) if subject.is_full else None))
    return states


def encode(state: StreamState, subject: Subject) -> bytes:
    """Return the payload of a state."""
    return state.encode(subject.codec) if subject.is_binary else protocol.encode(state.to_dict(), subject.codec)


class Served:
    """A stream of a subject, and its states.

    Args:
        grasp: the grasp.
        subject: the kind of state.
        authenticated: whether the messages have codes.
    """

    def __init__(self, grasp: Grasp, subject: Subject, authenticated: bool) -> None:
        self._stream = ServerStream("benchmark", StreamSetup(grasp, authenticated=authenticated))
        self._signer = MessageSigner(self._stream.key, STATE) if self._stream.key else None
        self._subject, self._states, self._sequence = subject, make_states(grasp, subject), 0
        self.bytes_in = self.bytes_out = 0

    def time_state(self, i: int) -> float:
        """Return the time from the bytes of a state to those of its command, s."""
        self._sequence += 1
        payload = encode(replace_time(self._states[i], self._sequence), self._subject)
        code = b"" if self._signer is None else self._signer.sign(payload)
        begun = time.perf_counter()
        is_accepted = self._stream.accepts(payload, code)
        reply = self._stream.command(payload, self._subject.codec)
        self._stream.sign(reply.payload)
        seconds = time.perf_counter() - begun
        assert is_accepted
        assert reply.ok, reply.payload
        self.bytes_in, self.bytes_out = len(payload), len(reply.payload)
        return seconds


def replace_time(state: StreamState, sequence: int) -> StreamState:
    """Return a state with another number, sent now."""
    return StreamState(sequence, time.monotonic(), state.state, state.desired, state.external)


def time_steps(grasp: Grasp, subject: Subject) -> Callable[[int], float]:
    """Return a function that returns the time of a control step of the reference, s."""
    controller, states = ObjectController(grasp), make_states(grasp, subject)

    def step(i: int) -> float:
        state = states[i]
        assert isinstance(state.state, GraspState)
        begun = time.perf_counter()
        controller.step(state.state, state.desired, state.external)
        return time.perf_counter() - begun

    return step


def time_compiled_steps(grasp: Grasp, subject: Subject) -> Callable[[int], float]:
    """Return a function that returns the time of a control step of the law of streams, s."""
    law, states = CompiledControlLaw(grasp, ControlSettings()), make_states(grasp, subject)
    memory = law.initial_memory()

    def step(i: int) -> float:
        nonlocal memory
        state = states[i]
        assert isinstance(state.state, GraspState)
        begun = time.perf_counter()
        _, memory = law.step(memory, state.state, state.desired, state.external)
        return time.perf_counter() - begun

    return step


def measure(subject: Subject, rounds: int) -> tuple[str, ...]:
    """Return the row of a kind of state."""
    grasp = allegro_grasp()
    plain, authenticated = (Served(grasp, subject, each) for each in (False, True))
    parts = {
        "step": time_steps(grasp, subject),
        "compiled": time_compiled_steps(grasp, subject),
        "plain": plain.time_state,
        "codes": authenticated.time_state,
    }
    times: dict[str, list[float]] = {name: [] for name in parts}
    for _ in range(rounds):
        for name, part in parts.items():
            tick = time.perf_counter()
            for i in range(BURST):
                seconds = part(i)
                if i >= WARM_UP:
                    times[name].append(seconds)
                tick = max(tick + PERIOD, time.perf_counter())
                time.sleep(max(tick - time.perf_counter(), 0.0))
    step, compiled, without, codes = (float(np.median(times[name])) for name in parts)
    return (
        subject.name,
        str(plain.bytes_in),
        str(plain.bytes_out),
        f"{1e6 * step:.1f}",
        f"{1e6 * compiled:.1f}",
        f"{1e6 * without:.1f}",
        f"{without / step:.2f}, {without / compiled:.2f}",
        f"{1e6 * codes:.1f}",
        f"{codes / step:.2f}, {codes / compiled:.2f}",
    )


def _show(rows: list[tuple[str, ...]], rounds: int, save: Path | None) -> None:
    """Print the table and write the page."""
    counts = f"{rounds * (BURST - WARM_UP)} states per figure"
    report_page.publish("Server time of a control stream without Zenoh", __doc__, HEAD, rows, save, counts, width=180)


def main() -> None:
    """Measure, print the table and write the page."""
    parser = report_page.parser("stream_overhead", __doc__)
    parser.add_argument("--rounds", type=int, default=50, help="bursts of each subject")
    options = parser.parse_args()
    _show([measure(subject, options.rounds) for subject in SUBJECTS], options.rounds, options.save)


if __name__ == "__main__":
    main()
