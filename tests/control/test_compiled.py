"""The compiled laws give what the laws in Python give, to rounding; wherever a contact may be, edges and middles included."""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
from dataclasses import replace
from pathlib import Path
from shutil import which

import numpy as np
import pytest
from support.control_grasps import GRASP_NAMES, named_grasp
from support.tip_motions import SHAPES, random_initial_contacts, random_tip_motion

from graspforce.contact import compiled_kinematics
from graspforce.contact.contact import ContactModel
from graspforce.contact.kinematics import rolling_contacts_reference
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, GraspState, mobility, object_controller
from graspforce.control.mobility import MassFactor, compute_accelerations, compute_accelerations_reference
from graspforce.control.object_controller import ObjectControlLaw

native = pytest.importorskip("graspforce.core._native", reason="the laws were not built: no C compiler at installation")
COMPILER = which(os.environ.get("CC", "cc")) or which("gcc") or which("clang")
SOURCES = Path(compiled_kinematics.__file__).parents[1] / "csrc" / "python"
ROUNDING = 1e-12


@pytest.mark.parametrize("name", GRASP_NAMES)
def test_accelerations_of_every_grasp_in_c_are_those_of_the_reference(name: str) -> None:
    grasp, rng = named_grasp(name), np.random.default_rng(14)
    radii = np.array([grasp.hand.finger(finger).tip_radius or 0.0 for finger in grasp.fingers])
    for _ in range(5):
        q, v = grasp.q + 0.02 * rng.normal(size=grasp.hand.n), 0.3 * rng.normal(size=grasp.hand.n)
        motion = BodyMotion(grasp.p_HO + 1e-3 * rng.normal(size=3), grasp.R_HO, 0.1 * rng.normal(size=6))
        arguments = (
            grasp.hand.tip_motion(q, v, grasp.fingers),
            radii,
            motion,
            grasp.body.shape,
            grasp.contacts,
            grasp.contacts.R_OC,
        )
        law = rolling_contacts_reference(*arguments)
        posture, wanted, M_factor = (
            10.0 * rng.normal(size=grasp.hand.n),
            rng.normal(size=6),
            MassFactor.from_body(grasp.body),
        )
        terms = law.A, law.B, law.beta, wanted, posture, M_factor, ControlSettings().rank_tolerance
        found, by_law = compute_accelerations(*terms), compute_accelerations_reference(*terms)
        # A's condition is below 1/rank_tolerance, and its square is solved: 1e4 roundings of 100 rad/s².
        np.testing.assert_allclose(
            found.joint_acceleration,
            by_law.joint_acceleration,
            rtol=0.0,
            atol=1e-12 * np.abs(by_law.joint_acceleration).max() * 1e2,
        )
        np.testing.assert_allclose(found.object_acceleration, by_law.object_acceleration, atol=1e-12)
        assert (found.Q is None) == (by_law.Q is None)


def rows(rng: np.random.Generator, r: int, n: int, sizes: np.ndarray) -> np.ndarray:
    """(r, n) of given singular values."""
    left, right = (np.linalg.qr(rng.normal(size=(size, size)))[0] for size in (r, n))
    return left @ np.diag(sizes) @ right[:, :r].T


def test_joint_accelerations_of_any_rows() -> None:
    """By the normal equations and by pseudo-inverse; close to where fingers are stretched out each says so for itself."""
    rng, lever, told = np.random.default_rng(16), 0.01, {True: 0, False: 0}
    for _ in range(300):
        r = int(rng.integers(1, 17))
        n = r + int(rng.integers(0, 8))
        sizes = 0.05 * np.append(rng.uniform(0.1, 1.0, r - 1), rng.choice([1.0, 0.3, 0.05, 0.02, 0.005, 0.0]))  # m/rad
        A, B, beta = rows(rng, r, n, sizes), rng.normal(size=(r, 6)), rng.normal(size=r)
        wanted, posture = rng.normal(size=6), 5.0 * rng.normal(size=n)
        answer = np.empty(n)
        every_way = native.keep_contacts(A, B, beta, wanted, posture, lever, answer)
        told[every_way] += 1
        if not every_way:
            assert sizes.min() <= lever * sizes.max() * r  # ‖L⁻¹‖² tr K is at most r² σ_max²/σ_min²
            continue
        assert sizes.min() > lever * sizes.max()
        joints = posture + np.linalg.pinv(A) @ (B @ wanted + beta - A @ posture)
        np.testing.assert_allclose(answer, joints, rtol=0.0, atol=1e-11 * np.abs(joints).max())
        np.testing.assert_allclose(A @ answer, B @ wanted + beta, rtol=0.0, atol=1e-11 * np.abs(joints).max())
    assert min(told.values()) > 30
    assert native.keep_contacts(np.full((1, 2), np.nan), B[:1], beta[:1], wanted, np.zeros(2), lever, np.empty(2)) is False


