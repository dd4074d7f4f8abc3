"""From an empty hand to the release: `python -m benchmarks.lifecycle [SECTION …] [--records DIR] [--save FILE]`.

Each section has its own file of results in the records' folder and continues it. The page contains all sections that have
results.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks import report_page
from benchmarks.lifecycle import full_cycle

SECTIONS = {"full_cycle": full_cycle}


def main() -> None:
    """Run sections, and write the page."""
    options = argparse.ArgumentParser(prog="python -m benchmarks.lifecycle", description=(__doc__ or "").splitlines()[0])
    options.add_argument("sections", nargs="*", choices=[[], *SECTIONS], help="sections to run (default: all)")
    options.add_argument("--records", type=Path, default=Path("lifecycle"), help="folder of the files of results")
    options.add_argument("--save", type=Path, help="write the page as Markdown to this file")
    options.add_argument("--hands", default=",".join(full_cycle.HANDS), help="hands of the full cycle")
    options.add_argument("--objects", type=int, default=len(full_cycle.OBJECTS), help="number of objects of the full cycle")
    options.add_argument("--seeds", type=int, default=2, help="number of seeds of the full cycle")
    options.add_argument("--page-only", action="store_true", help="run nothing")
    given = options.parse_args()
    size = full_cycle.Size(tuple(given.hands.split(",")), given.objects, given.seeds)
    if not given.page_only:
        for name in given.sections or SECTIONS:
            SECTIONS[name].run(given.records / f"{name}.jsonl", size)
    parts = ["# From an empty hand to the release", report_page.facts()]
    for name, section in SECTIONS.items():
        path = given.records / f"{name}.jsonl"
        if path.exists():
            parts += [f"## {section.TITLE}", f"Command: `python -m benchmarks.lifecycle {name}`.", section.page(path)]
    page = "\n\n".join(parts) + "\n"
    print(page)
    if given.save is not None:
        given.save.parent.mkdir(parents=True, exist_ok=True)
        given.save.write_text(page)


if __name__ == "__main__":
    main()
