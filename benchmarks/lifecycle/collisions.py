"""Collisions in plans, checked by MuJoCo, and refusals, checked by a search by sampling.

Random moves of a held ball: 5 to 40 mm in any direction and up to 20° about any axis, along the straight line, from the grasp
of `find_grasp`. MuJoCo's collision detection checks every plan on the same shapes at 20 instants in each interval. It shares no
distance code with the planner.

A refusal for a collision is confirmed if MuJoCo finds a penetration on the path that the same planner makes without collision
checks. A claim that every motion collides is confirmed if MuJoCo finds the object inside the palm at the goal.

Some moves are planned by `plan_free`, too, with and without collision checks; the times are those of the second of two runs.

Refusals of `plan_free` claim that no motion exists, unless they say that their search proves nothing. For each such claim a
random tree of poses searches a motion with rolling contacts and without collisions; it ignores forces. These moves are 5 to
80 mm long: in shorter ones, a fingertip mostly reaches some place on the object, and the planner claims nothing.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks import report_page
from benchmarks.lifecycle.sampled_search import Node, find_path
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.result_file import ResultFile, read_results
from graspforce.geometry import Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search import find_grasp
from graspforce.hand.hand import Hand
from graspforce.planning import GraspTask, Plan, PlanFailure, PlanSettings, StraightPath, plan_along, plan_free
from graspforce.planning.check import times_between
from graspforce.planning.collisions import inevitable_collision, scene_of_task
from graspforce.planning.failure import COLLISION, IMMOVABLE, OVERLOADED, SINGULAR, UNHOLDABLE, UNREACHABLE
from graspforce.planning.progress import SEARCH, Progress
from graspforce.simulation import Scene, build_scene

TITLE = "Collisions"
SCHEMA = "graspforce/collisions/1"
HANDS = ("four_finger", "allegro_right", "dlr_hit2", "shadow_right", "leap_right")
INSTANTS = 20  # in each interval
SETTINGS = PlanSettings(intervals=40)
TOLERANCE = 1e-4  # m: largest penetration of a plan
LONGEST_REFUSED = 0.08  # m, of the moves whose refusals are checked
CLAIMS = (COLLISION, UNREACHABLE, SINGULAR, UNHOLDABLE, OVERLOADED, IMMOVABLE)  # kinds that exclude every motion


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


@dataclass(frozen=True, slots=True)
class RefusalRecord:
    """A refusal of `plan_free`, and the result of the search by sampling.

    Args:
        hand: name of the hand.
        number: number of the move.
        refusal: kind of the failure.
        reason: its reason.
        edges: number of edges of the path found by sampling; 0 if none was found.
        samples: number of edges that were tried at most.
    """

    hand: str
    number: int
    refusal: str
    reason: str
    edges: int
    samples: int


def random_goal(grasp: Grasp, number: int, longest: float = 0.04) -> StraightPath:
    """Return the path of a numbered move.

    Args:
        grasp: the grasp in which it starts.
        number: number of the move.
        longest: its largest length, m.
    """
    rng = np.random.default_rng(number)
    direction, axis = (x / np.linalg.norm(x) for x in rng.normal(size=(2, 3)))
    turn = Rotation.from_rotvec(np.radians(rng.uniform(0.0, 20.0)) * axis).as_matrix()
    return StraightPath(grasp.p_HO, grasp.R_HO, grasp.p_HO + rng.uniform(0.005, longest) * direction, turn @ grasp.R_HO)


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
    """Return the times of `plan_free` with and without checks, each the second of two runs, and its penetration.

    Nothing for a grasp that `plan_free` does not represent, such as one of fingers that share a joint.
    """
    ends = path.points(np.array([0.0, 1.0]))
    seconds, depth = [], 0.0
    for each in (task, replace(task, collisions=None)):
        try:
            plan_free(each, ends.p, ends.R, grasp.q, settings=SETTINGS)  # builds the solver
        except InvalidInput:
            return {}
        start = time.process_time()
        plan = plan_free(each, ends.p, ends.R, grasp.q, settings=SETTINGS)
        seconds.append(time.process_time() - start)
        if each is task and isinstance(plan, Plan):
            depth = deepest(scene, plan, times_between(plan.knots.times, INSTANTS - 1))
    return {"free_seconds": seconds[0], "unchecked_seconds": seconds[1], "free_depth": depth}


def check_refusal(grasp: Grasp, number: int, samples: int) -> RefusalRecord | None:
    """Return the record of a move that `plan_free` refuses for certain; None if it does not.

    Args:
        grasp: the grasp in which it starts.
        number: number of the move.
        samples: edges that the search tries.
    """
    task = GraspTask(grasp.hand, grasp.body, grasp.contacts, grasp.fingers)
    ends = random_goal(grasp, number, LONGEST_REFUSED).points(np.array([0.0, 1.0]))

    def until_the_search(now: Progress) -> bool:
        return now.stage != SEARCH

    try:
        answer = plan_free(task, ends.p, ends.R, grasp.q, settings=SETTINGS, callback=until_the_search)
    except InvalidInput:
        return None  # a grasp that the planner does not represent
    if isinstance(answer, Plan) or answer.kind not in CLAIMS:
        return None
    found = find_path(Node(task, ends.p[0], ends.R[0], grasp.q), ends.p[1], ends.R[1], samples, number)
    return RefusalRecord(grasp.hand.name, number, answer.kind, answer.reason, max(len(found) - 1, 0), samples)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the section.

    Args:
        parser: the parser.
    """
    parser.add_argument("--moves", type=int, default=500, help="moves of each hand (default: 500)")
    parser.add_argument("--free", type=int, default=12, help="moves of each hand that plan_free plans, too (default: 12)")
    parser.add_argument("--hands", nargs="*", choices=HANDS, help="hands (default: all)")
    parser.add_argument("--refusals", type=int, default=20, help="refusals of each hand to check (default: 20)")
    parser.add_argument("--samples", type=int, default=60, help="edges that the search for a refused move tries (default: 60)")


