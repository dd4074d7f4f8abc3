"""The Python binding of the control code in C: wrong arguments are refused by name, and no memory is read out of bounds."""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
from pathlib import Path
from shutil import which
from typing import Any

import numpy as np
import pytest
from support.tip_motions import SHAPES, random_initial_contacts, random_tip_motion

import graspforce
from graspforce.contact.contact import ContactModel

native = pytest.importorskip("graspforce.core._native", reason="the C code was not built: no C compiler at installation")
COMPILER = which(os.environ.get("CC", "cc")) or which("gcc") or which("clang")
SOURCES = Path(graspforce.__file__).parent / "csrc"
N, K, J, M, R = 2, 6, 3, 4, 6  # contacts, force components, motors, joints and constraint rows of a made-up hand

SETTINGS = [
    "posture_stiffness",
    "posture_damping",
    "rank_tolerance",
    "spin_damping",
    "spin_damping_start",
    "period",
    "creep_decay",
    "creep_limit",
]
SETTINGS += ["contact_tolerance", "mass"]
GRASP_ARRAYS = {"kp": (6,), "kd": (6,), "ki": (6,), "integral_limits": (2,), "gravity_H": (3,), "inertia": (3, 3), "p_OM": (3,)}
GRASP_ARRAYS |= {"radii": (N,), "p_OC": (N, 3), "R_OC": (N, 3, 3), "q": (J,), "max_posture_pull": (J,), "p_LF": (N, 3)}
GRASP_ARRAYS |= {"R_LF": (N, 3, 3), "T": (M, J), "torque_limits": (2, J), "saturation_limits": (2, J), "q_limits": (2, J)}
STATE = {"q": (J,), "v": (J,), "p_HO": (3,), "R_HO": (3, 3), "twist": (6,), "p_d": (3,), "R_d": (3, 3), "twist_d": (6,)}
STATE |= {"acceleration_d": (6,), "integral": (6,), "R_OC_last": (N, 3, 3), "joint_twists": (6, M), "joint_twist_rates": (6, M)}
OPTIONAL = {"q_d": (J,), "v_d": (J,), "a_d": (J,), "external": (6,), "spin_acceleration": (N,)}
RESULT_INPUTS = {"q": (J,), "tau_u": (J,), "f": (K,), "integral": (6,), "creep": (N, 2), "p_OF": (N, 3), "R_OF": (N, 3, 3)}
RESULT_INPUTS |= {"p_OC": (N, 3)}
ERRORS = (ValueError, TypeError, BufferError)


def random_arrays(rng: np.random.Generator, shapes: dict[str, tuple[int, ...]]) -> dict[str, np.ndarray]:
    return {name: rng.normal(size=shape) for name, shape in shapes.items()}


def grasp_arguments(rng: np.random.Generator) -> dict[str, Any]:
    """Return the arguments of a `ControlStep`."""
    rows = np.array([0, 1, 2, 4, 5, 6], dtype=np.intc)
    indices = {"tip_links": np.array([1, 2], dtype=np.intc), "moves_tip": np.ones((N, M), dtype=np.bool_)}
    indices |= {"constraint_rows": rows, "force_rows": rows, "surface": ("box", 0.02, 0.03, 0.04)}
    return {**{name: float(rng.normal()) for name in SETTINGS}, **random_arrays(rng, GRASP_ARRAYS), **indices}


def state_arguments(rng: np.random.Generator) -> dict[str, Any]:
    """Return the arguments of `compute_targets` without the output."""
    poses = tuple(rng.normal(size=(3,) if i % 2 == 0 else (3, 3)) for i in range(6))
    return {**random_arrays(rng, STATE | OPTIONAL), "link_poses": poses}


def wrong_arrays(right: np.ndarray) -> list[Any]:
    """Return wrong values for an array: other types, lengths and dimensions."""
    return [right.astype(np.float32), np.zeros(right.size + 1), right[:-1], right[..., None], right.tolist(), None]


