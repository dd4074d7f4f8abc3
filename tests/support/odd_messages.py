"""Read random and damaged messages of streams with compiled code, for a build under sanitizers: `odd_messages.py MODULE COUNT`.

Print the numbers of accepted states, accepted commands, and genuine messages. Any other result ends the program with an error.
Only the module file and NumPy are imported. With PYTHONMALLOC=malloc the sanitizer sees each read beyond a payload.
"""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import numpy as np

JOINTS, CONTACTS = 3, 2
FORCES = 3 * CONTACTS
ODD_BYTES = (0x00, 0x7F, 0x80, 0x83, 0x90, 0xC0, 0xC3, 0xC4, 0xC6, 0xCB, 0xCF, 0xDB, 0xDC, 0xDE, 0xFF)
STATE_SIZES = (JOINTS, JOINTS, 3, 9, 6, 3, 9, 6, 6)
COMMAND_SIZES = (FORCES, 3 * CONTACTS, 6, 6, JOINTS, 6, CONTACTS, 12, 6)
MEMORY_SIZES = (6, 9 * CONTACTS, 2 * CONTACTS, FORCES, 3 * CONTACTS, 9 * CONTACTS, 3 * CONTACTS)


def load_module(path: str) -> ModuleType:
    """Return the compiled module of a file, whose name before the first dot is that of the module."""
    spec = importlib.util.spec_from_file_location(Path(path).name.partition(".")[0], path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def write_state(module: ModuleType, rng: np.random.Generator) -> bytes:
    """Return a valid state, with or without desired joints and external wrench."""
    parts = [rng.normal(size=size) for size in STATE_SIZES]
    parts[3], parts[6] = np.eye(3), np.eye(3)[:, ::-1].T[::-1]  # the second one is not contiguous
    parts += [rng.normal(size=JOINTS) for _ in range(3 * int(rng.integers(2)))]
    parts += [rng.normal(size=6) for _ in range(int(rng.integers(2)))]
    written = module.write_stream_state(tuple(parts), JOINTS, int(rng.integers(2**63)) >> int(rng.integers(63)), rng.normal())
    assert isinstance(written, bytes)
    wrong = int(rng.integers(len(parts)))
    parts[wrong] = [parts[wrong].ravel()[:-1], parts[wrong].astype(np.float32), None, "text", b""][rng.integers(5)]
    assert module.write_stream_state(tuple(parts), JOINTS, 1, 0.0) is None
    return written


def write_command(module: ModuleType, rng: np.random.Generator) -> bytes:
    """Return a valid command."""
    arrays = tuple(rng.normal(size=size) for size in (*COMMAND_SIZES, *MEMORY_SIZES))
    warnings = tuple("µ" * int(rng.integers(400)) for _ in range(int(rng.integers(20))))
    facts = bool(rng.integers(2)), bool(rng.integers(2)), warnings, bool(rng.integers(2)), rng.normal(), 7, rng.normal()
    written: bytes = module.write_stream_command(rng.normal(size=JOINTS), arrays, *facts)
    return written


def damage(rng: np.random.Generator, payload: bytes) -> bytes:
    """Return a payload with bytes changed, removed, repeated, cut off, or with others in its place."""
    changed = bytearray(payload)
    for _ in range(int(rng.integers(1, 4))):
        place = int(rng.integers(len(changed) + 1))
        kind = rng.integers(6)
        if kind == 0 and place < len(changed):
            changed[place] = int(rng.choice(ODD_BYTES))
        elif kind == 1 and place < len(changed):
            changed[place] ^= 1 << int(rng.integers(8))
        elif kind == 2:
            del changed[place : place + int(rng.integers(1, 9))]
        elif kind == 3:
            changed[place:place] = changed[place : place + int(rng.integers(1, 9))]
        elif kind == 4:
            del changed[place:]
        else:
            changed[place:] = rng.bytes(int(rng.integers(40)))
    return bytes(changed)


def main() -> None:
    module, rng, counts = load_module(sys.argv[1]), np.random.default_rng(8), [0, 0, 0]
    for _ in range(int(sys.argv[2])):
        state, command = write_state(module, rng), write_command(module, rng)
        assert module.read_stream_state(state, JOINTS) is not None
        assert module.read_stream_command(command, JOINTS, FORCES, CONTACTS) is not None
        for payload in (damage(rng, state), damage(rng, command), rng.bytes(int(rng.integers(100)))):
            counts[0] += module.read_stream_state(payload, JOINTS) is not None
            counts[1] += module.read_stream_command(payload, JOINTS, FORCES, CONTACTS) is not None
        if hasattr(module, "MessageCode"):
            key = rng.bytes(32)
            signer, verifier = module.MessageCode(key, b"S"), module.MessageCode(key, b"S")
            code = signer.sign(state)
            other = damage(rng, code)
            assert other == code or verifier.check(state, other) == module.FORGED
            counts[2] += verifier.check(state, code) == 0
    print(*counts)


if __name__ == "__main__":
    main()
