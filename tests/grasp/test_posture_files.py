"""Posture files: written with the documented fields of BODex and DexGraspBench, and tables, they give the grasp back."""

from __future__ import annotations

import pickle
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.hands import load

from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput, MissingField
from graspforce.geometry import Sphere
from graspforce.geometry.rotations import rotation_exp
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.posture_files import RecordedPosture, load_postures
from graspforce.grasp.posture_repair import PostureOptions
from graspforce.grasp.search import find_grasp

P_WR, R_WR = np.array([0.1, -0.2, 0.3]), rotation_exp([0.4, -0.9, 1.3])  # pose of the hand's root in the file's world W


@lru_cache
def grasp() -> Grasp:
    return find_grasp(load("allegro_right"), Body.solid(Sphere(0.03), 0.05), friction=0.7)


def pose(p: Array, R: Array) -> Array:
    return np.concatenate([p, Rotation.from_matrix(R).as_quat(scalar_first=True)])


def record(p_RO: Array | None = None, R_RO: Array | None = None) -> dict[str, Any]:
    """Return the dictionary of one grasp whose hand stands at W."""
    p, R = (grasp().p_HO, grasp().R_HO) if p_RO is None or R_RO is None else (p_RO, R_RO)
    return {
        "grasp_qpos": np.concatenate([pose(P_WR, R_WR), grasp().q]),
        "obj_pose": pose(P_WR + R_WR @ p, R_WR @ R),
        "obj_scale": np.float64(0.06),
        "obj_path": "assets/object/ball",
    }


def saved(folder: Path, content: object) -> Path:
    path = folder / "grasp.npy"
    np.save(path, np.array(content, dtype=object), allow_pickle=True)
    return path


def assert_same(found: RecordedPosture) -> None:
    np.testing.assert_allclose(found.q, grasp().q, atol=1e-12)
    np.testing.assert_allclose(found.p_HO, grasp().p_HO, atol=1e-12)
    np.testing.assert_allclose(found.R_HO, grasp().R_HO, atol=1e-12)


def test_one_grasp(tmp_path: Path) -> None:
    (found,) = load_postures(saved(tmp_path, record()), grasp().hand)
    assert_same(found)
    assert found.scale == 0.06


def test_several_grasps_and_separate_poses(tmp_path: Path) -> None:
    values = record()
    several = {**values, "grasp_qpos": np.tile(values["grasp_qpos"], (3, 1))}
    found = load_postures(saved(tmp_path, several), grasp().hand)
    assert len(found) == 3
    assert_same(found[2])
    apart = {**values, "grasp_pose": values["grasp_qpos"][:7], "grasp_qpos": values["grasp_qpos"][7:]}
    assert_same(*load_postures(saved(tmp_path, apart), grasp().hand))


@pytest.mark.parametrize(("stages", "grasp_stage"), [(3, 1), (6, 3)])
def test_stages_of_raw_files(tmp_path: Path, stages: int, grasp_stage: int) -> None:
    values = record()
    robot_pose = np.tile(values.pop("grasp_qpos"), (1, 2, stages, 1))
    robot_pose[..., 7:] += 0.1 * (np.arange(stages) - grasp_stage)[:, None]
    for found in load_postures(saved(tmp_path, {**values, "robot_pose": robot_pose}), grasp().hand):
        assert_same(found)


def test_joints_are_taken_by_name(tmp_path: Path) -> None:
    names = [joint.name for joint in grasp().hand.joints]
    order = np.random.default_rng(0).permutation(len(names))
    values = record()
    columns = np.concatenate([values["grasp_qpos"][7:][order], [9.0]])
    values["grasp_qpos"] = np.concatenate([values["grasp_qpos"][:7], columns])
    listed = [*(names[i] for i in order), "a joint that follows"]
    assert_same(*load_postures(saved(tmp_path, {**values, "joint_names": listed}), grasp().hand))
    assert_same(*load_postures(saved(tmp_path, values), grasp().hand, joints=listed))
    with pytest.raises(InvalidInput, match=f"{names[0]} is missing"):
        load_postures(saved(tmp_path, values), grasp().hand, joints=["other", *[n for n in listed if n != names[0]]])


