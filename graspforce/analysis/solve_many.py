"""Label many force problems with forces, proofs and quality: from a Parquet file to a folder of Parquet files.

Each part of the result holds consecutive rows of the source and is written whole or not at all. Labelling that was interrupted
goes on with the missing parts, here or on a Dask cluster. A task that runs twice, because a worker died, writes the same part.

A Parquet file is read by groups of rows. If a group has many more rows than a part, the problems are first copied to a file in
the folder with one group a part. No process then holds more than a part and the pages that it reads.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from graspforce.analysis.cluster import run_on_cluster
from graspforce.analysis.quality import quality
from graspforce.core.errors import GraspForceError, InvalidInput
from graspforce.core.json_text import decode
from graspforce.core.optional_libraries import optional_imports
from graspforce.core.whole_file import replace_file, write_text
from graspforce.force.problem import ForceProblem
from graspforce.force.solver import solve

_LARGEST_GROUP = 10  # rows of a group of the source, over those of a part, above which the problems are copied
_READ_BYTES = 2**20  # of the source that are read at a time for the copy
INVALID = "invalid"  # status of a row that is not a force problem


@dataclass(frozen=True, slots=True)
class LabelledParts:
    """Result of `solve_many`.

    Args:
        folder: folder of the parts.
        rows: number of rows of the source.
        parts: number of parts.
        written: number of parts that this call wrote; the others existed.
    """

    folder: Path
    rows: int
    parts: int
    written: int


@dataclass(frozen=True, slots=True)
class _Part:
    """Consecutive rows of a source, and the file of their labels.

    Args:
        source: the Parquet file of the problems.
        target: the Parquet file of the labels.
        first: index of the first row.
        count: number of rows.
        with_quality: whether to compute measures of the grasp.
    """

    source: str
    target: str
    first: int
    count: int
    with_quality: bool


def solve_many(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str] | None = None,
    *,
    cluster: Any = None,
    rows_per_part: int = 1000,
    with_quality: bool = False,
    progress: Callable[[int, int], None] = lambda *_: None,
) -> LabelledParts:
    """Solve the force problems of a Parquet file and write their labels to a folder, ``part-<first row>.parquet``.

    The source has a column ``problem`` with problem files as JSON text, and further columns that are ignored. A part has the
    columns ``row``, ``status``, ``objective``, ``forces``, ``torques``, ``multipliers`` (of the optimum or the proof) and
    ``certificate`` as JSON, ``quality`` as JSON, and ``error`` for rows with the status "invalid".

    Args:
        source: the Parquet file. With a cluster, all workers read it at this path.
        target: the folder; created if missing. Existing parts are kept. Default: beside the source, with ``-labels`` after its
            name.
        cluster: address of a Dask scheduler, or a cluster of Dask; by default this process solves everything.
        rows_per_part: number of rows of a part.
        with_quality: whether to compute `quality`, which takes longer than the forces.
        progress: callback with the number of finished parts and of all parts.

    Raises:
        InvalidInput: no such file or column, or the folder holds parts of another source or size.
        MissingLibrary: pyarrow or, with a cluster, distributed is not installed.
        BackendError: the cluster cannot be reached.
    """
    if rows_per_part < 1:
        raise InvalidInput("rows_per_part", rows_per_part, "at least 1")
    path = Path(source).resolve()
    folder = path.with_name(f"{path.stem}-labels") if target is None else Path(target).resolve()
    rows = _row_count(path)
    folder.mkdir(parents=True, exist_ok=True)
    _check_folder(folder, {"source": _fingerprint(path), "rows_per_part": rows_per_part, "with_quality": with_quality})
    problems = str(_grouped_problems(path, folder, rows_per_part))
    parts = [
        _Part(problems, str(folder / f"part-{first:010}.parquet"), first, min(rows_per_part, rows - first), with_quality)
        for first in range(0, rows, rows_per_part)
    ]
    missing = [part for part in parts if not Path(part.target).exists()]
    done = len(parts) - len(missing)
    progress(done, len(parts))
    arguments = ((part,) for part in missing)
    results = map(_label_part, missing) if cluster is None else run_on_cluster(cluster, _label_part, arguments)
    for _ in results:
        done += 1
        progress(done, len(parts))
    return LabelledParts(folder, rows, len(parts), len(missing))


def _label_part(part: _Part) -> int:
    """Write the labels of a part, and return the number of its rows."""
    import pyarrow
    import pyarrow.parquet

    labels = [
        {"row": part.first + i, **_label(text, part.with_quality)}
        for i, text in enumerate(_problem_texts(part.source, part.first, part.count))
    ]
    numbers, text = pyarrow.list_(pyarrow.float64()), pyarrow.string()
    types = {"row": pyarrow.int64(), "status": text, "objective": pyarrow.float64(), "forces": numbers, "torques": numbers}
    types |= dict.fromkeys(("multipliers", "certificate", "quality", "error"), text)
    table = pyarrow.Table.from_pylist(labels, pyarrow.schema(list(types.items())))
    with replace_file(part.target) as temporary:
        pyarrow.parquet.write_table(table, temporary, compression="zstd")
    return part.count


def _label(text: str | None, with_quality: bool) -> dict[str, Any]:
    """Return the labels of a problem file; a row without a force problem is marked as invalid."""
    try:
        problem = ForceProblem.from_dict(decode((text or "").encode()))
    except GraspForceError as error:
        return {"status": INVALID, "error": str(error)}
    solution = solve(problem, explain=False)
    certificate = solution.certificate
    found: dict[str, Any] = {"status": solution.status.value, "objective": solution.objective}
    if solution.found:
        torques = solution.torques
        found |= {"forces": solution.f.tolist(), "torques": None if torques is None else torques.tolist()}
    if solution.multipliers is not None:
        found["multipliers"] = json.dumps(solution.multipliers.to_dict())
    if certificate is not None:
        found["certificate"] = json.dumps(certificate.to_dict())
    if with_quality:
        found["quality"] = json.dumps(quality(problem).to_dict())
    return found


def _problem_texts(source: str, first: int, count: int) -> Iterator[str | None]:
    """Yield the texts of consecutive rows. Only the row groups that hold them are read."""
    import pyarrow.parquet

    with pyarrow.parquet.ParquetFile(source) as file:
        start = 0
        for group in range(file.num_row_groups):
            size = file.metadata.row_group(group).num_rows
            low, high = max(first, start), min(first + count, start + size)
            if low < high:
                column = file.read_row_group(group, columns=["problem"]).column("problem")
                yield from column.slice(low - start, high - low).to_pylist()
            start += size


def _grouped_problems(path: Path, folder: Path, rows_per_part: int) -> Path:
    """Return the source, or a copy of its problems with one group of rows a part if its groups are much larger."""
    import pyarrow.parquet

    with pyarrow.parquet.ParquetFile(path) as file:
        largest = max((file.metadata.row_group(k).num_rows for k in range(file.num_row_groups)), default=0)
    if largest <= _LARGEST_GROUP * rows_per_part:
        return path
    copy = folder / "problems.parquet"
    if not copy.exists():
        with (
            replace_file(copy) as temporary,
            pyarrow.parquet.ParquetFile(path, memory_map=True, buffer_size=_READ_BYTES, pre_buffer=False) as file,
            pyarrow.parquet.ParquetWriter(temporary, pyarrow.schema([file.schema_arrow.field("problem")])) as writer,
        ):
            for batch in file.iter_batches(rows_per_part, columns=["problem"]):
                writer.write_batch(batch)
    return copy


def _row_count(path: Path) -> int:
    """Return the number of rows of a source after checking its column."""
    with optional_imports():
        import pyarrow
        import pyarrow.parquet
    try:
        with pyarrow.parquet.ParquetFile(path) as file:
            names, rows = file.schema_arrow.names, int(file.metadata.num_rows)
    except (OSError, pyarrow.ArrowInvalid) as error:
        raise InvalidInput("source", str(path), f"a Parquet file ({error})") from None
    if "problem" not in names:
        raise InvalidInput("source", str(path), f"a file with the column problem; this one has {', '.join(names)}")
    return rows


def _check_folder(folder: Path, facts: dict[str, Any]) -> None:
    """Check that a folder holds parts of the same source and size, or none yet."""
    path = folder / "source.json"
    if path.exists():
        known = json.loads(path.read_text(encoding="utf-8"))
        different = [name for name, value in facts.items() if known.get(name) != value]
        if different:
            raise InvalidInput("target", str(folder), f"a new folder; this one has parts with another {different[0]}")
    else:
        write_text(path, json.dumps(facts) + "\n")


def _fingerprint(path: Path) -> str:
    """Return the SHA-256 of a file."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()
