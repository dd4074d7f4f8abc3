"""Tips on inner links and on the palm: they move with their links, share joints, and have names of their own."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from support.hands import load, random_posture

from graspforce.core.errors import InvalidInput
from graspforce.hand.contact_tips import ContactTip, add_contact_tips, check_fingertips, has_contact_tips, own_fingers

PLACES = {"thumb_link_2": [0.02, 0.01, 0.05], "palm": [0.0, 0.0, 0.02]}


def tips() -> list[ContactTip]:
    return [ContactTip(link, np.array(p), 0.007) for link, p in PLACES.items()]


def test_tips_move_with_their_links_and_with_no_other_joints() -> None:
    hand = load("dlr_hit2")
    q, posture = random_posture(hand, 1), random_posture(hand, 2)
    extended, names = add_contact_tips(hand, tips(), q)
    assert names == tuple(PLACES)
    for name, place in PLACES.items():
        np.testing.assert_allclose(extended.tip_pose(q, name)[0], place, atol=1e-15)
        (p_0, R_0), (p_1, R_1) = (hand.link_poses(each)[name] for each in (q, posture))
        np.testing.assert_allclose(extended.tip_pose(posture, name)[0], p_1 + R_1 @ R_0.T @ (place - p_0), atol=1e-15)
    thumb = hand.finger("thumb").joints
    assert extended.finger("thumb_link_2").joints == thumb[:2]
    assert extended.finger("palm").joints == ()
    assert extended.finger("palm").tip_radius == 0.007


def test_the_rest_of_the_hand_stays() -> None:
    hand = load("dlr_hit2")
    q = random_posture(hand, 3)
    extended, _ = add_contact_tips(hand, tips(), q)
    assert own_fingers(extended) == hand.fingers
    assert extended.palm == hand.palm
    assert extended.common_joints == hand.common_joints
    assert list(extended.link_poses(q)) == list(hand.link_poses(q))
    np.testing.assert_allclose(extended.mass_matrix(q), hand.mass_matrix(q), rtol=1e-12, atol=1e-18)
    again = pickle.loads(pickle.dumps(extended))
    np.testing.assert_array_equal(again.tip_pose(q, "palm")[0], extended.tip_pose(q, "palm")[0])


def test_names_are_unique() -> None:
    hand = load("dlr_hit2")
    each = ContactTip("palm", np.zeros(3), 0.005)
    extended, names = add_contact_tips(hand, [each, each], hand.neutral)
    assert names == ("palm 1", "palm 2")
    _, more = add_contact_tips(extended, [ContactTip("palm", np.ones(3), 0.005)] * 2, hand.neutral)
    assert not set(more) & set(names)


def test_check_names_the_contacts_and_the_reason() -> None:
    hand = load("dlr_hit2")
    extended, names = add_contact_tips(hand, tips(), hand.neutral)
    own = [finger.name for finger in hand.fingers]
    check_fingertips(extended, own, "plans")
    assert not has_contact_tips(extended, own)
    with pytest.raises(InvalidInput, match=r"palm.*tips of the fingers of dlr_hit2: plans take no contacts on inner links"):
        check_fingertips(extended, [*own, *names], "plans")
