"""Labels: each finger's motion with its times, in recordings and in running streams."""

from __future__ import annotations

import numpy as np
import pytest
from support import hands

from graspforce.core.errors import InvalidInput, UnknownName
from graspforce.learning import (
    META_MOTIONS,
    MotionLabel,
    MotionMonitor,
    label_motions,
    labelled_gist,
    labels_at,
    load_labels,
    save_labels,
)
from graspforce.learning.actions.labels import motion_name
from graspforce.learning.actions.meta_motions import IDLE

HAND = hands.load("allegro_right")
TIMES = np.linspace(0.0, 3.0, 3001)  # s, as of a controller


def bent(t, begin, end):
    """Return postures (T, n) in which the index finger bends from one time to the other at 30 °/s."""
    q = np.tile(HAND.neutral, (len(t), 1))
    bending = np.radians(30.0) * np.clip(t - begin, 0.0, end - begin)
    for joint in list(HAND.finger("index").joints)[1:]:
        q[:, joint] += bending
    return q


def test_a_bending_finger_is_labelled_between_two_rests():
    labels = [each for each in label_motions(HAND, TIMES, bent(TIMES, 1.0, 2.0)) if each.finger == "index"]
    assert [each.text.split()[0] for each in labels] == ["rest", "close", "rest"]
    assert labels[1].begin == pytest.approx(1.0, abs=0.03)
    assert labels[1].end == pytest.approx(2.0, abs=0.03)
    assert (labels[0].begin, labels[-1].end) == (TIMES[0], TIMES[-1])


def test_opening_is_the_reverse_of_closing():
    labels = label_motions(HAND, TIMES, bent(TIMES, 1.0, 2.0)[::-1], ["index"])
    assert [each.text.split()[0] for each in labels] == ["rest", "open", "rest"]


def test_other_fingers_rest():
    labels = label_motions(HAND, TIMES, bent(TIMES, 1.0, 2.0))
    assert {each.finger for each in labels if each.motion == IDLE} == {finger.name for finger in HAND.fingers}
    assert labelled_gist(labels).motions == (("index", labels_at(labels, 1.5)["index"].motion),)


def test_labels_do_not_depend_on_the_rate_of_the_stream():
    fast, slow = (label_motions(HAND, t, bent(t, 1.0, 2.0), ["index"]) for t in (TIMES, TIMES[::8]))
    assert [each.motion for each in fast] == [each.motion for each in slow]
    np.testing.assert_allclose([each.begin for each in fast], [each.begin for each in slow], atol=0.02)


def test_the_label_of_a_time_is_that_of_the_motion_that_began_last():
    labels = (MotionLabel("index", 9, 0.0, 1.0), MotionLabel("index", 5, 1.0, 2.0), MotionLabel("thumb", 1, 0.5, 0.8))
    assert {name: each.motion for name, each in labels_at(labels, 0.6).items()} == {"index": 9, "thumb": 1}
    assert {name: each.motion for name, each in labels_at(labels, 1.0).items()} == {"index": 5}
    assert labels_at(labels, 3.0) == {}


def test_saved_labels_come_back(tmp_path):
    labels = label_motions(HAND, TIMES, bent(TIMES, 1.0, 2.0))
    save_labels(labels, tmp_path / "labels.csv")
    assert load_labels(tmp_path / "labels.csv") == labels


def test_every_motion_has_a_name_of_its_own():
    assert len({motion_name(each) for each in META_MOTIONS}) == len(META_MOTIONS)


def test_a_monitor_names_the_present_motion():
    monitor = MotionMonitor(HAND, ["index"])
    seen = {}
    for t, q in zip(TIMES, bent(TIMES, 1.0, 2.0), strict=True):
        monitor.add(t, q)
        if round(1e3 * t) in (50, 500, 1500, 2900):
            seen[round(1e3 * t)] = {name: motion_name(each).split()[0] for name, each in monitor.present().items()}
    assert seen == {50: {}, 500: {"index": "rest"}, 1500: {"index": "close"}, 2900: {"index": "rest"}}
    monitor.add(0.0, HAND.neutral)  # the stream begins anew
    assert monitor.present() == {}


@pytest.mark.parametrize(
    "text", ["finger,motion\nindex,1\n", "finger,motion,begin,end\nindex,10,0,1\n", "finger,motion,begin,end\nindex,1,1,0\n"]
)
def test_files_that_are_no_labels_are_refused(text, tmp_path):
    (tmp_path / "labels.csv").write_text(text)
    with pytest.raises(InvalidInput, match="row 1"):
        load_labels(tmp_path / "labels.csv")


def test_invalid_arguments_are_refused():
    q = np.tile(HAND.neutral, (3, 1))
    for error, call in (
        (InvalidInput, lambda: label_motions(HAND, [0.0, 0.005, 0.01], q)),
        (InvalidInput, lambda: label_motions(HAND, [0.0, 1.0, 0.5], q)),
        (InvalidInput, lambda: label_motions(HAND, [0.0, 1.0], q)),
        (UnknownName, lambda: label_motions(HAND, [0.0, 0.5, 1.0], q, ["tail"])),
        (UnknownName, lambda: MotionMonitor(HAND, ["tail"])),
        (InvalidInput, lambda: MotionMonitor(HAND).add(0.0, [0.0])),
        (InvalidInput, lambda: motion_name(0)),
    ):
        with pytest.raises(error):
            call()
