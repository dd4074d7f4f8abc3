"""Whole control steps with odd numbers in a build with sanitizers: `python odd_whole_steps.py MODULE`.

Prints the number of attempts and of steps that were found. A sanitizer ends the process at the first error.
"""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, GraspState, compiled_control_law
from graspforce.grasp.grasp import Grasp
from support.control_grasps import GRASP_NAMES, named_grasp, with_all_contact_models

STEPS = 30  # of each grasp


def load_module(path: str) -> None:
    """Use the module of a file in place of the installed one."""
    spec = importlib.util.spec_from_file_location("graspforce.core._whole_step", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    compiled_control_law.whole_step = module


def odd_state(grasp: Grasp, rng: np.random.Generator) -> GraspState:
    """Return a state near the grasp, or far from it, or with giant numbers."""
    scale, n = 10.0 ** rng.integers(-6, 12), grasp.hand.n
    body = BodyMotion(grasp.p_HO + 1e-3 * scale * rng.normal(size=3), grasp.R_HO, scale * rng.normal(size=6))
    return GraspState(grasp.q + 1e-2 * scale * rng.normal(size=n), scale * rng.normal(size=n), body)


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
    load_module(path)
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
    print(attempts, found)


if __name__ == "__main__":
    main(sys.argv[1])
