"""How well the closed loop holds and follows in MuJoCo: python -m benchmarks.closed_loop [--full] [--save FILE].

The plant runs at 1 kHz with the hands' real torque limits and perfect measurements. The short form judges three fingers of
Allegro about a free sphere of 50 g and 30 mm radius, μ = 0.7, palm up; the long one adds a minute at rest, and every shipped
hand with a ball, a cube and a cylinder of the IST object set.
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

from benchmarks import every_hand, report_page
from benchmarks.mujoco_loop import PALM_UP, Row, run
from graspforce import Contact, ContactSet, Hand, simulation
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, ObjectController, PoseGains
from graspforce.core.arrays import Array
from graspforce.geometry import Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.simulation import FrictionChange, Plant, Push, Recording, compute_metrics

TITLE = "The closed loop in MuJoCo"
PD = PoseGains(ki_linear=0.0, ki_angular=0.0)


def main() -> None:
    """Measure and show."""
    parser = report_page.parser("closed_loop", __doc__)
    parser.add_argument("--full", action="store_true", help="a minute at rest, and every shipped hand: some ten minutes")
    options = parser.parse_args()
    rows: list[Row] = []
    parts: list[Callable[[], Iterator[Row]]] = [sinusoids, pushes, masses, frictions, rest, speed]
    if options.full:
        parts += [rest_for_a_minute, *every_hand.PARTS]
    with Progress(SpinnerColumn(), TextColumn("{task.description}"), transient=True) as progress:
        task = progress.add_task("")
        for part in parts:
            progress.update(task, description=(part.__doc__ or "").splitlines()[0])
            for row in part():
                rows.append(row)
                progress.console.print(f"{'ok ' if row.is_met else 'NO '} {row.label}: {row.measured}", highlight=False)
    head = ("what", "bar", "measured", "met")
    cells = [(row.label, row.requirement, row.measured, "yes" if row.is_met else "no") for row in rows]
    report_page.show(TITLE, head, cells, width=150)
    if options.save:
        facts = report_page.facts(f"MuJoCo {mujoco.__version__}")
        report_page.save(options.save, TITLE, __doc__, facts, report_page.table(head, cells, words=4))


def three_finger_grasp() -> Grasp:
    """Allegro's index, middle and thumb about the sphere."""
    hand, shape = Hand.load("allegro_right"), Sphere(0.03)
    normals = np.array([[-0.2, -0.45, -0.9], [-0.2, 0.45, -0.9], [-0.2, 0.0, 1.0]])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    contacts = ContactSet.stack([Contact(-shape.radius * n, n, 0.7) for n in normals])
    p_HO, fingers = np.array([0.07, 0.03, 0.01]), ("index", "middle", "thumb")
    q = hand.grasp_posture(fingers, contacts, p_HO, np.eye(3))
    return Grasp(hand, Body.solid(shape, 0.05), fingers, contacts, q, p_HO, np.eye(3))


def sinusoids() -> Iterator[Row]:
    """10 mm peak to peak, along each axis"""
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
            label = f"10 mm peak to peak at {frequency:g} Hz along {'xyz'[axis]}: RMS"
            yield Row(
                label,
                f"≤ {requirement} mm",
                f"{1e3 * metrics.position_error_rms:.4f} mm",
                1e3 * metrics.position_error_rms <= requirement,
            )
    yield Row("the same: planned less true contact forces", "≤ 5 % RMS", f"{100 * worst_force:.3f} %", worst_force <= 0.05)
    measured = f"{max_cone_violation:.1g} N; {slip_steps} steps at the edge"
    yield Row("the same: true forces outside their cones", "none", measured, max_cone_violation == 0.0 and slip_steps == 0)