def test_pose_of_another_link(tmp_path: Path) -> None:
    link = grasp().hand.finger("index").tip
    p, R = grasp().hand.link_poses(grasp().q)[link]
    values = record(R.T @ (grasp().p_HO - p), R.T @ grasp().R_HO)
    assert_same(*load_postures(saved(tmp_path, values), grasp().hand, root=link))


def test_table_of_postures(tmp_path: Path) -> None:
    names = [joint.name for joint in grasp().hand.joints]
    header = ["label", *reversed(names), "x", "y", "z", "qw", "qx", "qy", "qz"]
    row = [*grasp().q[::-1], *pose(grasp().p_HO, grasp().R_HO)]
    path = tmp_path / "grasps.csv"
    path.write_text("\n".join([",".join(header), "first," + ",".join(map(repr, map(float, row)))]) + "\n")
    assert_same(*load_postures(path, grasp().hand))
    path.write_text("\n".join([",".join(header), "first," + ",".join("x" for _ in row)]) + "\n")
    with pytest.raises(InvalidInput, match="line 2"):
        load_postures(path, grasp().hand)
    path.write_text("x,y,z\n")
    with pytest.raises(InvalidInput, match=f"the column {names[0]}"):
        load_postures(path, grasp().hand)


def test_a_file_becomes_a_grasp(tmp_path: Path) -> None:
    values = record()
    values["grasp_qpos"] = (values["grasp_qpos"]).astype(np.float32)  # as datasets store it
    (found,) = load_postures(saved(tmp_path, values), grasp().hand)
    same = Grasp.from_posture(grasp().hand, grasp().body, found.q, found.p_HO, found.R_HO, options=PostureOptions(friction=0.7))
    assert same.fingers == grasp().fingers
    np.testing.assert_allclose(same.contacts.p_OC, grasp().contacts.p_OC, atol=1e-6)  # m; single precision of 0.3 m


class _Call:
    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]:
        return Path.touch, (self.path,)


def test_files_cannot_run_code(tmp_path: Path) -> None:
    mark = tmp_path / "mark"
    with pytest.raises(InvalidInput, match="is not allowed"):
        load_postures(saved(tmp_path, {"grasp_qpos": _Call(mark)}), grasp().hand)
    assert not mark.exists()
    pickle.loads(pickle.dumps(_Call(mark)))  # an ordinary reader runs it
    assert mark.exists()


@pytest.mark.parametrize(
    ("change", "error", "text"),
    [
        ({"obj_pose": None}, InvalidInput, "obj_pose"),
        ({"obj_pose": np.zeros(7)}, InvalidInput, "quaternion has length 1, not 0"),
        ({"grasp_qpos": np.zeros(9)}, InvalidInput, "16 joint positions"),
        ({"grasp_qpos": np.full(23, np.nan)}, InvalidInput, "finite"),
        ({"robot_pose": np.zeros((2, 3))}, InvalidInput, r"\(1, N, M, 7 \+ k\)"),
    ],
)
def test_wrong_fields_are_named(tmp_path: Path, change: dict[str, Any], error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text):
        load_postures(saved(tmp_path, {**record(), **change}), grasp().hand)


def test_missing_fields_and_other_files_are_refused(tmp_path: Path) -> None:
    values = record()
    del values["obj_pose"]
    with pytest.raises(MissingField, match="obj_pose"):
        load_postures(saved(tmp_path, values), grasp().hand)
    with pytest.raises(InvalidInput, match="one dictionary"):
        load_postures(saved(tmp_path, [1, 2]), grasp().hand)
    path = tmp_path / "text.npy"
    path.write_text("not an array")
    with pytest.raises(InvalidInput, match="one dictionary"):
        load_postures(path, grasp().hand)
    with pytest.raises(InvalidInput, match=r"\.npy or \.csv"):
        load_postures(tmp_path / "grasps.yaml", grasp().hand)
