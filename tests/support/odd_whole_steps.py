"""Whole control steps with odd numbers in a build with sanitizers: `python odd_whole_steps.py MODULE`.

Prints the number of attempts and of steps that were found. A sanitizer ends the process at the first error.
"""

from __future__ import annotations

import sys
import time
from functools import partial
from pathlib import Path

import msgspec
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, GraspState, compiled_control_law
from graspforce.grasp.grasp import Grasp
from support.control_grasps import GRASP_NAMES, named_grasp, with_all_contact_models
from support.odd_messages import load_module

STEPS = 30  # of each grasp


def odd_state(grasp: Grasp, rng: np.random.Generator) -> GraspState:
    """Return a state near the grasp, or far from it, or with giant numbers."""
    scale, n = 10.0 ** rng.integers(-6, 12), grasp.hand.n
    body = BodyMotion(grasp.p_HO + 1e-3 * scale * rng.normal(size=3), grasp.R_HO, scale * rng.normal(size=6))
    return GraspState(grasp.q + 1e-2 * scale * rng.normal(size=n), scale * rng.normal(size=n), body)


def encode_state(state: GraspState, desired: BodyMotion, external: np.ndarray | None, binary: bool) -> bytes:
    """Return the payload of a state with binary arrays, or with lists."""
    write = np.ndarray.tobytes if binary else np.ndarray.tolist
    body = state.object
    motion = {"position": desired.p_HO, "rotation": desired.R_HO, "twist": desired.twist, "acceleration": desired.acceleration}
    measured = {"position": body.p_HO, "rotation": body.R_HO, "twist": body.twist}
    record = {
        "sequence": 7,
        "time": 0.0,
        "state": {"posture": state.q, "velocity": state.v, "object": measured},
        "desired": motion,
        **({} if external is None else {"external": external}),
    }
    return msgspec.msgpack.encode(record, enc_hook=lambda array: write(np.array(array, dtype=float)))


def stream_arguments(law: compiled_control_law.CompiledControlLaw, torque_step: float = np.inf) -> tuple[object, ...]:
    """Return the arguments of a StreamStep with wide rules and a bound of the torque's step in N·m, but its warnings."""
    n = law.grasp.hand.n
    rules, largest = np.repeat([[0.0], [1e6], [np.inf], [np.inf]], 5 * n + 48, axis=1), np.full(n, torque_step)
    return law._whole_step, rules, largest, np.array(law.grasp.contacts.mu), 0.02, 0.01, time.perf_counter


def memory_after_a_step(law: compiled_control_law.CompiledControlLaw, creep: float = 0.0) -> bytes:
    """Return the memory of a StreamStep after a first step, with additional sliding in m."""
    grasp, n = law.grasp, law.grasp.hand.n
    rest = BodyMotion(grasp.p_HO, grasp.R_HO)
    _, memory = law.step(law.initial_memory(), GraspState(grasp.q, np.zeros(n), rest), rest)
    tips, measured = memory.tip_contacts, np.zeros(2 + 2 * n + 18)
    parts = measured, np.zeros(n), memory.integral, memory.R_OC, memory.creep + creep, memory.f, tips.p_OF, tips.R_OF, tips.p_OC
    return b"".join(np.ascontiguousarray(part).tobytes() for part in parts)


def check_answers(law: compiled_control_law.CompiledControlLaw, rng: np.random.Generator) -> int:
    """Answer usual states, odd ones and spoiled bytes; return how many are answered. Check that wrong arguments are not."""
    grasp, n = law.grasp, law.grasp.hand.n
    make, fixed = compiled_control_law.whole_step.StreamStep, stream_arguments(law)
    step, last = make(*fixed, lambda *parts: tuple(map(repr, parts))), memory_after_a_step(law)
    rest = BodyMotion(grasp.p_HO, grasp.R_HO)
    answered = 0
    for i in range(4 * STEPS):
        state = GraspState(grasp.q, np.zeros(n), rest) if i % 4 == 0 else odd_state(grasp, rng)
        payload = bytearray(encode_state(state, rest, rng.normal(size=6) * 0.01 if i % 3 else None, i % 5 < 3))
        if i % 4 == 2:
            payload[rng.integers(len(payload))] = rng.integers(256)
        if i % 4 == 3:
            del payload[rng.integers(len(payload)) :]
        found = step.answer(bytes(payload), time.perf_counter(), last)
        answered += found is not None
        last = last if found is None else found[1]
    for call, arguments in (
        (step.answer, []),
        (step.answer, [b"", 0.0, b""]),
        (step.answer, [b"", "x", last]),
        (make, [None, *fixed[1:]]),
        (make, [*fixed[:-1], None]),
        (make, [*fixed, "warn"]),
        (make, [fixed[0], *fixed[3:0:-1], *fixed[4:]]),
    ):
        try:
            call(*arguments)
        except (TypeError, ValueError):
            continue
        raise AssertionError(f"{arguments!r} was accepted")
    return answered


