"""The list of packages in pyproject.toml is complete, so that a wheel holds every module of a checkout."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest
import yaml

import graspforce
from graspforce.service.server.configuration import DEFAULT_SECURE_ADDRESS

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


@in_source_tree
def test_the_conda_recipe_needs_what_the_wheel_needs():
    """The recipe repeats the version, the requirements and the licence; pip does not check them there."""
    recipe = yaml.safe_load((ROOT / "packaging" / "conda" / "recipe.yaml").read_text())
    project = PYPROJECT["project"]
    assert recipe["context"]["version"] == graspforce.__version__
    required = {name.replace(" ", "") for name in recipe["requirements"]["run"]}
    assert required == {*project["dependencies"], f"python{project['requires-python']}"}
    assert {name.replace(" ", "") for name in recipe["requirements"]["host"]} >= set(PYPROJECT["build-system"]["requires"])
    assert recipe["about"]["license"] == project["license"]
    scripts = [f"{name} = {target}" for name, target in project["scripts"].items()]
    assert recipe["build"]["python"]["entry_points"] == scripts


@in_source_tree
def test_the_image_installs_extras_that_exist_and_exposes_the_port_of_the_server():
    lines = (ROOT / "packaging" / "docker" / "Dockerfile").read_text().splitlines()
    text = "\n".join(line for line in lines if not line.startswith("#"))
    named = re.search(r"\{wheel\}\[([a-z0-9,]+)\]", text)
    assert named is not None
    assert set(named[1].split(",")) <= set(PYPROJECT["project"]["optional-dependencies"])
    ports = {port for line in lines if line.startswith("EXPOSE") for port in line.split()[1:]}
    metrics = re.search(r'"--metrics", "127\.0\.0\.1:(\d+)"', text)
    assert metrics is not None
    assert ports == {DEFAULT_SECURE_ADDRESS.rpartition(":")[2]}
    assert f"127.0.0.1:{metrics[1]}/healthz" in text


def test_bibliography_is_well_formed():
    text = (ROOT / "docs" / "references.bib").read_text()
    entries = text.split("\n@")
    assert all(entry.count("{") == entry.count("}") > 0 for entry in entries), "an entry with unbalanced braces"
