"""The list of packages in pyproject.toml is complete, so that a wheel holds every module of a checkout."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[2]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
SETUPTOOLS = PYPROJECT["tool"]["setuptools"]


def package_folders() -> dict[str, str]:
    """Return the folder of each package, by its installed name."""
    folders = {}
    for top in ("graspforce", "service", "problems"):
        for module in (ROOT / top).rglob("*.py"):
            folder = module.parent.relative_to(ROOT).as_posix()
            name = folder.replace("/", ".")
            folders[name if top == "graspforce" else f"graspforce.{name}"] = folder
    return folders


in_source_tree = pytest.mark.skipif(not (ROOT / "graspforce").is_dir(), reason="the package is installed, without its sources")


@in_source_tree
def test_every_folder_of_modules_is_packaged():
    assert set(SETUPTOOLS["packages"]) == set(package_folders())


@in_source_tree
def test_folders_beside_the_package_are_mapped_into_it():
    outside = {name: folder for name, folder in package_folders().items() if not folder.startswith("graspforce")}
    assert SETUPTOOLS["package-dir"] == outside


@in_source_tree
def test_sources_of_extension_modules_exist():
    for module in SETUPTOOLS["ext-modules"]:
        for path in (*module["sources"], *module["depends"]):
            assert (ROOT / path).is_file(), f"{module['name']}: {path} is missing"


@in_source_tree
def test_sources_of_extension_modules_are_complete():
    folders = {"graspforce/csrc/kernel", "graspforce/csrc/control", "graspforce/csrc/python"}
    listed = {path for module in SETUPTOOLS["ext-modules"] for path in module["sources"]}
    present = {path.relative_to(ROOT).as_posix() for folder in folders for path in (ROOT / folder).glob("*.c")}
    assert listed == present


def test_bibliography_is_well_formed():
    text = (ROOT / "docs" / "references.bib").read_text()
    entries = text.split("\n@")
    assert all(entry.count("{") == entry.count("}") > 0 for entry in entries), "an entry with unbalanced braces"
