"""Plausibility of the states of a stream: within the limits of the hand, and no jumps.

A state that breaks a rule is refused with the code ``implausible`` and gets no command. The client's last command stays valid
until its `validity` ends; then its watchdog holds the joints. With dt the time since the last accepted state, at most 0.01 s:

| quantity                  | range                                               | change                                 |
|---------------------------|-----------------------------------------------------|----------------------------------------|
| positions of turning      | the joint limits ± 0.1 rad                          | 0.05 rad + 1.5 dt × the limit of rates |
| and of sliding joints     | the joint limits ± 5 mm                             | 2.5 mm + 1.5 dt × the limit of rates   |
| joint rates               | 3 × their limits                                    | any                                    |
| position of the object    | reach of the fingertips + size of the object + 5 cm | 0.01 m + 2 m/s dt                      |
| orientation of the object | any                                                 | 0.1 + 20 rad/s dt, each entry of R     |
| twist of the object       | 5 m/s and 50 rad/s in each direction                | any                                    |

A jump that lasts is accepted after 0.05 s of states that agree with one another. Measured poses of the object, of a camera, may
jump: the estimator weighs them.
"""

from __future__ import annotations

import math
from functools import cache, lru_cache

import numpy as np
import numpy.typing as npt

from graspforce.control import GraspState
from graspforce.core.arrays import Array, freeze
from graspforce.core.compiled import native
from graspforce.core.errors import InvalidInput
from graspforce.estimation.measurement import Measurement
from graspforce.grasp.grasp import Grasp
from graspforce.hand.hand import Hand
from graspforce.service.wire.state_block import STACKED_NUMBERS

_POSITION_MARGIN, _SLIDE_MARGIN = 0.1, 0.005  # rad, and m for prismatic joints
_RATE_FACTOR = 3.0  # largest measured rate over the limit of the rate; measured rates are noisy
_REACH_MARGIN = 0.05  # m
_JUMP_POSTURE, _JUMP_SLIDE = 0.05, 0.0025  # rad, and m for prismatic joints, without time between two states
_JUMP_POSITION, _JUMP_ROTATION = 0.01, 0.1  # m and –, of the object
_JUMP_RATE_FACTOR, _JUMP_SPEED, _JUMP_RATE = 1.5, 2.0, 20.0  # –, m/s, rad/s: of a motion between two states
LONGEST_GAP = 0.01  # s between two states that adds to their change
OBJECT_SPEED, OBJECT_RATE = 5.0, 50.0  # m/s, rad/s: of a measured twist
_LASTING = 0.05  # s, after which a jump is accepted
_TRUE_BYTE = b"\1"  # NumPy's True in memory
_SAMPLES = 256  # postures from which the reach is computed
_REACH_FACTOR = 1.1  # for the postures between them


class Implausible(InvalidInput):
    """A state that the hand or the object cannot have."""

    code = "implausible"


Accepted = tuple[Array, float, float]
"""Numbers of a state, its time on the sender's clock, and when it was received, s."""


