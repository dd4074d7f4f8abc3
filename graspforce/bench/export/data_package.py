"""Write the data package graspforce-problems: a folder that ``pip wheel`` builds.

Data are written as Parquet (all cases), JSON (one line per case), CBF (all cases), QPS (cases without second-order cones), and
NumPy arrays (batches). `reader` becomes the module of the package. Equal cases give equal bytes of JSON, CBF and QPS.
"""

from __future__ import annotations

import hashlib
import io
import json
import lzma
import shutil
import tarfile
from collections.abc import Callable, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

from scipy import sparse

from graspforce import problems
from graspforce.bench.export import reader
from graspforce.bench.export.batches import write_batches
from graspforce.bench.export.cbf import write_cbf
from graspforce.bench.export.parquet import write_parquet
from graspforce.bench.export.qps import write_qps
from graspforce.bench.export.standard_form import StandardForm, standard_form
from graspforce.bench.export.tags import case_tags
from graspforce.core.errors import InvalidInput
from graspforce.problems.case import Case

LICENCE = "CC-BY-4.0"
_FILES = ("pyproject.toml.in", "README.md", "LICENSE", "CITATION.cff")


def write_data_package(
    folder: Path, names: Sequence[str] = (), progress: Callable[[int, int], None] = lambda *_: None
) -> dict[str, Any]:
    """Write the data package, and return its manifest.

    Args:
        folder: an empty or new folder.
        names: names of the cases; all by default.
        progress: callback with the number of written cases and of all cases.

    Raises:
        InvalidInput: the folder is not empty.
        BackendError: pyarrow is missing, or a proven answer could not be computed again.
    """
    if folder.exists() and any(folder.iterdir()):
        raise InvalidInput("folder", str(folder), "an empty or new folder")
    module = folder / "graspforce_problems"
    data = module / "data"
    (data / "json").mkdir(parents=True)
    chosen = tuple(names) or problems.names()
    records, cbf, qps = [], {}, {}
    for done, name in enumerate(chosen):
        progress(done, len(chosen))
        case = problems.load(name)
        form = standard_form(case)
        records.append(case_record(case, form))
        cbf[f"{name}.cbf"] = write_cbf(form)
        if not form.cones:
            qps[f"{name}.qps"] = write_qps(form)
    progress(len(chosen), len(chosen))
    hashes = _write_json(data / "json", records)
    _write_archive(data / "cbf.tar.xz", cbf)
    _write_archive(data / "qps.tar.xz", qps)
    if any(name.startswith("batch/") for name in chosen):
        write_batches(data / "batches")
    facts = {"version": problems.DATA_VERSION, "licence": LICENCE}
    hashed = [{**record, "sha256": hashes[record["name"]]} for record in records]
    write_parquet(data / "cases.parquet", hashed, {**facts, "readme": reader.__doc__ or ""})
    files = {path.relative_to(data).as_posix(): _sha256(path.read_bytes()) for path in sorted(data.rglob("*.*"))}
    manifest = {**facts, "files": files, "cases": hashes}
    (data / "manifest.json").write_text(json.dumps(manifest, indent=1) + "\n", encoding="utf-8")
    _write_sources(folder, module)
    return manifest


def case_record(case: Case, form: StandardForm) -> dict[str, Any]:
    """Return the record of a case: the program, its answer, its tags, and the force problem in SI units.

    Args:
        case: the case.
        form: the case as a program.
    """
    problem = case.problem.to_dict()
    vectors = {key: None if (vector := getattr(form, key)) is None else vector.tolist() for key in "qbdrxyzu"}
    return {
        "name": case.name,
        "collection": case.name.split("/")[0],
        "status": case.expected.status.value,
        "tags": list(case_tags(case)),
        "contacts": len(case.problem.contacts),
        "variables": len(form.q),
        "scale": form.scale,
        "offset": form.offset,
        "objective": form.objective,
        "tolerance": form.tolerance,
        "cones": list(form.cones),
        **vectors,
        **{key: _triplets(getattr(form, key)) for key in ("P", "A", "C", "S")},
        "problem": problem,
    }


def _triplets(matrix: sparse.spmatrix) -> dict[str, list[Any]]:
    entries = matrix.tocoo()
    return {"row": entries.row.tolist(), "column": entries.col.tolist(), "value": entries.data.tolist()}


def _write_json(folder: Path, records: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Write one compressed file per collection, and return the hash of each case's line."""
    hashes: dict[str, str] = {}
    files: dict[str, list[str]] = {}
    for record in records:
        line = json.dumps(record, ensure_ascii=False, separators=(",", ":"))
        hashes[record["name"]] = _sha256(line.encode())
        files.setdefault(record["collection"], []).append(line)
    for collection, lines in files.items():
        (folder / f"{collection}.jsonl.xz").write_bytes(lzma.compress(("\n".join(lines) + "\n").encode()))
    return hashes


def _write_archive(path: Path, texts: Mapping[str, str]) -> None:
    """Write texts to a compressed archive; without dates and owners, so that equal data give equal bytes."""
    with tarfile.open(path, "w:xz", format=tarfile.USTAR_FORMAT) as archive:
        for name, text in texts.items():
            member = tarfile.TarInfo(name)
            member.size = len(text.encode())
            archive.addfile(member, io.BytesIO(text.encode()))


def _write_sources(folder: Path, module: Path) -> None:
    """Copy the reader and the files of the package, with the version of the data."""
    shutil.copyfile(reader.__file__, module / "__init__.py")
    for name in _FILES:
        text = (resources.files("graspforce.problems") / "data_package" / name).read_text(encoding="utf-8")
        (folder / name.removesuffix(".in")).write_text(text.replace("{version}", problems.DATA_VERSION), encoding="utf-8")


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
