"""Search of object moves and finger steps over a graph of grasps.

A node is a pose of the object with the contacts of its fingers. Its edges are steps of single fingers while the others hold,
followed by a move of the object as far as every finger can follow and forces hold it. The search extends the node that is
farthest along the path, less a share for each time that it was extended before. At first each finger steps to a place that
allows a long travel of the object and lets the other fingers step later; among the best places one is drawn at random. Where
this fails, sequences of steps are searched in the graph of grasps at one pose; see `step_graph`.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice
from typing import NamedTuple

import numpy as np

from graspforce.core.arrays import Array
from graspforce.hand.collision import LinkGap
from graspforce.planning.regrasp.contact_candidates import WIDE_CLEARANCE, Candidate
from graspforce.planning.regrasp.records import FingerStage, ObjectStage, RegraspSettings, RegraspTask, Stage
from graspforce.planning.regrasp.rolling_motion import HeldObject
from graspforce.planning.regrasp.step_graph import StepGraph
from graspforce.planning.regrasp.step_tools import StepTools

_AT_END = 1e-9  # of the path parameter
_CHECK_EVERY = 3  # steps of the rolling motion between checks of forces
_LEAST_PROGRESS = 0.05  # rad: a round of finger steps must move the object at least by this much
_RETREAT = 0.3  # rad: fingers step at most this far before the end of a move
_WIDE_RETREAT = 0.6  # rad: the same for sequences out of the graph of grasps
_TRAVEL_SHARES = (1.0, 0.5, 0.25)  # of the wanted travel, which every finger has after such a sequence
_SEQUENCES = 6  # that are tried at a state
_FATIGUE = 0.1  # rad by which a node counts as less far for each time that it was extended
_CLEARANCE_WEIGHT = 0.5  # of a wide clearance, against the whole travel
_PEAK = 1.875  # largest rate of the rise with least jerk, divided by its mean
_MIN_DURATION = 0.25  # s


@dataclass(frozen=True, slots=True)
class RegraspProgress:
    """Progress of a search.

    Attributes:
        u: farthest place on the path so far.
        length: length of the path.
        tried: number of finger steps that were tried.
        seconds: time since the start, s.
    """

    u: float
    length: float
    tried: int
    seconds: float


RegraspCallback = Callable[[RegraspProgress], bool | None]  # returns False to stop


class _Ranked(NamedTuple):
    """A place for a finger with its score."""

    score: float
    candidate: Candidate
    state: HeldObject


@dataclass(eq=False, slots=True)
class _Node:
    """A move of the object, and what came before.

    Attributes:
        parent: the node before; None at the start.
        left: index of the parent's state in which its move ended and the fingers stepped.
        steps: the finger steps then.
        run: states of the object's move after them.
        margins: of these states, N.
        blocking: fingers that collide if the move goes on.
        expansions: number of times that the node was extended.
    """

    parent: _Node | None
    left: int
    steps: list[FingerStage]
    run: list[HeldObject]
    margins: Array
    blocking: tuple[str, ...]
    expansions: int = 0

    @property
    def u(self) -> float:
        """Place on the path at the end."""
        return self.run[-1].u


class _SearchEndedError(Exception):
    """The budget is spent, or the callback stops the search."""


class RegraspSearch:
    """The search for one task.

    Args:
        task: the task.
        settings: of the search.
        callback: called after each finger step that is tried.

    Attributes:
        farthest: farthest place on the path that was reached.
        obstacle: what stopped the object there, in words.
    """

    def __init__(self, task: RegraspTask, settings: RegraspSettings, callback: RegraspCallback | None = None) -> None:
        self._task, self._settings, self._callback = task, settings, callback
        self._hand, self._path = task.grasp.hand, task.path
        self._tools = StepTools(task, settings, self._count_step)
        self._least, self._scene, self._rng = self._tools.least, self._tools.scene, self._tools.rng
        self._started, self._tried = 0.0, 0
        self.farthest, self.obstacle = 0.0, ""

    def run(self) -> tuple[Stage, ...] | None:
        """Return the stages to the end of the path; None if the search found none within its budget."""
        grasp = self._task.grasp
        self._started, self._tried, self.farthest = time.perf_counter(), 0, 0.0
        start = HeldObject(0.0, grasp.q, grasp.fingers, grasp.contacts)
        nodes = [_Node(None, 0, [], *self._advance(start))]
        try:
            while nodes[-1].u < self._path.length - _AT_END:
                node = max(nodes, key=lambda each: each.u - _FATIGUE * each.expansions)
                node.expansions += 1
                child = self._extend(node)
                if child is not None:
                    nodes.append(child)
                    self.farthest = max(self.farthest, child.u)
        except _SearchEndedError:
            return None
        return tuple(self._stages(nodes[-1]))

    def _stages(self, node: _Node) -> list[Stage]:
        """Return the stages from the start to the end of a node."""
        stages: list[Stage] = []
        last, following = len(node.run) - 1, node
        current: _Node | None = node
        while current is not None:
            if last > 0:
                stages = [self._object_stage(current.run[: last + 1], current.margins[: last + 1]), *stages]
            stages = [*current.steps, *stages]
            following, current = current, current.parent
            last = following.left
        return stages

    # ── the object moves ───────────────────────────────────────────────────────────────────────────────────────────────────

    def _advance(self, state: HeldObject) -> tuple[list[HeldObject], Array, tuple[str, ...]]:
        """Return the states along the path as far as fingers, forces and collisions allow.

        Returns:
            The states, their slip margins, N, and the fingers that would collide next.
        """
        run = self._tools.rolling.roll(state, self._path.next_knot(state.u))
        margins = np.full(len(run), np.inf)
        for k in range(len(run)):
            if k % _CHECK_EVERY == 0 or k == len(run) - 1:
                margins[k] = self._tools.holding.find(run[k])
                if margins[k] < self._least:
                    self.obstacle = "no forces keep the slip margin"
                    return run[: max(k - _CHECK_EVERY, 0) + 1], margins[: max(k - _CHECK_EVERY, 0) + 1], ()
            motion = self._path.motion(run[k].u)
            gap = None if self._scene is None else self._scene.least_gap(run[k].q, motion.p_HO, motion.R_HO)
            if gap is not None and k > 0 and gap.distance < self._margin_of_scene:
                self.obstacle = f"{gap.first} and {gap.second} come too near"
                return run[:k], margins[:k], self._fingers_of(gap)
        return run, margins, ()

    def _fingers_of(self, gap: LinkGap) -> tuple[str, ...]:
        """Return the fingers that two bodies belong to."""
        if self._scene is None:
            return ()
        found = [self._scene.finger_of(name, self._task.grasp.fingers) for name in (gap.first, gap.second)]
        return tuple(name for name in found if name is not None)

    @property
    def _margin_of_scene(self) -> float:
        """Distance that bodies keep, m."""
        return 0.0 if self._scene is None else self._scene.margin

    def _object_stage(self, run: list[HeldObject], margins: Array) -> ObjectStage:
        """Return the stage of a run of states."""
        q, du = np.array([state.q for state in run]), np.diff([state.u for state in run])
        length = float(du.sum())
        slope = np.abs(np.diff(q, axis=0)) / du[:, None]  # rad for each unit of the path
        by_joints = _PEAK * length * float((slope / (0.5 * self._hand.velocity_limit)).max())
        duration = max(_PEAK * length / self._settings.object_rate, by_joints, _MIN_DURATION)
        return ObjectStage(tuple(run), duration, float(margins.min()))

    # ── a finger steps ─────────────────────────────────────────────────────────────────────────────────────────────────────

    def _extend(self, node: _Node) -> _Node | None:
        """Return the node after a round of finger steps and a move of the object; None if the object gains nothing."""
        self._check_budget()
        if node.expansions % 2 == 0:
            return self._extend_by_graph(node)
        left = self._leave(node, _RETREAT)
        at, moved = node.run[left], set[str]()
        steps: list[FingerStage] = []
        wanted = min(self._settings.advance, self._path.length - at.u)
        while True:
            travels = {name: self._tools.travel(at, name, wanted) for name in at.fingers if name not in moved}
            short = [name for name in travels if travels[name] < wanted - _AT_END]
            order = [name for name in node.blocking if name in travels]
            order += sorted((name for name in short if name not in order), key=travels.__getitem__)
            if not order and steps:
                break
            spare = [name for name in travels if name not in order]
            stage = None
            for finger in [*order, *(spare[i] for i in self._rng.permutation(len(spare)))]:
                moved.add(finger)
                stage = self._step_somewhere(at, finger, wanted)
                if stage is not None:
                    break
            if stage is None:
                break
            steps.append(stage)
            at = stage.end
            moved = {stage.finger for stage in steps}
        return self._node_after(node, left, steps) if steps else None

    def _extend_by_graph(self, node: _Node) -> _Node | None:
        """Return the node after a sequence of finger steps out of the graph of grasps at one pose; None if there is none."""
        left = self._leave(node, _WIDE_RETREAT)
        at = node.run[left]
        wanted = float(self._rng.choice(_TRAVEL_SHARES)) * min(self._settings.advance, self._path.length - at.u)
        for steps in islice(StepGraph(self._tools, at, wanted).sequences(), _SEQUENCES):
            after = self._node_after(node, left, steps)
            if after is not None:
                return after
        return None

    def _leave(self, node: _Node, retreat: float) -> int:
        """Return the index of the state in which fingers step: the last one first, later any of the last ones."""
        early = [k for k, state in enumerate(node.run) if state.u >= node.u - retreat]
        return early[-1] if node.expansions == 1 else int(self._rng.choice(early))

    def _node_after(self, node: _Node, left: int, steps: list[FingerStage]) -> _Node | None:
        """Return the node after finger steps and a move of the object; None if the object gains nothing."""
        at = steps[-1].end
        run, margins, blocking = self._advance(at)
        if run[-1].u < max(at.u + _LEAST_PROGRESS, min(node.u + _LEAST_PROGRESS, self._path.length - _AT_END)):
            return None
        return _Node(node, left, steps, run, margins, blocking)

    def _step_somewhere(self, at: HeldObject, finger: str, wanted: float) -> FingerStage | None:
        """Return the step of a finger to one of its best places; None if it cannot step."""
        if self._tools.holding.find_without(at, finger) < self._least:
            return None
        ranked = self._rank(at, finger, wanted)[: self._settings.branches]
        for k in self._rng.permutation(len(ranked)):
            stage = self._tools.step(at, finger, ranked[k].candidate)
            if stage is not None:
                return stage
        return None

    def _rank(self, at: HeldObject, finger: str, wanted: float) -> list[_Ranked]:
        """Return places for a finger, the best first."""
        others = [name for name in at.fingers if name != finger]
        motion = self._path.motion(at.u)
        found = self._tools.places.find(finger, motion, at.q, others, self._settings.candidates, self._rng)
        ranked = []
        for candidate in found:
            state = self._tools.state_after(at, finger, candidate, candidate.q)
            clearance = min(self._tools.clearance(state), candidate.clearance)
            if self._tools.holding.find(state) < self._least or clearance < 0.0:
                continue
            travel = self._tools.travel(state, finger, wanted) / wanted
            free = np.mean([min(self._tools.holding.find_without(state, name) / self._least, 1.5) for name in others])
            score = travel + float(free) + _CLEARANCE_WEIGHT * clearance / WIDE_CLEARANCE
            ranked.append(_Ranked(score, candidate, state))
        return sorted(ranked, key=lambda each: -each.score)

    def _count_step(self) -> None:
        """Count a step that is tried."""
        self._tried += 1
        self._check_budget()

    def _check_budget(self) -> None:
        """Report the progress, and end the search if its budget is spent.

        Raises:
            _SearchEndedError: the budget is spent, or the callback stops the search.
        """
        seconds = time.perf_counter() - self._started
        progress = RegraspProgress(self.farthest, self._path.length, self._tried, seconds)
        if seconds > self._settings.budget or (self._callback is not None and self._callback(progress) is False):
            raise _SearchEndedError
