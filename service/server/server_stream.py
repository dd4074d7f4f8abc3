"""The server's end of a stream: a state in, a command out, both encoded. It does not use the network."""

from __future__ import annotations

import hmac
import secrets
import time
from collections import Counter
from concurrent.futures import Executor
from typing import Any, Protocol

import msgspec

from graspforce.control.compiled_control_law import CompiledControlLaw
from graspforce.control.object_control_law import ObjectControlLaw
from graspforce.core.errors import RequestRefused
from graspforce.core.json_text import JsonRecord
from graspforce.service.server.compiled_answers import CompiledAnswers
from graspforce.service.server.desired_motion import DesiredGuard
from graspforce.service.server.exact_control import ExactControl, check_finite
from graspforce.service.server.joint_control import JointControl
from graspforce.service.server.measured_control import MeasuredControl
from graspforce.service.server.phase_control import PhaseControl
from graspforce.service.server.plausibility import StateGuard
from graspforce.service.server.server_load import client_label
from graspforce.service.server.silent_context import make_silent_context
from graspforce.service.server.stream_heat import StreamHeat
from graspforce.service.server.torque_step import TorqueStepLimit
from graspforce.service.wire import protocol
from graspforce.service.wire.binary_command import AnyCommand, BinaryCommand
from graspforce.service.wire.command_records import ClearanceRecord, CommandRecord
from graspforce.service.wire.control_records import ControlRequest, StreamSetup
from graspforce.service.wire.joint_records import JointCommandRecord, JointStreamSetup
from graspforce.service.wire.latency_histogram import LatencyHistogram
from graspforce.service.wire.phase_records import PhaseCommandRecord, PhaseStreamSetup
from graspforce.service.wire.reply import Reply, make_failure_reply
from graspforce.service.wire.stream_authentication import (
    COMMAND,
    STATE,
    MessageSigner,
    MessageVerifier,
    make_key,
    ownership_proof,
)
from graspforce.service.wire.stream_setups import AnySetup
from graspforce.service.wire.stream_status import StreamStatus

_EPOCH_BYTES = 8
_MAX_PROOFS = 4  # of a request, the newest first
_PROOF_CHARACTERS = 64
_MAX_STATE_BYTES = 64 * 2**10  # a hand with 20 joints needs 1 KiB


