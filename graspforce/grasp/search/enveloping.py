"""Search for enveloping grasps: contacts on inner links and the palm, several on one finger.

Each candidate places the object against a part of the hand and then closes fingers around it:

- *power*: the object lies on the palm, and fingers close. The palm and two fingers touch at least; see `power`.
- *lateral*: the object lies against the side of the index finger, and the thumb closes onto it; see `lateral`.

The collision shapes of the links touch. A flat object on the palm has contacts near the ends of the face or line on which it
lies. Contacts on an edge of the object are left out, because it has no normal there, and so
are those on the convex hull of a mesh over a hollow. Every candidate is checked for force closure, forces within the motors'
limits under each gravity, and overlaps.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from graspforce.contact.contact import Contact, ContactModel, ContactSet
from graspforce.core import fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.force.problem_options import Objective
from graspforce.force.solver import solve
from graspforce.geometry import Solid
from graspforce.grasp.body import Body
from graspforce.grasp.link_grasp import LinkGrasp
from graspforce.grasp.search.batch_kinematics import BatchKinematics, palm_normal, rotations
from graspforce.grasp.search.checks import LoadRequirements, closure_quality
from graspforce.grasp.search.closing import GAP, ClosingFinger, TouchScene
from graspforce.grasp.search.grasp_class import ENVELOPING_CLASSES, GraspClass
from graspforce.grasp.search.lateral import LateralSampler
from graspforce.grasp.search.options import GraspSearchOptions, GraspSearchProgress, check_search
from graspforce.grasp.search.power import PowerSampler
from graspforce.hand.hand import Hand

_CANDIDATES = 400  # at most
_ENOUGH = 2  # candidates without a fault, of which the one with the best closure is chosen
_CLOSING = 0.03  # m: a joint closes a finger if its range brings the tip nearer to the palm's axis by this
_ONE_SIDED = 2.0  # ratio of the longer to the shorter side of the range of a joint that bends a finger
_HEIGHT = 0.05  # m, above the palm, of the point that closing fingers approach
_SAME_POINT = 1e-3  # m: nearer contacts of one link count once
_COINCIDENT = 1e-5  # m: the same of two links, which touch a corner of a mesh
_OFF_SURFACE = 1e-3  # m: largest distance of a contact on the convex hull of a mesh from its surface
_PATCH_TILT, _PATCH_ANGLE = 1e-3, 0.5  # rad: tilts of the object on the palm, and the first direction of their axes
_PATCH_SHARE = 0.9  # of the distance of the ends of a contact patch from its middle
_TIE = 4.0 * GAP  # m: links this near touch


def find_link_grasp(
    hand: Hand,
    body: Body,
    grasp_class: GraspClass | str = GraspClass.POWER,
    *,
    friction: float = 0.6,
    gravity_H: npt.ArrayLike | None = None,
    seed: int = 0,
    options: GraspSearchOptions | None = None,
) -> LinkGrasp:
    """Find a grasp with contacts on inner links or the palm.

    The search is random, with a seed: equal arguments give equal grasps. Of the first two candidates without a fault, it
    returns the one with the best force closure.

    Args:
        hand: the hand.
        body: the object. Its shape is a sphere, cylinder, box, superquadric or mesh; the last two touch with their convex hull.
        grasp_class: `GraspClass.POWER` or `GraspClass.LATERAL`, or its name.
        friction: μ of all contacts, > 0.
        gravity_H: (3,) or (K, 3) accelerations of gravity in H, m/s², each a load case. By default 9.81 m/s² along the six
            directions of H's axes.
        seed: seed of the random candidates, ≥ 0.
        options: of these count `max_normal`, `slip_margin`, `palm_normal_H`, `pad_friction`, which makes all contacts soft,
            `budget` and `callback`.

    Returns:
        The best grasp found.

    Raises:
        InvalidInput: an argument is not allowed, or no grasp was found. In the second case the field is `body`, and the message
            names the requirement that the best candidate fails.
    """
    options = GraspSearchOptions() if options is None else options
    chosen = GraspClass(fields.check_choice(getattr(grasp_class, "value", grasp_class), "grasp_class", ENVELOPING_CLASSES))
    shape, load = check_search(hand, body, friction, gravity_H, options)
    seed = fields.check_integer(seed, "seed", minimum=0, maximum=2**32 - 1)
    sampler = _Sampler(shape, chosen, load, options)
    best, start, found = _Checked(None, "no posture touches it", 0.0), time.perf_counter(), 0
    rng = np.random.default_rng(seed)
    for k in range(_CANDIDATES):
        result = _check(sampler, rng, load)
        found += not result.fault
        best = max(best, result, key=lambda each: (not each.fault, each.quality))
        seconds = time.perf_counter() - start
        progress = GraspSearchProgress(k + 1, _CANDIDATES, found, best.fault, seconds)
        is_stopped = options.callback is not None and not options.callback(progress)
        if found >= _ENOUGH or is_stopped or (options.budget is not None and seconds >= options.budget):
            break
    if best.grasp is None or best.fault:
        allowed = f"an object that {hand.name} can hold in a {chosen.value} grasp; best candidate: {best.fault}"
        raise InvalidInput("body", type(shape).__name__, allowed)
    return best.grasp


@dataclass(frozen=True, eq=False, slots=True)
class _Checked:
    """A candidate after its checks: the grasp, its fault, and a quality that is larger the later the failed check."""

    grasp: LinkGrasp | None
    fault: str
    quality: float


class _Sampler:
    """Random candidates of a class."""

    def __init__(self, shape: Solid, grasp_class: GraspClass, load: LoadRequirements, options: GraspSearchOptions) -> None:
        self.hand, self.shape, self.grasp_class = (hand := load.hand), shape, grasp_class
        kinematics = BatchKinematics(hand)
        self.scene = TouchScene(hand, kinematics.collision, shape)
        R_HP = hand.link_poses(hand.neutral)[hand.palm][1]
        given = options.palm_normal_H
        normal = np.asarray(palm_normal(hand, kinematics, R_HP) if given is None else given)
        self.across = np.linalg.svd(normal[None])[2][1:]  # (2, 3) directions along the palm, in H
        bases = hand.model.joint_origins(hand.neutral)[kinematics.first_links]
        self.fingers = _closing_fingers(hand, kinematics, bases.mean(axis=0) + _HEIGHT * normal)
        self.palm = set(range(-1, len(kinematics.links))) - {frame for finger in self.fingers for frame in finger.frames}
        self._candidates: PowerSampler | LateralSampler
        if grasp_class is GraspClass.POWER:
            self._candidates = PowerSampler(load, shape, kinematics, self.scene, self.fingers, normal)
        else:
            thumb, first = _thumb_and_index(hand)
            self._candidates = LateralSampler(hand, shape, kinematics, self.scene, self.fingers, thumb, first)

    def sample(self, rng: np.random.Generator) -> tuple[Array, Array, Array] | None:
        """Return posture, position and axes of the object of a random candidate; None if the object does not get in place."""
        return self._candidates.sample(rng)


def _thumb_and_index(hand: Hand) -> tuple[int, int]:
    """Return the indices of the thumb and of the index finger, or of the first other finger if none is named so."""
    names = [finger.name.lower() for finger in hand.fingers]
    thumb = next((i for i, name in enumerate(names) if "thumb" in name), None)
    if thumb is None:
        raise InvalidInput("grasp_class", GraspClass.LATERAL.value, f"another class: {hand.name} has no thumb")
    others = [i for i in range(len(names)) if i != thumb]
    return thumb, next((i for i in others if any(each in names[i] for each in ("index", "first", "fore"))), others[0])


def _closing_fingers(hand: Hand, kinematics: BatchKinematics, centre: Array) -> tuple[ClosingFinger, ...]:
    """Return the joints that close each finger.

    A joint bends a finger if its range about zero, the stretched finger, is much longer on one side: that side closes. In a
    finger without such joints, those close it that bring its tip much nearer to a point of H, m, over their range.
    """
    ends, every = np.tile(hand.neutral, (2, hand.n, 1)), np.arange(hand.n)
    ends[0, every, every], ends[1, every, every] = hand.q_lower, hand.q_upper
    tips = kinematics.evaluate(ends.reshape(-1, hand.n)).tip_centres.reshape(2, hand.n, len(hand.fingers), 3)
    nearer = np.linalg.norm(tips[0] - centre, axis=2) - np.linalg.norm(tips[1] - centre, axis=2)  # (n, F) m, at the upper end
    above, below = np.maximum(hand.q_upper, 0.0), np.maximum(-hand.q_lower, 0.0)
    bends = np.where(above > _ONE_SIDED * below, 1.0, np.where(below > _ONE_SIDED * above, -1.0, 0.0))
    found = []
    for f, finger in enumerate(hand.fingers):
        own = [j for j in finger.joints if j not in hand.common_joints]
        signs = bends[own] if bends[own].any() else np.sign(nearer[own, f]) * (np.abs(nearer[own, f]) > _CLOSING)
        joints = tuple(j for j, sign in zip(own, signs.tolist(), strict=True) if sign)
        found.append(ClosingFinger(finger.name, joints, tuple(signs[signs != 0.0].tolist()), kinematics.own_links[f]))
    return tuple(found)


# ── checks ─────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def _check(sampler: _Sampler, rng: np.random.Generator, load: LoadRequirements) -> _Checked:
    """Return a random candidate after all checks."""
    sample = sampler.sample(rng)
    if sample is None:
        return _Checked(None, "no posture touches it", 0.0)
    q, p_HO, R_HO = sample
    links, contacts, frames = _contacts(sampler, sample, load)
    touching = sum(bool(frames & set(finger.frames)) for finger in sampler.fingers)
    if sampler.grasp_class is GraspClass.POWER and not (frames & sampler.palm and touching >= 2):
        return _Checked(None, "the palm and two fingers do not touch the object", 0.05 * touching)
    if len(contacts) < 2:
        return _Checked(None, "fewer than two links touch the object", 0.0)
    gaps, _ = sampler.scene.object_gaps(q, p_HO, R_HO, 1e-3)
    if min(sampler.scene.link_gap(q), float(gaps.min())) < -GAP:
        return _Checked(None, "links overlap", 0.2)
    grasp = LinkGrasp(load.hand, load.body, links, ContactSet.stack(contacts), q, p_HO, R_HO)
    closure = closure_quality(grasp.contacts, load.friction)
    if closure <= 0.0:
        return _Checked(grasp, "the contacts are not force-closed", 0.3)
    margins = [solve(grasp.force_problem(g, objective=Objective("margin")), explain=False) for g in load.gravities]
    held = sum(each.found and float(each.objective or 0.0) >= load.slip_margin for each in margins)
    if held < len(margins):
        fault = f"it holds the object in {held} of {len(margins)} directions of gravity"
        return _Checked(grasp, fault, 0.4 + 0.1 * held / len(margins))
    return _Checked(grasp, "", closure)


def _contacts(
    sampler: _Sampler, sample: tuple[Array, Array, Array], load: LoadRequirements
) -> tuple[list[str], list[Contact], set[int]]:
    """Return the links that touch the object, the contacts, and the indices of the moving links."""
    q, p_HO, R_HO = sample
    gaps, points = sampler.scene.object_gaps(q, p_HO, R_HO, 1e-3)
    links, contacts, frames = list[str](), list[Contact](), set[int]()
    soft = load.pad_friction is not None
    for k in np.flatnonzero(gaps <= _TIE).tolist():
        body = sampler.scene.bodies[k]
        places = (points[k, 1] - p_HO) @ R_HO
        is_on_palm = sampler.grasp_class is GraspClass.POWER and body.frame in sampler.palm
        for place in _patch(sampler, k, sample, places) if is_on_palm else places[None]:
            try:
                p = sampler.shape.project_to_surface(place)
                normal = sampler.shape.inward_normal(p)
            except InvalidInput:  # an edge
                continue
            if np.linalg.norm(place - p) > _OFF_SURFACE:  # on the hull of a mesh, over a hollow
                continue
            seen = zip(links, contacts, strict=True)
            if any(np.linalg.norm(p - e.position) < (_SAME_POINT if name == body.name else _COINCIDENT) for name, e in seen):
                continue
            contact = Contact(p, normal, load.friction, max_normal=load.max_normal)
            if soft:
                contact = replace(contact, model=ContactModel.SOFT, torsional_friction=load.pad_friction)
            links.append(body.name)
            contacts.append(contact)
            frames.add(body.frame)
    return links, contacts, frames


def _patch(sampler: _Sampler, k: int, sample: tuple[Array, Array, Array], place: Array) -> Array:
    """Return points (N, 3) in O near the ends of the face or line on which the object lies; else the nearest point alone.

    Small tilts of the object find the ends. The points are a little inside, away from the edges of link and object.

    Args:
        sampler: of the class.
        k: index of the link's body.
        sample: posture, position and axes of the object.
        place: (3,) the nearest point of the object, in O, m.
    """
    q, p_HO, R_HO = sample
    pivot, ends = p_HO + R_HO @ place, []
    for angle in _PATCH_ANGLE + np.pi / 2.0 * np.arange(4):
        turn = rotations(_PATCH_TILT * (np.cos(angle) * sampler.across[0] + np.sin(angle) * sampler.across[1])[None])[0]
        tilted = pivot + turn @ (p_HO - pivot)
        ends.append((sampler.scene.object_gaps(q, tilted, turn @ R_HO, 1e-2)[1][k, 1] - tilted) @ (turn @ R_HO))
    found = np.array(ends)
    middle = found.mean(axis=0)
    found = middle + _PATCH_SHARE * (found - middle)
    size = np.linalg.svd(found - middle, compute_uv=False)
    is_flat = size[2] < _TIE and size[0] > 2.0 * _SAME_POINT
    return found if is_flat else place[None]
