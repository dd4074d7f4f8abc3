"""Parts of `benchmarks.every_hand` on kinds of hands: wrists, tendons, breakaways, jaws, inner links, and lint."""

from __future__ import annotations

import re
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support.faulty_hands import DEFECTS, SOUND, write_hand
from support.wrists import WristKind, with_lift, with_wrist

import graspforce as gf
from benchmarks.every_hand_drives import JAW_NOISE, MASS, OBJECTS, TORQUE_ERROR, with_errors
from graspforce import GraspForceError, Hand
from graspforce.contact.matrices import grasp_matrix
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, ObjectController, OutputFeedbackController, feasible_twists
from graspforce.core.arrays import Array
from graspforce.estimation import SensorModel
from graspforce.force.problem import ForceProblem
from graspforce.grasp.body import Body
from graspforce.grasp.search import GraspSearchOptions, find_grasp, find_link_grasp
from graspforce.hand.drives.drive import Drive
from graspforce.hand.lint.lint_hand import lint_hand
from graspforce.hand.tendon_modes import balanced_actuation
from graspforce.simulation import (
    Plant,
    Push,
    World,
    build_scene,
    compute_metrics,
    constant_reference,
    linear_reference,
    make_world_plant,
    simulate,
    simulate_measured,
)
from graspforce.simulation.campaigns.outcome import judge_run

WRIST_HANDS = ("allegro_right", "dlr_hit2")
WRIST_KINDS: tuple[WristKind, ...] = ("driven", "locked", "fixed")
TENDON_FINGERS = ("first", "middle", "ring", "thumb")
TENDON_SEEDS = range(10)
LIFT, LIFT_PERIOD = 0.05, 2.0  # m, s
DOWNWARDS = (0.0, 0.0, 9.81)  # m/s²: the hand points downwards
POWER_HANDS = ("allegro_right", "dlr_hit2")
POWER_FRICTION, POWER_MARGIN, POWER_TIME = 0.6, 1.5, 10.0  # coefficient, N, s
PUSH, PUSH_START, PUSH_TIME = np.array([1.0, 0.0, 0.0]), 1.0, 8.0  # N, twice the weight of the ball; s


def compare_wrists(name: str) -> dict[str, Any]:
    """Return the largest differences between a hand on a driven, a locked and a fixed wrist.

    Args:
        name: name of a shipped hand.
    """
    body, options = Body.solid(OBJECTS["ball"], MASS), GraspSearchOptions(travel=0.003)
    with tempfile.TemporaryDirectory() as folder:
        grasps = {}
        for kind in WRIST_KINDS:
            (Path(folder) / kind).mkdir()
            grasps[kind] = find_grasp(with_wrist(name, kind, Path(folder) / kind), body, friction=0.7, options=options)
    fixed = grasps["fixed"]
    own = [j for j, joint in enumerate(grasps["driven"].hand.joints) if joint.name != "wrist"]
    postures = {"driven": grasps["driven"].q[own], "locked": grasps["locked"].q}
    posture = max(float(np.abs(q - fixed.q).max()) for q in postures.values())
    force = 0.0
    for g in np.vstack([np.eye(3), -np.eye(3)]) * 9.81:
        settings = gf.SolverSettings(tolerance=1e-12)
        f = {kind: np.concatenate(gf.solve(grasp.force_problem(g), settings=settings).forces) for kind, grasp in grasps.items()}
        force = max(force, *(float(np.abs(f[kind] - f["fixed"]).max()) for kind in ("driven", "locked")))
    return {"posture": posture, "force": force}


def compare_tendon(seed: int) -> dict[str, Any]:
    """Return the largest difference of J1's and J2's torques in certified forces of the Shadow hand, N·m.

    The torques are moments of the tip forces about the joints' axes. Fingertips press along the middle links, which the
    differentials balance.

    Args:
        seed: of the posture.
    """
    hand, rng = Hand.load("shadow_right"), np.random.default_rng(seed)
    q = hand.q_lower + rng.uniform(0.3, 0.7, hand.n) * (hand.q_upper - hand.q_lower)
    poses = hand.link_poses(q)
    tips = [hand.finger(name).tip for name in TENDON_FINGERS]
    along = [poses[f"{tip.removesuffix('_tip')}_middle"][1][:, 2] for tip in tips]
    contacts = gf.ContactSet.stack([gf.Contact(poses[tip][0], n, 0.6) for tip, n in zip(tips, along, strict=True)])
    place = np.zeros(3), np.eye(3)
    actuation = balanced_actuation(hand, q, TENDON_FINGERS, contacts, *place, np.zeros(3))
    w = grasp_matrix(contacts) @ np.tile([0.0, 0.0, 1.0], len(contacts))
    solution = gf.solve(ForceProblem(contacts, w, actuation))
    difference = largest = 0.0
    for tip, R, f in zip(tips[:3], contacts.R_OC, solution.forces, strict=False):  # the thumb has no tendon
        tau = [_moment(poses, f"{tip.removesuffix('_tip')}_{link}", tip, R @ f) for link in ("middle", "distal")]
        difference, largest = max(difference, abs(tau[0] - tau[1])), max(largest, abs(tau[0]))
    return {"difference": difference, "torque": largest, "verified": bool(solution.certificate.verified)}


