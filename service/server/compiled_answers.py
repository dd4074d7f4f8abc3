"""The usual answers of a stream with exact states, each in one call of C: from the bytes of a state to those of its command.

A state is usual if it has the form of docs/wire.md, in MessagePack also the order of its fields, breaks no rule, and has
certified forces with the full slip margin. `ServerStream` answers all others, and hands the memory over to this class and back.
The rules are those of `StateGuard`, `DesiredGuard` and `TorqueStepLimit`, which give their numbers.
"""

from __future__ import annotations

import time
from typing import Any, NamedTuple

import msgspec
import numpy as np

from graspforce.contact.kinematics import TipContactState
from graspforce.control import ControlMemory
from graspforce.core import compiled
from graspforce.core.arrays import Array
from graspforce.core.constants import LARGEST_DISTANCE
from graspforce.service.server.desired_motion import DesiredGuard
from graspforce.service.server.exact_control import ExactControl, Warn
from graspforce.service.server.plausibility import LONGEST_GAP, StateGuard
from graspforce.service.server.torque_step import TorqueStepLimit, torque_step_warning
from graspforce.service.wire import protocol
from graspforce.service.wire.control_records import StreamSetup
from graspforce.service.wire.state_block import STACKED_NUMBERS, block_layout, usual_range
from graspforce.service.wire.state_structs import msgpack_from_json

_PAUSE = 10  # states that are answered in Python from one that was not usual on, because such states follow each other

_decode_msgpack, _encode_json = msgspec.msgpack.Decoder().decode, msgspec.json.Encoder().encode


class Answer(NamedTuple):
    """An answer to a state.

    Attributes:
        payload: the encoded command.
        memory: what the next answer starts from.
        sequence: number of the state.
        seconds: time from its receipt to its command, s.
        late: whether that is longer than the validity of the stream.
    """

    payload: bytes
    memory: bytes
    sequence: int
    seconds: float
    late: bool


class CompiledAnswers:
    """Usual answers of one stream. One thread at a time uses it.

    Args:
        setup: fixed parameters of the stream.
        control: control of the stream, whose memory it takes and returns.
        guard: plausibility of its states.
        desired_guard: plausibility of its desired motions.
        torque_step: bound of its torque's step.
    """

    def __init__(
        self,
        setup: StreamSetup,
        control: ExactControl,
        guard: StateGuard,
        desired_guard: DesiredGuard,
        torque_step: TorqueStepLimit,
    ) -> None:
        self._setup, self._control = setup, control
        self._guard, self._torque_step = guard, torque_step
        self._rules = _stack_rules(setup.hand.n, guard, desired_guard)
        self._has_torsion = bool(np.any(setup.grasp.contacts.gamma > 0.0))  # friction about the normals
        self._step: Any = None  # in C; made for the first usual state
        self._layout = np.dtype(np.void)
        self._memory: bytes | None = None  # after the last answer in C; None after one in Python
        self._pause = 0  # states until the C code is tried again

    def answer(self, payload: bytes, codec: str, received: float) -> Answer | None:
        """Return the answer to a state; None if it is not usual: then the control answers it in Python.

        Args:
            payload: the encoded state.
            codec: its encoding.
            received: when it arrived, on the clock `time.perf_counter`, s.
        """
        self._pause = max(self._pause - 1, 0)
        memory = self._memory
        if memory is None and self._pause == 0:
            memory = self._take_memory()
        if memory is None:
            return None
        found = None
        try:
            found = self._answer(payload, codec, received, memory)
        finally:
            if found is None:
                self._pause = _PAUSE
                self._return_memory()
        if found is not None:
            self._memory = found.memory
        return found

    def _answer(self, payload: bytes, codec: str, received: float, memory: bytes) -> Answer | None:
        """Return the answer to a state in C, or None."""
        state = payload if codec == protocol.MSGPACK else msgpack_from_json(payload)
        found = None if state is None else self._step.answer(state, received, memory)
        if found is None:
            return None
        answer = Answer._make(found)
        return answer if codec == protocol.MSGPACK else answer._replace(payload=_encode_json(_decode_msgpack(answer.payload)))

    def _take_memory(self) -> bytes | None:
        """Return the memory of control, guard and torque step; None if the next step cannot be usual."""
        usual, last, tau = self._control.usual_step(), self._guard.last, self._torque_step.last
        if usual is None or last is None or tau is None or self._has_torsion:
            return None
        step, warn, memory = usual
        if memory.tip_contacts is None or memory.f is None:
            return None
        if self._step is None:
            self._step = self._make_step(step, warn)
            self._layout = np.dtype(self._step.memory_layout)
        block, tips = np.zeros((), self._layout), memory.tip_contacts
        measured, *times = last
        parts = (
            *(times, measured, np.frombuffer(tau) if isinstance(tau, bytes) else tau),
            *(memory.integral, memory.R_OC, memory.creep, memory.f, tips.p_OF, tips.R_OF, tips.p_OC),
        )
        for name, part in zip(self._layout.names or (), parts, strict=True):
            block[name] = part
        return block.tobytes()

    def _return_memory(self) -> None:
        """Give the memory back to control, guard and torque step."""
        if self._memory is None:
            return
        block, self._memory = np.ndarray((), self._layout, self._memory), None
        sent, received = block["times"].tolist()
        self._guard.resume((block["measured"], sent, received))
        self._torque_step.last = block["tau"]
        tips = TipContactState(block["p_OF"], block["R_OF"], block["p_OC"])
        self._control.resume(ControlMemory(block["integral"], block["R_OC"], block["creep"], block["f"], tips))

    def _make_step(self, step: Any, warn: Warn) -> Any:
        """Return the `StreamStep` in C of this stream, with the solver of a `WholeStep`."""
        contacts = self._setup.grasp.contacts
        arrays = (np.array(each, dtype=float) for each in (self._rules, self._torque_step.largest, contacts.mu))

        def find_warnings(creep: bytes, gap: bytes, q: bytes, excess: float) -> tuple[str, ...]:
            of_step = warn(np.frombuffer(creep), np.frombuffer(gap), np.frombuffer(q))
            return (*of_step, torque_step_warning(excess)) if excess > 1.0 else of_step

        times = self._setup.validity, LONGEST_GAP, time.perf_counter
        return compiled.whole_step.StreamStep(step, *arrays, *times, find_warnings)


def _stack_rules(n: int, guard: StateGuard, desired_guard: DesiredGuard) -> Array:
    """Return the rules of all numbers of a state with n joints, (4, 5 n + 48), as `StreamStep` in C takes them."""
    layout = block_layout(n, joints=True, external=True)
    rules: Array = usual_range(layout.itemsize // protocol.FLOAT_BYTES).copy()
    rows = rules.view(layout)[:, 0]
    rows[STACKED_NUMBERS] = guard.rules
    rows["p_d"], rows["twist_d"] = desired_guard.position.rules, desired_guard.twist.rules
    rows["q_d"] = desired_guard.posture.rules
    np.minimum(rules[1], LARGEST_DISTANCE, out=rules[1])
    return rules