def wrong_outputs(right: np.ndarray) -> list[Any]:
    """Return wrong values for an output: other sizes, and read-only memory."""
    return [np.zeros(right.nbytes // 8 + 1), np.zeros(right.nbytes // 8 - 1), bytes(right.nbytes), None]


def assert_refused(call: Any, arguments: dict[str, Any], name: str, values: list[Any]) -> None:
    for value in values:
        with pytest.raises(ERRORS):
            call(**{**arguments, name: value})


def function_arguments(rng: np.random.Generator) -> list[tuple[Any, dict[str, Any], str]]:
    """Return each function with right arguments and the name of its output."""
    tips = random_tip_motion(rng, rng.normal(size=(N, 3)), J)
    contacts = random_initial_contacts(rng, (ContactModel.POINT,) * N)
    roll = {"surface": SHAPES["box"].primitive_parameters, "p_HF": tips.p_HF, "R_HF": tips.R_HF, "rates": tips.rates}
    roll |= {"radii": np.ones(N), "p_HO": np.zeros(3), "R_HO": np.eye(3), "twist": np.zeros(6), "p_OC": contacts.p_OC}
    roll |= {
        "R_OC": contacts.R_OC,
        "R_OC_last": contacts.R_OC,
        "contacts": np.empty((), np.dtype(native.contacts_layout(N, J))),
    }
    keep = {"A": np.ones((2, J)), "B": np.ones((2, 6)), "beta": np.ones(2), "object_acceleration": np.ones(6)}
    keep |= {"posture": np.ones(J), "rank_tolerance": 0.01, "joint_acceleration": np.empty(J)}
    slide = {"p_OF_last": np.ones((N, 3)), "R_OF_last": np.ones((N, 3, 3)), "p_OC_last": np.ones((N, 3))}
    slide |= {"p_OF": np.ones((N, 3)), "R_OF": np.ones((N, 3, 3)), "R_OC": np.ones((N, 3, 3)), "slip": np.empty((N, 2))}
    return [
        (native.compute_contacts, roll, "contacts"),
        (native.joint_accelerations, keep, "joint_acceleration"),
        (native.slip_displacement, slide, "slip"),
    ]


def tracking_arguments(rng: np.random.Generator) -> dict[str, Any]:
    """Return the arguments of `track_contacts`: contacts on a box, near the start."""
    grasp = np.zeros((), np.dtype(native.tracked_grasp_layout(N, J, M)))
    pose = np.zeros((), np.dtype(native.contact_pose_layout(N, J)))
    grasp["period"], grasp["least_eigenvalue"], grasp["radii"], grasp["T"] = 1e-3, 1e-3 * N, 0.01, rng.normal(size=(M, J))
    for block in (grasp, pose):
        block["R_OC"], block["p_OC"] = np.eye(3), 0.02 * rng.normal(size=(N, 3))
    grasp["R_LF"], pose["R_OF"], pose["R_HO"] = np.eye(3), np.eye(3), np.eye(3)
    poses = tuple(0.05 * rng.normal(size=3) if i % 2 == 0 else np.eye(3) for i in range(6))
    indices = {"tip_links": np.array([1, 2], dtype=np.intc), "moves_tip": np.ones((N, M), dtype=np.bool_)}
    motion = {"v": rng.normal(size=J), "joint_twists": rng.normal(size=(6, M)), "joint_twist_rates": rng.normal(size=(6, M))}
    references = {"gap": np.zeros(N), "weights": np.ones((N, 4)), "last": pose, "next": np.empty_like(pose)}
    return {"surface": ("box", 0.02, 0.03, 0.04), **indices, "grasp": grasp, **motion, "link_poses": poses, **references}


def uncertainty_arguments(rng: np.random.Generator) -> dict[str, Any]:
    """Return the arguments of `pose_uncertainty` for the pose of `tracking_arguments`."""
    arguments = tracking_arguments(rng)
    native.track_contacts(**arguments)
    numbers = {"motor_count": J, "least_eigenvalue": 1e-3, "joint_variance": 1e-6, "contact_variance": 1e-10}
    arrays = {"weights": arguments["weights"], "reference": np.eye(4 * N), "pose": arguments["next"]}
    return {**numbers, **arrays, "covariance": np.empty((6, 6)), "free_motions": np.empty((6, 6))}


def fusion_arguments(rng: np.random.Generator) -> dict[str, Any]:
    """Return the arguments of `fuse_pose`."""
    poses = {f"{name}_{of}": value for of in ("measured", "HO") for name, value in (("p", np.zeros(3)), ("R", np.eye(3)))}
    covariances = {name: np.eye(6) for name in ("noise", "contact_covariance", "free_motions")}
    last = {"p": 0.1 * rng.normal(size=3), "R": np.eye(3), "bias": np.zeros(6), "covariance": np.eye(12)}
    numbers = {"position_drift": 0.1, "angle_drift": 0.1, "free_drift": 0.1, "gate": 20.0}
    return {**poses, **covariances, **last, **numbers, "next": np.zeros((), np.dtype(native.offset_layout()))}


def friction_arguments(rng: np.random.Generator) -> dict[str, Any]:
    """Return the arguments of `friction_step`."""
    settings = np.zeros((), np.dtype(native.friction_layout(J)))
    for name in settings.dtype.names:
        settings[name] = rng.uniform(0.1, 1.0, size=settings[name].shape)
    settings["rest_rate"] = 1e-3  # rad/s: far below random rates, so that the plan moves
    arrays = random_arrays(rng, {"A": (R, J), "B": (R, 6), "R_HO": (3, 3), "twist": (6,), "twist_d": (6,), "error": (6,)})
    arrays |= {"v_d": rng.normal(size=J), "level": rng.uniform(size=J)}
    return {
        "friction": settings,
        "observes": True,
        **arrays,
        "result": np.zeros((), np.dtype(native.friction_result_layout(J))),
    }


# ── wrong arguments ───────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_functions_refuse_wrong_arrays() -> None:
    for call, arguments, output in function_arguments(np.random.default_rng(18)):
        call(**arguments)
        for name, value in arguments.items():
            if isinstance(value, np.ndarray):
                assert_refused(call, arguments, name, wrong_outputs(value) if name == output else wrong_arrays(value))


def test_arguments_are_taken_by_keyword_only() -> None:
    rng = np.random.default_rng(19)
    step = native.ControlStep(**grasp_arguments(rng))
    targets = np.empty((), np.dtype(step.targets_layout))
    calls = [(call, arguments) for call, arguments, _ in function_arguments(rng)]
    for call, arguments in [*calls, (step.compute_targets, {**state_arguments(rng), "targets": targets})]:
        call(**dict(reversed(arguments.items())))  # in any order
        with pytest.raises(TypeError, match="keyword arguments only"):
            call(*arguments.values())
        for name in arguments:
            with pytest.raises(TypeError, match=f"needs the argument '{name}'"):
                call(**{other: value for other, value in arguments.items() if other != name})
        with pytest.raises(TypeError, match="has no argument 'extra'"):
            call(**arguments, extra=1.0)


def test_surfaces_are_a_kind_and_three_sizes() -> None:
    (call, arguments, _), *_ = function_arguments(np.random.default_rng(18))
    for surface in (("mesh", 1.0, 1.0, 1.0), (1, 1.0, 1.0, 1.0), ("sphere", 1.0), ["sphere", 1.0, 1.0, 1.0]):
        assert_refused(call, arguments, "surface", [surface])
    with pytest.raises(ValueError, match="surface = 'mesh': must be plane, sphere, cylinder or box"):
        call(**{**arguments, "surface": ("mesh", 1.0, 1.0, 1.0)})
    for exponents in ((), (0.0, 1.0), (1.0, 2.1), (1.0, np.nan)):
        with pytest.raises(ValueError, match="exponents of a superquadric must be greater than 0 and at most 2"):
            call(**{**arguments, "surface": ("superquadric", 1.0, 1.0, 1.0, *exponents)})


def test_contiguity_and_width_are_checked() -> None:
    (roll, contacts, _), (keep, constraints, _), _ = function_arguments(np.random.default_rng(18))
    with pytest.raises(ValueError, match="contiguous"):
        keep(**{**constraints, "A": np.ones((J, 2)).T})
    with pytest.raises(ValueError, match="Jacobian, twist and drift"):
        roll(**{**contacts, "rates": np.zeros((N, 6, 1))})
    with pytest.raises(ValueError, match=r"R_HF must be a float64 array of shape \(2, 3, 3\)"):
        roll(**{**contacts, "R_HF": np.zeros((N, 3))})


def test_construction_refuses_wrong_arguments() -> None:
    arguments = grasp_arguments(np.random.default_rng(23))
    native.ControlStep(**arguments)
    sizes = {"radii": 1, "T": 2, "constraint_rows": 1, "force_rows": 1}  # other lengths are other grasps
    for name, value in arguments.items():
        if not isinstance(value, np.ndarray):
            continue
        for other in wrong_arrays(value):
            if name in sizes and isinstance(other, np.ndarray) and other.dtype == value.dtype and other.ndim == sizes[name]:
                continue
            assert_refused(native.ControlStep, arguments, name, [other])
    for name in SETTINGS:
        assert_refused(native.ControlStep, arguments, name, [None, "high", np.ones(2)])
    for name in arguments:
        with pytest.raises(TypeError, match=f"needs the argument '{name}'"):
            native.ControlStep(**{other: value for other, value in arguments.items() if other != name})
    with pytest.raises(TypeError, match="has no argument 'extra'"):
        native.ControlStep(**arguments, extra=1.0)
    with pytest.raises(TypeError, match="keyword arguments only"):
        native.ControlStep(*arguments.values())
    with pytest.raises(ValueError, match="too long"):
        native.ControlStep(**{**arguments, "radii": np.zeros(5000)})
    for name, limit in (("tip_links", 1 << 12), ("constraint_rows", 4 * N), ("force_rows", 4 * N)):
        for index in (-1, limit, np.iinfo(np.intc).max):
            wrong = arguments[name].copy()
            wrong[-1] = index
            with pytest.raises(ValueError, match=rf"{name}\[{len(wrong) - 1}\] = {index}: must be an index from 0"):
                native.ControlStep(**{**arguments, name: wrong})


def test_steps_refuse_wrong_arrays() -> None:
    rng = np.random.default_rng(23)
    step, state = native.ControlStep(**grasp_arguments(rng)), state_arguments(rng)
    targets = np.empty((), np.dtype(step.targets_layout))
    result = np.empty((), np.dtype(step.result_layout))
    assert step.compute_targets(**state, targets=targets) in (True, False)
    for name, value in state.items():
        if name != "link_poses":
            wrong = [other for other in wrong_arrays(value) if not (name in OPTIONAL and other is None)]
            assert_refused(step.compute_targets, {**state, "targets": targets}, name, wrong)
    poses = state["link_poses"]
    wrong = [poses[:5], list(poses), (*poses[:2], None, *poses[3:]), (*poses[:3], poses[0], *poses[4:]), None]
    assert_refused(step.compute_targets, {**state, "targets": targets}, "link_poses", wrong)
    assert_refused(step.compute_targets, state, "targets", wrong_outputs(targets))

    margin = {
        "targets": targets,
        "tau_u": np.ones(J),
        "shift": np.ones(N),
        "w_shifted": np.empty(6),
        "tau_shifted": np.empty(J),
    }
    outcome = {**random_arrays(rng, RESULT_INPUTS), "targets": targets, "integral_rule": 1, "result": result}
    for call, arguments in ((step.apply_slip_margin, margin), (step.compute_result, outcome)):
        call(**arguments)
        for name, value in arguments.items():
            if name in ("w_shifted", "tau_shifted", "result"):
                assert_refused(call, arguments, name, wrong_outputs(value))
            elif name == "targets":
                assert_refused(call, arguments, name, [*wrong_outputs(value)[:2], None])
            elif name == "integral_rule":
                assert_refused(call, arguments, name, [-1, 3, None, 1.0])
            else:
                assert_refused(call, arguments, name, wrong_arrays(value))


def test_tracking_refuses_wrong_arrays() -> None:
    arguments = tracking_arguments(np.random.default_rng(31))
    assert native.track_contacts(**arguments) >= 1
    assert all(np.isfinite(arguments["next"][name]).all() for name in arguments["next"].dtype.names)
    for name in ("v", "joint_twists", "joint_twist_rates", "gap", "weights"):
        assert_refused(native.track_contacts, arguments, name, wrong_arrays(arguments[name]))
    for name in ("grasp", "last"):
        assert_refused(native.track_contacts, arguments, name, [*wrong_outputs(arguments[name])[:2], None])
    assert_refused(native.track_contacts, arguments, "next", wrong_outputs(arguments["next"]))
    for name, dimension in (("tip_links", np.float64), ("moves_tip", np.uint8)):
        right = arguments[name]
        assert_refused(native.track_contacts, arguments, name, [right.astype(dimension), right[:1], right[None], None])
    for index in (-1, 3, 5000):
        assert_refused(native.track_contacts, arguments, "tip_links", [np.array([0, index], dtype=np.intc)])
    assert_refused(native.track_contacts, arguments, "link_poses", [list(arguments["link_poses"]), (), None])
    with pytest.raises(TypeError, match="keyword arguments only"):
        native.track_contacts(*arguments.values())


def test_uncertainty_fusion_and_motions_refuse_wrong_arrays() -> None:
    rng = np.random.default_rng(33)
    poses = {"p": np.zeros(3), "R": np.eye(3), "p_target": np.zeros(3), "R_target": np.eye(3), "share": 0.5}
    poses |= {"p_next": np.empty(3), "R_next": np.empty((3, 3))}
    uncertainty, fusion = uncertainty_arguments(rng), fusion_arguments(rng)
    assert native.pose_uncertainty(**uncertainty) is True
    assert native.fuse_pose(**fusion) == 2
    assert native.fuse_pose(**{**fusion, "gate": 0.0}) == 1
    assert native.fuse_pose(**{**fusion, "noise": -9.0 * np.eye(6)}) == 0
    assert native.interpolate_pose(**poses) == 0.0
    body = {"p_HO": np.ones(3), "R_HO": np.eye(3), "twist": np.ones(6), "acceleration": np.ones(6)}
    motion = np.zeros((), np.dtype(native.body_motion_layout()))
    frame = {**body, "p_OP": np.ones(3), "R_OP": np.eye(3), "motion": motion}
    calls: list[tuple[Any, dict[str, Any]]] = [(native.pose_uncertainty, uncertainty), (native.fuse_pose, fusion)]
    calls += [(native.interpolate_pose, poses), (native.fixed_frame_motion, frame)]
    calls += [(native.motion_after, {**body, "duration": 0.1, "motion": motion})]
    outputs = ("covariance", "free_motions", "next", "p_next", "R_next", "motion")
    for call, arguments in calls:
        call(**arguments)
        for name, value in arguments.items():
            if not isinstance(value, np.ndarray):
                assert_refused(call, arguments, name, [None, "high"])
            elif name == "pose":
                assert_refused(call, arguments, name, [*wrong_outputs(value)[:2], None])
            elif name == "weights":  # another length is another grasp, whose other arrays do not fit
                assert_refused(call, arguments, name, wrong_arrays(value))
            else:
                is_output = name in outputs and not (call is native.fuse_pose and name != "next")
                assert_refused(call, arguments, name, wrong_outputs(value) if is_output else wrong_arrays(value))
    assert_refused(native.pose_uncertainty, uncertainty, "motor_count", [-1, 5000, np.nan, J + 1])


def force_arguments(rng: np.random.Generator) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the arguments of `force_gains` and of `contact_forces`."""
    model = np.zeros((), np.dtype(native.force_model_layout(N)))
    for name in model.dtype.names or ():
        model[name] = 1.0
    pose = np.zeros((), np.dtype(native.contact_pose_layout(N, J)))
    pose["R_HO"], pose["R_OC"], pose["A"] = np.eye(3), np.eye(3), rng.normal(size=(3 * N, J))
    shared = {"contact_count": N, "tau": rng.normal(size=J), "tip_wrench": rng.normal(size=(N, 6)), "pose": pose}
    shared["gains"] = np.zeros((), np.dtype(native.force_gains_layout(N, J)))
    forces = np.zeros((), np.dtype(native.contact_forces_layout(N)))
    motion = {"tau_u": rng.normal(size=J), "deviation": rng.normal(size=J), "forces": forces}
    return {**shared, "model": model, "M": np.eye(J)}, {**shared, **motion}


def test_contact_forces_refuse_wrong_arrays() -> None:
    gains, forces = force_arguments(np.random.default_rng(35))
    assert native.force_gains(**gains) is True
    assert native.force_gains(**{**gains, "M": np.full((J, J), np.nan)}) is False
    assert native.force_gains(**gains) is True
    native.contact_forces(**forces)
    assert np.abs(forces["forces"]["f"]).max() > 0.0
    native.contact_forces(**{**forces, "tip_wrench": None})
    assert not forces["forces"]["measured"].any()
    outputs = {native.force_gains: "gains", native.contact_forces: "forces"}
    for call, arguments in ((native.force_gains, gains), (native.contact_forces, forces)):
        for name, value in arguments.items():
            if name == "contact_count":
                assert_refused(call, arguments, name, [None, "high", -1, 5000, N + 1])
            elif name == outputs[call]:
                assert_refused(call, arguments, name, wrong_outputs(value))
            elif name in ("gains", "pose", "model"):
                assert_refused(call, arguments, name, [*wrong_outputs(value)[:2], None])
            else:
                assert_refused(call, arguments, name, [other for other in wrong_arrays(value) if other is not None])


def slip_arguments(rng: np.random.Generator, window_count: int = 2) -> dict[str, Any]:
    """Return the arguments of `slip_step`."""
    _, forces = force_arguments(rng)
    settings, state, test = (
        np.zeros((), np.dtype(layout(N, window_count)))
        for layout in (native.slip_settings_layout, native.slip_state_layout, native.slip_test_layout)
    )
    for name in settings.dtype.names or ():
        settings[name] = 1.0
    arguments = {"contact_count": N, "window_count": window_count, "t": 1.0, "joint_error": rng.normal(size=J)}
    arguments |= {"pose_error": rng.normal(size=6), "mu": np.ones(N), "settings": settings, "pose": forces["pose"]}
    arguments |= {"forces": forces["forces"], "gains": forces["gains"], "last": state, "contact_test": test}
    return {**arguments, "pose_test": test, "fresh": test.copy(), "next": state.copy()}


def test_slip_detector_refuses_wrong_arrays() -> None:
    arguments = slip_arguments(np.random.default_rng(36))
    has_residuals, new_test = 1, 2
    assert native.slip_step(**arguments) & (has_residuals | new_test) == has_residuals | new_test
    without = {"pose_error": None, "mu": None, "forces": None, "gains": None, "contact_test": None, "pose_test": None}
    assert native.slip_step(**{**arguments, **without}) & has_residuals
    assert native.slip_step(**{**arguments, "pose_error": np.full(6, np.nan), "t": 1.0}) >= 0
    degenerate = arguments["settings"].copy()
    degenerate["compliance"] = degenerate["encoder_noise"] = degenerate["encoder_bias"] = -1.0
    assert native.slip_step(**{**arguments, "settings": degenerate}) == -1
    for name, value in arguments.items():
        if name in ("contact_count", "window_count"):
            assert_refused(native.slip_step, arguments, name, [None, "high", -1, 5000, value + 1])
        elif name == "t":
            assert_refused(native.slip_step, arguments, name, [None, "high"])
        elif name in ("fresh", "next"):
            assert_refused(native.slip_step, arguments, name, wrong_outputs(value))
        elif name in ("settings", "pose", "last", "gains"):
            assert_refused(native.slip_step, arguments, name, [*wrong_outputs(value)[:2], None])
        elif name in ("forces", "contact_test", "pose_test"):
            assert_refused(native.slip_step, arguments, name, wrong_outputs(value)[:2])
        else:
            assert_refused(native.slip_step, arguments, name, [other for other in wrong_arrays(value) if other is not None])


def test_test_for_precautions_refuses_wrong_arrays() -> None:
    rng = np.random.default_rng(38)
    settings = np.ones((), np.dtype(native.precaution_settings_layout()))
    state = np.zeros((), np.dtype(native.precaution_state_layout(N)))
    slip = slip_arguments(rng)
    arguments = {"contact_count": N, "motor_count": J, "window_count": slip["window_count"], "p_HO": rng.normal(size=3)}
    arguments |= {"R_HO": np.eye(3), "settings": settings, "pose": slip["pose"], "slip": slip["last"]}
    arguments |= {"last": state, "next": state.copy()}
    assert native.precaution_step(**arguments) == 0  # the first period has no test
    assert arguments["next"]["updates"] == 1.0
    for name, value in arguments.items():
        if name.endswith("_count"):
            assert_refused(native.precaution_step, arguments, name, [None, "high", -1, 5000, value + 1])
        elif name == "next":
            assert_refused(native.precaution_step, arguments, name, wrong_outputs(value))
        elif name in ("settings", "pose", "slip", "last"):
            assert_refused(native.precaution_step, arguments, name, [*wrong_outputs(value)[:2], None])
        else:
            assert_refused(native.precaution_step, arguments, name, wrong_arrays(value))


def payload_arguments(rng: np.random.Generator) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the arguments of `payload_inputs` and of `payload_step`."""
    _, forces = force_arguments(rng)
    settings, inputs, state = (
        np.zeros((), np.dtype(layout()))
        for layout in (native.payload_settings_layout, native.payload_inputs_layout, native.payload_state_layout)
    )
    for name in settings.dtype.names or ():
        settings[name] = 1.0
    motion = {"motor_count": J, "force_sum": rng.normal(size=(N, 3)), "periods": 8.0, "acceleration": rng.normal(size=6)}
    motion |= {"twist": rng.normal(size=6), "gravity_H": np.array([0.0, 0.0, -9.81]), "pose": forces["pose"]}
    state["mass"] = 1.0
    step = {"settings": settings, "inputs": inputs, "last": state, "next": state.copy()}
    return {**motion, "gains": forces["gains"], "inputs": inputs}, step


def test_payload_refuses_wrong_arrays() -> None:
    inputs, step = payload_arguments(np.random.default_rng(37))
    native.payload_inputs(**inputs)
    assert native.payload_step(**step) is True
    assert np.isfinite(step["next"]["covariance"]).all()
    degenerate = step["inputs"].copy()
    degenerate["noise"] = -np.eye(6)
    assert native.payload_step(**{**step, "inputs": degenerate}) is False
    for call, arguments in ((native.payload_inputs, inputs), (native.payload_step, step)):
        for name, value in arguments.items():
            if name == "motor_count":
                assert_refused(call, arguments, name, [None, "high", -1, 5000, J + 1])
            elif name == "periods":
                assert_refused(call, arguments, name, [None, "high"])
            elif name == "next" or (name == "inputs" and call is native.payload_inputs):
                assert_refused(call, arguments, name, wrong_outputs(value))
            elif value.dtype.names is not None:
                assert_refused(call, arguments, name, [*wrong_outputs(value)[:2], None])
            else:
                assert_refused(call, arguments, name, wrong_arrays(value))


def test_friction_bounds_refuse_wrong_arrays() -> None:
    rng = np.random.default_rng(38)
    _, forces = force_arguments(rng)
    settings, state = (
        np.zeros((), np.dtype(layout(N))) for layout in (native.bound_settings_layout, native.bound_state_layout)
    )
    for name in settings.dtype.names or ():
        settings[name] = 0.5
    forces["forces"]["f"] = forces["forces"]["measured"] = [[0.1, 0.2, 1.0]] * N
    arguments = {"motor_count": J, "has_tips": True, "has_alarm": True, "is_certain": True, "distance": np.ones((N, 2))}
    arguments |= {"slipping": np.ones(N, bool), "alarms": np.ones(N, bool), "settings": settings}
    arguments |= {"forces": forces["forces"], "gains": forces["gains"], "last": state, "next": state.copy()}
    assert native.friction_bounds_step(**arguments) is True
    assert native.friction_bounds_step(**{**arguments, "has_alarm": False, "has_tips": False}) is False
    for name in ("distance", "settings", "forces", "gains", "last", "next"):
        wrong = wrong_outputs(arguments[name]) if name == "next" else wrong_outputs(arguments[name])[:2]
        assert_refused(native.friction_bounds_step, arguments, name, [*wrong, None])
    for name in ("slipping", "alarms"):
        assert_refused(native.friction_bounds_step, arguments, name, [np.ones(N), np.ones(N + 1, bool), None])
    assert_refused(native.friction_bounds_step, arguments, "motor_count", [None, "high", -1, 5000, J + 1])


def test_joint_filter_refuses_wrong_arrays() -> None:
    joints = {"gains": np.ones((3, 6)), "x": np.ones((3, J)), "commands": np.ones((2, J)), "acceleration": np.ones(J)}
    joints |= {"limits": np.ones(J), "q": np.ones(J), "v": np.ones(J), "prediction": np.ones((3, 5))}
    joints |= {"next": np.empty((3, J)), "next_commands": np.empty((2, J)), "present": np.empty((3, J))}
    native.filter_joints(**joints)
    native.filter_joints(**{**joints, "acceleration": None, "v": None, "gains": np.ones((3, 5))})
    without = {"commands": np.ones((0, J)), "prediction": None, "next_commands": None, "present": None}
    native.filter_joints(**{**joints, **without})
    for name, value in joints.items():
        wrong = wrong_outputs(value) if name in ("next", "next_commands", "present") else wrong_arrays(value)
        wrong = [other for other in wrong if not (name == "acceleration" and other is None)]
        assert_refused(native.filter_joints, joints, name, wrong)
    with pytest.raises(ValueError, match="contiguous"):
        native.filter_joints(**{**joints, "x": np.asfortranarray(joints["x"])})


def test_tracking_of_numbers_that_are_not_finite_returns_zero() -> None:
    arguments = tracking_arguments(np.random.default_rng(32))
    assert native.track_contacts(**{**arguments, "v": np.array([np.nan, 0.0, 0.0])}) == 0
    assert native.track_contacts(**{**arguments, "gap": np.array([np.inf, 0.0])}) == 0


def test_friction_refuses_wrong_arrays() -> None:
    arguments = friction_arguments(np.random.default_rng(34))
    assert native.friction_step(**arguments) == 0
    assert all(np.isfinite(arguments["result"][name]).all() for name in arguments["result"].dtype.names)
    assert native.friction_step(**{**arguments, "v_d": None}) == 0
    assert native.friction_step(**{**arguments, "v_d": None, "twist_d": np.zeros(6)}) == 1
    for name, value in arguments.items():
        if name == "friction":
            assert_refused(native.friction_step, arguments, name, [*wrong_outputs(value)[:2], None])
        elif name == "result":
            assert_refused(native.friction_step, arguments, name, wrong_outputs(value))
        elif isinstance(value, np.ndarray):
            wrong = [other for other in wrong_arrays(value) if not (name == "v_d" and other is None)]
            assert_refused(native.friction_step, arguments, name, wrong)
    for name in ("A", "B"):
        with pytest.raises(ValueError, match="contiguous"):
            native.friction_step(**{**arguments, name: np.asfortranarray(arguments[name])})
    with pytest.raises(ValueError, match="at most 4096"):
        native.friction_step(**{**arguments, "A": np.zeros((5000, J))})


def test_friction_of_numbers_that_are_not_finite_is_refused() -> None:
    arguments = friction_arguments(np.random.default_rng(35))
    for name in ("A", "B", "R_HO", "twist", "twist_d", "error", "v_d", "level"):
        wrong = arguments[name].copy()
        wrong.flat[0] = np.nan
        assert native.friction_step(**{**arguments, name: wrong}) == -1, name


# ── memory ────────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def strided(value: Any) -> Any:
    """Return an equal array that is not contiguous."""
    if isinstance(value, tuple):
        return tuple(map(strided, value))
    if not isinstance(value, np.ndarray):
        return value
    return np.repeat(value, 2)[::2] if value.ndim == 1 else np.asfortranarray(value)


def test_results_do_not_depend_on_the_memory_order_of_arrays() -> None:
    rng = np.random.default_rng(24)
    grasp, state = grasp_arguments(rng), state_arguments(rng)
    step = native.ControlStep(**grasp)
    fortran = native.ControlStep(**{name: strided(grasp[name]) if name in GRASP_ARRAYS else grasp[name] for name in grasp})
    dtype = np.dtype(step.targets_layout)
    straight, turned = np.empty((), dtype), np.empty((), dtype)
    is_complete = step.compute_targets(**state, targets=straight)
    assert fortran.compute_targets(**{name: strided(value) for name, value in state.items()}, targets=turned) == is_complete
    for name in dtype.names:
        if is_complete or name not in ("w", "joint_acceleration"):
            np.testing.assert_array_equal(straight[name], turned[name], err_msg=name)

    (roll, arguments, output), *_ = function_arguments(rng)
    again = np.empty((), arguments[output].dtype)
    roll(**arguments)
    others = ("p_HF", "R_HF", "R_HO", "p_OC", "R_OC", "R_OC_last")
    roll(**{**arguments, **{name: strided(arguments[name]) for name in others}, output: again})
    assert again.tobytes() == arguments[output].tobytes()


def test_layouts_are_float64_arrays_without_gaps() -> None:
    step = native.ControlStep(**grasp_arguments(np.random.default_rng(25)))
    tracking = native.tracked_grasp_layout(N, J, M), native.contact_pose_layout(N, J)
    friction = native.friction_layout(J), native.friction_result_layout(J)
    others = native.contacts_layout(N, J), native.offset_layout(), native.body_motion_layout(), *tracking, *friction
    for layout in (step.targets_layout, step.result_layout, *others):
        dtype, end = np.dtype(layout), 0
        for name in dtype.names:
            part, offset = dtype.fields[name][:2]
            assert (part.base, offset) == (np.dtype(np.float64), end), name
            end += part.itemsize
        assert dtype.itemsize == end
    contacts = np.dtype(native.contacts_layout(N, J))
    assert np.dtype(step.targets_layout).names[-len(contacts.names) :] == contacts.names


@pytest.mark.skipif(COMPILER is None, reason="no C compiler")
def test_c_code_is_clean_under_sanitizers(tmp_path: Path) -> None:
    """A build with both sanitizers and all warnings computes with odd numbers, and reads damaged messages."""
    found = subprocess.run([COMPILER, "-print-file-name=libasan.so"], capture_output=True, text=True, check=False)
    library = found.stdout.strip()
    if not os.path.isabs(library):
        pytest.skip("this compiler has no shared sanitizer")
    module = tmp_path / ("_native" + str(sysconfig.get_config_var("EXT_SUFFIX")))
    flags = ["-std=c11", "-O0", "-g", "-fPIC", "-shared", "-Wall", "-Wextra", "-Wshadow", "-Werror", f"-I{SOURCES / 'include'}"]
    flags += ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", f"-I{sysconfig.get_paths()['include']}"]
    sources = [SOURCES / "python/control_module.c", *sorted((SOURCES / "control").glob("*.c"))]
    subprocess.run([COMPILER, *flags, *map(str, sources), "-lm", "-o", str(module)], check=True)
    # Leaks are not reported: the interpreter keeps memory until it ends. Python's own allocator would hide small overruns.
    environment = {**os.environ, "LD_PRELOAD": library, "ASAN_OPTIONS": "detect_leaks=0", "OPENBLAS_NUM_THREADS": "1"}
    environment["PYTHONMALLOC"] = "malloc"
    support = Path(__file__).parents[1] / "support"
    numbers = run_script([support / "odd_control_numbers.py", module], environment)
    assert min(numbers) > 100  # joint accelerations and poses found in spite of the odd numbers
    states, commands, genuine = run_script([support / "odd_messages.py", module, 2000], environment)
    assert min(states, commands) > 10  # damaged numbers are numbers, too
    assert genuine in (0, 2000)  # 0 on processors without SHA instructions


def run_script(arguments: list[object], environment: dict[str, str]) -> list[int]:
    """Return the integers that a script prints."""
    command = [sys.executable, *map(str, arguments)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return [int(number) for number in done.stdout.split()]
