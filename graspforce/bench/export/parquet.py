"""All cases in one Parquet table (extra ``learn``): one row per case; matrices as lists of row, column and value."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from graspforce.core.optional_libraries import optional_imports


def write_parquet(path: Path, records: Sequence[Mapping[str, Any]], metadata: Mapping[str, str]) -> None:
    """Write the records of `data_package.case_record` as a table.

    Args:
        path: the file.
        records: one record per case.
        metadata: texts for the schema's metadata.

    Raises:
        MissingLibrary: pyarrow is not installed.
    """
    with optional_imports():
        import pyarrow
        import pyarrow.parquet
    numbers, indices = pyarrow.list_(pyarrow.float64()), pyarrow.list_(pyarrow.int32())
    fields = [pyarrow.field(name, pyarrow.string()) for name in ("name", "collection", "status", "sha256")]
    fields.append(pyarrow.field("tags", pyarrow.list_(pyarrow.string())))
    fields += [pyarrow.field(name, pyarrow.int32()) for name in ("contacts", "variables")]
    fields += [pyarrow.field(name, pyarrow.float64()) for name in ("scale", "offset", "objective", "tolerance")]
    fields.append(pyarrow.field("cones", indices))
    fields += [pyarrow.field(name, numbers) for name in "qbdrxyzu"]
    for matrix in ("P", "A", "C", "S"):
        fields += [pyarrow.field(f"{matrix}_{part}", indices) for part in ("row", "column")]
        fields.append(pyarrow.field(f"{matrix}_value", numbers))
    schema = pyarrow.schema(fields, metadata={key.encode(): text.encode() for key, text in metadata.items()})
    rows = [{**record, **_flat_matrices(record)} for record in records]
    table = pyarrow.Table.from_pylist([{field.name: row.get(field.name) for field in fields} for row in rows], schema)
    floats = [f"{name}.list.element" for name in (*"qbrxyzu", "A_value", "C_value")]
    packing = {"compression": "zstd", "compression_level": 19, "use_dictionary": False, "use_byte_stream_split": floats}
    pyarrow.parquet.write_table(table, path, **packing)


def _flat_matrices(record: Mapping[str, Any]) -> dict[str, Any]:
    return {f"{matrix}_{part}": record[matrix][part] for matrix in ("P", "A", "C", "S") for part in ("row", "column", "value")}
