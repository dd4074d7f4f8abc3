"""Accuracy of the closed loop in MuJoCo: python -m benchmarks.closed_loop [--full] [--save FILE].

The plant runs at 1 kHz with the torque limits of the hands and perfect measurements. The short form uses three fingers of the
Allegro hand and a free sphere of 50 g and 30 mm radius, μ = 0.7, palm up. The full form adds a minute at rest, and every
shipped hand with a ball, a box and a cylinder of the IST object set.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import mujoco
import numpy as np
from rich.progress import Progress, SpinnerColumn, TextColumn
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from benchmarks import closed_loop_hands, report_page
from benchmarks.mujoco_loop import PALM_UP, Row, run
from graspforce import Contact, ContactSet, Hand, simulation
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, ObjectController, PoseGains
from graspforce.core.arrays import Array
from graspforce.geometry import Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.simulation import FrictionChange, Plant, Push, Recording, compute_metrics

TITLE = "Accuracy of the closed loop in MuJoCo"
PD = PoseGains(ki_linear=0.0, ki_angular=0.0)


def main() -> None:
    """Measure, print the table and write the page."""
    parser = report_page.parser("closed_loop", __doc__)
    parser.add_argument("--full", action="store_true", help="add a minute at rest and every shipped hand (about ten minutes)")
    options = parser.parse_args()
    rows: list[Row] = []
    parts: list[Callable[[], Iterator[Row]]] = [sinusoids, pushes, masses, frictions, rest, speed]
    if options.full:
        parts += [rest_for_a_minute, *closed_loop_hands.PARTS]
    with Progress(SpinnerColumn(), TextColumn("{task.description}"), transient=True) as progress:
        task = progress.add_task("")
        for part in parts:
            progress.update(task, description=(part.__doc__ or "").splitlines()[0])
            for row in part():
                rows.append(row)
                progress.console.print(f"{'ok ' if row.is_met else 'NO '} {row.label}: {row.measured}", highlight=False)
    head = ("quantity", "requirement", "measured", "met")
    cells = [(row.label, row.requirement, row.measured, "yes" if row.is_met else "no") for row in rows]
    report_page.show(TITLE, head, cells, width=150)
    if options.save:
        facts = report_page.facts(f"MuJoCo {mujoco.__version__}")
        report_page.save(options.save, TITLE, __doc__, facts, report_page.table(head, cells, text_columns=4))


def three_finger_grasp() -> Grasp:
    """Return the grasp of the sphere by index, middle finger and thumb of the right Allegro hand."""
    hand, shape = Hand.load("allegro_right"), Sphere(0.03)
    normals = np.array([[-0.2, -0.45, -0.9], [-0.2, 0.45, -0.9], [-0.2, 0.0, 1.0]])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    contacts = ContactSet.stack([Contact(-shape.radius * n, n, 0.7) for n in normals])
    p_HO, fingers = np.array([0.07, 0.03, 0.01]), ("index", "middle", "thumb")
    q = hand.grasp_posture(fingers, contacts, p_HO, np.eye(3))
    return Grasp(hand, Body.solid(shape, 0.05), fingers, contacts, q, p_HO, np.eye(3))


def sinusoids() -> Iterator[Row]:
    """Measure the tracking error of sinusoids of 10 mm peak to peak along each axis"""
    worst_force, max_cone_violation, slip_steps = 0.0, 0.0, 0
    for frequency, requirement in ((1.0, 0.05), (3.0, 0.15)):
        for axis in range(3):
            travel = 0.01 * np.eye(3)[axis]
            metrics = compute_metrics(
                run(
                    three_finger_grasp(),
                    2.0,
                    lambda start, d=travel, f=frequency: simulation.linear_reference(start, d, 1.0 / f),
                )
            )
            worst_force, max_cone_violation, slip_steps = (
                max(worst_force, metrics.force_error),
                max(max_cone_violation, metrics.max_cone_violation),
                slip_steps + metrics.slip_steps,
            )
            label = f"10 mm peak to peak at {frequency:g} Hz along {'xyz'[axis]}: position error, RMS"
            yield Row(
                label,
                f"≤ {requirement} mm",
                f"{1e3 * metrics.position_error_rms:.4f} mm",
                1e3 * metrics.position_error_rms <= requirement,
            )
    yield Row("these motions: contact-force error, RMS", "≤ 5 %", f"{100 * worst_force:.3f} %", worst_force <= 0.05)
    measured = f"{max_cone_violation:.1g} N; {slip_steps} slip steps"
    is_met = max_cone_violation == 0.0 and slip_steps == 0
    yield Row("these motions: violation of friction cones", "none", measured, is_met)


def pushes() -> Iterator[Row]:
    """Measure the response to pushes of 0.5 N for 0.1 s along each axis"""
    grasp = three_finger_grasp()
    for axis in range(3):
        force = 0.5 * np.eye(3)[axis]
        r = run(grasp, 0.9, disturbances=(Push(force, 0.1, 0.1),), gains=PD)
        moved = 1e3 * np.linalg.norm(r.position_error, axis=1)  # mm
        ratio = moved.max() / (1e3 * _predicted_peak(grasp, force))
        metrics = compute_metrics(r)
        label, measured = f"push of 0.5 N along {'xyz'[axis]}", f"{moved.max():.3f} mm, {ratio:.4f} × the prediction"
        yield Row(f"{label}: peak with PD", "within 5 % of the prediction", measured, abs(ratio - 1.0) <= 0.05)
        r = run(grasp, 0.9, disturbances=(Push(force, 0.1, 0.1),))
        for law, error in (
            ("PD", moved[-200:].max()),
            ("integral", 1e3 * np.linalg.norm(r.position_error, axis=1)[-200:].max()),
        ):
            yield Row(f"{label}: position error 0.5 s later, {law}", "≤ 0.1 mm", f"{error:.4f} mm", error <= 0.1)
        measured = f"{100 * metrics.force_error:.2f} %, violation {metrics.max_cone_violation:.1g} N, "
        measured += f"{metrics.slip_steps} slip steps"
        inside = metrics.max_cone_violation == 0.0 and metrics.slip_steps == 0
        yield Row(
            f"{label}: contact-force error, RMS", "≤ 5 %, inside the cones", measured, metrics.force_error <= 0.05 and inside
        )


def _predicted_peak(grasp: Grasp, force: Array) -> float:
    """Return the largest displacement, m, by (M_o + G M_h Gᵀ)(ẍ + K_d ẋ + K_p x) = F for 0.1 s, M_h = (J M⁻¹ Jᵀ)⁻¹."""
    hand = grasp.hand
    J = hand.contact_jacobian(grasp.q, grasp.fingers, grasp.contacts, grasp.p_HO, grasp.R_HO)
    G = grasp.contacts.wrench_bases().transpose(1, 0, 2).reshape(6, -1)[:, grasp.contacts.columns]
    M_h = np.linalg.inv(J @ np.linalg.inv(hand.mass_matrix(grasp.q)) @ J.T)
    a = np.linalg.solve(grasp.body.mass_matrix() + G @ M_h @ G.T, np.append(force, np.zeros(3)))
    kp, kd, _ = PD.rows()
    x = solve_ivp(
        lambda t, x: [*x[6:], *(a * (t < 0.1) - kd * x[6:] - kp * x[:6])], (0.0, 0.3), np.zeros(12), max_step=1e-3, rtol=1e-8
    )
    return float(np.linalg.norm(x.y[:3], axis=0).max())


def masses() -> Iterator[Row]:
    """Measure the position error with a mass error of 20 %"""
    grasp = three_finger_grasp()
    for factor in (1.2, 0.8):
        body = replace(grasp.body, mass=factor * grasp.body.mass, inertia=factor * grasp.body.inertia)
        error = 1e6 * np.linalg.norm(run(grasp, 1.2, body=body).position_error, axis=1)  # µm
        measured = f"{error.max():.0f} µm at most, {error[1000:].max():.3f} µm after 1 s"
        label = f"mass error {100 * (factor - 1):+.0f} %: position error"
        yield Row(label, "< 1 µm after 1 s", measured, error[1000:].max() < 1.0)


def frictions() -> Iterator[Row]:
    """Measure the response to friction that falls from 0.7 to 0.4 in 0.5 s"""
    change = (FrictionChange(0.4, 0.1, 0.5),)
    r = run(three_finger_grasp(), 1.5, disturbances=change, friction_reserve=0.45)
    error, margin = 1e3 * np.linalg.norm(r.position_error, axis=1).max(), compute_metrics(r).min_slip_margin
    measured = f"moved {error:.4f} mm, least slip margin {margin:.2f} N"
    yield Row("friction falls, friction reserve sufficient", "held", measured, error < 0.1 and margin > 0.0)
    r = run(three_finger_grasp(), 0.6, disturbances=change, friction_reserve=0.0, slip_margin=0.05)
    moved = np.linalg.norm(r.position_error, axis=1) > 5e-4
    warning, motion = r.warnings[0][0] if r.warnings else np.inf, r.t[moved][0] if moved.any() else np.inf
    measured = f"warning at {warning:.3f} s, moved 0.5 mm at {motion:.3f} s"
    yield Row("friction falls, no friction reserve", "warning before motion", measured, warning < motion)


def rest() -> Iterator[Row]:
    """Measure the creep of the engine and of the controlled object in 10 s"""
    yield from _rest_rows(10.0)


def rest_for_a_minute() -> Iterator[Row]:
    """Measure the creep of the engine and of the controlled object in a minute"""
    yield from _rest_rows(60.0)


def _rest_rows(duration: float) -> Iterator[Row]:
    grasp = three_finger_grasp()
    creep, rotation = engine_creep(grasp, duration)
    measured = f"{1e6 * creep:.4f} µm, {np.degrees(rotation):.6f}°"
    yield Row(f"creep of the engine in {duration:g} s, joints fixed", "–", measured, True)
    r = run(grasp, duration)
    error, angle = np.linalg.norm(r.position_error, axis=1), np.degrees(np.linalg.norm(r.orientation_error, axis=1))
    yield creep_row(duration, creep, float(error[:500].max()), float(error[-500:].max()))
    yield Row(f"held for {duration:g} s: orientation error", "≤ 0.1°", f"{angle.max():.5f}°", angle.max() <= 0.1)
    yield Row(f"held for {duration:g} s: drift of the contacts", "–", f"{1e6 * _contact_drift(r):.3f} µm", True)


def creep_row(duration: float, engine: float, first: float, last: float) -> Row:
    """Return the row on the creep of a controlled object: its last half second, compared with the creep of the engine.

    The first half second is reported but not judged, because the contacts settle in it.

    Args:
        duration: duration of the run, s.
        engine: creep of the engine with fixed joints over the same time, m.
        first: largest position error in the first half second, m.
        last: largest position error in the last half second, m.
    """
    rounding = 1e-9  # m, of the recorded positions
    measured = f"{1e6 * last:.4f} µm (first half second, not judged: {1e6 * first:.4f} µm)"
    requirement = "last half second ≤ creep of the engine + 0.001 µm"
    return Row(f"held for {duration:g} s: position error", requirement, measured, last <= engine + rounding)


def _contact_drift(r: Recording) -> float:
    """Return the largest displacement of a contact on the object, m, from the second half second to the last one."""
    return float(np.linalg.norm(r.p_OC[-500:].mean(axis=0) - r.p_OC[500:1000].mean(axis=0), axis=1).max())


def engine_creep(grasp: Grasp, duration: float) -> tuple[float, float]:
    """Return the displacement, m, and the rotation, rad, of the object in the engine while the finger joints are fixed.

    Args:
        grasp: the grasp.
        duration: simulated time, s.
    """
    plant = Plant(simulation.build_scene(grasp, gravity_H=PALM_UP))
    scene, model, data = plant.scene, plant.model, plant.data
    model.dof_armature[scene.v_address] = 1e6  # kg·m², so that contact forces do not move the joints
    data.qfrc_applied[:] = 0.0
    q = data.qpos[scene.q_address].copy()
    for _ in range(round(duration / plant.dt)):
        mujoco.mj_step(model, data)
        data.qpos[scene.q_address], data.qvel[scene.v_address] = q, 0.0
    now = plant.object_motion()
    rotation = Rotation.from_matrix(now.R_HO @ grasp.R_HO.T).magnitude()
    return float(np.linalg.norm(now.p_HO - grasp.p_HO)), float(rotation)


def speed() -> Iterator[Row]:
    """Measure the time of a control step and of a plant step"""
    grasp = three_finger_grasp()
    plant = Plant(simulation.build_scene(grasp, gravity_H=PALM_UP))
    controller = ObjectController(grasp, ControlSettings(gravity_H=PALM_UP))
    desired, state = BodyMotion(grasp.p_HO, grasp.R_HO), plant.state()
    wall_times, thread_times = [], []  # s; thread time excludes other processes
    for _ in range(2000):
        wall, thread = [time.perf_counter()], [time.thread_time()]
        command = controller.step(state, desired)
        wall.append(time.perf_counter()), thread.append(time.thread_time())
        state = plant.step(command.tau)
        wall.append(time.perf_counter()), thread.append(time.thread_time())
        wall_times.append(np.diff(wall)), thread_times.append(np.diff(thread))
    wall, thread = 1e6 * np.median(wall_times, axis=0), 1e6 * np.median(thread_times, axis=0)  # µs
    measured = f"{wall[0]:.0f} µs (processor time {thread[0]:.0f} µs)"
    yield Row("control step, three fingers: median", "≤ 150 µs", measured, wall[0] <= 150.0)
    yield Row("plant step with contact forces: median", "–", f"{wall[1]:.0f} µs (processor time {thread[1]:.0f} µs)", True)


if __name__ == "__main__":
    main()
