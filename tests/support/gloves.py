"""Operators with simulated gloves."""

from __future__ import annotations

from functools import cache

import numpy as np

from graspforce.learning import FingertipMap, GloveCalibration, GloveOperator, SimulatedGlove, calibrate_glove

_PAIRS, _FRAMES = 60, 30


def glove_of(hand, noise=0.01) -> SimulatedGlove:
    return SimulatedGlove(hand.q_lower, hand.q_upper, noise=noise, cross_talk=0.1)


@cache
def calibration_of(hand) -> GloveCalibration:
    """Return the calibration from 60 postures with 30 frames each."""
    rng, glove = np.random.default_rng(0), glove_of(hand)
    q = rng.uniform(hand.q_lower, hand.q_upper, (_PAIRS, hand.n))
    readings = np.mean([glove.readings(q, rng) for _ in range(_FRAMES)], axis=0)
    return calibrate_glove(readings, hand.joint_names, q)


def operator_of(hand, correspondence=None) -> GloveOperator:
    """Return an operator whose glove has the joints of a hand; by default all its fingers lead their namesakes."""
    same = FingertipMap({finger.name: finger.name for finger in hand.fingers})
    return GloveOperator(calibration_of(hand), hand, correspondence or same)


def operator_frames(hand, postures, noise=0.01, seed=1):
    """Return the frames (T, m) of an operator whose hand takes postures."""
    return glove_of(hand, noise).readings(np.array(postures), np.random.default_rng(seed))


def pose_frames(grasp, shifts, noise=0.01, seed=1):
    """Return the frames (T, m) of an operator whose fingertips move as those of a grasp do when its object is shifted."""
    q, postures = grasp.q, []
    for shift in shifts:
        q = grasp.hand.grasp_posture(grasp.fingers, grasp.contacts, grasp.p_HO + shift, grasp.R_HO, q)
        postures.append(q)
    return operator_frames(grasp.hand, postures, noise, seed)