def _moment(poses: dict[str, tuple[Array, Array]], link: str, tip: str, force: Array) -> float:
    """Return the moment of the reaction to a tip's force about the axis x of a link, N·m."""
    p, R = poses[link]
    return float(R[:, 0] @ np.cross(poses[tip][0] - p, force))


def open_breakaway(step: float = 1e-3) -> dict[str, Any]:
    """Return how the Barrett hand's breakaway opens while its first joint presses on a spring.

    Args:
        step: motion of the motor in a step, rad.
    """
    tendon = next(each for each in Hand.load("barrett").tendons if each.kind == "breakaway")
    stiffness, stop, torques = 40.0, None, []
    for k in range(round(1.0 / step)):
        torques.append(stiffness * max(0.0, float(tendon.positions(stop, k * step)[0]) - 0.5))
        stop = tendon.next_stop(stop, k * step, torques[-1])
        if stop is not None:
            break
    return {"threshold": tendon.threshold, "before": torques[-2], "opened": torques[-1], "per_step": stiffness * step}


def lift_with_jaws(object_name: str) -> dict[str, Any]:
    """Return the outcome of lifting an object with the parallel jaws on a lift, and of lowering it again.

    Args:
        object_name: one of `OBJECTS`.
    """
    with tempfile.TemporaryDirectory() as folder:
        hand = with_lift("parallel_jaws", Path(folder))
    described = Hand.load("parallel_jaws").drives.joints
    names = [joint.name for joint in Hand.load("parallel_jaws").joints]
    drives = [Drive() if each.name == "lift" else with_errors(described[names.index(each.name)]) for each in hand.joints]
    grasp = find_grasp(hand, Body.solid(OBJECTS[object_name], MASS), friction=0.7, gravity_H=DOWNWARDS)
    grasp = replace(grasp, hand=hand.with_drives(drives))
    sensors = SensorModel(encoder_noise=JAW_NOISE, rate=500.0)
    world = World(sensors=sensors, torque_error=TORQUE_ERROR, seed=3)
    base = ControlSettings(gravity_H=DOWNWARDS, slip_margin=0.5, period=1.0 / sensors.rate)
    settings = ControlSettings.for_sensors(sensors, base, drives=grasp.hand.drives)
    controller = OutputFeedbackController(grasp, settings.settings, sensors)
    reference = linear_reference(BodyMotion(grasp.p_HO, grasp.R_HO), [0.0, 0.0, -LIFT], LIFT_PERIOD)
    run = simulate_measured(make_world_plant(world, grasp, DOWNWARDS), controller, reference, LIFT_PERIOD, world)
    outcome = judge_run(run)
    rms = float(np.sqrt(np.mean(np.sum(run.motion_error**2, axis=1))))
    return {"result": outcome.result, "lifted": float(np.ptp(run.truth.p_HO[:, 2])), "rms": rms}


def hold_power_grasp(name: str) -> dict[str, Any]:
    """Return the measured values of a ball that palm and inner links hold against a push.

    Args:
        name: name of a shipped hand.
    """
    body = Body.solid(OBJECTS["ball"], MASS)
    grasp = find_link_grasp(Hand.load(name), body, "power", friction=POWER_FRICTION).as_grasp()
    rest, settings = BodyMotion(grasp.p_HO, grasp.R_HO), ControlSettings(slip_margin=POWER_MARGIN)
    plant = Plant(build_scene(grasp), disturbances=[Push(PUSH, PUSH_START, PUSH_TIME)])
    first = ObjectController(grasp, settings).step(plant.reset(), rest)
    controller = ObjectController(grasp, settings)
    run = simulate(plant, controller, constant_reference(rest), POWER_TIME, initial_forces=first.f)
    metrics = compute_metrics(run)
    return {
        "contacts": len(grasp.contacts),
        "free": len(feasible_twists(grasp)),
        "moved": metrics.position_error_peak,
        "lost": metrics.lost_contact_steps,
        "steps": len(run.t),
        "certified": len(run.t) - metrics.reused_force_steps,
        "force_error": float(np.abs(run.planned - run.f)[run.t < PUSH_START][..., 2].max()),
        "largest": float(run.planned[..., 2].max()),
    }


