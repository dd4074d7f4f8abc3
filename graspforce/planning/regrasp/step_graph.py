"""Sequences of finger steps at one pose of the object, as paths in a graph of grasps.

A node is one place for each finger: the present one, or one of some random places. An edge moves one finger while the others
hold. The search is best first: by the steps so far, and the number of fingers that cannot follow the object far enough and must
therefore step. Places of all kinds take part, so that a finger may step to a place that only lets another one step.

Margins are checked when an edge is found, collisions and motions when it is used.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from graspforce.core.arrays import Array
from graspforce.planning.regrasp.contact_candidates import Candidate
from graspforce.planning.regrasp.records import FingerStage
from graspforce.planning.regrasp.rolling_motion import HeldObject
from graspforce.planning.regrasp.step_tools import StepTools

_LARGEST_USE = 40  # edges whose motions are planned, at most
_LARGEST_DEPTH = 8  # steps in a sequence, at most
_TRAVEL_WEIGHT = 0.9  # of the travel against a step: of two sequences with equally many steps the one with more travel is first

Choice = tuple[int, ...]  # for each finger the index of its place; 0 is the present one


@dataclass(frozen=True, eq=False, slots=True)
class _Place:
    """A place of a finger.

    Attributes:
        candidate: place and posture; None for the present ones.
        travel: how far the finger can follow the object from there, as a fraction of the wanted distance.
        tip: (3,) position of the fingertip in H, m.
    """

    candidate: Candidate | None
    travel: float
    tip: Array


class StepGraph:
    """The graph of grasps at one state.

    Args:
        tools: tools of the search.
        start: fingers and object.
        wanted: distance that each finger should be able to follow the object afterwards, in units of the path parameter.
    """

    def __init__(self, tools: StepTools, start: HeldObject, wanted: float) -> None:
        self._tools, self._start, self._wanted = tools, start, wanted
        self._places = [self._places_of(name) for name in start.fingers]
        self._radii = [tools.hand.finger(name).tip_radius or 0.0 for name in start.fingers]  # m
        self._margins: dict[tuple[int | None, ...], float] = {}  # by choice; None for a finger without contact

    def sequences(self) -> Iterator[list[FingerStage]]:
        """Yield sequences of steps to grasps from which every finger can follow the object far enough, the shortest first."""
        first = (0,) * len(self._places)
        heap: list[tuple[float, int, Choice, HeldObject, list[FingerStage], int, int]] = []
        count, used, reached = 0, 0, {first}
        self._push_edges(heap, first, self._start, [], count)
        while heap and used < _LARGEST_USE:
            _, _, choice, at, stages, i, k = heapq.heappop(heap)
            after = (*choice[:i], k, *choice[i + 1 :])
            candidate = self._places[i][k].candidate
            if after in reached or candidate is None:
                continue
            finger = self._start.fingers[i]
            if self._tools.clearance(self._tools.state_after(at, finger, candidate, candidate.q)) < 0.0:
                continue
            used += 1
            stage = self._tools.step(at, finger, candidate)
            if stage is None:
                continue
            reached.add(after)
            following = [*stages, stage]
            if self._lacking(after) == 0:
                yield following
            if len(following) < _LARGEST_DEPTH:
                count = len(heap) + count
                self._push_edges(heap, after, stage.end, following, count)

    def _push_edges(
        self,
        heap: list[tuple[float, int, Choice, HeldObject, list[FingerStage], int, int]],
        choice: Choice,
        at: HeldObject,
        stages: list[FingerStage],
        count: int,
    ) -> None:
        """Add the edges of a node that keep the slip margin."""
        least = self._tools.least
        for i, places in enumerate(self._places):
            if self._margin((*choice[:i], None, *choice[i + 1 :])) < least:
                continue
            for k in range(1, len(places)):
                after = (*choice[:i], k, *choice[i + 1 :])
                if k == choice[i] or not self._is_spaced(after, i) or self._margin(after) < least:
                    continue
                travel = sum(self._places[j][c].travel for j, c in enumerate(after)) / len(after)
                cost = len(stages) + 1 + self._lacking(after) - _TRAVEL_WEIGHT * travel
                count += 1
                heapq.heappush(heap, (cost, count, choice, at, stages, i, k))

    def _lacking(self, choice: Choice) -> int:
        """Return the number of fingers that cannot follow the object far enough."""
        return sum(self._places[i][k].travel < 1.0 - 1e-6 for i, k in enumerate(choice))

    def _margin(self, choice: tuple[int | None, ...]) -> float:
        """Return the slip margin of a choice of places, N."""
        if choice not in self._margins:
            state = self._start
            for i, k in enumerate(choice):
                candidate = None if k is None else self._places[i][k].candidate
                if candidate is not None:
                    state = self._tools.state_after(state, self._start.fingers[i], candidate, candidate.q)
            missing = [name for name, k in zip(self._start.fingers, choice, strict=True) if k is None]
            for name in missing:
                state = state.without(name)
            self._margins[choice] = self._tools.holding.find(state)
        return self._margins[choice]

    def _is_spaced(self, choice: Choice, i: int) -> bool:
        """Return whether the tip of a finger keeps its distance from the others."""
        tips = [self._places[j][k].tip for j, k in enumerate(choice)]
        least = [self._radii[i] + radius + self._tools.settings.spacing for radius in self._radii]
        return all(j == i or np.linalg.norm(tips[j] - tips[i]) > least[j] for j in range(len(tips)))

    def _places_of(self, finger: str) -> list[_Place]:
        """Return the places of a finger, the present one first."""
        tools, start, motion = self._tools, self._start, self._tools.path.motion(self._start.u)
        present = np.asarray(tools.hand.tip_pose(start.q, finger)[0])
        found = [_Place(None, tools.travel(start, finger, self._wanted) / self._wanted, present)]
        radius = tools.hand.finger(finger).tip_radius or 0.0  # m
        for candidate in tools.places.find(finger, motion, start.q, (), tools.settings.candidates, tools.rng):
            state = tools.state_after(start, finger, candidate, candidate.q)
            tip = candidate.contact.position - radius * candidate.contact.normal  # in O, m
            travel = tools.travel(state, finger, self._wanted) / self._wanted
            found.append(_Place(candidate, travel, motion.p_HO + motion.R_HO @ tip))
        return found
