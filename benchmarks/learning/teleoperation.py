"""Teleoperation of held objects in MuJoCo.

The Allegro hand with the palm up holds five objects of 50 g. A simulated operator lifts the object by 4 mm with the fingers,
holds it and lowers it again, twice within 8 s. The operator's poses come at 60 Hz with an error of 5 mm RMS, which changes
with a time constant of 0.5 s. `TeleoperationFilter` makes the desired motion of them, within the travel of the grasp;
`ObjectController` chooses the forces, with a slip margin of 0.5 N. The true margin is that of the plant's contact forces,
least over all contacts and steps after 0.1 s. *Operator's error* and *object's distance* are RMS distances from the intended
motion: the operator's, and the true object's.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from benchmarks import report_page
from benchmarks.mujoco_loop import PALM_UP
from graspforce import GraspForceError, Hand
from graspforce.contact import friction
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, ObjectController
from graspforce.core.arrays import Array
from graspforce.geometry import Box, Cylinder, Solid, Sphere, Superquadric
from graspforce.grasp.body import Body
from graspforce.grasp.search import find_grasp, relax_idle_fingers, travel_limits
from graspforce.learning import TeleoperationFilter, TeleoperationLimits
from graspforce.simulation import Plant, build_scene, simulate

TITLE = "Teleoperation"
HAND = "allegro_right"
OBJECTS: dict[str, Solid] = {
    "ball of 60 mm": Sphere(0.03),
    "cube of 50 mm": Box([0.05, 0.05, 0.05]),
    "cylinder of 50 mm": Cylinder(0.025, 0.08),
    "box of 40 × 50 × 70 mm": Box([0.04, 0.05, 0.07]),
    "ellipsoid of 56 × 56 × 70 mm": Superquadric([0.028, 0.028, 0.035], [1.0, 1.0]),
}
_MASS, _FRICTION, _MARGIN = 0.05, 0.7, 0.5  # kg, and N
_LIFT, _PERIOD, _DURATION = 0.004, 4.0, 8.0  # m and s
_RATE, _ERROR, _MEMORY = 60.0, 0.005, 0.5  # Hz, m RMS, s
_SETTLED = 0.1  # s


def run(_records: Path, _pictures: Path) -> list[dict[str, Any]]:
    """Run all objects."""
    return [{"object": name, **_lift(shape, seed)} for seed, (name, shape) in enumerate(OBJECTS.items())]


def intended(t: float) -> float:
    """Return the intended height, m: up, hold, down, hold.

    Args:
        t: time, s.
    """
    phase = (t % _PERIOD) / _PERIOD
    rise = np.clip(phase / 0.25, 0.0, 1.0) - np.clip((phase - 0.5) / 0.25, 0.0, 1.0)
    return float(_LIFT * rise * rise * (3.0 - 2.0 * rise))


def _operator_errors(rng: np.random.Generator) -> Array:
    """Return the operator's errors (T, 3), m, with the stated RMS length."""
    count = int(_DURATION * _RATE) + 1
    keep = float(np.exp(-1.0 / (_RATE * _MEMORY)))
    e = np.zeros((count, 3))
    for k in range(1, count):
        e[k] = keep * e[k - 1] + np.sqrt(1.0 - keep**2) * rng.normal(size=3)
    return np.asarray(e * _ERROR / np.sqrt(np.square(e).sum(axis=1).mean()))


def _lift(shape: Solid, seed: int) -> dict[str, Any]:
    """Return the figures of one object."""
    hand = Hand.load(HAND)
    grasp = relax_idle_fingers(find_grasp(hand, Body.solid(shape, _MASS), friction=_FRICTION, gravity_H=PALM_UP))
    travel = min(limit.distance for limit in travel_limits(grasp, 0.006))
    start, up = BodyMotion(grasp.p_HO, grasp.R_HO), -np.asarray(PALM_UP) / np.linalg.norm(PALM_UP)
    teleoperation = TeleoperationFilter(start, TeleoperationLimits(travel=max(travel, 1e-3)))
    errors, margins, applied = _operator_errors(np.random.default_rng(seed)), [], []
    plant = Plant(build_scene(grasp, gravity_H=PALM_UP))
    state = {"frame": -1}

    def reference(t: float) -> BodyMotion:
        frame = int(t * _RATE + 1e-9)
        if frame != state["frame"]:
            state["frame"] = frame
            teleoperation.command(grasp.p_HO + intended(t) * up + errors[frame])
        applied.append(grasp.p_HO + intended(t) * up)
        return teleoperation.step(plant.dt)

    def observe(plant: Any, _command: Any) -> None:
        contacts = plant.true_contacts()
        margins.append(float(friction.slip_margin(contacts.f, contacts.mu, contacts.gamma).min()))

    controller = ObjectController(grasp, ControlSettings(gravity_H=PALM_UP, slip_margin=_MARGIN))
    try:
        recording = simulate(plant, controller, reference, _DURATION, on_step=observe)
    except GraspForceError as error:
        return {"held": False, "message": str(error)[:120]}
    true_p = recording.p_HO
    settled = int(_SETTLED / plant.dt)
    distance = np.linalg.norm(true_p - np.array(applied[: len(true_p)]), axis=1)
    return {
        "held": bool(len(true_p) == round(_DURATION / plant.dt) and distance.max() < 0.02),
        "travel": travel,
        "operator": float(np.sqrt(np.square(errors).sum(axis=1).mean())),
        "distance": float(np.sqrt(np.square(distance).mean())),
        "margin": float(np.min(margins[settled:])),
    }


def page(results: list[dict[str, Any]]) -> str:
    """Return the table.

    Args:
        results: of `run`.
    """
    head = ("object", "result", "travel", "operator's error", "object's distance", "least true margin")
    rows = []
    for each in results:
        if "margin" not in each:
            rows.append((each["object"], each["message"], *("–" for _ in range(4))))
            continue
        lengths = (f"{1e3 * each[name]:.1f} mm" for name in ("travel", "operator", "distance"))
        rows.append((each["object"], "held" if each["held"] else "dropped", *lengths, f"{each['margin']:.2f} N"))
    note = (
        "The hand's base is at rest: the fingers lift the object. Lifts by an arm are not part of this comparison. "
        f"MuJoCo {mujoco.__version__}."
    )
    return f"{report_page.table(head, rows, 2)}\n\n{note}"
