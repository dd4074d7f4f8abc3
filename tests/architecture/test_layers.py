"""Packages import only from packages below them, in the order that layers.toml states."""

from __future__ import annotations

import ast
import sys
from pathlib import Path

import pytest

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[2]
LAYERS = tomllib.loads((Path(__file__).parent / "layers.toml").read_text())
PACKAGES = list(LAYERS["packages"])


def module_files() -> list[tuple[str, Path]]:
    """(dotted name below graspforce, file) of every module; graspforce/__init__ and __main__ stand outside the order."""
    found = []
    for top in ("graspforce", "service", "problems"):
        for path in sorted((ROOT / top).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            inside = parts[1:] if top == "graspforce" else parts
            if len(inside) > 1:
                found.append((".".join(inside), path))
    return found


def imported_names(path: Path) -> list[str]:
    """Dotted names that a file imports, wherever in it."""
    names = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: imports are absolute, so that this test can read them"
            names.append(node.module)
            names += [f"{node.module}.{alias.name}" for alias in node.names]
    return names


def module_order(package: str) -> list[str] | None:
    """Modules of a package or sub-package from the ground up; None where the order is not stated."""
    return LAYERS["packages"].get(package) or LAYERS["modules"].get(package)


MODULES = module_files()
CASES = pytest.mark.parametrize(("module", "path"), MODULES, ids=[module for module, _ in MODULES])


@CASES
def test_no_import_runs_upward(module, path):
    parts = module.split(".")
    assert parts[0] in PACKAGES, f"{parts[0]} is not in layers.toml"
    for name in imported_names(path):
        other = name.split(".")[1:]
        if not name.startswith("graspforce.") or not other or other[0] not in PACKAGES:
            continue
        if other[0] != parts[0]:
            lower = PACKAGES.index(other[0]) < PACKAGES.index(parts[0])
            assert lower, f"{path.relative_to(ROOT)} imports {name}: {other[0]} is not below {parts[0]}"
            continue
        if parts[-1] == "__init__":
            continue  # a package's face names what lies in it
        depth = next((i for i, (a, b) in enumerate(zip(parts, other, strict=False)) if a != b), None)
        if depth is None:
            continue
        order = module_order(".".join(parts[:depth]))
        assert order is not None, f"layers.toml does not state the order of {'.'.join(parts[:depth])}"
        if other[depth] in order:
            assert order.index(other[depth]) < order.index(parts[depth]), f"{path.relative_to(ROOT)} imports {name}, above it"


@CASES
def test_upward_imports_on_demand_are_listed(module, path):
    listed = LAYERS["on_demand"].get(module, [])
    own = PACKAGES.index(module.split(".")[0])
    for node in ast.walk(ast.parse(path.read_text())):
        if not isinstance(node, ast.Call) or not ast.unparse(node.func).endswith("import_module"):
            continue
        name = node.args[0].value if isinstance(node.args[0], ast.Constant) else ""
        if name.startswith("graspforce.") and PACKAGES.index(name.split(".")[1]) > own:
            assert name.split(".")[1] in listed, f"{module} imports {name} on demand: put it into layers.toml"


@CASES
def test_every_module_has_its_place_in_the_order(module, path):
    parts = module.split(".")
    for depth in range(1, len(parts)):
        if parts[depth] == "__init__":
            continue
        order = module_order(".".join(parts[:depth]))
        if order is not None:
            assert parts[depth] in order, f"{module}: put it into layers.toml"


in_source_tree = pytest.mark.skipif(not (ROOT / "graspforce").is_dir(), reason="the package is installed, without its sources")


@in_source_tree
def test_layers_name_only_modules_that_exist():
    known = {module for module, _ in MODULES}
    for package, order in {**LAYERS["packages"], **LAYERS["modules"]}.items():
        for name in order:
            assert {f"{package}.{name}", f"{package}.{name}.__init__"} & known, f"{package}.{name}"


@CASES
def test_each_library_is_imported_in_its_places_only(module, path):
    place = module.replace(".", "/")
    for name in imported_names(path):
        places = LAYERS["libraries"].get(name.split(".")[0])
        if places is not None:
            assert any(place.startswith(one) for one in places), f"{place} imports {name}; only {places} may"


@CASES
def test_no_package_imports_what_it_must_never_know(module, path):
    forbidden = tuple(f"graspforce.{name}" for name in LAYERS["never"].get(module.split(".")[0], ()))
    assert not forbidden or not any(name.startswith(forbidden) for name in imported_names(path))


@in_source_tree
def test_the_certificate_needs_only_numpy():
    files = (ROOT / "graspforce/force/certificate.py", ROOT / "graspforce/force/scale.py")
    outside = {name.split(".")[0] for path in files for name in imported_names(path)}
    assert outside - set(sys.stdlib_module_names) == {"graspforce", "numpy"}


@in_source_tree
def test_the_top_level_has_few_entries():
    entries = {path.name for path in (ROOT / "graspforce").iterdir()} - {
        "__pycache__",
        "__init__.py",
        "__main__.py",
        "py.typed",
    }
    assert len(entries) <= 17, sorted(entries)