def pushes() -> Iterator[Row]:
    """0.5 N for 0.1 s, along each axis"""
    grasp = three_finger_grasp()
    for axis in range(3):
        force = 0.5 * np.eye(3)[axis]
        r = run(grasp, 0.9, disturbances=(Push(force, 0.1, 0.1),), gains=PD)
        moved = 1e3 * np.linalg.norm(r.position_error, axis=1)  # mm
        ratio = moved.max() / (1e3 * _predicted_peak(grasp, force))
        metrics = compute_metrics(r)
        measured = f"{moved.max():.3f} mm, {ratio:.4f} of the prediction"
        yield Row(f"push of 0.5 N along {'xyz'[axis]}: peak with PD", "within 5 %", measured, abs(ratio - 1.0) <= 0.05)
        r = run(grasp, 0.9, disturbances=(Push(force, 0.1, 0.1),))
        for law, left in (
            ("PD", moved[-200:].max()),
            ("integral", 1e3 * np.linalg.norm(r.position_error, axis=1)[-200:].max()),
        ):
            yield Row(f"… 0.5 s later, {law}", "≤ 0.1 mm", f"{left:.4f} mm", left <= 0.1)
        measured = f"{100 * metrics.force_error:.2f} %, {metrics.max_cone_violation:.1g} N outside, "
        measured += f"{metrics.slip_steps} steps at the edge"
        inside = metrics.max_cone_violation == 0.0 and metrics.slip_steps == 0
        yield Row("… planned less true contact forces", "≤ 5 % RMS", measured, metrics.force_error <= 0.05 and inside)


def _predicted_peak(grasp: Grasp, force: Array) -> float:
    """Return the peak of (M_o + G M_h Gᵀ)(ẍ + K_d ẋ + K_p x) = F for 0.1 s, with M_h = (J M⁻¹ Jᵀ)⁻¹, m."""
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
    """Measure the response to a mass that is 20 % wrong"""
    grasp = three_finger_grasp()
    for factor in (1.2, 0.8):
        body = replace(grasp.body, mass=factor * grasp.body.mass, inertia=factor * grasp.body.inertia)
        off = 1e6 * np.linalg.norm(run(grasp, 1.2, body=body).position_error, axis=1)  # µm
        measured = f"{off.max():.0f} µm at first, {off[1000:].max():.3f} µm after 1 s"
        yield Row(f"mass {100 * (factor - 1):+.0f} %: offset", "gone in 1 s", measured, off[1000:].max() < 1.0)


def frictions() -> Iterator[Row]:
    """Friction that falls from 0.7 to 0.4 in 0.5 s"""
    falls = (FrictionChange(0.4, 0.1, 0.5),)
    r = run(three_finger_grasp(), 1.5, disturbances=falls, friction_reserve=0.45)
    off, margin = 1e3 * np.linalg.norm(r.position_error, axis=1).max(), compute_metrics(r).min_slip_margin
    measured = f"moved {off:.4f} mm, least true margin {margin:.2f} N"
    yield Row("friction falls, the squeeze covers it", "held", measured, off < 0.1 and margin > 0.0)
    r = run(three_finger_grasp(), 0.6, disturbances=falls, friction_reserve=0.0, slip_margin=0.05)
    moved = np.linalg.norm(r.position_error, axis=1) > 5e-4
    slips, gone = r.warnings[0][0] if r.warnings else np.inf, r.t[moved][0] if moved.any() else np.inf
    measured = f"warned at {slips:.3f} s, moved 0.5 mm at {gone:.3f} s"
    yield Row("friction falls, the squeeze does not", "warned before", measured, slips < gone)


def rest() -> Iterator[Row]:
    """Measure creep of the engine and of the controller"""
    grasp = three_finger_grasp()
    own, turned = engine_creep(grasp, 10.0)
    yield Row("engine's own creep in 10 s, joints fixed", "–", f"{1e6 * own:.4f} µm, {np.degrees(turned):.6f}°", True)
    yield from _rest_rows(grasp, 10.0, own)


def rest_for_a_minute() -> Iterator[Row]:
    """Measure a minute at rest"""
    grasp = three_finger_grasp()
    own, turned = engine_creep(grasp, 60.0)
    yield Row("engine's own creep in 60 s, joints fixed", "–", f"{1e6 * own:.4f} µm, {np.degrees(turned):.6f}°", True)
    yield from _rest_rows(grasp, 60.0, own)


