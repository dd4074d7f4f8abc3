"""Server time of a control stream without Zenoh, over its control step: `python -m benchmarks.stream_overhead`.

A state goes from bytes through decoding, plausibility, control step and bound of the torque's step to the bytes of the
command, as in the server. Two control steps on the same states stand beside it, in the same process: that of the reference,
`ObjectController.step`, and that with `CompiledControlLaw`, which streams use. All take turns in bursts at 1 kHz, so that a
drift of the machine's speed and cold caches affect them equally. The ratios are those of the medians over both steps. With
authentication, the code of the state is checked and the command is signed, too: clients of this package do so.

The Allegro hand holds a sphere with three fingers. Clients of this package send binary arrays. "All fields" adds desired joint
motions and an external wrench. "Sensor noise" adds 0.3 mrad to the joint positions and 0.3 mm to the object's position
(standard deviations): most commands then warn of slip. "Measured" are streams with sensors: encoders with 0.1 mrad of noise,
poses of the object from a camera at 100 Hz, and in the last row forces of the fingertips. Their control step is
`OutputFeedbackController.step`, with its estimator.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks import report_page
from benchmarks.control_stream import allegro_grasp, state_sequence
from graspforce.contact.motion import BodyMotion
from graspforce.control import (
    ControlSettings,
    DesiredMotion,
    GraspMotion,
    GraspState,
    ObjectController,
    OutputFeedbackController,
)
from graspforce.control.compiled_control_law import CompiledControlLaw
from graspforce.control.output_feedback_law import OutputFeedbackLaw
from graspforce.core.arrays import Array
from graspforce.estimation import CameraModel, Measurement, PoseMeasurement, SensorModel
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
        sensors: sensors of a stream of measurements; None for exact states.
    """

    name: str
    is_full: bool
    is_binary: bool
    codec: str
    noise: float = 0.0
    sensors: SensorModel | None = None


LATENCY = 0.01  # s, of the camera
ENCODERS = SensorModel(encoder_noise=1e-4, camera=CameraModel(rate=100.0, latency=LATENCY))
TIP_FORCES = replace(ENCODERS, tip_force_noise=0.05)
SUBJECTS = (
    Subject("MessagePack, binary arrays", False, True, protocol.MSGPACK),
    Subject("MessagePack, binary arrays, all fields", True, True, protocol.MSGPACK),
    Subject("MessagePack, binary arrays, sensor noise", False, True, protocol.MSGPACK, noise=3e-4),
    Subject("MessagePack, lists", False, False, protocol.MSGPACK),
    Subject("JSON", False, False, protocol.JSON),
    Subject("measured: MessagePack, binary arrays", False, True, protocol.MSGPACK, sensors=ENCODERS),
    Subject("measured: MessagePack, lists", False, False, protocol.MSGPACK, sensors=ENCODERS),
    Subject("measured: JSON", False, False, protocol.JSON, sensors=ENCODERS),
    Subject("measured, with forces: MessagePack, binary arrays", False, True, protocol.MSGPACK, sensors=TIP_FORCES),
)
_CAMERA_PERIOD = 10  # states


def make_states(grasp: Grasp, subject: Subject) -> list[StreamState]:
    """Return the states of a burst, measurements with the times from its begin."""
    rest, states, rng = np.zeros(grasp.hand.n), [], np.random.default_rng(0)
    wrench = tip_wrenches(grasp)
    for i, (exact, motion) in enumerate(state_sequence(grasp, BURST)):
        body, sigma = exact.object, subject.noise
        body = BodyMotion(body.p_HO + sigma * rng.normal(size=3), body.R_HO, body.twist)
        state: GraspState | Measurement = GraspState(exact.q + sigma * rng.normal(size=grasp.hand.n), exact.v, body)
        if subject.sensors is not None:
            noise, t = subject.sensors.tip_force_noise, PERIOD * i
            noisy = None if noise is None else wrench + noise * rng.normal(size=wrench.shape)
            pose = PoseMeasurement(t - LATENCY, exact.object.p_HO, exact.object.R_HO) if i % _CAMERA_PERIOD == 0 else None
            state = Measurement(t, exact.q, tip_wrench=noisy, object=pose)
        desired: DesiredMotion = GraspMotion(motion, grasp.q, rest, rest) if subject.is_full else motion
        states.append(StreamState(i, 0.0, state, desired, np.full(6, 1e-3) if subject.is_full else None))
    return states


