"""An option has one name and one kind of value in all commands."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from typing import Any

import typer.main

from graspforce.cli import app


def walk(command: Any, words: tuple[str, ...] = ()) -> Iterator[tuple[str, str, str | None]]:
    """Yield command, long option and kind of value of every option."""
    for parameter in command.params:
        for name in parameter.opts:
            if name.startswith("--"):
                yield " ".join(words), name, parameter.metavar
    for word, child in getattr(command, "commands", {}).items():
        yield from walk(child, (*words, word))


def test_options_of_the_same_name_take_the_same_kind_of_value() -> None:
    kinds: dict[str, dict[str | None, list[str]]] = defaultdict(lambda: defaultdict(list))
    for command, name, kind in walk(typer.main.get_command(app)):
        kinds[name][kind].append(command)
    assert len(kinds) > 80
    different = {name: dict(found) for name, found in kinds.items() if len(found) > 1}
    assert not different
