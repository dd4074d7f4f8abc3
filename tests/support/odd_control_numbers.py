"""Call a build of the control code in C with odd numbers and sizes: `python odd_control_numbers.py MODULE`.

It prints how often joint accelerations were found, poses tracked, and poses fused. The sanitizers of the build report wrong
memory accesses.
"""

from __future__ import annotations

import importlib.util
import sys

import numpy as np

ODD = [0.0, -0.0, 1e300, -1e300, 5e-324, np.inf, -np.inf, np.nan, 1e154]
ROUNDS = 1500
rng = np.random.default_rng(1)


def some(*shape: int) -> np.ndarray:
    """Return a random array; one in five has an odd number."""
    array = rng.normal(size=shape)
    if array.size and rng.random() < 0.2:
        array.flat[rng.integers(array.size)] = rng.choice(ODD)
    return array


def maybe(*shape: int) -> np.ndarray | None:
    return None if rng.random() < 0.3 else some(*shape)


def call_functions(native, N: int, n: int, r: int, surface: tuple) -> bool:
    contacts = np.empty((), np.dtype(native.contacts_layout(N, n)))
    tips = {"p_HF": some(N, 3), "R_HF": some(N, 3, 3), "rates": some(N, 6, n + 2), "radii": some(N)}
    start = {"p_OC": some(N, 3), "R_OC": some(N, 3, 3), "R_OC_last": some(N, 3, 3)}
    pose = {"p_HO": some(3), "R_HO": some(3, 3), "twist": some(6)}
    native.compute_contacts(surface=surface, **tips, **pose, **start, contacts=contacts)
    last = {"p_OF_last": some(N, 3), "R_OF_last": some(N, 3, 3), "p_OC_last": some(N, 3)}
    native.slip_displacement(**last, p_OF=some(N, 3), R_OF=some(N, 3, 3), R_OC=some(N, 3, 3), slip=np.empty((N, 2)))
    rows = {"A": some(r, n), "B": some(r, 6), "beta": some(r), "object_acceleration": some(6), "posture": some(n)}
    return native.joint_accelerations(**rows, rank_tolerance=0.01, joint_acceleration=np.empty(n))


def call_step(native, N: int, n: int, surface: tuple) -> bool:
    m, padded = int(rng.integers(9)), np.arange(4 * N, dtype=np.intc)
    constraint_rows, force_rows = (rng.permutation(padded)[: rng.integers(4 * N + 1)] for _ in range(2))
    numbers = [
        "posture_stiffness",
        "posture_damping",
        "rank_tolerance",
        "spin_damping",
        "spin_damping_start",
        "period",
        "creep_decay",
        "creep_limit",
    ]
    arrays = {"kp": (6,), "kd": (6,), "ki": (6,), "integral_limits": (2,), "gravity_H": (3,), "inertia": (3, 3), "p_OM": (3,)}
    arrays |= {"radii": (N,), "p_OC": (N, 3), "R_OC": (N, 3, 3), "q": (n,), "max_posture_pull": (n,), "p_LF": (N, 3)}
    arrays |= {"R_LF": (N, 3, 3), "T": (m, n), "torque_limits": (2, n), "saturation_limits": (2, n), "q_limits": (2, n)}
    step = native.ControlStep(
        **{name: float(some(1)[0]) for name in [*numbers, "contact_tolerance", "mass"]},
        **{name: some(*shape) for name, shape in arrays.items()},
        surface=surface,
        tip_links=rng.integers(0, 3, N).astype(np.intc),
        moves_tip=rng.random((N, m)) < 0.7,
        constraint_rows=constraint_rows,
        force_rows=force_rows,
    )
    targets, result = np.zeros((), np.dtype(step.targets_layout)), np.empty((), np.dtype(step.result_layout))
    measured = {"q": some(n), "v": some(n), "p_HO": some(3), "R_HO": some(3, 3), "twist": some(6)}
    desired = {"p_d": some(3), "R_d": some(3, 3), "twist_d": some(6), "acceleration_d": some(6)}
    joints = {"q_d": maybe(n), "v_d": maybe(n), "a_d": maybe(n), "external": maybe(6), "spin_acceleration": maybe(N)}
    memory = {"integral": some(6), "R_OC_last": some(N, 3, 3)}
    tree = {"joint_twists": some(6, m), "joint_twist_rates": some(6, m)}
    tree["link_poses"] = tuple(some(*size) for size in 3 * [(3,), (3, 3)])
    is_complete = step.compute_targets(**measured, **desired, **memory, **joints, **tree, targets=targets)
    margin = {"tau_u": some(n), "shift": some(N), "w_shifted": np.empty(6), "tau_shifted": np.empty(n)}
    step.apply_slip_margin(targets=targets, **margin)
    last = {"integral": some(6), "creep": some(N, 2), "p_OF": some(N, 3), "R_OF": some(N, 3, 3), "p_OC": some(N, 3)}
    forces = {"q": some(n), "tau_u": some(n), "f": some(len(force_rows))}
    flags = step.compute_result(**forces, **last, targets=targets, integral_rule=N % 3, result=result)
    assert 0 <= flags <= native.SATURATED | native.CONTACT_LOST | native.JOINT_LIMIT
    return is_complete


