"""The grasp search: sample candidates, refine the best by least squares, validate them exactly."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt

from graspforce.core import fields
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.geometry import Solid
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search.batch_kinematics import BatchKinematics, palm_normal
from graspforce.grasp.search.candidates import Candidates, GeometryRequirements
from graspforce.grasp.search.checks import UNMOVABLE_PENALTY, CandidateResult, LoadRequirements, check_candidate
from graspforce.grasp.search.common_joints import without_common_joints
from graspforce.grasp.search.goal import SearchGoal, hull_points
from graspforce.grasp.search.grasp_class import GraspClass, class_finger_sets, opposing_fingers
from graspforce.grasp.search.options import GraspSearchOptions, GraspSearchProgress, check_search
from graspforce.grasp.search.pair_distances import Pair
from graspforce.grasp.search.prior import PosturePrior
from graspforce.grasp.search.refinement import refine, refine_in_prior
from graspforce.grasp.search.sampling import sample_candidates
from graspforce.grasp.search.side_conditions import SideConditions
from graspforce.hand.hand import Hand

_DESCENTS = 16  # candidates that are refined, at most
_PREFERENCE_WEIGHTS = (1.0, 0.1)  # the second descent gives the requirements more weight against the preferences
_OVERLAP_DESCENTS = 3  # further ones of a candidate whose links overlap, each with the distances of all overlaps found
_MANY_OVERLAPS = 3  # candidates with overlaps after which further ones are refined without their overlaps at once
_NEARLY_FEASIBLE = 0.003  # m: a geometric fault that the second descent may remove, with the distances of overlaps
_ENOUGH_LOADED = 2  # candidates that support every load, if one meets all requirements: the search chooses the best of them
_ENOUGH_UNMOVABLE = 4  # the same, if none can be moved as far as required
_ENOUGH_TOUCHING = 8  # candidates with possible contacts: if none supports the loads, the search ends
_PRIOR_DESCENTS = 5  # candidates of a prior that are refined, at most
_DEFAULT_TRAVEL = 0.005  # m
_JOINTS_WITHOUT_SPIN = 4  # of a finger: three for the velocity of the contact, and one for no spin about its normal
_KNOWN_OVERLAPS = 6  # pairs of bodies that overlapped in earlier candidates, whose distances later ones keep
_TABLE_CLEARANCE = 0.006  # m, of fingers and palm

RefineSet = Callable[[list[SearchGoal], LoadRequirements, np.random.Generator, int, "_SearchWatch"], list[CandidateResult]]


def find_grasp(
    hand: Hand,
    body: Body,
    fingers: Sequence[str] | None = None,
    *,
    friction: float = 0.6,
    gravity_H: npt.ArrayLike | None = None,
    seed: int = 0,
    options: GraspSearchOptions | None = None,
    prior: PosturePrior | None = None,
) -> Grasp:
    """Find a posture of a hand and a pose of an object in which the fingertips hold the object.

    The grasp meets these requirements:

    - Each tip touches the surface to within a nanometre, inside a face.
    - The contacts are force-closed.
    - Joints, with their couplings, keep 5 % of their range from their limits.
    - Fingers keep `clearance` from each other, and the object keeps it from links, idle fingers and palm. Links are modelled by
      spheres that follow the collision shapes of the URDF. The palm is the plane across `palm_normal_H` through the origin of
      the last link that carries all fingers, and the shapes of its links.
    - The collision shapes do not overlap, neither two links nor a link and the object; see `HandCollision`. The last links of
      touching fingers count as thick as the tip where they meet the object.
    - Under each gravity, certified contact forces exist within the motor limits, with the slip margin `slip_margin`.
    - The fingers can move the object by `travel`; see `travel_limits`.

    The search is random, with a seed: equal arguments give equal grasps. Fingers that do not touch are stretched. Joints that
    move all fingers, such as a wrist, stay in the neutral posture; their motors must support the load, too.

    Args:
        hand: the hand.
        body: the object. Its shape is a sphere, cylinder, box, superquadric or mesh.
        fingers: names of at least three fingers that touch, or of two with soft pads. By default three fingers, or four if no
            three can hold the object, with the thumb if the hand has one; both fingers of a hand that has two.
        friction: μ of all contacts, > 0.
        gravity_H: (3,) or (K, 3) accelerations of gravity in H, m/s², each a load case. By default 9.81 m/s² along the six
            directions of H's axes: any orientation of the palm.
        seed: seed of the random candidates, ≥ 0.
        options: further requirements.
        prior: distribution of the postures. The search then samples from it, and refines candidates over its components
            before it refines them in all joints. It ends with the first grasp that meets all requirements. If five
            candidates give none, the search without prior follows.

    Returns:
        The best grasp found.

    Raises:
        InvalidInput: an argument is not allowed, or no grasp was found. In the second case the field is `body`, or `travel` if
            the grasps found only lack travel, and the message names the requirement that the best candidate fails.
        UnknownName: the hand has no finger of that name.
    """
    options = GraspSearchOptions() if options is None else options
    shape, load = check_search(hand, body, friction, gravity_H, options)
    seed = fields.check_integer(seed, "seed", minimum=0, maximum=2**32 - 1)
    finger_sets = _finger_sets(hand, fingers, shape, options)
    anyone = "both fingers" if len(hand.fingers) == 2 else "any three or four fingers"
    if isinstance(options.grasp_class, GraspClass):
        anyone = f"fingers in a {options.grasp_class.value}"
    who = f"{anyone if fingers is None else ', '.join(fingers)} of {hand.name}"
    hand = without_common_joints(hand, hand.neutral)
    kinematics = BatchKinematics(hand)
    p_HP, R_HP = hand.link_poses(hand.neutral)[hand.palm]
    palm_normal_H = palm_normal(hand, kinematics, R_HP) if options.palm_normal_H is None else freeze(options.palm_normal_H)
    if options.travel is None and _is_held_by_spin(hand, finger_sets, options):
        attempts = [(0.0, _DESCENTS)]
    elif options.travel is None:  # fewer descents for the travel that is only preferred
        attempts = [(_DEFAULT_TRAVEL, _DESCENTS // 2), (0.0, _DESCENTS)]
    else:
        attempts = [(options.travel, _DESCENTS)]
    searches: list[tuple[float, int, PosturePrior | None]] = [(travel, descents, None) for travel, descents in attempts]
    if prior is not None:
        searches.insert(0, (attempts[0][0], _PRIOR_DESCENTS, prior.for_hand(hand)))
    hull = hull_points(shape)
    watch, side = _SearchWatch(options), _side_conditions(hull, options)
    for travel, descents, each_prior in searches:
        requirements = GeometryRequirements(
            *(options.clearance, options.edge_ratio, palm_normal_H, p_HP, travel, side), options.grasp_class is not None
        )
        goals = ([SearchGoal(hand, kinematics, shape, each, requirements, hull) for each in sets] for sets in finger_sets)
        refine_set = _refine_best if each_prior is None else partial(_refine_from_prior, prior=each_prior)
        best = _best_candidate(goals, load, np.random.default_rng(seed), descents, watch, refine_set)
        is_unmovable = best.grasp is not None and 0.0 < best.penalty <= UNMOVABLE_PENALTY
        if best.grasp is not None and (not best.fault or (is_unmovable and options.travel is None)):
            return best.grasp
        if watch.is_over:
            break
    if is_unmovable:
        allowed = f"a distance by which {who} can move the object; best candidate: {best.fault}"
        raise InvalidInput("travel", options.travel, allowed)
    allowed = f"an object that {who} can hold; best candidate: {best.fault}"
    raise InvalidInput("body", type(shape).__name__, allowed)


def _best_candidate(
    goals: Iterable[list[SearchGoal]],
    load: LoadRequirements,
    rng: np.random.Generator,
    descents: int,
    watch: _SearchWatch,
    refine_set: RefineSet,
) -> CandidateResult:
    """Return the best candidate of the first list of goals with a faultless one, or of all lists.

    Args:
        goals: lists of goals. A later list is tried only if the earlier ones have no faultless candidate.
        load: the loads.
        rng: random generator of the samples.
        descents: largest number of candidates to refine for each list.
        watch: ends the search.
        refine_set: refines and checks candidates of one list.
    """
    results: list[CandidateResult] = []
    for each in goals:
        results += refine_set(each, load, rng, descents, watch)
        if watch.is_over or any(not result.fault for result in results):
            break
    return min(results, key=lambda result: (result.penalty, -result.quality))


def _refine_best(
    goals: Sequence[SearchGoal], load: LoadRequirements, rng: np.random.Generator, descents: int, watch: _SearchWatch
) -> list[CandidateResult]:
    """Sample candidates of all goals, and refine and check the best, until enough of them meet the requirements."""
    samples = [(goal, sample_candidates(goal, rng)) for goal in goals]
    costs = [np.square(goal.residuals(candidates, 1.0, goal.rough_faces)).sum(axis=1) for goal, candidates in samples]
    order = sorted((cost, g, b) for g, each in enumerate(costs) for b, cost in enumerate(each.tolist()))
    starts = [(samples[g][0], _one(samples[g][1], b)) for _, g, b in order[:descents]]
    results: list[CandidateResult] = []
    for result in _refined_results(starts, load):
        results.append(result)
        touching = [result for result in results if result.grasp is not None]
        loaded = sum(result.penalty <= UNMOVABLE_PENALTY for result in touching)
        enough = _ENOUGH_LOADED if any(not result.fault for result in touching) else _ENOUGH_UNMOVABLE
        if len(results) >= descents:
            enough = 1  # what follows are candidates with overlaps
        if watch.report(results, descents) or loaded >= enough or len(touching) >= _ENOUGH_TOUCHING:
            break
    return results


def _refined_results(starts: Sequence[tuple[SearchGoal, Candidates]], load: LoadRequirements) -> Iterator[CandidateResult]:
    """Yield the results of candidates. The first ones with overlaps are refined again without these at the end only.

    Pairs of bodies that overlap in one candidate of a class often do in the next: later ones keep their distances from the
    start.
    """
    overlapping: list[_Refined] = []
    known: dict[Pair, None] = {}  # pairs that overlapped in earlier candidates, in the order in which they were found
    for goal, start in starts:
        forbidden = set(goal.forbidden_pairs.pairs) if known else set()
        pairs = [pair for pair in known if pair in forbidden][:_KNOWN_OVERLAPS]
        each = _refined(goal.with_pairs(pairs) if pairs else goal, start, load)
        if goal.requirements.keeps_overlaps:
            known.update(dict.fromkeys(each.result.overlaps))
        if each.result.overlaps and len(overlapping) >= _MANY_OVERLAPS:
            each = _without_overlaps(each, load)
        elif each.result.overlaps:
            overlapping.append(each)
        yield each.result
    for each in overlapping:
        yield _without_overlaps(each, load).result


def _refine_from_prior(
    goals: Sequence[SearchGoal],
    load: LoadRequirements,
    rng: np.random.Generator,
    descents: int,
    watch: _SearchWatch,
    *,
    prior: PosturePrior,
) -> list[CandidateResult]:
    """Sample candidates from a prior, refine the best over its components and then in all joints, until one has no fault."""
    samples = [(goal, sample_candidates(goal, rng, prior)) for goal in goals]
    costs = [np.square(goal.residuals(candidates, 1.0, goal.rough_faces)).sum(axis=1) for goal, candidates in samples]
    order = sorted((cost, g, b) for g, each in enumerate(costs) for b, cost in enumerate(each.tolist()))
    results: list[CandidateResult] = []
    for _, g, b in order[:descents]:
        goal, candidates = samples[g]
        results.append(_refined(goal, refine_in_prior(goal, _one(candidates, b), prior), load).result)
        if watch.report(results, descents) or not results[-1].fault:
            break
    return results


@dataclass(frozen=True, eq=False, slots=True)
class _Refined:
    """A refined candidate with its goal and the result of its checks."""

    goal: SearchGoal
    candidate: Candidates
    result: CandidateResult


def _refined(goal: SearchGoal, one: Candidates, load: LoadRequirements) -> _Refined:
    """Refine one candidate in all variables, and check it."""
    for preference_weight in _PREFERENCE_WEIGHTS:
        one = refine(goal, one, preference_weight)
        result = check_candidate(goal, one, load)
        if not 0.0 < result.penalty - 1.0 < _NEARLY_FEASIBLE:
            break
        if result.overlaps and goal.requirements.keeps_overlaps:
            goal = goal.with_pairs(result.overlaps)
    return _Refined(goal, one, result)


def _without_overlaps(each: _Refined, load: LoadRequirements) -> _Refined:
    """Refine a candidate again with the distances of the pairs that overlap, until none does."""
    for _ in range(_OVERLAP_DESCENTS):
        if not each.result.overlaps:
            break
        goal = each.goal.with_pairs(each.result.overlaps)
        one = refine(goal, each.candidate, _PREFERENCE_WEIGHTS[-1])
        each = _Refined(goal, one, check_candidate(goal, one, load))
    return each


def _one(candidates: Candidates, b: int) -> Candidates:
    """Return one of several candidates."""
    return Candidates(candidates.x[b : b + 1], candidates.R_start[b : b + 1], candidates.face[b : b + 1])


class _SearchWatch:
    """Ends a search at its budget, or when its callback returns False.

    Attributes:
        is_over: whether the search is to end.
    """

    def __init__(self, options: GraspSearchOptions) -> None:
        self._options, self._start, self.is_over = options, time.perf_counter(), False

    def report(self, results: Sequence[CandidateResult], largest: int) -> bool:
        """Report the candidates of a stage, and return whether the search is to end."""
        seconds, callback = time.perf_counter() - self._start, self._options.callback
        best = min(results, key=lambda result: (result.penalty, -result.quality))
        found = sum(not result.fault for result in results)
        if callback is not None and not callback(GraspSearchProgress(len(results), largest, found, best.fault, seconds)):
            self.is_over = True
        if self._options.budget is not None and seconds >= self._options.budget:
            self.is_over = True
        return self.is_over


# ── arguments ──────────────────────────────────────────────────────────────────────────────────────────────────────────────


def _side_conditions(hull: Array, options: GraspSearchOptions) -> SideConditions:
    """Return the conditions on approach direction, table and opposed fingers."""
    approach, up = options.approach_O, options.up_O
    opposing = opposing_fingers(options.grasp_class if isinstance(options.grasp_class, GraspClass) else None)
    below = 0.0 if up is None else float(-(hull @ np.asarray(up)).min())
    return SideConditions(
        approach_O=None if approach is None else np.asarray(approach),
        up_O=None if up is None else np.asarray(up),
        table_height=below,
        table_clearance=_TABLE_CLEARANCE,
        opposing=opposing,
    )


def _finger_sets(
    hand: Hand, fingers: Sequence[str] | None, shape: Solid, options: GraspSearchOptions
) -> list[list[tuple[int, ...]]]:
    """Return lists of finger sets, by indices. The sets of one list compete; a later list is for when they all fail."""
    names = [finger.name for finger in hand.fingers]
    has_pads = options.pad_friction is not None
    if isinstance(options.grasp_class, GraspClass):
        sets = class_finger_sets(hand, options.grasp_class, shape)
        if fingers is not None:
            sets = [each for each in sets if {names[i] for i in each} == {hand.finger(name).name for name in fingers}]
            if not sets:
                raise InvalidInput("fingers", fingers, f"fingers of a {options.grasp_class.value}, or none")
        soft = [each for each in sets if len(each) > 2 or has_pads or _all_soft(hand, each)]
        if not soft:
            allowed = "a class of three fingers, or pads: pad_friction; two point contacts are never force-closed"
            raise InvalidInput("grasp_class", options.grasp_class.value, allowed)
        return [soft]
    if fingers is None and len(names) == 2:
        fingers = names
    if fingers is None:
        thumbs = {i for i, name in enumerate(names) if "thumb" in name.lower()}
        lists: list[list[tuple[int, ...]]] = []
        for with_thumb in (True, False):
            for size in (3, 4):
                every = itertools.combinations(range(len(names)), size)
                lists.append([chosen for chosen in every if thumbs.issubset(chosen) is with_thumb])
        if not any(lists):
            raise InvalidInput("hand", f"{hand.name} with {len(names)} finger", "a hand with two fingers at least")
        return [each for each in lists if each]
    chosen = () if isinstance(fingers, str) else tuple(names.index(hand.finger(name).name) for name in fingers)
    least = 2 if has_pads or _all_soft(hand, chosen) else 3
    if len(set(chosen)) < len(chosen) or len(chosen) < least:
        allowed = (
            "at least three different fingers, or two with soft pads (torsional_friction in the hand's description): "
            "two point contacts are never force-closed"
        )
        raise InvalidInput("fingers", fingers, allowed)
    return [[chosen]]


def _is_held_by_spin(hand: Hand, finger_sets: list[list[tuple[int, ...]]], options: GraspSearchOptions) -> bool:
    """Return whether each set of a class, or of given pads, has a soft finger that cannot follow an object without spin."""
    if options.grasp_class is None and options.pad_friction is None:
        return False
    soft = [options.pad_friction is not None or finger.torsional_friction is not None for finger in hand.fingers]
    held = [is_soft and len(finger.joints) < _JOINTS_WITHOUT_SPIN for is_soft, finger in zip(soft, hand.fingers, strict=True)]
    return all(any(held[i] for i in each) for sets in finger_sets for each in sets)


def _all_soft(hand: Hand, fingers: Sequence[int]) -> bool:
    """Return whether all fingers have soft pads."""
    return all(hand.fingers[i].torsional_friction is not None for i in fingers)
