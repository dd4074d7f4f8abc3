"""Check of a hand's postures: the share of those within the joint limits in which links collide."""

from __future__ import annotations

import numpy as np

from graspforce.core import fields
from graspforce.hand.collision import hand_collision
from graspforce.hand.hand import Hand
from graspforce.hand.lint.findings import Finding

_TOUCH = 1e-4  # m: links with smaller overlaps only touch, such as jaws that close
_MAX_COUNT = 2**31


def check_postures(hand: Hand, samples: int = 300, seed: int = 0) -> tuple[Finding, ...]:
    """Return a note if links collide in some postures within the joint limits, with their share and the deepest example.

    Ordinary hands have such postures: fingers can cross and reach the palm.

    Args:
        hand: the hand.
        samples: number of random postures, uniform within the limits.
        seed: seed of the postures.

    Raises:
        InvalidInput: fewer than one sample, or a negative seed.
    """
    fields.check_integer(samples, "samples", minimum=1, maximum=_MAX_COUNT)
    rng = np.random.default_rng(fields.check_integer(seed, "seed", minimum=0, maximum=_MAX_COUNT))
    collision, postures = hand_collision(hand), rng.uniform(hand.q_lower, hand.q_upper, (samples, hand.n))
    if not collision.pairs:
        return ()
    nearest = [collision.link_gaps(q)[0] for q in postures]
    count = sum(gap.distance < -_TOUCH for gap in nearest)
    if count == 0:
        return ()
    worst = min(range(samples), key=lambda k: nearest[k].distance)
    gap, units = nearest[worst], [joint.position_unit for joint in hand.joints]
    example = ", ".join(f"{x:.3g}" for x in postures[worst])
    unit = units[0] if len(set(units)) == 1 else f"each in {' or '.join(dict.fromkeys(units))}"
    problem = (
        f"links collide in {100.0 * count / samples:.0f} % of {samples} random postures within the limits, "
        f"{gap.first} and {gap.second} by up to {-1e3 * gap.distance:.1f} mm, at q = ({example}) {unit}"
    )
    return (
        Finding(
            "note",
            f"hand {hand.name}",
            problem,
            "planners and searches refuse these postures; a controller does not know them",
            "none if the real links collide there, too; otherwise correct the collision shapes, or list the pair in "
            "allowed_contacts",
        ),
    )
