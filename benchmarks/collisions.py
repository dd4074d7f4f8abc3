"""Collisions in plans, checked by MuJoCo: `python -m benchmarks.collisions [--moves N] [--records FILE] [--save FILE]`.

Random moves of a held ball: 5 to 40 mm in any direction and up to 20° about any axis, along the straight line, from the grasp
of `find_grasp`. MuJoCo's collision detection checks every plan on the same shapes at 20 instants in each interval. It shares no
distance code with the planner.

A refusal for a collision is confirmed if MuJoCo finds a penetration on the path that the same planner makes without collision
checks. A claim that every motion collides is confirmed if MuJoCo finds the object inside the palm at the goal.

Some moves are planned by `plan_free`, too, with and without collision checks; the times are those of the second of two runs.
Moves are numbered. Those in the records file are not repeated, so that a run can be continued.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks import report_page
from graspforce.core.arrays import Array
from graspforce.geometry import Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search import find_grasp
from graspforce.hand.hand import Hand
from graspforce.planning import GraspTask, Plan, PlanFailure, PlanSettings, StraightPath, plan_along, plan_free
from graspforce.planning.check import times_between
from graspforce.planning.collisions import inevitable_collision, scene_of_task
from graspforce.planning.failure import COLLISION
from graspforce.simulation import Scene, build_scene

HANDS = ("four_finger", "allegro_right", "dlr_hit2", "shadow_right", "leap_right")
INSTANTS = 20  # in each interval
SETTINGS = PlanSettings(intervals=40)
TOLERANCE = 1e-4  # m: largest penetration of a plan


@dataclass(frozen=True, slots=True)
class MoveRecord:
    """The result of one move.

    Args:
        hand: name of the hand.
        number: number of the move, which is its seed.
        result: "planned", "collision", or the kind of another failure.
        depth: largest penetration by MuJoCo in the plan, or on the refused path without checks, m; 0 for none.
        inevitable: whether `plan_free` claims a collision of every motion.
        confirmed: whether MuJoCo confirms the refusal, and the claim if there is one.
        free_seconds: processor time of `plan_free` with collision checks, s; 0 if not run.
        unchecked_seconds: the same without collision checks, s.
        free_depth: largest penetration in the free plan, m.
    """

    hand: str
    number: int
    result: str
    depth: float
    inevitable: bool
    confirmed: bool
    free_seconds: float = 0.0
    unchecked_seconds: float = 0.0
    free_depth: float = 0.0


def random_goal(grasp: Grasp, number: int) -> StraightPath:
    """Return the path of a numbered move.

    Args:
        grasp: the grasp in which it starts.
        number: number of the move.
    """
    rng = np.random.default_rng(number)
    direction, axis = (x / np.linalg.norm(x) for x in rng.normal(size=(2, 3)))
    turn = Rotation.from_rotvec(np.radians(rng.uniform(0.0, 20.0)) * axis).as_matrix()
    return StraightPath(grasp.p_HO, grasp.R_HO, grasp.p_HO + rng.uniform(0.005, 0.04) * direction, turn @ grasp.R_HO)


def deepest(scene: Scene, plan: Plan, times: Array, palm_only: bool = False) -> float:
    """Return the largest penetration of pairs that must not touch at some times of a plan, by MuJoCo, m.

    Args:
        scene: the scene.
        plan: the plan.
        times: (M,) s.
        palm_only: count only contacts of the object with bodies that no joint moves.
    """
    model, data, depth = scene.model, mujoco.MjData(scene.model), 0.0
    at = plan.at(times)
    for q, p, R in zip(at.q, at.p_HO, at.R_HO, strict=True):
        data.qpos[scene.q_address] = scene.T @ q + scene.q0
        start = scene.object_q_address
        data.qpos[start : start + 7] = np.append(p, Rotation.from_matrix(R).as_quat(scalar_first=True))
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        for geoms, distance in zip(data.contact.geom.tolist(), data.contact.dist.tolist(), strict=True):
            other = [geom for geom in geoms if geom != scene.object_geom]
            fixed = len(other) == 1 and model.geom_bodyid[other[0]] == 0
            if not set(geoms) & set(scene.tip_geoms) and (fixed or not palm_only):
                depth = max(depth, -distance)
    return depth


def run_move(grasp: Grasp, scene: Scene, number: int, with_free: bool) -> MoveRecord:
    """Plan and check one move.

    Args:
        grasp: the grasp in which it starts.
        scene: the scene of the grasp.
        number: number of the move.
        with_free: whether `plan_free` plans it, too.
    """
    task = GraspTask(grasp.hand, grasp.body, grasp.contacts, grasp.fingers)
    unchecked, path = replace(task, collisions=None), random_goal(grasp, number)
    answer = plan_along(task, path, grasp.q, settings=SETTINGS)
    if isinstance(answer, Plan):
        depth = deepest(scene, answer, times_between(answer.knots.times, INSTANTS - 1))
        record = MoveRecord(grasp.hand.name, number, "planned", depth, False, depth <= TOLERANCE)
        return replace(record, **_free_figures(task, path, grasp, scene)) if with_free else record
    if answer.kind != COLLISION:
        return MoveRecord(grasp.hand.name, number, answer.kind, 0.0, False, True)
    other = plan_along(unchecked, path, grasp.q, settings=SETTINGS)
    if isinstance(other, PlanFailure):
        return MoveRecord(grasp.hand.name, number, f"collision, and {other.kind}", 0.0, False, True)
    depth = deepest(scene, other, times_between(other.knots.times, INSTANTS - 1))
    inevitable = inevitable_collision(scene_of_task(task), other) is not None
    at_goal = deepest(scene, other, np.array([other.duration]), palm_only=True)
    return MoveRecord(grasp.hand.name, number, COLLISION, depth, inevitable, depth > 0.0 and (at_goal > 0.0 or not inevitable))


def _free_figures(task: GraspTask, path: StraightPath, grasp: Grasp, scene: Scene) -> dict[str, float]:
    """Return the times of `plan_free` with and without checks, each the second of two runs, and its penetration."""
    ends = path.points(np.array([0.0, 1.0]))
    seconds, depth = [], 0.0
    for each in (task, replace(task, collisions=None)):
        plan_free(each, ends.p, ends.R, grasp.q, settings=SETTINGS)  # builds the solver
        start = time.process_time()
        plan = plan_free(each, ends.p, ends.R, grasp.q, settings=SETTINGS)
        seconds.append(time.process_time() - start)
        if each is task and isinstance(plan, Plan):
            depth = deepest(scene, plan, times_between(plan.knots.times, INSTANTS - 1))
    return {"free_seconds": seconds[0], "unchecked_seconds": seconds[1], "free_depth": depth}


def measure(count: int, free: int, known: list[MoveRecord]) -> Iterator[MoveRecord]:
    """Yield the records of all moves that are not known yet, hand by hand.

    Args:
        count: moves of each hand.
        free: moves of each hand that `plan_free` plans, too.
        known: records of an earlier run.
    """
    done = {(record.hand, record.number) for record in known}
    timed = {name: sum(record.hand == name and record.free_seconds > 0.0 for record in known) for name in HANDS}
    grasps = {name: find_grasp(Hand.load(name), Body.solid(Sphere(0.03), mass=0.05), friction=0.7) for name in HANDS}
    scenes = {name: build_scene(grasp) for name, grasp in grasps.items()}
    for number in range(count):
        for name in HANDS:
            if (name, number) not in done:
                record = run_move(grasps[name], scenes[name], number, timed[name] < free)
                timed[name] += record.free_seconds > 0.0
                yield record


def table(records: list[MoveRecord]) -> str:
    """Return the table of all records.

    Args:
        records: the records.
    """
    head = (
        "hand", "moves", "planned", "deepest in a plan, mm", "refused: collision", "confirmed", "claimed for every motion",
        "confirmed", "free plans", "deepest in one, mm", "time with / without checks",
    )  # fmt: skip
    rows = []
    for name in HANDS:
        own = [record for record in records if record.hand == name]
        planned = [record for record in own if record.result == "planned"]
        refused = [record for record in own if record.result == COLLISION]
        claimed = [record for record in refused if record.inevitable]
        free = [record for record in planned if record.free_seconds > 0.0]
        ratios = [record.free_seconds / record.unchecked_seconds for record in free]
        rows.append(
            (
                name,
                str(len(own)),
                str(len(planned)),
                _depth(planned, "depth"),
                str(len(refused)),
                str(sum(record.confirmed for record in refused)),
                str(len(claimed)),
                str(sum(record.confirmed for record in claimed)),
                str(len(free)),
                _depth(free, "free_depth"),
                f"{np.median(ratios):.2f} (largest {max(ratios):.2f})" if ratios else "–",
            )
        )
    return report_page.table(head, rows)


def _depth(records: list[MoveRecord], field: str) -> str:
    return f"{1e3 * max(getattr(record, field) for record in records):.4f}" if records else "–"


def main() -> None:
    """Measure, print, and write the page."""
    options = report_page.parser("collisions", __doc__)
    options.add_argument("--moves", type=int, default=500, help="moves of each hand")
    options.add_argument("--free", type=int, default=5, help="moves of each hand that plan_free plans, too")
    options.add_argument("--records", type=Path, help="file of records: read if it exists, and continued")
    given = options.parse_args()
    records: list[MoveRecord] = []
    if given.records and given.records.exists():
        records = [MoveRecord(**json.loads(line)) for line in given.records.read_text().splitlines()]
    for record in measure(given.moves, given.free, records):
        records.append(record)
        if given.records:
            with given.records.open("a") as file:
                file.write(json.dumps(asdict(record)) + "\n")
        print(record, flush=True)
    print(table(records))
    if given.save:
        facts = report_page.facts(f"MuJoCo {mujoco.__version__}")
        report_page.save(given.save, "Collisions in plans", __doc__, facts, table(records))


if __name__ == "__main__":
    main()