class ServerStream:
    """An open stream. One thread at a time gives it states.

    Attributes:
        id: id of the stream, its key after ``streams/``.
        setup: fixed parameters.
        outcomes: number of states by outcome: "ok" or an error code.
        skipped: number of states that newer ones replaced before they were read, from the gaps in the sequence numbers.
        last_received: when the last valid state arrived, on the clock `time.perf_counter`, s. Invalid states do not count: they
            do not keep a stream open.
        late: number of commands that were finished later than their validity.
        latency: times from receipt of a state to its command.
        owner: session of the client that opened it.
        key: key of its messages; None for a stream without authentication.
        epoch: number of this opening of a stream without authentication; with authentication, the key has its purpose.

    Args:
        id: id of the stream.
        setup: fixed parameters.
        owner: session of the client that opened it.
        proof: proofs of its client in the request that opened it. Repeated, they prove the opening if its answer got lost.
        changes: runs the preparations of contact changes; None for a thread of the server.
        law_type: type of the control law of a grasp. Both give the same results, to the accuracy of the force solver.
    """

    def __init__(
        self,
        id: str,
        setup: AnySetup,
        owner: bytes = b"",
        proof: object = None,
        *,
        changes: Executor | None = None,
        law_type: type[ObjectControlLaw] = CompiledControlLaw,
    ) -> None:
        self.id, self.setup, self.owner = id, setup, owner
        self._claims = tuple(each.encode() for each in _read_proofs(proof))
        self.outcomes: Counter[str] = Counter()
        self.skipped = self.late = 0
        self.latency = LatencyHistogram()
        self.last_received = time.perf_counter()
        self._control = _make_control(setup, changes, law_type)
        self.key = make_key() if setup.authenticated else None
        self.epoch = None if setup.authenticated else secrets.token_bytes(_EPOCH_BYTES)
        self._verifier = None if self.key is None else MessageVerifier(self.key, STATE)
        self._signer = None if self.key is None else MessageSigner(self.key, COMMAND)
        self._guard: StateGuard | None = None
        self._desired_guard: DesiredGuard | None = None
        self._torque_step: TorqueStepLimit | None = None
        self._heat: StreamHeat | None = None
        self._answers: CompiledAnswers | None = None
        if isinstance(setup, StreamSetup):
            self._guard = StateGuard(setup.grasp, setup.validity, setup.sensors is not None)
            self._desired_guard = DesiredGuard(setup.grasp)
            self._torque_step = TorqueStepLimit(setup.grasp, setup.torque_step)
            self._heat = StreamHeat(setup.hand) if setup.hand.drives.has_thermal_data else None
            if isinstance(self._control, ExactControl):
                checks = self._guard, self._desired_guard, self._torque_step
                self._answers = CompiledAnswers(setup, self._control, *checks)
        self._sequence: int | None = None
        self._silent_context = make_silent_context()

    def accepts(self, payload: bytes, attachment: bytes) -> bool:
        """Return whether a state is for this opening of the stream; with authentication, also genuine and new.

        Refused states count as outcomes "forged" and "replayed", or as "replaced" if they are for another opening, maybe at
        another server. They get no reply.

        Args:
            payload: the encoded state.
            attachment: its attachment; empty for none.
        """
        if self._verifier is None:
            if attachment not in (b"", self.epoch):
                self.outcomes["replaced"] += 1
                return False
            return True
        if self._verifier.accept(payload, attachment):
            return True
        self.outcomes.update(self._verifier.refused)
        self._verifier.refused.clear()
        return False

    def sign(self, payload: bytes) -> bytes | None:
        """Return the attachment of a command: counter and code, or the epoch of a stream without authentication.

        Args:
            payload: the encoded command.
        """
        return self.epoch if self._signer is None else self._signer.sign(payload)

    def is_owned(self, client: bytes, proof: object) -> bool:
        """Return whether a client may open this stream again, or close it.

        A stream with authentication is owned by the session that opened it, and by a client with its key.

        Args:
            client: session of the client; empty for one that is not connected directly.
            proof: `ownership_proof` as the client sent it, or several, of all openings of its stream, the newest first.
        """
        return self.key is None or bool(client and client == self.owner) or self._find_proof(proof) is not None

    def is_replaced(self, proof: object) -> bool:
        """Return whether its client has opened the stream at another server since then.

        Args:
            proof: as in `is_owned`.
        """
        found = self._find_proof(proof)
        return self.key is not None and found != 0 and (found is not None or bool(proof))

    def _find_proof(self, proof: object) -> int | None:
        """Return the index of the proof for this opening of the stream; None if there is none."""
        if self.key is None:
            return None
        own = ownership_proof(self.key, self.id).encode(), *self._claims
        for k, given in enumerate(_read_proofs(proof)):
            if any(hmac.compare_digest(given.encode(), each) for each in own):
                return k
        return None

    def command(self, payload: bytes, encoding: str | None, received: float | None = None) -> Reply:
        """Return the command for a state. Every exception becomes an error record.

        Args:
            payload: the encoded state.
            encoding: its Zenoh encoding; None for JSON.
            received: when it arrived, on the clock `time.perf_counter`, s; None for now.
        """
        received = time.perf_counter() if received is None else received
        codec = protocol.JSON
        try:
            codec = protocol.select_codec(encoding)
            if len(payload) > _MAX_STATE_BYTES:
                message = f"the state has {len(payload)} bytes: at most {_MAX_STATE_BYTES} are allowed"
                raise RequestRefused("too_large", message)
            reply, outcome = Reply(True, self._answer(payload, codec, received), codec), "ok"
            self.last_received = received
        except Exception as error:
            about = _find_sequence(payload, codec), client_label(self.owner)
            outcome, reply = make_failure_reply(codec, error, f"streams/{self.id}/state", *about)
        self.outcomes[outcome] += 1
        return reply

    def status(self) -> StreamStatus:
        """Return counts and latencies. Any thread may call it."""
        hand, client, idle = self.setup.hand.name, client_label(self.owner), time.perf_counter() - self.last_received
        return StreamStatus(self.id, hand, client, dict(self.outcomes), self.skipped, self.late, idle, self.latency)

    def _answer(self, payload: bytes, codec: str, received: float) -> bytes:
        """Return the encoded command for a valid state."""
        answer = None if self._answers is None else self._answers.answer(payload, codec, received)
        if answer is not None:
            self._count(answer.sequence)
            self.late += answer.late
            self.latency.observe(answer.seconds)
            return answer.payload
        state = self._control.decode(payload, codec)
        self._count(state.sequence)
        if self._guard is not None:
            self._guard.check(state.state, state.time, received)
        if self._desired_guard is not None:
            self._desired_guard.check(state.desired)
        record = self._silent_context.run(self._control.step, state)
        if self._torque_step is not None and isinstance(record, AnyCommand):
            self._torque_step.apply(record, state)
        if self._heat is not None and isinstance(record, CommandRecord):
            self._heat.apply(record, state)
        record.sequence, record.time = state.sequence, state.time
        record.server_seconds = time.perf_counter() - received
        record.late = record.server_seconds > self.setup.validity
        self.late += record.late
        self.latency.observe(record.server_seconds)
        return record.encode() if isinstance(record, BinaryCommand) else protocol.encode(record, codec)

    def _count(self, sequence: int) -> None:
        """Count the states that were skipped before one."""
        if self._sequence is not None and sequence > self._sequence:
            self.skipped += sequence - self._sequence - 1
        self._sequence = sequence


