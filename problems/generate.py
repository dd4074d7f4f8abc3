"""Write the textbook cases from their derivations: ``python -m graspforce.problems.generate``, in a checkout."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from graspforce.core.whole_file import write_text
from graspforce.problems.derivations import fixture, nose_cone, opposed, ring
from graspforce.problems.derivations.records import Record
from graspforce.problems.json_format import format_case


def records() -> Iterator[Record]:
    """Yield the records of the textbook cases."""
    for collection in (fixture, nose_cone, opposed, ring):
        yield from collection.cases()


def main() -> None:
    """Write each case to ``<collection>/<case>.json`` in this module's folder."""
    here = Path(__file__).parent
    for record in records():
        path = here / f"{record['name']}.json"
        path.parent.mkdir(exist_ok=True)
        write_text(path, format_case(record) + "\n")


if __name__ == "__main__":
    main()
