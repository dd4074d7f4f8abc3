"""The reference motion of ``graspforce simulate``: the motion of its options, or one that the fingers can make."""

from __future__ import annotations

import dataclasses

import numpy as np
from rich.console import Console
from scipy.spatial.transform import Rotation

from graspforce import simulation
from graspforce.cli.simulate_options import SimulateOptions
from graspforce.contact.motion import BodyMotion
from graspforce.control import feasible_twists, object_motion
from graspforce.core.errors import InvalidInput
from graspforce.geometry import Solid
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search import TravelLimit, travel_limits
from graspforce.hand.contact_tips import has_contact_tips
from graspforce.simulation import Reference
from graspforce.simulation.loops.reach import find_unholdable, find_unreachable

_TRAVEL = 0.01  # m, upwards, of simulations without --travel
_TURN, _NOTHING = (0.0, 0.0, 0.1), (0.0, 0.0, 0.0)  # rad, of the reference "turn" without --travel; m, of "still"
_LEAST_TRAVEL = 1e-3  # m: a shorter motion is not worth simulating
_DIGITS = 5  # of a shown travel: 10 µm
_REFERENCE_SAMPLES = 25  # instants of a motion that is checked against the contacts
_LARGEST_SLIP, _LEVER = 1e-4, 0.03  # m: slip in a motion that the contacts do not allow, at this distance from O


def choose_travel(options: SimulateOptions, grasp: Grasp, console: Console) -> SimulateOptions:
    """Return options with a travel: the given one, or one that the fingers can make, which is shown.

    Args:
        options: of the command.
        grasp: the grasp at the start.
        console: shows the chosen travel and what limits it.
    """
    if options.travel is not None:
        return options
    if options.reference in ("still", "turn"):
        return dataclasses.replace(options, travel=_TURN if options.reference == "turn" else _NOTHING)
    travel, reason = default_travel(grasp, is_symmetric=options.reference == "sine")
    if not any(travel):
        console.print(f"The object is held still: {reason}.", soft_wrap=True)
        return dataclasses.replace(options, reference="still", travel=travel)
    if reason:
        vector = ",".join(f"{x:.4g}" for x in travel)
        console.print(
            f"Moves the object by {1e3 * np.linalg.norm(travel):.3g} mm, --travel={vector}: {reason}.", soft_wrap=True
        )
    return dataclasses.replace(options, travel=travel)


def default_travel(grasp: Grasp, is_symmetric: bool = False) -> tuple[tuple[float, float, float], str]:
    """Return a translation of the object that the fingers can make, m, and why it is not 10 mm upwards.

    The direction is up if the fingers can move the object by 10 mm upwards, and otherwise the one in which they can move it
    farthest, by the distance that `travel_limits` finds. The translation is zero if they cannot move it by 1 mm.

    Args:
        grasp: the grasp at the start, of a solid by fingertips.
        is_symmetric: whether the object moves by half of the distance both ways.
    """
    if not has_contact_tips(grasp.hand, grasp.fingers) and isinstance(grasp.body.shape, Solid):
        limits = travel_limits(grasp, _TRAVEL)
    else:
        return _NOTHING, "contacts on inner links or the palm allow few motions; give --reference and --travel for one"
    if not limits:
        return _NOTHING, "the fingers cannot translate it without slipping"
    distances = [_distance(each, limits) if is_symmetric else each.distance for each in limits]
    upward = max(range(len(limits)), key=lambda k: limits[k].direction[2])
    best = upward if distances[upward] >= _TRAVEL else max(range(len(limits)), key=distances.__getitem__)
    if distances[best] < _LEAST_TRAVEL:
        return _NOTHING, limits[upward].reason
    x, y, z = np.round(distances[best] * limits[best].direction, _DIGITS).tolist()
    return (x, y, z), limits[upward].reason


def _distance(limit: TravelLimit, limits: tuple[TravelLimit, ...]) -> float:
    """Return how far the object can move from end to end along a direction if it starts in the middle, m."""
    opposite = min(limits, key=lambda each: float(each.direction @ limit.direction))
    return min(_TRAVEL, 2.0 * min(limit.distance, opposite.distance))


def make_reference(options: SimulateOptions, grasp: Grasp) -> Reference:
    """Return the reference motion of the options, which begins at the grasp.

    Args:
        options: of the command; without a travel, that of `default_travel`.
        grasp: the grasp at the start.
    """
    options = choose_travel(options, grasp, Console(quiet=True))
    start, travel, turn = BodyMotion(grasp.p_HO, grasp.R_HO), np.array(options.travel), np.array(options.turn)
    if options.reference == "turn":
        angle = float(np.linalg.norm(travel))
        return simulation.rotation_reference(start, travel / angle, angle, options.period)
    if options.reference == "still":
        translation = simulation.constant_reference(start)
    elif options.reference == "reach":
        translation = simulation.linear_reference(start, travel, options.period)
    else:
        translation = simulation.sine_reference(start, travel / 2.0, options.period)
    angle = float(np.linalg.norm(turn))
    if angle == 0.0:
        return translation
    rotation = simulation.rotation_reference(start, turn / angle, angle, options.turn_period or options.period)
    return simulation.combined_reference(translation, rotation)


def check_reference(options: SimulateOptions, grasp: Grasp) -> None:
    """Refuse a motion that the fingers cannot follow.

    Args:
        options: of the command, with a travel.
        grasp: the grasp at the start.

    Raises:
        InvalidInput: names the first finger and instant, or says which motions contacts on inner links and the palm allow.
    """
    if has_contact_tips(grasp.hand, grasp.fingers):
        _check_feasible(options, grasp)
        return
    reference, travel = make_reference(options, grasp), options.travel or _NOTHING
    found, held = find_unreachable(grasp, reference, options.duration), None
    if found is None:
        span = min(options.duration, max(options.period, options.turn_period or 0.0))  # s: the motion is periodic
        held = find_unholdable(grasp, reference, span, options.grasp.gravity_H)
    if found is not None:
        allowed = f"a motion within reach of the fingers: at {found[0]:.2f} s {found[1]} cannot follow its contact"
    elif held is not None:
        allowed = f"a motion that the fingers can follow and hold: at {held[0]:.2f} s {held[1]}"
    else:
        return
    field, value = ("--turn", options.turn) if held is not None and any(options.turn) else ("--travel", travel)
    field, value = (field, value) if any(value) else ("--turn", options.turn)
    raise InvalidInput(field, ",".join(f"{x:g}" for x in value), allowed)


def _check_feasible(options: SimulateOptions, grasp: Grasp) -> None:
    """Refuse a motion that contacts on inner links and the palm do not allow."""
    reference, allowed = make_reference(options, grasp), feasible_twists(grasp)
    for t in np.linspace(0.0, options.duration, _REFERENCE_SAMPLES):
        motion = object_motion(reference(float(t)))
        turn = Rotation.from_matrix(motion.R_HO @ grasp.R_HO.T).as_rotvec()
        change = np.append(motion.p_HO - grasp.p_HO, turn)
        missing = change - allowed.T @ (allowed @ change)
        if np.linalg.norm(missing[:3]) > _LARGEST_SLIP or np.linalg.norm(missing[3:]) * _LEVER > _LARGEST_SLIP:
            text = f"still: the contacts with {', '.join(grasp.fingers)} allow {len(allowed)} of 6 directions, and not this one"
            raise InvalidInput("--reference", options.reference, text)