def _read_proofs(proof: object) -> list[str]:
    """Return the proofs of a request that have the length of one."""
    given = proof[:_MAX_PROOFS] if isinstance(proof, list) else [proof]
    return [each for each in given if isinstance(each, str) and len(each) == _PROOF_CHARACTERS]


class _Control(Protocol):
    """Controller of a stream of one kind."""

    def decode(self, payload: bytes, codec: str) -> Any:
        """Return a state, which has `sequence` and `time`."""

    def step(self, state: Any) -> AnyCommand | PhaseCommandRecord | JointCommandRecord:
        """Return the command for a state."""


def _make_control(setup: AnySetup, changes: Executor | None, law_type: type[ObjectControlLaw]) -> _Control:
    """Return the controller of a stream."""
    if isinstance(setup, PhaseStreamSetup):
        return PhaseControl(setup)
    if isinstance(setup, JointStreamSetup):
        return JointControl(setup)
    return (ExactControl if setup.sensors is None else MeasuredControl)(setup, changes, law_type)


def answer_control_request(request: ControlRequest) -> JsonRecord:
    """Return the record of the command for a single control step, with the certified solution of its force problem.

    Args:
        request: grasp, state, desired motion and memory.

    Raises:
        InvalidInput: the numbers are so large that the torques are not finite.
    """
    law = ObjectControlLaw(request.grasp, request.settings)
    inputs = request.memory or law.initial_memory(), request.state, request.desired, request.external
    command, memory = make_silent_context().run(law.step, *inputs)
    check_finite(command, memory)
    record = CommandRecord.pack(command, memory, has_drive=not request.grasp.hand.drives.is_ideal)
    record.clearance = ClearanceRecord.pack(command, request.settings.clearance_steps)
    joints = list(request.grasp.hand.joint_names)
    return {**msgspec.to_builtins(record), "joints": joints, "solution": command.solution.to_dict()}


def _find_sequence(payload: bytes, codec: str) -> int | None:
    """Return the sequence number of an invalid state if it can be read."""
    return protocol.read_sequence(payload, codec) if len(payload) <= _MAX_STATE_BYTES else None
