"""Check an installed wheel outside the checkout: python packaging/check_wheel.py CHECKOUT [TEST ...].

Runs tests against the installed package: those of the core, which need no optional library, or the given ones. `tests` is
the whole suite, which needs the extra `test`.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

CORE = (
    *("tests/core", "tests/geometry"),
    *(f"tests/contact/test_{name}.py" for name in ("contact", "friction", "matrices", "closure")),
    *(f"tests/force/test_{name}.py" for name in ("certificate", "cone_program", "problem", "rigorous", "scale")),
)
FOLDERS = (".github", "benchmarks", "docs", "examples", "packaging", "tests")
FILES = ("CHANGELOG.md", "CITATION.cff", "CONTRIBUTING.md", "Makefile", "README.md", "mkdocs.yml", "pyproject.toml")


def main() -> int:
    """Copy the tests, and what they read, to a folder of their own, run them there, and return pytest's exit code."""
    checkout, given = Path(sys.argv[1]).resolve(), sys.argv[2:]
    with tempfile.TemporaryDirectory() as folder:
        for name in (*FOLDERS, *FILES):
            source = checkout / name
            (shutil.copytree if source.is_dir() else shutil.copy)(source, Path(folder) / name)
        code = "import graspforce; print(graspforce.__file__)"
        found = subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True).stdout.strip()
        if not found or checkout in Path(found).parents:
            print(f"graspforce is not installed outside {checkout}: {found or 'not found'}")
            return 1
        print(f"Testing {found}")
        tests = given or ("--noconftest", *CORE)  # the configuration of the whole suite imports Zenoh
        return subprocess.run([sys.executable, "-m", "pytest", "-q", *tests], cwd=folder).returncode


if __name__ == "__main__":
    sys.exit(main())
