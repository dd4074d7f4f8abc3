"""From an empty hand to the release: `python -m benchmarks.lifecycle [SECTION [OPTION …]] [--records DIR] [--save FILE]`.

Each section has its own file of results in the records' folder and continues it. The page contains all sections that have
results. Without a section, all run with their default options.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks import report_page
from benchmarks.lifecycle import collisions, cycle_times, foreign, full_cycle, gaiting, query_latency, search

SECTIONS = {
    "collisions": collisions,
    "full_cycle": full_cycle,
    "cycle_times": cycle_times,
    "gaiting": gaiting,
    "search": search,
    "query_latency": query_latency,
    "foreign": foreign,
}
RECORDS = Path("benchmarks/results/records")


def main() -> None:
    """Run sections, and write the page."""
    common = argparse.ArgumentParser(add_help=False)
    common.add_argument("--records", type=Path, default=RECORDS, help=f"folder of the files of results (default: {RECORDS})")
    common.add_argument("--save", type=Path, help="write the page as Markdown to this file")
    common.add_argument("--page-only", action="store_true", help="run nothing")
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.lifecycle", description=(__doc__ or "").splitlines()[0], parents=[common]
    )
    commands = parser.add_subparsers(dest="section", metavar="SECTION", help=f"{', '.join(SECTIONS)} (default: all)")
    for name, section in SECTIONS.items():
        section.add_options(commands.add_parser(name, help=section.TITLE, parents=[common]))
    given = parser.parse_args()
    if not given.page_only:
        for name in [given.section] if given.section else SECTIONS:
            options = given if given.section else parser.parse_args([name])
            SECTIONS[name].run(given.records / f"{name}.jsonl", options)
    page = _page(given.records)
    print(page)
    if given.save is not None:
        given.save.parent.mkdir(parents=True, exist_ok=True)
        given.save.write_text(page)


def _page(records: Path) -> str:
    """Return the Markdown of all sections that have results."""
    parts = ["# From an empty hand to the release", report_page.facts()]
    for name, section in SECTIONS.items():
        path = records / f"{name}.jsonl"
        if path.exists():
            parts += [f"## {section.TITLE}", f"Command: `python -m benchmarks.lifecycle {name}`.", section.page(path)]
    return "\n\n".join(parts) + "\n"


if __name__ == "__main__":
    main()
