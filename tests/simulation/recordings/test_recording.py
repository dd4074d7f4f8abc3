"""Recordings: files and parts."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from support.simulated_runs import simulate_three_fingers

from graspforce import InvalidInput
from graspforce.simulation.plants.disturbance import FrictionChange
from graspforce.simulation.recordings.recording import Recording


def test_saved_recording_is_loaded_unchanged(tmp_path):
    r = simulate_three_fingers(duration=0.02, disturbances=[FrictionChange(0.01, 0.005)])
    assert len(r.t) == 20
    r.save(tmp_path / "run.npz")
    back = Recording.load(tmp_path / "run.npz")
    for each in fields(Recording):
        if isinstance(getattr(r, each.name), np.ndarray):
            np.testing.assert_array_equal(getattr(back, each.name), getattr(r, each.name))
            assert not getattr(back, each.name).flags.writeable
        else:
            assert getattr(back, each.name) == getattr(r, each.name)
    for content in (b"", b"PK\x03\x04 no"):
        (tmp_path / "broken.npz").write_bytes(content)
        with pytest.raises(InvalidInput, match="a recording"):
            Recording.load(tmp_path / "broken.npz")
    with pytest.raises(InvalidInput, match="a recording"):
        Recording.load(tmp_path / "nowhere.npz")
    np.savez(tmp_path / "other.npz", words=np.array("{}"))
    with pytest.raises(InvalidInput, match="a recording"):
        Recording.load(tmp_path / "other.npz")


def test_since_keeps_the_later_steps():
    r = simulate_three_fingers(duration=0.02)
    late = r.since(0.0145)
    np.testing.assert_array_equal(late.t, r.t[15:])
    np.testing.assert_array_equal(late.f, r.f[15:])
    np.testing.assert_array_equal(late.torque_upper, r.torque_upper)
