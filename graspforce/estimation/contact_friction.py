"""Friction coefficients of the contacts, with bounds, from forces of contacts that stick and contacts that slip.

A contact that sticks shows that μ is at least r = ‖f_t‖/f_n. A contact that slides shows that μ equals this ratio. So
each finger has a lower bound from the start, and an upper bound only after it slipped: before that, μ is unbounded
above. The variance of the ratio follows from the covariance of the force, σ_r² = (σ_t² + r² σ_n²)/f_n².

A slip is used only if the friction force points against it, and if all fingers press. Where a contact opens, the object
leaves the hand, and fingers that stick seem to slip. A motion that is blamed on the wrong finger usually has the friction force
along it. If another finger is nearly as likely, the two must be nearly parallel.

Fingertip sensors measure the force during the slip, whatever accelerates. Forces from torques alone have errors as large as the
forces that accelerate the finger, which widen the bounds. Such a slip may also be over when it is found: it is used if the
finger is found slipping again soon after, at the same ratio, as it slid at this ratio in between.

Slip of a finger moves its contact by an unknown part of it, which turns the normal. All earlier slip counts as error. The slip
that was just found, s, counts with the standard deviation of a uniform part, s/√12. If the ratio changes, the mean over the
window lags behind. So the difference between momentary and mean ratio also counts as error, less its noise. A ratio that is too
uncertain shows nothing: μ then stays unbounded above. Finite bounds are at most 4 max(0.15 r, 0.023) apart, with two deviations
each way.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.compiled import Block
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import set_fields, unchecked_constructor
from graspforce.core.settings_record import SettingsRecord
from graspforce.estimation.contact_forces import ContactForces
from graspforce.estimation.pose.contact_pose import ARM
from graspforce.estimation.slip.detector import SlipEstimate

_STICK_STEPS = 8  # periods between two updates of the lower bounds
_ALIGNED = 0.7  # least cosine of the angle between the slip of a finger and its force on the object
_PARALLEL = 0.95  # the same if another finger is nearly as likely to slip
_WEAK, _WEAK_RATIO = 0.15, 0.023  # standard deviation above which a slip shows nothing: of the ratio, or at least
_UNIFORM = 1.0 / math.sqrt(12.0)  # standard deviation of a uniform part of 1
_CONFIRMATION = 0.05  # s between two findings of one slip, at most
_STEADY = 3.0  # standard deviations of a momentary ratio from the mean, up to which a force counts as steady


@dataclass(frozen=True, slots=True)
class ContactFrictionSettings(SettingsRecord):
    """Settings of the estimator of friction coefficients.

    Args:
        window: time over which forces are averaged, s. A slip lasts longer before it is found.
        deviations: standard deviations between an estimate and its bounds.
        ratio_error: standard deviation of the error of a ratio that is not noise, such as from the direction of the normal.
        memory_time: time constant with which lower bounds from sticking are forgotten, s, as surfaces change.
        least_normal: normal force below which a contact shows nothing, N.

    Raises:
        InvalidInput: a value is out of range; names the field and the allowed values.
    """

    RECORD: ClassVar[str] = "contact_friction"

    window: float = 0.004
    deviations: float = 2.0
    ratio_error: float = 0.02
    memory_time: float = 60.0
    least_normal: float = 0.1

    def __post_init__(self) -> None:
        for name in ("window", "deviations", "memory_time", "least_normal"):
            set_fields(self, **{name: arrays.check_number(getattr(self, name), name, above=0.0)})
        set_fields(self, ratio_error=arrays.check_number(self.ratio_error, "ratio_error", minimum=0.0))


@dataclass(frozen=True, eq=False, slots=True)
class ContactFrictionEstimate:
    """Friction coefficients of N contacts.

    Attributes:
        lower: (N,) lower bounds.
        upper: (N,) upper bounds; infinite for a finger that never slipped.
        expected: (N,) most likely coefficients: from slips, or else the given ones, or the lower bounds if these are larger.
    """

    lower: Array
    upper: Array
    expected: Array

    def to_dict(self) -> JsonRecord:
        """Return the record of the estimate; an upper bound is null if there is none."""
        upper = [None if math.isinf(bound) else bound for bound in self.upper.tolist()]
        return {"lower": self.lower.tolist(), "upper": upper, "expected": self.expected.tolist()}


class ContactFrictionMemory(NamedTuple):
    """State of the estimator between two periods.

    Attributes:
        f: (N, 3) contact forces over the window, N; None before the first period.
        age: periods since the last update of the lower bounds.
        information: inverse variance of each coefficient from slips; zero for a finger that never slipped.
        slip_ratio: coefficient of each finger from slips.
        stick_ratio: lower bound of each finger from sticking.
        since_slip: periods since the last slip of each finger that was used.
        found_ratio: ratio of each finger when it was last found slipping.
        since_found: periods since then.
        slid: slip of each finger that was found before, m.
        estimate: the present estimate.
    """

    f: Array | None
    age: int
    information: tuple[float, ...]
    slip_ratio: tuple[float, ...]
    stick_ratio: tuple[float, ...]
    since_slip: tuple[int, ...]
    found_ratio: tuple[float, ...]
    since_found: tuple[int, ...]
    slid: tuple[float, ...]
    estimate: ContactFrictionEstimate


class FrictionBlocks(NamedTuple):
    """State of the compiled estimator (`csrc/include/graspforce/friction_bounds.h`).

    Attributes:
        state: the state.
        estimate: the present estimate.
    """

    state: Block
    estimate: ContactFrictionEstimate


class ContactFrictionEstimator:
    """Estimator of the friction coefficients of the contacts. Call `step` once every period, after `SlipDetector.step`.

    Args:
        mu: (N,) given friction coefficients, used as long as no finger slips at a smaller ratio.
        period: time between two steps, s.
        settings: windows and bounds.
    """

    def __init__(self, mu: Array, period: float, settings: ContactFrictionSettings | None = None) -> None:
        self.settings = ContactFrictionSettings() if settings is None else settings
        self._mu = arrays.check_array(mu, "mu", (None,), minimum=0.0).tolist()
        self._gain = -math.expm1(-period / self.settings.window)
        self._share = self._gain / (2.0 - self._gain)  # of the variance of the noise that remains in the mean
        self._independent = round(2.0 * self.settings.window / period)  # periods between two slips that count as independent
        self._confirmation = round(_CONFIRMATION / period)  # periods
        self._kept = math.exp(-_STICK_STEPS * period / self.settings.memory_time)

    def initial_memory(self) -> ContactFrictionMemory | FrictionBlocks:
        """Return the memory before the first step."""
        nothing = (0.0,) * len(self._mu)
        long_ago = (self._independent + self._confirmation,) * len(self._mu)
        estimate = self._estimate(nothing, nothing, nothing)
        return ContactFrictionMemory(None, 0, nothing, nothing, nothing, long_ago, nothing, long_ago, nothing, estimate)

    def step(
        self, memory: ContactFrictionMemory | FrictionBlocks, forces: ContactForces, slip: SlipEstimate
    ) -> tuple[ContactFrictionEstimate, ContactFrictionMemory | FrictionBlocks]:
        """Return the friction coefficients after a period, and the memory for the next one.

        Args:
            memory: memory after the last period; `initial_memory` before the first.
            forces: contact forces.
            slip: slip of the fingertips.
        """
        assert isinstance(memory, ContactFrictionMemory)  # `initial_memory` makes no other
        present = _present_forces(forces)
        f = present if memory.f is None else memory.f + self._gain * (present - memory.f)
        age = memory.age + 1
        if not slip.has_alarm and age < _STICK_STEPS:
            return memory.estimate, memory._replace(f=f, age=age)
        return self._updated(memory, f, forces, slip)

    # ── implementation ─────────────────────────────────────────────────────────────────────────────────────────────────────

    def _updated(
        self, memory: ContactFrictionMemory, f: Array, forces: ContactForces, slip: SlipEstimate
    ) -> tuple[ContactFrictionEstimate, ContactFrictionMemory]:
        """Return the coefficients after an update with the mean forces f."""
        settings, slipping, alarms = self.settings, slip.slipping.tolist(), slip.alarms.tolist()
        information, slip_ratio, stick_ratio = list(memory.information), list(memory.slip_ratio), list(memory.stick_ratio)
        since_slip, since_found = ([age + memory.age + 1 for age in ages] for ages in (memory.since_slip, memory.since_found))
        found_ratio, slid, present = list(memory.found_ratio), list(memory.slid), _present_forces(forces)
        all_press = min(f[:, 2].min(), present[:, 2].min()) >= settings.least_normal
        aligned = _ALIGNED if slip.is_certain else _PARALLEL
        for i, ((t1, t2, n), now) in enumerate(zip(f.tolist(), present.tolist(), strict=True)):
            stick_ratio[i] *= self._kept
            s1, s2 = slip.distance[i].tolist() if alarms[i] else (0.0, 0.0)
            found = math.hypot(s1, s2)  # m
            turned, slid[i] = math.hypot(slid[i], _UNIFORM * found), slid[i] + found  # m
            if min(n, now[2]) < settings.least_normal:
                continue
            ratio = math.hypot(t1, t2) / n
            noise, deviation = self._deviations(ratio, n, i, forces, turned)
            lag = math.hypot(now[0], now[1]) / now[2] - ratio
            if abs(lag) > _STEADY * noise:
                continue  # the ratio changes within the window
            if alarms[i]:
                deviation = math.sqrt(deviation**2 + max(lag**2 - noise**2, 0.0))
            is_weak = deviation > max(_WEAK * ratio, _WEAK_RATIO)
            is_aligned = s1 * t1 + s2 * t2 >= aligned * found * math.hypot(t1, t2)
            if alarms[i] and all_press and is_aligned and not is_weak and since_slip[i] >= self._independent:
                is_confirmed = since_found[i] <= self._confirmation and abs(ratio - found_ratio[i]) <= _STEADY * deviation
                found_ratio[i], since_found[i] = ratio, 0
                if not is_confirmed and forces.measured is None:
                    continue
                since_slip[i] = 0
                information[i], slip_ratio[i] = self._with_slip(information[i], slip_ratio[i], ratio, deviation)
                stick_ratio[i] = min(stick_ratio[i], max(ratio - settings.deviations * deviation, 0.0))
            elif not slipping[i]:
                stick_ratio[i] = max(stick_ratio[i], ratio - settings.deviations * deviation)
                if information[i] > 0.0 and stick_ratio[i] > slip_ratio[i] + settings.deviations / math.sqrt(information[i]):
                    information[i], slip_ratio[i] = 0.0, 0.0  # it sticks above the coefficient at which it slipped: μ has grown
        state = tuple(information), tuple(slip_ratio), tuple(stick_ratio)
        ages = tuple(since_slip), tuple(since_found)
        estimate = self._estimate(*state)
        return estimate, ContactFrictionMemory(f, 0, *state, ages[0], tuple(found_ratio), ages[1], tuple(slid), estimate)

    def _deviations(self, ratio: float, n: float, i: int, forces: ContactForces, slid: float) -> tuple[float, float]:
        """Return the standard deviations of a momentary ratio of finger i from noise, and of the mean ratio.

        Args:
            ratio: mean ratio.
            n: mean normal force, N.
            i: index of the finger.
            forces: contact forces.
            slid: standard deviation of the motion of the contact by slip, m.
        """
        model = self.settings.ratio_error**2 + (slid / ARM) ** 2
        if forces.measured is not None:
            noise, bias = (variance * (1.0 + ratio**2) / n**2 for variance in forces.measured_variance)
            return math.sqrt(noise), math.sqrt(self._share * noise + bias + model)
        rows = slice(3 * i, 3 * i + 3)
        noise, bias = (
            (max(t1, t2) + ratio**2 * normal) / n**2
            for t1, t2, normal in (forces.noise.diagonal()[rows].tolist(), forces.bias.diagonal()[rows].tolist())
        )
        inertial = float(np.square(forces.inertial[i]).sum()) / n**2
        return math.sqrt(noise + inertial), math.sqrt(self._share * noise + bias + inertial + model)

    def _with_slip(self, information: float, mean: float, ratio: float, deviation: float) -> tuple[float, float]:
        """Return inverse variance and mean of a coefficient after a slip at a ratio; a change of the surface starts anew."""
        new = 1.0 / deviation**2
        if information > 0.0 and abs(ratio - mean) > 3.0 * math.sqrt(1.0 / information + 1.0 / new):
            return new, ratio
        total = min(information + new, 1.0 / self.settings.ratio_error**2 if self.settings.ratio_error > 0.0 else math.inf)
        return total, mean + (ratio - mean) * new / (information + new)

    def _estimate(
        self, information: tuple[float, ...], slip: tuple[float, ...], stick: tuple[float, ...]
    ) -> ContactFrictionEstimate:
        """Return the coefficients and bounds of a state."""
        lower, upper, expected = [], [], []
        for given, known, ratio, stuck in zip(self._mu, information, slip, stick, strict=True):
            width = self.settings.deviations / math.sqrt(known) if known > 0.0 else math.inf
            lower.append(max(stuck, ratio - width))
            upper.append(ratio + width)
            expected.append(ratio if known > 0.0 else max(given, stuck))
        return make_estimate(freeze(lower), freeze(upper), freeze(expected))


def _present_forces(forces: ContactForces) -> Array:
    """Return the forces (N, 3) that show friction, N: those of fingertip sensors if there are any."""
    return forces.f if forces.measured is None else forces.measured


make_estimate = unchecked_constructor(ContactFrictionEstimate)