def run(path: Path, options: argparse.Namespace) -> None:
    """Run the moves that are missing in a file of results, number by number and hand by hand.

    Args:
        path: the file.
        options: of the section.
    """
    with ResultFile(path, SCHEMA, {}) as file:
        known = [record for record in file.records if isinstance(record, dict)]
        done = {(each["hand"], each["number"]) for each in known if "result" in each}
        timed = {name: sum(each["hand"] == name and each.get("free_seconds", 0.0) > 0.0 for each in known) for name in HANDS}
        refused = {name: [each["number"] for each in known if each["hand"] == name and "refusal" in each] for name in HANDS}
        hands = options.hands or HANDS
        grasps = {name: find_grasp(Hand.load(name), Body.solid(Sphere(0.03), mass=0.05), friction=0.7) for name in hands}
        scenes = {name: build_scene(grasp) for name, grasp in grasps.items()}
        for number in range(options.moves):
            for name in hands:
                if (name, number) not in done:
                    record = run_move(grasps[name], scenes[name], number, timed[name] < options.free)
                    timed[name] += record.free_seconds > 0.0
                    file.append(asdict(record))
                    print(record, flush=True)
                if len(refused[name]) < options.refusals and number > max(refused[name], default=-1):
                    refusal = check_refusal(grasps[name], number, options.samples)
                    if refusal is not None:
                        refused[name].append(number)
                        file.append(asdict(refusal))
                        print(refusal, flush=True)


def page(path: Path) -> str:
    """Return the Markdown of the section.

    Args:
        path: the file of results.
    """
    known = [record for record in read_results(path, SCHEMA)[1] if isinstance(record, dict)]
    moves = [MoveRecord(**record) for record in known if "result" in record]
    refusals = [RefusalRecord(**record) for record in known if "refusal" in record]
    about = [" ".join(part.split()) for part in (__doc__ or "").split("\n\n")[1:]]
    explanation = "The other moves fail before their collisions matter: a joint limit or a singular finger ends them."
    return "\n\n".join([*about, table(moves), explanation, "### Refusals of plan_free", _refusal_table(refusals)])


def _refusal_table(refusals: list[RefusalRecord]) -> str:
    """Return the table of all refusals that were checked."""
    head = ("hand", "refusals", "by kind", "samples each", "a path found by sampling")
    rows = []
    for name in HANDS:
        own = [each for each in refusals if each.hand == name]
        kinds = ", ".join(
            f"{kind} {sum(each.refusal == kind for each in own)}" for kind in sorted({each.refusal for each in own})
        )
        samples = ", ".join(str(count) for count in sorted({each.samples for each in own}))
        rows.append((name, str(len(own)), kinds or "–", samples or "–", str(sum(each.edges > 0 for each in own))))
    return report_page.table(head, rows)


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
