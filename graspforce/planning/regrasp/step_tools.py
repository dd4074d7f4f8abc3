"""What a search of finger steps needs at one pose of the object: places, travels, clearances, and single steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from graspforce.contact.contact import ContactSet
from graspforce.core.arrays import Array, freeze
from graspforce.grasp.collision.scene_collision import SceneCollision
from graspforce.planning.regrasp.contact_candidates import WIDE_CLEARANCE, Candidate, CandidateOptions, ContactCandidates
from graspforce.planning.regrasp.finger_step import FingerStepPlanner, step_duration
from graspforce.planning.regrasp.holding import HoldingMargin
from graspforce.planning.regrasp.records import FingerStage, RegraspSettings, RegraspTask
from graspforce.planning.regrasp.rolling_motion import HeldObject, RollingMotion

_COARSE = 0.06  # rad: step of the rolling motion that estimates how far a finger can follow


class StepTools:
    """Tools of the search for one task.

    Args:
        task: the task.
        settings: of the search.
        on_try: called before each step that is tried; it may raise an error to end the search.

    Attributes:
        hand: the hand.
        path: path of the object.
        settings: of the search.
        least: least slip margin, N.
        scene: collision geometry of hand, object and obstacles; None for no checks.
        rolling: rolling motion of the fingertips.
        holding: slip margins.
        places: places that fingers can touch.
        rng: generator of the random places.
    """

    def __init__(self, task: RegraspTask, settings: RegraspSettings, on_try: Callable[[], None]) -> None:
        grasp, shape = task.grasp, task.shape
        hand = grasp.hand
        self.hand, self.path, self.settings, self._on_try = hand, task.path, settings, on_try
        self.least = settings.least_margin(task.control)
        self.scene, self._own_scenes = None, dict[str, SceneCollision]()
        if task.collisions is not None:
            self.scene = SceneCollision(hand, shape, grasp.fingers, task.collisions)
            self._own_scenes = {name: self.scene.of_finger(name) for name in grasp.fingers}
        self.rolling = RollingMotion(hand, shape, task.path)
        self.holding = HoldingMargin(hand, grasp.body, task.path, task.control, 2.0 * self.least)
        options = CandidateOptions(settings.spacing, self.scene)
        self.places = ContactCandidates(hand, shape, grasp.fingers, grasp.contacts.contacts, options)
        self._steps = FingerStepPlanner(hand, shape, self.scene)
        self.rng = np.random.default_rng(settings.seed)

    def travel(self, at: HeldObject, finger: str, wanted: float) -> float:
        """Return how far a finger can follow along the path, clear of object and palm; at most the wanted distance.

        Args:
            at: fingers and object.
            finger: name of the finger.
            wanted: the distance, in units of the path parameter.
        """
        run = self.rolling.roll(at.only([finger]), at.u + wanted, _COARSE)
        if self.scene is not None:
            run = self._free_part(run, self._own_scenes[finger])
        return run[-1].u - at.u

    def _free_part(self, run: list[HeldObject], scene: SceneCollision) -> list[HeldObject]:
        """Return the states of a run before the first collision in a scene, at least one."""
        motions = [self.path.motion(state.u) for state in run]
        q = np.array([state.q for state in run])
        p, R = np.array([motion.p_HO for motion in motions]), np.array([motion.R_HO for motion in motions])
        count = len(run)
        while count > 1:
            along = scene.least_gap_along(q[:count], p[:count], R[:count])
            if along is None or along.gap.distance >= scene.margin:
                break
            count = max(along.instant, 1)
        return run[:count]

    def clearance(self, state: HeldObject) -> float:
        """Return the clearance of all bodies beyond their margin, m, at most `WIDE_CLEARANCE`; negative if two are too near.

        Args:
            state: fingers and object.
        """
        motion = self.path.motion(state.u)
        gap = None if self.scene is None else self.scene.least_gap(state.q, motion.p_HO, motion.R_HO)
        return WIDE_CLEARANCE if self.scene is None or gap is None else min(gap.distance - self.scene.margin, WIDE_CLEARANCE)

    def state_after(self, at: HeldObject, finger: str, candidate: Candidate, q_finger: Array) -> HeldObject:
        """Return the state after a step of a finger.

        Args:
            at: the state before.
            finger: name of the finger.
            candidate: its new place.
            q_finger: (m,) its joint positions there, rad.
        """
        q = np.array(at.q)
        q[list(self.hand.finger(finger).joints)] = q_finger
        contacts = list(at.contacts.contacts)
        contacts[at.fingers.index(finger)] = candidate.contact
        return replace(at, q=freeze(q), contacts=ContactSet.stack(contacts))

    def step(self, at: HeldObject, finger: str, candidate: Candidate) -> FingerStage | None:
        """Return the step of a finger to a place; None if there is no motion, or no forces at its end.

        Args:
            at: the state before.
            finger: name of the finger.
            candidate: its new place.
        """
        self._on_try()
        before = at.contacts.contacts[at.fingers.index(finger)]
        postures = self._steps.plan(finger, self.path.motion(at.u), at.q, before, candidate.contact)
        if postures is None:
            return None
        end = self.state_after(at, finger, candidate, postures[-1][list(self.hand.finger(finger).joints)])
        margin = min(self.holding.find(end), self.holding.find_without(at, finger))
        if margin < self.least:
            return None
        limit = np.minimum(0.5 * self.hand.velocity_limit, self.settings.joint_rate)  # rad/s
        duration = step_duration(self.hand, postures, limit, self.settings.torque_rate)
        return FingerStage(finger, candidate.contact, postures, end, duration, margin)
