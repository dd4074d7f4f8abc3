"""A prior of grasp postures: a mean, a few components, and the spread along each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.core.records import set_fields
from graspforce.hand.hand import Hand


@dataclass(frozen=True, eq=False, slots=True)
class PosturePrior:
    """Postures q = q̄ + Σ a_i e_i with independent normal amplitudes a_i of zero mean; `Synergies.prior` makes one.

    Args:
        joints: names of the n joints.
        mean: (n,) mean posture q̄, rad; m of prismatic joints.
        components: (b, n) components e_i.
        deviations: (b,) standard deviations of the amplitudes, ≥ 0.

    Raises:
        InvalidInput: names the field and what is allowed.
    """

    joints: tuple[str, ...]
    mean: Array
    components: Array
    deviations: Array

    def __post_init__(self) -> None:
        joints = tuple(self.joints)
        if not joints or len(set(joints)) < len(joints):
            raise InvalidInput("joints", joints, "at least one name, each once")
        components = arrays.check_array(self.components, "components", (None, len(joints)))
        set_fields(
            self,
            joints=joints,
            mean=arrays.check_array(self.mean, "mean", (len(joints),)),
            components=components,
            deviations=arrays.check_array(self.deviations, "deviations", (len(components),), minimum=0.0),
        )

    def for_hand(self, hand: Hand) -> PosturePrior:
        """Return the prior with the joints of a hand, in its order; further joints are left out.

        Args:
            hand: the hand.

        Raises:
            InvalidInput: a joint of the hand is missing.
        """
        columns = []
        for joint in hand.joints:
            if joint.name not in self.joints:
                raise InvalidInput(
                    "prior.joints", self.joints, f"names with all joints of {hand.name}: {joint.name} is missing"
                )
            columns.append(self.joints.index(joint.name))
        names = tuple(joint.name for joint in hand.joints)
        return PosturePrior(names, freeze(self.mean[columns]), freeze(self.components[:, columns]), self.deviations)

    def sample(self, count: int, rng: np.random.Generator) -> Array:
        """Return random postures (count, n), rad; joint limits are not applied.

        Args:
            count: number of postures.
            rng: random generator.
        """
        a = self.deviations * rng.normal(size=(count, len(self.deviations)))
        return np.asarray(self.mean + a @ self.components)
