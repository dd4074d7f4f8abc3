"""Recordings are read from .npz files and from text, and errors name the line or the column."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from graspforce.core.errors import InvalidInput
from graspforce.hand.identification.joint_recording import JointRecording, load_joint_recording, read_joint_recording

JOINTS = ("near", "far")
T = np.arange(120) / 100.0
Q, TAU, V = (np.random.default_rng(0).normal(size=(3, 120, 2))).round(6)


def text_of(header: str, *columns: np.ndarray) -> list[str]:
    return [header, *(",".join(f"{x:.6f}" for x in row) for row in np.column_stack(columns))]


@pytest.mark.parametrize("header", ["t,q_near,q_far,tau_near,tau_far,v_near,v_far", "t, q_0, q_1, tau_0, tau_1, v_0, v_1"])
def test_columns_are_found_by_name_or_index(header: str) -> None:
    recording = read_joint_recording(text_of(header, T, Q, TAU, V), JOINTS)
    for ours, expected in ((recording.t, T), (recording.q, Q), (recording.tau, TAU), (recording.v, V)):
        np.testing.assert_allclose(ours, expected, atol=1e-9)


def test_columns_may_have_any_order_and_further_ones() -> None:
    lines = text_of("tau_far,tau_near,I,t,q_far,q_near", TAU[:, 1], TAU[:, 0], V[:, 0], T, Q[:, 1], Q[:, 0])
    recording = read_joint_recording(lines, JOINTS)
    np.testing.assert_allclose(recording.q, Q, atol=1e-9)
    np.testing.assert_allclose(recording.tau, TAU, atol=1e-9)
    assert recording.v is None


def test_files_are_read_by_their_suffix(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", t=T, q=Q, tau=TAU)
    (tmp_path / "a.csv").write_text("\n".join(text_of("t,q_0,q_1,tau_0,tau_1", T, Q, TAU)))
    for name in ("a.npz", "a.csv"):
        recording = load_joint_recording(tmp_path / name, JOINTS)
        np.testing.assert_allclose(recording.tau, TAU, atol=1e-9)
        assert recording.v is None


def test_wrong_files_are_named(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", t=T, q=Q)
    (tmp_path / "b.npz").write_bytes(b"no archive")
    for name, words in (("a.npz", "array 'tau'"), ("b.npz", "readable file"), ("c.csv", "readable file")):
        with pytest.raises(InvalidInput, match=words):
            load_joint_recording(tmp_path / name, JOINTS)


def test_wrong_lines_are_named() -> None:
    lines = text_of("t,q_0,q_1,tau_0,tau_1", T, Q, TAU)
    for wrong in ("0.03,one,2,3,4", "0.03,1"):
        with pytest.raises(InvalidInput, match="recording line 4"):
            read_joint_recording([*lines[:3], wrong, *lines[3:]], JOINTS)
    with pytest.raises(InvalidInput, match="column q_far or q_1"):
        read_joint_recording(text_of("t,q_0,tau_0,tau_1", T, Q[:, 0], TAU), JOINTS)


def test_impossible_recordings_are_refused() -> None:
    with pytest.raises(InvalidInput, match="at least 100 samples"):
        JointRecording(T[:50], Q[:50], TAU[:50])
    with pytest.raises(InvalidInput, match=r"t\[60\]"):
        JointRecording(np.where(T < 0.6, T, T - 0.3), Q, TAU)
    with pytest.raises(InvalidInput, match="tau"):
        JointRecording(T, Q, TAU[:, :1])