def tip_wrenches(grasp: Grasp) -> Array:
    """Return force and moment of each finger on the object at rest, (N, 6) in H, N and N·m."""
    rest = BodyMotion(grasp.p_HO, grasp.R_HO)
    command = ObjectController(grasp).step(GraspState(grasp.q, np.zeros(grasp.hand.n), rest), rest)
    f = grasp.contacts.pad(command.f)[:, :3, None]  # (N, 3, 1) in the contact frames, N
    return np.hstack([(grasp.R_HO @ grasp.contacts.R_OC @ f)[:, :, 0], np.zeros((len(f), 3))])


class Served:
    """A stream of a subject.

    Args:
        grasp: the grasp.
        subject: the kind of state.
        states: the states of a burst.
        authenticated: whether the messages have codes.
    """

    def __init__(self, grasp: Grasp, subject: Subject, states: list[StreamState], authenticated: bool) -> None:
        setup = StreamSetup(grasp, authenticated=authenticated, sensors=subject.sensors)
        self._stream = ServerStream("benchmark", setup)
        self._signer = MessageSigner(self._stream.key, STATE) if self._stream.key else None
        self._subject, self._states, self._sequence = subject, states, 0
        self.bytes_in = self.bytes_out = 0

    def time_state(self, i: int) -> float:
        """Return the time from the bytes of a state to those of its command, s."""
        self._sequence += 1
        state = replace_time(self._states[i], self._sequence)
        payload = state.encode(self._subject.codec, binary=self._subject.is_binary)
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
    """Return a state with another number, sent now. A measurement gets the time of the number."""
    now = state.state
    if isinstance(now, Measurement):
        now = at_time(now, PERIOD * sequence)
    return StreamState(sequence, time.monotonic(), now, state.desired, state.external)


def at_time(measured: Measurement, t: float) -> Measurement:
    """Return a measurement at another time, s, with its pose."""
    pose = measured.object
    return replace(measured, t=t, object=None if pose is None else replace(pose, t=pose.t - measured.t + t))


def make_reference_step(grasp: Grasp, sensors: SensorModel | None) -> Callable[[StreamState], object]:
    """Return a function that takes a control step of the reference in Python."""
    settings = ControlSettings()
    controller: Any = ObjectController(grasp, settings)
    if sensors is not None:
        controller = OutputFeedbackController(grasp, settings, sensors)
    return lambda state: controller.step(state.state, state.desired, state.external)


def make_compiled_step(grasp: Grasp, sensors: SensorModel | None) -> Callable[[StreamState], object]:
    """Return a function that takes a control step of the law of streams."""
    settings = ControlSettings()
    law: Any = CompiledControlLaw(grasp, settings)
    if sensors is not None:
        law = OutputFeedbackLaw(grasp, settings, sensors, law_type=CompiledControlLaw)
    memory = law.initial_memory()

    def step(state: StreamState) -> None:
        nonlocal memory
        memory = law.step(memory, state.state, state.desired, state.external)[-1]  # the last part of the result

    return step


def time_steps(take: Callable[[StreamState], object], states: list[StreamState]) -> Callable[[int], float]:
    """Return a function that returns the time of a control step, s."""
    sequence = 0

    def step(i: int) -> float:
        nonlocal sequence
        sequence += 1
        state = replace_time(states[i], sequence)
        begun = time.perf_counter()
        take(state)
        return time.perf_counter() - begun

    return step


def measure(subject: Subject, rounds: int) -> tuple[str, ...]:
    """Return the row of a kind of state."""
    grasp = allegro_grasp()
    states = make_states(grasp, subject)
    plain, authenticated = (Served(grasp, subject, states, each) for each in (False, True))
    parts = {
        "step": time_steps(make_reference_step(grasp, subject.sensors), states),
        "compiled": time_steps(make_compiled_step(grasp, subject.sensors), states),
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
