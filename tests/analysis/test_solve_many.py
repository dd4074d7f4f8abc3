"""Tests of labelling: Parquet to Parquet, resumed, and on a Dask cluster of which a worker is killed."""

from __future__ import annotations

import json
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import graspforce as gf
from benchmarks.dask_processes import scheduler, worker
from graspforce import problems
from graspforce.analysis import solve_many as labelling
from graspforce.core.errors import BackendError

pyarrow = pytest.importorskip("pyarrow")
parquet = pytest.importorskip("pyarrow.parquet")

NAMES = ("opposed/force", "ring/3-torque", "opposed/capped", "ring/3-force")


def write_source(path: Path, count: int, group: int = 7) -> Path:
    """Write problems of the library, one of them broken, in row groups of several sizes."""
    texts = [json.dumps(problems.load(NAMES[i % 4]).problem.to_dict()) for i in range(count)]
    texts[3] = '{"schema": "graspforce/problem/1"}'
    parquet.write_table(pyarrow.table({"problem": texts, "id": list(range(count))}), path, row_group_size=group)
    return path


def labels(folder: Path) -> list[dict[str, Any]]:
    """Return the rows of all parts, in the order of the files."""
    return [row for part in sorted(folder.glob("part-*.parquet")) for row in parquet.read_table(part).to_pylist()]


def test_labels_are_certified_and_cover_each_row_once(tmp_path: Path) -> None:
    source = write_source(tmp_path / "source.parquet", 12)
    seen: list[tuple[int, int]] = []
    done = gf.solve_many(source, tmp_path / "out", rows_per_part=5, progress=lambda *counts: seen.append(counts))
    assert (done.rows, done.parts, done.written) == (12, 3, 3)
    assert seen == [(0, 3), (1, 3), (2, 3), (3, 3)]
    rows = labels(tmp_path / "out")
    assert [row["row"] for row in rows] == list(range(12))
    assert [row["status"] for row in rows[:4]] == ["optimal", "optimal", "infeasible", "invalid"]
    assert "contacts" in rows[3]["error"]
    for row in rows[4:]:
        case = problems.load(NAMES[row["row"] % 4])
        multipliers = gf.Multipliers.from_dict(json.loads(row["multipliers"]))
        if row["status"] == "optimal":
            f = np.array(row["forces"])
            assert row["objective"] == pytest.approx(case.expected.objective, rel=1e-6)
            assert case.problem.G @ f == pytest.approx(case.problem.w, abs=1e-6)
            assert len(row["torques"] or []) == (0 if case.problem.actuation is None else len(case.problem.actuation.tau_u))
        else:
            assert multipliers.y.any()


def test_interrupted_labelling_goes_on_with_the_missing_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source, out = write_source(tmp_path / "source.parquet", 12), tmp_path / "out"

    def stop(done: int, _: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        gf.solve_many(source, out, rows_per_part=3, progress=stop)
    kept = {part: part.stat().st_mtime_ns for part in out.glob("part-*")}
    assert len(kept) == 2
    assert gf.solve_many(source, out, rows_per_part=3).written == 2
    assert all(part.stat().st_mtime_ns == time for part, time in kept.items())
    assert [row["row"] for row in labels(out)] == list(range(12))
    with pytest.raises(gf.InvalidInput, match="another rows_per_part"):
        gf.solve_many(source, out, rows_per_part=4)
    write_source(source, 11)
    with pytest.raises(gf.InvalidInput, match="another source"):
        gf.solve_many(source, out, rows_per_part=3)


def test_large_groups_of_rows_are_read_in_parts(tmp_path: Path) -> None:
    """A source with one group of rows gets the labels of one with small groups; no group read later exceeds a part."""
    whole = write_source(tmp_path / "whole.parquet", 60, group=60)
    small = write_source(tmp_path / "small.parquet", 60, group=4)
    for source in (whole, small):
        done = gf.solve_many(source, rows_per_part=4)
        assert done.folder == source.with_name(f"{source.stem}-labels")
    copy = parquet.ParquetFile(tmp_path / "whole-labels" / "problems.parquet")
    assert max(copy.metadata.row_group(k).num_rows for k in range(copy.num_row_groups)) <= 4
    assert copy.metadata.num_rows == 60
    assert not (tmp_path / "small-labels" / "problems.parquet").exists()
    assert labels(tmp_path / "whole-labels") == labels(tmp_path / "small-labels")


def test_other_sources_are_rejected(tmp_path: Path) -> None:
    (tmp_path / "text.parquet").write_text("no table")
    parquet.write_table(pyarrow.table({"grasp": ["a"]}), tmp_path / "other.parquet")
    for name, message in (("text", "a Parquet file"), ("none", "a Parquet file"), ("other", "this one has grasp")):
        with pytest.raises(gf.InvalidInput, match=message):
            gf.solve_many(tmp_path / f"{name}.parquet", tmp_path / "out")
    with pytest.raises(gf.InvalidInput, match="rows_per_part"):
        gf.solve_many(tmp_path / "other.parquet", tmp_path / "out", rows_per_part=0)


def test_quality_is_a_label_on_request(tmp_path: Path) -> None:
    texts = [json.dumps(problems.load("ring/3-force").problem.to_dict())]
    parquet.write_table(pyarrow.table({"problem": texts}), tmp_path / "one.parquet")
    gf.solve_many(tmp_path / "one.parquet", tmp_path / "out", with_quality=True)
    (row,) = labels(tmp_path / "out")
    assert json.loads(row["quality"])["force_closed"] is True


# ── on a cluster ───────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_dead_worker_loses_no_row_and_repeats_none(tmp_path: Path) -> None:
    """Two workers in separate processes, of which one is killed while it works."""
    distributed = pytest.importorskip("distributed")
    source, out = write_source(tmp_path / "source.parquet", 120, group=50), tmp_path / "out"
    with scheduler(tmp_path) as address, worker(address, "first") as first, worker(address, "second"):
        with distributed.Client(address, set_as_default=False) as client:
            client.wait_for_workers(2, timeout=120)

        def kill(done: int, _: int) -> None:
            if done == 3:
                first.send_signal(signal.SIGKILL)

        result = gf.solve_many(source, out, cluster=address, rows_per_part=4, progress=kill)
        assert first.wait() == -signal.SIGKILL
    assert (result.parts, result.written) == (30, 30)
    rows = labels(out)
    assert [row["row"] for row in rows] == list(range(120))
    local = tmp_path / "local"
    gf.solve_many(source, local, rows_per_part=4)
    assert rows == labels(local)


def test_missing_scheduler_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    from graspforce.analysis import cluster

    monkeypatch.setattr(cluster, "_CONNECTION_LIMIT", 0.2)
    source = write_source(tmp_path / "source.parquet", 4)
    with pytest.raises(BackendError, match=r"no Dask scheduler answers at tcp://127\.0\.0\.1:1"):
        gf.solve_many(source, tmp_path / "out", cluster="tcp://127.0.0.1:1")
    assert labelling.LabelledParts.__slots__