def check_lint() -> dict[str, Any]:
    """Return how many faulty descriptions of the tests' corpus lint reports, and how many sound ones it passes."""
    reported = passed = 0
    with tempfile.TemporaryDirectory() as folder:
        for name, defect in DEFECTS.items():
            found = _findings(write_hand(_folder(folder, name), swap=defect.swap, edit=defect.edit))
            reported += any(re.search(defect.words, text) for text in found)
        for name, (swap, edit) in SOUND.items():
            passed += not _findings(write_hand(_folder(folder, f"sound {name}"), swap=swap, edit=edit))
    return {"faulty": len(DEFECTS), "reported": reported, "sound": len(SOUND), "passed": passed}


def _folder(parent: str, name: str) -> Path:
    """Return a new folder."""
    folder = Path(parent) / re.sub(r"\W+", "_", name)
    folder.mkdir()
    return folder


def _findings(path: Path) -> list[str]:
    """Return the findings of a description, or the error that says why it cannot be read."""
    try:
        return [f"{finding.location}: {finding.problem}; remedy: {finding.remedy}" for finding in lint_hand(path)]
    except GraspForceError as error:
        return [str(error)]


def rows(results: dict[tuple[Any, ...], dict[str, Any]]) -> list[tuple[str, ...]]:
    """Return the table of requirement, figure and requirement's limit of the results of this module.

    Args:
        results: of all tasks.
    """
    table = []
    for name in WRIST_HANDS:
        if (found := results.get(("wrist", name))) and "force" in found:
            figure = f"posture {found['posture']:.1e} rad, forces {found['force']:.1e} N"
            table.append((f"wrist of {name} driven, locked, fixed: largest difference", figure, "1e-6"))
    tendons = [found for seed in TENDON_SEEDS if (found := results.get(("tendon", seed))) and "difference" in found]
    if tendons:
        difference, largest = (max(each[name] for each in tendons) for name in ("difference", "torque"))
        figure = f"difference {difference:.1e} N·m of torques up to {largest:.3f} N·m in {len(tendons)} postures"
        certified = sum(each["verified"] for each in tendons)
        table.append((f"torques of J1 and J2 through the differentials of shadow_right, {certified} certified", figure, "1e-9"))
    if found := results.get(("breakaway",)):
        figure = f"{found['before']:.3f} N·m in the step before, {found['opened']:.3f} N·m when it opens"
        table.append(("breakaway of barrett", figure, f"{found['threshold']:g} N·m, {found['per_step']:.3f} N·m a step"))
    for name in OBJECTS:
        if (found := results.get(("jaws", name))) and "lifted" in found:
            figure = f"{found['result']}, lifted by {1e3 * found['lifted']:.1f} mm, {1e3 * found['rms']:.3f} mm RMS"
            table.append((f"jaws lift the {name} by {1e3 * LIFT:.0f} mm, torque constants 20 % wrong", figure, "held"))
    for name in POWER_HANDS:
        if (found := results.get(("power", name))) and "moved" in found:
            what = (
                f"power grasp of {name}, {found['contacts']} contacts, {found['free']} of 6 directions free: {POWER_TIME:g} s"
            )
            what += f" with a push of {np.linalg.norm(PUSH):g} N for {PUSH_TIME:g} s"
            figure = f"moved by {1e3 * found['moved']:.3f} mm, {found['lost']} steps with a lost contact, "
            figure += f"{found['certified']} of {found['steps']} steps certified, normal forces before the push as planned to "
            figure += f"{1e3 * found['force_error']:.0f} mN of up to {found['largest']:.1f} N"
            table.append((what, figure, "held"))
    if found := results.get(("lint",)):
        figure = f"{found['reported']} of {found['faulty']} reported, {found['passed']} of {found['sound']} sound ones passed"
        table.append(("lint: corpus of faulty and sound descriptions", figure, "60 and 12"))
    return table