def fill(layout: dict) -> np.ndarray:
    """Return a block of that layout with random arrays."""
    block = np.zeros((), np.dtype(layout))
    for name in block.dtype.names:
        block[name] = some(*block.dtype[name].shape)
    return block


def call_tracking(native, N: int, n: int, surface: tuple) -> bool:
    m = int(rng.integers(9))
    weights = rng.choice([0.0, 1.0], (N, 4)) if rng.random() < 0.5 else some(N, 4)
    iterations = native.track_contacts(
        surface=surface,
        tip_links=rng.integers(0, 3, N).astype(np.intc),
        moves_tip=rng.random((N, m)) < 0.7,
        grasp=fill(native.tracked_grasp_layout(N, n, m)),
        v=some(n),
        joint_twists=some(6, m),
        joint_twist_rates=some(6, m),
        link_poses=tuple(some(*size) for size in 3 * [(3,), (3, 3)]),
        gap=some(N),
        weights=weights,
        last=fill(native.contact_pose_layout(N, n)),
        next=np.empty((), np.dtype(native.contact_pose_layout(N, n))),
    )
    assert 0 <= iterations <= 10
    native.pose_uncertainty(
        motor_count=n,
        least_eigenvalue=float(some(1)[0]),
        joint_variance=float(some(1)[0]),
        contact_variance=float(some(1)[0]),
        weights=weights,
        reference=some(4 * N, 4 * N),
        pose=fill(native.contact_pose_layout(N, n)),
        covariance=np.empty((6, 6)),
        free_motions=np.empty((6, 6)),
    )
    return iterations > 0


def call_fusion_and_filter(native) -> bool:
    root = some(12, 12)
    numbers = ["position_drift", "angle_drift", "free_drift"]
    result = native.fuse_pose(
        p_measured=some(3),
        R_measured=some(3, 3),
        noise=np.eye(6),
        p_HO=some(3),
        R_HO=some(3, 3),
        contact_covariance=some(6, 6) if rng.random() < 0.2 else np.eye(6),
        free_motions=some(6, 6),
        p=some(3),
        R=some(3, 3),
        bias=some(6),
        covariance=root @ root.T,
        **{name: abs(float(some(1)[0])) for name in numbers},
        gate=float(some(1)[0] + 20.0),
        next=np.empty((), np.dtype(native.offset_layout())),
    )
    assert result in (0, 1, 2)
    n, m, width = int(rng.integers(9)), int(rng.integers(4)), int(rng.integers(5, 7))
    joints = {"x": some(3, n), "acceleration": maybe(n), "limits": some(n), "q": some(n), "v": some(n) if width == 6 else None}
    delay = {
        "commands": some(m, n),
        "prediction": some(3, 3 + m),
        "next_commands": np.empty((m, n)),
        "present": np.empty((3, n)),
    }
    native.filter_joints(gains=some(3, width), **joints, **delay, next=np.empty((3, n)))
    pose, target = {"p": some(3), "R": some(3, 3)}, {"p_target": some(3), "R_target": some(3, 3)}
    native.interpolate_pose(**pose, **target, share=float(some(1)[0]), p_next=np.empty(3), R_next=np.empty((3, 3)))
    return result == 2


