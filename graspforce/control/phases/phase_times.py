"""Planned times of the phases, and their check against the time limits."""

from __future__ import annotations

import numpy as np

from graspforce.control.phases.cycle_plan import CyclePlan, move_time
from graspforce.control.phases.phase_rules import PHASE_RULES, PhaseName
from graspforce.control.phases.phase_settings import PhaseSettings
from graspforce.control.phases.tip_motion import TipMotion
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.grasp.grasp import Grasp
from graspforce.hand.hand import Hand

_OPENING_RATE = 1.0  # rad/s: mean rate of the fastest joint from the released posture to the pre-grasp posture
_SLIDING_SPEED = 0.05  # m/s: the same of a prismatic joint
_LEAST_OPENING_TIME = 0.3  # s
_LEAST_RELEASE_TIME = 0.2  # s, of the opening in the release


def opening_time(hand: Hand, q: Array, q_open: Array) -> float:
    """Return the time in which fingers without contact move to the pre-grasp posture, s.

    Args:
        hand: the hand.
        q: (n,) joint positions at the start, rad.
        q_open: (n,) the pre-grasp posture, rad.
    """
    rates = np.array([_SLIDING_SPEED if joint.is_prismatic else _OPENING_RATE for joint in hand.joints])
    return max(float((np.abs(q_open - q) / rates).max()), _LEAST_OPENING_TIME)


def release_time(grasp: Grasp, q: Array, q_open: Array, settings: PhaseSettings) -> float:
    """Return the time in which the fingers leave the object, s.

    Args:
        grasp: the grasp.
        q: (n,) joint positions at the start, rad.
        q_open: (n,) the pre-grasp posture, rad.
        settings: speed of the fingertips.
    """
    tips = TipMotion(grasp.hand, grasp.fingers)
    distance = float(np.linalg.norm(tips.positions(q_open) - tips.positions(q), axis=1).max())  # m
    return max(distance / settings.open_speed, _LEAST_RELEASE_TIME)


def planned_times(plan: CyclePlan, settings: PhaseSettings) -> dict[PhaseName, tuple[float, str]]:
    """Return the planned time of each phase, s, and the field that decides it.

    Contacts are where the plan expects them. In reopen the fingers are at their contacts, and the base stays.

    Args:
        plan: the plan.
        settings: settings of the phases.
    """
    grasp, profiles, settling = plan.grasp, plan.carry_profiles, settings.settling_time
    opening = opening_time(grasp.hand, grasp.q, plan.q_pregrasp)
    release = release_time(grasp, grasp.q, plan.q_pregrasp, settings)
    record = settings.RECORD
    return {
        "approach": (plan.approach.duration + settling, "plan.approach"),
        "close": (float(plan.standoff.max()) / settings.close_speed, f"{record}.close_speed"),
        "squeeze": (settings.squeeze_time + settings.transfer_time, f"{record}.squeeze_time"),
        "lift": (profiles.lift.duration + settling, "plan.profiles.lift"),
        "move": (profiles.move.duration + settling, "plan.profiles.move"),
        "place": (profiles.place.duration + settling + settings.transfer_time, "plan.profiles.place"),
        "release": (settings.squeeze_time + release, f"{record}.open_speed"),
        "retract": (_LEAST_OPENING_TIME + plan.approach.duration + settling, "plan.approach"),
        "reopen": (opening + settling + move_time(np.zeros(3)), "plan.pregrasp"),
    }


def check_times(plan: CyclePlan, settings: PhaseSettings) -> None:
    """Check that each phase can end within its time limit.

    Args:
        plan: the plan.
        settings: settings of the phases.

    Raises:
        InvalidInput: a phase takes longer than its limit; names the phase, its planned time and the limit.
    """
    for phase, (time, field) in planned_times(plan, settings).items():
        limit = PHASE_RULES[phase].time_limit
        if time > limit:
            raise InvalidInput(field, f"a planned {phase} of {time:.3g} s", f"a {phase} of {limit:g} s at most")
