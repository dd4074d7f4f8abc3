"""The core installs without optional libraries: forces work, and every other feature names the extra that it needs."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from graspforce import problems
from graspforce.core.errors import MissingLibrary
from graspforce.core.optional_libraries import LIBRARIES, optional_imports, require_libraries

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[2]
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
ABSENT = f"import sys; sys.modules.update(dict.fromkeys({sorted(LIBRARIES)!r}))\n"  # None: the import fails as if not installed
TWO_CONTACTS = """
import graspforce as gf
contacts = [gf.Contact(position=[0, y, 0], normal=[0, -y / 0.03, 0], friction=0.5, max_normal=20) for y in (-0.03, 0.03)]
problem = gf.ForceProblem(contacts, w=[0, 0, 1.962, 0, 0, 0])
"""


def run(code: str) -> subprocess.CompletedProcess[str]:
    """Run code in a process in which no optional library can be imported."""
    return subprocess.run([sys.executable, "-c", ABSENT + code], capture_output=True, text=True, timeout=120)


def test_forces_explanations_and_measures_need_no_optional_library() -> None:
    done = run(
        TWO_CONTACTS
        + """
print(gf.solve(problem).status.name, gf.Solver(problem).solve().status.name)
print(gf.solve(problem.replace(w=[0, 0, 30, 0, 0, 0])).status.name)
print(gf.explain(problem).solution.status.name, gf.quality(problem).force_closed)
print(len(gf.problems.load("ring/3-force").problem.contacts))
"""
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["OPTIMAL", "OPTIMAL", "INFEASIBLE", "OPTIMAL", "False", "3"]


@pytest.mark.parametrize(
    ("statement", "extra"),
    [
        ("gf.Hand.load('dlr_hit2')", "hand"),
        ("gf.planning.plan_free", "plan"),
        ("gf.service.Client", "serve"),
        ("gf.simulation.World", "sim"),
        ("gf.solve(problem).plot()", "plot"),
        ("gf.view.show", "plot"),
    ],
)
def test_features_name_the_extra_that_installs_their_library(statement: str, extra: str) -> None:
    done = run(f"{TWO_CONTACTS}\ntry:\n    {statement}\nexcept gf.GraspForceError as error:\n    print(error)")
    assert done.returncode == 0, done.stderr
    assert f'pip install "graspforce[{extra}]"' in done.stdout


@pytest.mark.parametrize(
    ("command", "extra"),
    [
        (["hands", "show", "dlr_hit2"], "hand"),
        (["plan", "--to", "0,0,0.01"], "plan"),
        (["serve"], "serve"),
        (["simulate"], "sim"),
        (["demo"], "plot"),
    ],
)
def test_commands_end_with_one_line_that_names_the_extra(command: list[str], extra: str) -> None:
    done = run(f"from graspforce.cli import main\nsys.exit(main({command!r}))")
    assert done.returncode == 1, done.stderr + done.stdout
    (line,) = done.stderr.splitlines()
    assert line.endswith(f'Install it: pip install "graspforce[{extra}]"')


def test_command_solves_without_optional_libraries() -> None:
    problem = str(Path(problems.__file__).parent / "ring" / "3-force.json")
    done = run(f"from graspforce.cli import main\nsys.exit(main(['solve', {problem!r}]))")
    assert done.returncode == 0, done.stderr
    assert "optimal" in done.stdout.lower()


def test_extras_of_all_libraries_exist() -> None:
    assert {library.extra for library in LIBRARIES.values()} <= set(EXTRAS)


def test_extra_all_has_every_extra_of_users() -> None:
    (all_extras,) = EXTRAS["all"]
    named = set(all_extras.removeprefix("graspforce[").removesuffix("]").split(","))
    assert named == set(EXTRAS) - {"all", "bench", "test", "docs", "dev", "torch", "jax"}  # these two need gigabytes


def test_other_import_errors_stay_as_they_are() -> None:
    with pytest.raises(ModuleNotFoundError, match="no_such_module") as caught, optional_imports():
        import no_such_module  # type: ignore[import-not-found]  # noqa: F401
    assert not isinstance(caught.value, MissingLibrary)
    require_libraries("pinocchio")