def call_contact_forces(native, N, n) -> bool:
    def fill(layout):
        block = np.zeros((), np.dtype(layout))
        for name in block.dtype.names:
            block[name] = some(*block[name].shape)
        return block

    shared = {"contact_count": N, "tau": some(n), "tip_wrench": maybe(N, 6), "pose": fill(native.contact_pose_layout(N, n))}
    shared["gains"] = np.zeros((), np.dtype(native.force_gains_layout(N, n)))
    root = some(n, n)
    is_definite = native.force_gains(**shared, model=fill(native.force_model_layout(N)), M=root @ root.T)
    forces = np.zeros((), np.dtype(native.contact_forces_layout(N)))
    native.contact_forces(**shared, tau_u=some(n), deviation=some(n), forces=forces)
    K = int(rng.integers(1, 4))
    state, test = np.dtype(native.slip_state_layout(N, K)), fill(native.slip_test_layout(N, K))
    measured = {"joint_error": some(n), "pose_error": maybe(6), "mu": maybe(N), "pose": shared["pose"]}
    last, used = fill(state), rng.random() < 0.5
    last["test_updates"] = 0.0 if used else 5.0
    bits = native.slip_step(
        contact_count=N,
        window_count=K,
        t=float(some(1)[0]),
        **measured,
        settings=fill(native.slip_settings_layout(N, K)),
        forces=forces if used else None,
        gains=shared["gains"],
        last=last,
        contact_test=None if used else test,
        pose_test=None if used else test,
        fresh=test.copy(),
        next=np.empty((), state),
    )
    assert bits >= -1
    moved = {"force_sum": some(N, 3), "acceleration": some(6), "twist": some(6), "gravity_H": some(3)}
    inputs = np.zeros((), np.dtype(native.payload_inputs_layout()))
    fields = {"pose": shared["pose"], "gains": shared["gains"]}
    native.payload_inputs(motor_count=n, periods=8.0, **moved, **fields, inputs=inputs)
    payload = np.dtype(native.payload_state_layout())
    settings = fill(native.payload_settings_layout())
    native.payload_step(settings=settings, inputs=inputs, last=fill(payload), next=np.empty((), payload))
    bounds = np.dtype(native.bound_state_layout(N))
    flags = {name: bool(rng.random() < 0.5) for name in ("has_tips", "has_alarm", "is_certain")}
    masks = {name: rng.random(N) < 0.5 for name in ("slipping", "alarms")}
    native.friction_bounds_step(
        motor_count=n,
        **flags,
        **masks,
        distance=some(N, 2),
        settings=fill(native.bound_settings_layout(N)),
        forces=forces,
        gains=shared["gains"],
        last=fill(bounds),
        next=np.empty((), bounds),
    )
    return is_definite


def main(module: str) -> None:
    spec = importlib.util.spec_from_file_location("_native", module)
    native = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(native)
    np.seterr(all="ignore")
    found = tracked = fused = weighed = 0
    for _ in range(ROUNDS):
        N, n, r = (int(x) for x in rng.integers([0, 0, 0], [5, 9, 9]))
        kind = rng.choice(["plane", "sphere", "cylinder", "box"])
        surface = (str(kind), *(float(x) for x in some(3)))
        found += call_functions(native, N, n, r, surface)
        found += call_step(native, N, n, surface)
        tracked += call_tracking(native, N, n, surface)
        fused += call_fusion_and_filter(native)
        weighed += call_contact_forces(native, N, n)
    print(found, tracked, fused, weighed)


if __name__ == "__main__":
    main(sys.argv[1])