def _rest_rows(grasp: Grasp, duration: float, own: float) -> Iterator[Row]:
    r = run(grasp, duration)
    off, turned = np.linalg.norm(r.position_error, axis=1), np.degrees(np.linalg.norm(r.orientation_error, axis=1))
    yield creep_row(duration, own, float(off[:500].max()), float(off[-500:].max()))
    yield Row(f"controlled for {duration:g} s: turned", "≤ 0.1°", f"{turned.max():.5f}°", turned.max() <= 0.1)
    slip_steps = _contact_drift(r)
    yield Row(f"controlled for {duration:g} s: contacts wander over the object", "–", f"{1e6 * slip_steps:.3f} µm", True)


def creep_row(duration: float, engine: float, first: float, last: float) -> Row:
    """Return the row that judges how far a controlled object creeps: its last half second, against the engine's own creep.

    The first half second is reported and not judged: contacts settle in it.

    Args:
        duration: of the run, s.
        engine: creep of the engine with fixed joints over the same time, m.
        first: largest distance from the goal in the first half second, m.
        last: largest distance in the last half second, m.
    """
    rounding = 1e-9  # m, of the recorded positions
    measured = f"{1e6 * last:.4f} µm (first half second, not judged: {1e6 * first:.4f} µm)"
    bar = "last half second ≤ the engine's own creep + 0.001 µm"
    return Row(f"controlled for {duration:g} s: distance from the goal", bar, measured, last <= engine + rounding)


def _contact_drift(r: Recording) -> float:
    """How far the contacts went over the object between the first half second and the last, m."""
    return float(np.linalg.norm(r.p_OC[-500:].mean(axis=0) - r.p_OC[500:1000].mean(axis=0), axis=1).max())


def engine_creep(grasp: Grasp, duration: float) -> tuple[float, float]:
    """How far, m, and by what angle, rad, the object goes in the engine while the fingers' joints do not move at all."""
    plant = Plant(simulation.build_scene(grasp, gravity_H=PALM_UP))
    scene, model, data = plant.scene, plant.model, plant.data
    model.dof_armature[scene.v_address] = 1e6  # kg·m²: no contact moves them
    data.qfrc_applied[:] = 0.0
    q = data.qpos[scene.q_address].copy()
    for _ in range(round(duration / plant.dt)):
        mujoco.mj_step(model, data)
        data.qpos[scene.q_address], data.qvel[scene.v_address] = q, 0.0
    now = plant.object_motion()
    turned = Rotation.from_matrix(now.R_HO @ grasp.R_HO.T).magnitude()
    return float(np.linalg.norm(now.p_HO - grasp.p_HO)), float(turned)


def speed() -> Iterator[Row]:
    """How long a step takes"""
    grasp = three_finger_grasp()
    plant = Plant(simulation.build_scene(grasp, gravity_H=PALM_UP))
    controller = ObjectController(grasp, ControlSettings(gravity_H=PALM_UP))
    desired, state = BodyMotion(grasp.p_HO, grasp.R_HO), plant.state()
    walls, works = [], []  # µs by the clock, and of this thread's own work: they differ where others use the machine
    for _ in range(2000):
        clock, work = [time.perf_counter()], [time.thread_time()]
        command = controller.step(state, desired)
        clock.append(time.perf_counter()), work.append(time.thread_time())
        state = plant.step(command.tau)
        clock.append(time.perf_counter()), work.append(time.thread_time())
        walls.append(np.diff(clock)), works.append(np.diff(work))
    wall, work = 1e6 * np.median(walls, axis=0), 1e6 * np.median(works, axis=0)
    measured = f"{wall[0]:.0f} µs ({work[0]:.0f} µs of work)"
    yield Row("one control step, three fingers: median", "≤ 150 µs", measured, wall[0] <= 150.0)
    yield Row("one step of the plant, forces read: median", "–", f"{wall[1]:.0f} µs ({work[1]:.0f} µs of work)", True)


if __name__ == "__main__":
    main()
