"""Learned inverse kinematics: networks of one hidden layer that map places to joint positions, as start values.

    y = W₂ tanh(W₁ x + b₁) + b₂,

with x and y divided by their standard deviations. Source for the use with hands: Al-Gallaf, whose network has 18 inputs, 50
hidden units and 12 outputs. A prediction is never a result by itself: `Hand.inverse_kinematics` starts from it, and other
starts follow if it fails.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.core.optional_libraries import optional_imports
from graspforce.hand.hand import Hand

_MAX_PATTERNS = 1_000_000
_ITERATIONS = 2000  # of the optimiser of the weights
_WEIGHT_DECAY = 1e-6
_CONSTANT = 1e-12  # standard deviation of a value that does not change


@dataclass(frozen=True, eq=False, slots=True)
class Network:
    """A network with one hidden layer; `fit_network` makes one.

    Attributes:
        centre: (a,) mean input.
        scale: (a,) standard deviation of the inputs.
        W1: (h, a) weights of the hidden layer.
        b1: (h,) its offsets.
        W2: (c, h) weights of the outputs, in their unit.
        b2: (c,) offsets of the outputs.
    """

    centre: Array
    scale: Array
    W1: Array
    b1: Array
    W2: Array
    b2: Array

    def predict(self, x: Array) -> Array:
        """Return the outputs (c,) of inputs (a,), or (N, c) of (N, a); the arguments are not checked.

        Args:
            x: the inputs.
        """
        return np.asarray(np.tanh(((x - self.centre) / self.scale) @ self.W1.T + self.b1) @ self.W2.T + self.b2)


def fit_network(x: npt.ArrayLike, y: npt.ArrayLike, hidden: int = 50, seed: int = 0) -> Network:
    """Fit a network to patterns by least squares with the method of Broyden, Fletcher, Goldfarb and Shanno.

    Args:
        x: (N, a) inputs.
        y: (N, c) outputs.
        hidden: number of hidden units, ≥ 1.
        seed: seed of the first weights, ≥ 0.

    Raises:
        InvalidInput: an argument is not allowed.
        MissingLibrary: scikit-learn is not installed.
    """
    with optional_imports():
        from sklearn.exceptions import ConvergenceWarning
        from sklearn.neural_network import MLPRegressor
    import warnings

    x = arrays.check_array(x, "x", (None, None))
    y = arrays.check_array(y, "y", (len(x), None))
    if len(x) < 2:
        raise InvalidInput("x", f"{len(x)} patterns", "at least two patterns")
    hidden = fields.check_integer(hidden, "hidden", minimum=1, maximum=10_000)
    seed = fields.check_integer(seed, "seed", minimum=0, maximum=2**32 - 1)
    (centre, scale), (mean, spread) = _normalisation(x), _normalisation(y)
    network = MLPRegressor(
        hidden_layer_sizes=(hidden,),
        activation="tanh",
        solver="lbfgs",
        alpha=_WEIGHT_DECAY,
        max_iter=_ITERATIONS,
        tol=1e-7,
        random_state=seed,
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # the caller judges the errors
        targets = (y - mean) / spread
        network.fit((x - centre) / scale, targets if targets.shape[1] > 1 else targets[:, 0])
    W1, W2 = network.coefs_
    b1, b2 = network.intercepts_
    return Network(
        freeze(centre),
        freeze(scale),
        freeze(W1.T),
        freeze(b1),
        freeze((W2 * spread).T),
        freeze(b2 * spread + mean),
    )


@dataclass(frozen=True, eq=False, slots=True)
class FingerStart:
    """Start values of a finger's inverse kinematics; `fit_finger_start` makes one.

    Attributes:
        finger: name of the finger.
        joints: indices of its joints in the hand.
        lower: (m,) least joint positions, rad.
        upper: (m,) largest joint positions, rad.
        members: the networks, whose outputs are averaged.
    """

    finger: str
    joints: tuple[int, ...]
    lower: Array
    upper: Array
    members: tuple[Network, ...]

    def predict(self, p_H: Array) -> Array:
        """Return predicted joint positions (m,) of the finger for a place (3,) of its tip frame in H, within the limits.

        Args:
            p_H: the place, m; not checked.
        """
        mean = sum((each.predict(p_H) for each in self.members), np.zeros(len(self.lower))) / len(self.members)
        return np.asarray(np.clip(mean, self.lower, self.upper))

    def posture(self, q: npt.ArrayLike, p_H: npt.ArrayLike) -> Array:
        """Return a posture of the hand with the prediction in the finger's joints: `q_start` of `Hand.inverse_kinematics`.

        Args:
            q: (n,) posture whose other joints are kept, rad.
            p_H: (3,) target of the tip frame's origin in H, m.

        Raises:
            InvalidInput: an argument is not allowed.
        """
        result = np.array(arrays.check_array(q, "q", (None,)))
        result[list(self.joints)] = self.predict(arrays.check_array(p_H, "p_H", (3,)))
        return freeze(result)


def fit_finger_start(
    hand: Hand, finger: str, patterns: int = 2000, members: int = 3, hidden: int = 50, seed: int = 0
) -> FingerStart:
    """Fit start values of a finger's inverse kinematics to random postures of the finger within its limits.

    The targets are the tips of these postures. The outputs are the postures that `Hand.inverse_kinematics` finds from the
    neutral posture, so that fingers with redundant joints have one posture for each tip.

    Args:
        hand: the hand.
        finger: name of the finger.
        patterns: number of postures, ≥ 10.
        members: number of networks with different first weights, ≥ 1.
        hidden: number of hidden units of each, ≥ 1.
        seed: seed of the postures and weights, ≥ 0.

    Raises:
        InvalidInput: an argument is not allowed.
        UnknownName: the hand has no finger of that name.
        MissingLibrary: scikit-learn is not installed.
    """
    patterns = fields.check_integer(patterns, "patterns", minimum=10, maximum=_MAX_PATTERNS)
    members = fields.check_integer(members, "members", minimum=1, maximum=100)
    joints = hand.finger(finger).joints
    tips, found = finger_patterns(hand, finger, patterns, np.random.default_rng(seed))
    networks = tuple(fit_network(tips, found, hidden, seed + k) for k in range(members))
    chosen = list(joints)
    return FingerStart(finger, tuple(joints), freeze(hand.q_lower[chosen]), freeze(hand.q_upper[chosen]), networks)


def finger_patterns(hand: Hand, finger: str, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return random reachable tip places (N, 3) in H, m, and the finger's joint positions (N, m) there, rad.

    Args:
        hand: the hand.
        finger: name of the finger.
        count: number of random postures; places that the numeric solution does not reach are left out.
        rng: random generator.
    """
    joints = list(hand.finger(finger).joints)
    frame = [hand.frame_id(finger)]
    q = np.tile(hand.neutral, (count, 1))
    q[:, joints] = rng.uniform(hand.q_lower[joints], hand.q_upper[joints], (count, len(joints)))
    places = hand.model.frame_jacobians(q, frame)[0][:, 0]
    kept, found = [], []
    for p in places:
        try:
            found.append(hand.inverse_kinematics(finger, p))
        except InvalidInput:
            continue
        kept.append(p)
    return np.array(kept), np.array(found)


def _normalisation(values: Array) -> tuple[Array, Array]:
    """Return mean and standard deviation of each column; 1 for a constant column."""
    spread = values.std(axis=0)
    return values.mean(axis=0), np.where(spread > _CONSTANT, spread, 1.0)