def check_warnings(law: compiled_control_law.CompiledControlLaw) -> None:
    """Check that wrong warnings are exceptions, and that a state which brings one has no answer without a function for it."""
    make, grasp = partial(compiled_control_law.whole_step.StreamStep, *stream_arguments(law)), law.grasp
    body = BodyMotion(grasp.p_HO, grasp.R_HO)
    payload = encode_state(GraspState(grasp.q, np.zeros(grasp.hand.n), body), body, None, binary=True)
    usual, slipped = memory_after_a_step(law), memory_after_a_step(law, creep=1.0)
    for texts in (None, [], (1,), ("\ud800",), ("a", None)):
        try:
            make(lambda *parts, texts=texts: texts).answer(payload, 0.0, slipped)
        except (TypeError, UnicodeEncodeError):
            continue
        raise AssertionError(f"{texts!r} was accepted")
    text = "slip" * 10_000
    assert make(lambda *parts: (text,) * 3).answer(payload, 0.0, slipped)[0].count(text.encode()) == 3
    assert make(None).answer(payload, 0.0, slipped) is None
    assert make(None).answer(payload, 0.0, usual) is not None
    limited = compiled_control_law.whole_step.StreamStep(*stream_arguments(law, 1e-6), lambda *parts: (f"{parts[-1] > 1.0}",))
    command = msgspec.msgpack.decode(limited.answer(payload, 0.0, usual)[0])  # after torques of zero
    assert command["warnings"] == ["True"]
    assert max(map(abs, np.frombuffer(command["torque"]))) < 1.001e-6


def check_refusals(law: compiled_control_law.CompiledControlLaw) -> None:
    """Check that wrong arguments are exceptions."""
    step, make, count = law._whole_step.step, compiled_control_law.whole_step.WholeStep, len(law.grasp.contacts)
    for wrong in (None, 1, "x", np.zeros(3)):
        for call, arguments in (
            (step, [wrong]),
            (step, [wrong] * 22),
            (make, [wrong]),
            (make, [law._compiled.step, np.zeros(count), 1.0, 1.0, *[wrong] * 9]),
            (make, [wrong, np.zeros(3, dtype=np.intc), 1.0, 1.0, *[wrong] * 9]),
        ):
            try:
                call(*arguments)
            except (TypeError, ValueError, BufferError):
                continue
            raise AssertionError(f"{wrong!r} was accepted")


def main(path: str) -> None:
    """Take the steps, call the type with wrong arguments, and print the counts."""
    compiled_control_law.whole_step = load_module(path)  # in place of the installed one
    rng, attempts, found = np.random.default_rng(0), 0, 0
    supported: list[compiled_control_law.CompiledControlLaw] = []
    grasps = [named_grasp(name) for name in GRASP_NAMES]
    for grasp in (*grasps, with_all_contact_models(named_grasp("allegro_right box"), 3)):
        law = compiled_control_law.CompiledControlLaw(grasp, ControlSettings())
        if law._whole_step is None:
            continue
        supported.append(law)
        memory, rest = law.initial_memory(), BodyMotion(grasp.p_HO, grasp.R_HO)
        for i in range(STEPS):
            external = rng.normal(size=6) if i % 2 else None
            step = law._take_whole_step(memory, odd_state(grasp, rng), rest, external)
            attempts += 1
            if step is not None:
                command, memory = step
                found += 1
                assert command.solution.certificate.verified
    check_refusals(supported[-1])
    check_warnings(supported[0])
    assert 0 < sum(check_answers(law, rng) for law in supported) < 3 * STEPS * len(supported)
    print(attempts, found)


if __name__ == "__main__":
    main(sys.argv[1])
