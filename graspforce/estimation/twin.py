"""A twin of a hand that holds an object: it compares the motion with the model, and reports drift.

| figure | meaning | drift if |
|---|---|---|
| share | torques that the motors make, over those that were commanded (`graspforce.estimation.motor_share`) | far from 1 |
| residual | what the share does not explain, over the uncertainty of torques and weight | above its limit |
| creep | sliding of each fingertip on the object, per minute | above its limit |
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import set_fields
from graspforce.estimation.motor_share import HeldState, ShareEquation, share_equation
from graspforce.grasp.grasp import Grasp

_PIECE = 0.05  # s, of the states in one equation
_LONGEST_GAP = 0.02  # s, between two states of a piece
_MINUTE = 60.0  # s
_FIGURES = ("share", "share_error", "residual")


@dataclass(frozen=True, slots=True)
class TwinSettings:
    """Settings of a twin.

    Args:
        window: time over which the share is estimated, s.
        share_limit: deviation of the share from 1 that counts as drift.
        residual_limit: residual that counts as drift.
        creep_limit: creep that counts as drift, m/min.

    Raises:
        InvalidInput: a value is not a finite number above 0.
    """

    window: float = 4.0
    share_limit: float = 0.1
    residual_limit: float = 5.0
    creep_limit: float = 2e-3

    def __post_init__(self) -> None:
        for name in ("window", "share_limit", "residual_limit", "creep_limit"):
            set_fields(self, **{name: arrays.check_number(getattr(self, name), name, above=0.0)})


@dataclass(frozen=True, eq=False, slots=True)
class TwinReading:
    """Figures of a twin at one time.

    Attributes:
        t: time since the first state, s.
        share: share of the commanded torques that the motors make.
        share_error: standard deviation of the share.
        residual: root mean square of what the share does not explain, over its uncertainty.
        creep: (N,) sliding of each fingertip in the last minute, m/min; drift only after the first minute.
        drifts: sentences about the figures beyond their limits.
    """

    t: float
    share: float
    share_error: float
    residual: float
    creep: Array
    drifts: tuple[str, ...] = ()

    def to_dict(self) -> JsonRecord:
        """Return a plain record, creep in m/min."""
        numbers = {name: getattr(self, name) for name in ("t", *_FIGURES)}
        return {**numbers, "creep": self.creep.tolist(), "drifts": list(self.drifts)}


class Twin:
    """The twin of one grasp. One thread at a time uses it.

    Args:
        grasp: hand, object and contacts as modelled.
        gravity_H: (3,) acceleration of gravity in H, m/s².
        settings: limits.

    Attributes:
        minutes: means of the readings of each full minute, the earliest first.
    """

    def __init__(self, grasp: Grasp, gravity_H: Array, settings: TwinSettings | None = None) -> None:
        self._grasp, self._gravity_H, self._settings = grasp, gravity_H, settings or TwinSettings()
        self._piece: list[HeldState] = []
        self._window: deque[ShareEquation] = deque()
        self._slides: deque[ShareEquation] = deque()
        self._minute: list[TwinReading] = []
        self.minutes: list[TwinReading] = []
        self._start: float | None = None

    def add(self, state: HeldState) -> TwinReading | None:
        """Take the next state. Return a reading twenty times a second, as soon as the window is full.

        Args:
            state: the state. After a gap in the times, the window begins again.
        """
        if self._piece and not 0.0 < state.t - self._piece[-1].t <= _LONGEST_GAP:
            self._piece, self._start = [], None
            self._window.clear()
            self._slides.clear()
        self._start = state.t if self._start is None else self._start
        self._piece.append(state)
        if state.t - self._piece[0].t < _PIECE:
            return None
        equation = share_equation(self._grasp, self._piece, self._gravity_H)
        self._piece = [state]
        self._window.append(equation)
        self._slides.append(equation)
        while self._window[0].t <= state.t - self._settings.window:
            self._window.popleft()
        while self._slides[0].t <= state.t - _MINUTE:
            self._slides.popleft()
        return None if state.t - self._start < self._settings.window else self._read(state.t - self._start)

    def _read(self, t: float) -> TwinReading:
        """Return the reading of the present window, and count it for its minute."""
        count = len(self._window)
        information = sum(each.information for each in self._window)
        product, square = (sum(getattr(each, name) for each in self._window) for name in ("product", "square"))
        share = product / information if information > 0.0 else 1.0
        error = np.sqrt(count / information) if information > 0.0 else np.inf  # one error in the whole window
        residual = np.sqrt(max(square - share * product, 0.0) / count)
        slid = np.linalg.norm(sum(each.sliding for each in self._slides), axis=1)
        elapsed = sum(each.duration for each in self._slides)  # s
        creep = freeze(slid * (_MINUTE / elapsed))
        reading = TwinReading(t, float(share), float(error), float(residual), creep)
        reading = replace(reading, drifts=self._drifts(reading))
        if self._minute and t // _MINUTE > self._minute[-1].t // _MINUTE:
            self.minutes.append(_mean(self._minute))
            self._minute = []
        self._minute.append(reading)
        return reading

    def _drifts(self, reading: TwinReading) -> tuple[str, ...]:
        """Return sentences about the figures beyond their limits."""
        limits, found = self._settings, []
        if abs(reading.share - 1.0) > max(limits.share_limit, 2.0 * reading.share_error):
            text = (
                f"the motors make {reading.share:.2f} of the commanded torques, or the object weighs {1.0 / reading.share:.2f}"
            )
            found.append(f"{text} of its mass (± {2.0 * reading.share_error:.2f})")
        if reading.residual > limits.residual_limit:
            found.append(f"the motion differs from the model by {reading.residual:.1f} times its uncertainty")
        for finger, creep in zip(self._grasp.fingers, reading.creep.tolist(), strict=True):
            if creep > limits.creep_limit and reading.t >= _MINUTE:
                found.append(f"{finger} creeps on the object by {1e3 * creep:.1f} mm/min")
        return tuple(found)


def _mean(readings: list[TwinReading]) -> TwinReading:
    """Return the mean figures of readings, with the time of the last one and all drifts."""
    share, error, residual = (float(np.mean([getattr(r, name) for r in readings])) for name in _FIGURES)
    creep = np.mean([each.creep for each in readings], axis=0)
    drifts = tuple(dict.fromkeys(text for each in readings for text in each.drifts))
    return TwinReading(readings[-1].t, share, error, residual, freeze(creep), drifts[-1:])