@pytest.mark.parametrize("name", ["allegro_right sphere", "allegro_right box", "four_finger cylinder", "dlr_hit2 sphere"])
def test_a_step_is_the_same_without_a_compiler(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The whole law, some steps on end, with what the laws in Python say in place of the compiled ones."""
    grasp = named_grasp(name)
    states = []
    rng = np.random.default_rng(17)
    for _ in range(4):
        desired = BodyMotion(grasp.p_HO, grasp.R_HO, 0.02 * rng.normal(size=6), 0.1 * rng.normal(size=6))
        seen = replace(desired, p_HO=grasp.p_HO + 1e-4 * rng.normal(size=3))
        states.append(
            (GraspState(grasp.q + 1e-3 * rng.normal(size=grasp.hand.n), 0.1 * rng.normal(size=grasp.hand.n), seen), desired)
        )

    def steps() -> list:
        law = ObjectControlLaw(grasp, ControlSettings())
        memory, taken = law.initial_memory(), []
        for state, desired in states:
            command, memory = law.step(memory, state, desired)
            taken.append((command, memory))
        return taken

    compiled = steps()
    for room in (object_controller, compiled_kinematics, mobility):
        monkeypatch.setattr(room, "native", None)
    for (ours, after), (theirs, after_theirs) in zip(compiled, steps(), strict=True):
        for part in ("w", "acceleration", "joint_acceleration", "error", "creep"):
            one, other = getattr(ours, part), getattr(theirs, part)
            np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-11 * max(1.0, np.abs(other).max()), err_msg=part)
        np.testing.assert_allclose(ours.tau, theirs.tau, atol=1e-6)  # N·m: the solver's answer
        assert ours.warnings == theirs.warnings
        np.testing.assert_allclose(after.R_OC, after_theirs.R_OC, atol=ROUNDING)


def test_arrays_that_do_not_fit_are_refused() -> None:
    """The compiled laws trust nobody: another type, shape or length is an error, and nothing is read beyond an array's end."""
    rng = np.random.default_rng(18)
    N, n = 2, 3
    tips, contacts = random_tip_motion(rng, rng.normal(size=(N, 3)), n), random_initial_contacts(rng, (ContactModel.POINT,) * N)
    answer = np.empty(56 * N + 4 * N * n)
    roll = [
        SHAPES["box"].primitive_parameters,
        tips.p_HF,
        tips.R_HF,
        tips.rates,
        np.ones(N),
        np.zeros(3),
        np.eye(3),
        np.zeros(6),
    ]
    roll += [contacts.p_OC, contacts.R_OC, contacts.R_OC, answer]
    keep = [np.ones((2, n)), np.ones((2, 6)), np.ones(2), np.ones(6), np.ones(n), 0.01, np.empty(n)]
    slide = [np.ones((N, 3)), np.ones((N, 3, 3)), np.ones((N, 3)), np.ones((N, 3)), np.ones((N, 3, 3)), np.ones((N, 3, 3))]
    slide += [np.empty((N, 2))]
    for call, right in ((native.roll, roll), (native.keep_contacts, keep), (native.slip_displacement, slide)):
        call(*right)
        for at, array in enumerate(right):
            if isinstance(array, np.ndarray):
                wrong = [array.astype(np.float32), np.zeros(array.size + 1), array[:-1], array[..., None], array.tolist(), None]
                if at == len(right) - 1:
                    wrong = [array[:-1], np.append(array, 0.0), bytes(array.nbytes), None]
                for other in wrong:
                    with pytest.raises((ValueError, TypeError, BufferError)):
                        call(*right[:at], other, *right[at + 1 :])
        with pytest.raises(TypeError, match="takes"):
            call(*right[:-1])
    for form in ((4, 1.0, 1.0, 1.0), (-1, 1.0, 1.0, 1.0), (1, 1.0), [1, 1.0, 1.0, 1.0]):
        with pytest.raises((ValueError, TypeError)):
            native.roll(form, *roll[1:])
    with pytest.raises(ValueError, match="contiguous"):
        native.keep_contacts(np.ones((n, 2)).T, *keep[1:])
    with pytest.raises(ValueError, match="J, twist and drift"):
        native.roll(*roll[:3], np.zeros((N, 6, 1)), *roll[4:])
    strided = [np.asfortranarray(array) if at in (1, 2, 6, 8, 9, 10) else array for at, array in enumerate(roll[:-1])]
    again = np.empty(answer.shape)
    native.roll(*strided, again)
    np.testing.assert_array_equal(again, answer)


@pytest.mark.skipif(COMPILER is None, reason="no C compiler")
def test_laws_under_sanitizers(tmp_path: Path) -> None:
    """This file's tests of the binding in a build with both sanitizers, odd numbers among the right ones."""
    found = subprocess.run([COMPILER, "-print-file-name=libasan.so"], capture_output=True, text=True, check=False)
    library = found.stdout.strip()
    if not os.path.isabs(library):
        pytest.skip("this compiler has no shared sanitizer")
    module = tmp_path / ("_native" + str(sysconfig.get_config_var("EXT_SUFFIX")))
    flags = ["-std=c11", "-O0", "-g", "-fPIC", "-shared", "-Wall", "-Wextra", "-Werror"]
    flags += ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", f"-I{sysconfig.get_paths()['include']}"]
    subprocess.run([COMPILER, *flags, str(SOURCES / "control_module.c"), "-lm", "-o", str(module)], check=True)
    # The interpreter itself keeps what it has until it ends: leaks are not looked for.
    environment = {**os.environ, "LD_PRELOAD": library, "ASAN_OPTIONS": "detect_leaks=0", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-c", ODD_NUMBERS, str(module)],
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert int(done.stdout) > 100  # joint accelerations were found in spite of all


ODD_NUMBERS = """
import importlib.util, sys
import numpy as np
spec = importlib.util.spec_from_file_location("_native", sys.argv[1])
laws = importlib.util.module_from_spec(spec)
spec.loader.exec_module(laws)
rng, found = np.random.default_rng(1), 0
ODD = [0.0, -0.0, 1e300, -1e300, 5e-324, np.inf, -np.inf, np.nan, 1e154]
def some(*shape):
    array = rng.normal(size=shape)
    if array.size and rng.random() < 0.2:
        array.flat[rng.integers(array.size)] = rng.choice(ODD)
    return array
for _ in range(1500):
    N, n, r = (int(x) for x in rng.integers([0, 0, 0], [5, 9, 9]))
    form = (int(rng.integers(4)), *(float(x) for x in some(3)))
    tips = some(N, 3), some(N, 3, 3), some(N, 6, n + 2), some(N)
    laws.roll(form, *tips, some(3), some(3, 3), some(6), some(N, 3), some(N, 3, 3), some(N, 3, 3), np.empty(56 * N + 4 * N * n))
    laws.slip_displacement(some(N, 3), some(N, 3, 3), some(N, 3), some(N, 3), some(N, 3, 3), some(N, 3, 3), np.empty((N, 2)))
    found += laws.keep_contacts(some(r, n), some(r, 6), some(r), some(6), some(n), 0.01, np.empty(n))
    full, padded = int(rng.integers(9)), np.arange(4.0 * N)
    tied, force = (rng.permutation(padded)[: rng.integers(4 * N + 1)] for _ in range(2))
    k, links = len(force), rng.integers(0, 3, N).astype(float)
    sizes = [(43,), (N,), (N, 3), (N, 3, 3), (n,), (n,), (N, 3), (N, 3, 3), (full, n), (2, n), (2, n), (2, n), (N, full)]
    step = laws.Step(form, *(some(*size) for size in sizes), links, tied, force)
    places = tuple(some(*size) for size in 3 * [(3,), (3, 3)])
    told = [some(n), some(n), some(3), some(3, 3), some(6), some(3), some(3, 3), some(6), some(6)]
    told += [*((None if rng.random() < 0.3 else some(n)) for _ in range(3)), some(6), some(N, 3, 3)]
    block = np.zeros(24 + n + k * n + 56 * N + 4 * N * n)
    found += step.want(*told, None if N % 2 else some(6), some(6, full), some(6, full), places, block)
    step.tighten(block, some(n), some(N), np.empty(6 + n))
    before = some(n), some(n), some(k), some(6), some(N, 2), some(N, 3), some(N, 3, 3), some(N, 3)
    assert 0 <= step.settle(block, *before, N % 2, np.empty(n + 3 * N + 6)) <= 7
print(found)
"""
