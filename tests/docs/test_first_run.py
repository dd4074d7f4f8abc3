"""The first run of the README: `make run` ends without a collision, a lost contact or a slip."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

from graspforce.cli import main

ROOT = Path(__file__).parents[2]


def film_options() -> list[str]:
    """Return the options of the simulation that `make run` films."""
    text = (ROOT / "Makefile").read_text().replace("\\\n", " ")
    found = re.search(r"^FILM := (.*)$", text, flags=re.M)
    assert found is not None
    return shlex.split(found[1])


def test_make_run_films_the_options_of_the_makefile() -> None:
    assert re.search(r"^run:.*\n\t.* simulate \$\(FILM\)", (ROOT / "Makefile").read_text(), flags=re.M)
    assert "make run" in (ROOT / "README.md").read_text()


def test_motion_of_make_run_collides_with_nothing(capsys) -> None:
    """In the first two seconds the ball reaches its farthest place. Exit code 0 means no collision, lost contact or slip."""
    options = film_options()
    options[options.index("--duration") + 1] = "2"
    assert main(["simulate", *options]) == 0
    assert "allegro_right" in capsys.readouterr().out