class StateGuard:
    """Checks of the states of one stream. One thread at a time uses it.

    Attributes:
        rules: (4, 2 n + 18) rules of q, v, and position, rotation and twist of the object: the middle and the half of the
            range, the largest change at once, and that per second.
        last: the last accepted state; None before the first.

    Args:
        grasp: hand, object and contacts.
        validity: largest age of a command of the stream, s; bounds the time that a sender's clock can add between two states.
        has_sensors: whether the states are measurements.
    """

    def __init__(self, grasp: Grasp, validity: float, has_sensors: bool = False) -> None:
        hand, n = grasp.hand, grasp.hand.n
        reach = object_reach(grasp)  # m
        slides = np.array([joint.is_prismatic for joint in hand.joints])
        margin = np.where(slides, _SLIDE_MARGIN, _POSITION_MARGIN)  # rad, m
        rate = _RATE_FACTOR * np.asarray(hand.velocity_limit)  # rad/s, m/s
        free = np.full(9, math.inf)
        speed = np.repeat([OBJECT_SPEED, OBJECT_RATE], 3)
        # in the order of _stack: q, v, position, rotation and twist of the object
        self._lower = np.concatenate([hand.q_lower - margin, -rate, np.full(3, -reach), -free, -speed])
        self._upper = np.concatenate([hand.q_upper + margin, rate, np.full(3, reach), free, speed])
        position = math.inf if has_sensors else _JUMP_POSITION
        parts = [(n, math.inf), (3, position), (9, _JUMP_ROTATION), (6, math.inf)]
        posture = np.where(slides, _JUMP_SLIDE, _JUMP_POSTURE)  # rad, m
        self._jump = np.concatenate([posture, *(np.full(count, value) for count, value in parts)])
        self._units = tuple(joint.position_unit for joint in hand.joints)
        rate = _JUMP_RATE_FACTOR * np.asarray(hand.velocity_limit)  # rad/s, m/s
        self._speed = np.concatenate([rate, np.zeros(n), np.full(3, _JUMP_SPEED), np.full(9, _JUMP_RATE), np.zeros(6)])
        self._n, self._validity = n, validity
        self._middle, self._half = middle_and_half(self._lower, self._upper)
        self.rules = np.array([self._middle, self._half, self._jump, self._speed])
        self.last: Accepted | None = None
        self._jumped: Accepted | None = None  # last state after a jump that is not accepted yet
        self._jumped_since = 0.0  # when its first state was received, s

    def check(self, state: GraspState | Measurement, time: float, received: float) -> None:
        """Accept a state.

        Args:
            state: the state.
            time: when it was sent, on the sender's clock, s.
            received: when it arrived, on the clock `time.perf_counter`, s.

        Raises:
            Implausible: it breaks a rule; names the field.
        """
        if len(state.q) != self._n or (state.v is not None and len(state.v) != self._n):
            return  # the control law names the array
        x = _stack(state)
        given = x, time, received
        if self._accept(given):
            return
        outside = np.abs(x - self._middle) > self._half
        if _TRUE_BYTE in outside.tobytes():  # faster than any()
            raise self._error(x, state, outside, None)
        if self.last is not None and _TRUE_BYTE in (jumps := self._jumps(given, self.last)).tobytes():
            if self._jumped is None or _TRUE_BYTE in self._jumps(given, self._jumped).tobytes():
                self._jumped_since = received
            self._jumped = given
            if received - self._jumped_since < _LASTING:
                raise self._error(x, state, jumps, self.last[0])
        self.last, self._jumped = given, None

    def resume(self, last: Accepted) -> None:
        """Continue after a state that was accepted elsewhere.

        Args:
            last: the state.
        """
        self.last, self._jumped = last, None

    def _accept(self, given: Accepted) -> bool:
        """Accept a plausible state in compiled code; otherwise return False, and `check` finds the broken rule."""
        if native is None:
            return False
        last, dt = (None, 0.0) if self.last is None else (self.last[0], self._elapsed(given, self.last))
        if not native.is_plausible_state(given[0], last, dt, self.rules):
            return False
        self.last, self._jumped = given, None
        return True

    def _elapsed(self, now: Accepted, last: Accepted) -> float:
        """Return the time between two states that adds to their change, s."""
        return max(min(now[1] - last[1], now[2] - last[2] + self._validity, LONGEST_GAP), 0.0)

    def _jumps(self, now: Accepted, last: Accepted) -> npt.NDArray[np.bool_]:
        """Return which quantities changed by more than their rules allow."""
        return np.abs(now[0] - last[0]) > self._jump + self._elapsed(now, last) * self._speed

    def _error(
        self, x: Array, state: GraspState | Measurement, wrong: npt.NDArray[np.bool_], last: Array | None
    ) -> Implausible:
        """Return the error of the first wrong quantity; with the last accepted state if it is a jump."""
        i, n = int(np.flatnonzero(wrong)[0]), self._n
        record = "state" if isinstance(state, GraspState) else "measurement"
        if i < n:
            field, unit = f"{record}.posture[{i}]", self._units[i]
        elif i < 2 * n:
            field, unit = f"{record}.velocity[{i - n}]", f"{self._units[i - n]}/s"
        elif i < 2 * n + 3:
            field, unit = f"{record}.object.position[{i - 2 * n}]", "m"
        elif i < 2 * n + 12:
            field, unit = f"{record}.object.rotation[{(i - 2 * n - 3) // 3}][{(i - 2 * n - 3) % 3}]", "–"
        else:
            field, unit = f"{record}.object.twist[{i - 2 * n - 12}]", "m/s or rad/s"
        if last is not None:
            return Implausible(field, float(x[i]), f"closer to the last one, {last[i]:.6g} {unit}: a jump")
        return Implausible(field, float(x[i]), f"plausible: from {self._lower[i]:.6g} to {self._upper[i]:.6g} {unit}")


def middle_and_half(lower: Array, upper: Array) -> tuple[Array, Array]:
    """Return the middle and the half of ranges; 0 and infinity where a bound is infinite.

    Args:
        lower: (m,) lower bounds.
        upper: (m,) upper bounds.
    """
    is_bounded = np.isfinite(lower) & np.isfinite(upper)
    lower, upper = np.where(is_bounded, lower, 0.0), np.where(is_bounded, upper, 0.0)
    return 0.5 * (lower + upper), np.where(is_bounded, 0.5 * (upper - lower), math.inf)


def object_reach(grasp: Grasp) -> float:
    """Return an upper bound of the distance of a held object from the origin of H, m.

    Args:
        grasp: hand, object and contacts.
    """
    size = float(np.linalg.norm(grasp.contacts.p_OC, axis=1).max())  # m
    return reach_of(grasp.hand) + size + _REACH_MARGIN


@lru_cache(maxsize=32)
def reach_of(hand: Hand) -> float:
    """Return an upper bound of the distance of the fingertips from the origin of H, m, from sampled postures.

    Args:
        hand: the hand.
    """
    rng = np.random.default_rng(0)
    lower, upper = np.clip(hand.q_lower, -np.pi, np.pi), np.clip(hand.q_upper, -np.pi, np.pi)
    postures = rng.uniform(lower, upper, size=(_SAMPLES, hand.n))
    tips = [np.linalg.norm(hand.tip_pose(q, finger.name)[0]) for q in postures for finger in hand.fingers]
    return _REACH_FACTOR * float(max(tips))


def _stack(state: GraspState | Measurement) -> Array:
    """Return q, v, and position, rotation and twist of the object in one array; NaN for what is not measured."""
    if isinstance(state, GraspState):
        motion, shared = state.object, state.q.base
        if isinstance(shared, np.ndarray) and motion.twist.base is shared and STACKED_NUMBERS in (shared.dtype.names or ()):
            return np.asarray(shared[STACKED_NUMBERS])  # of the wire: all in one block
        return np.concatenate((state.q, state.v, motion.p_HO, motion.R_HO.ravel(), motion.twist))
    v = _unknown(len(state.q)) if state.v is None else state.v
    position = _unknown(3) if state.object is None else state.object.p_HO
    return np.concatenate((state.q, v, position, _unknown(15)))


@cache
def _unknown(count: int) -> Array:
    """Return NaN for numbers that are not measured."""
    return freeze(np.full(count, math.nan))
