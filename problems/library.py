"""The cases that ship: one JSON file a case, one folder a collection; a case is called ``collection/file``."""

from __future__ import annotations

from functools import cache
from importlib import resources

from graspforce.errors import UnknownName
from graspforce.json_text import decode
from graspforce.problems.case import Case

_HERE = resources.files("graspforce.problems")
_SUFFIX = ".json"


def collections() -> tuple[str, ...]:
    """The names of the collections, in alphabetical order."""
    return tuple(dict.fromkeys(name.split("/")[0] for name in names()))


@cache
def names() -> tuple[str, ...]:
    """The names of all cases, such as ``nose-cone/5-force``, in alphabetical order."""
    folders = [folder for folder in _HERE.iterdir() if folder.is_dir()]
    return tuple(
        sorted(
            f"{folder.name}/{file.name.removesuffix(_SUFFIX)}"
            for folder in folders
            for file in folder.iterdir()
            if file.name.endswith(_SUFFIX)
        )
    )


def text(name: str) -> str:
    """The case file itself.

    Raises:
        UnknownName: no case is called so.
    """
    if name not in names():
        raise UnknownName("case", name, "one of " + ", ".join(names()))
    return _HERE.joinpath(*f"{name}{_SUFFIX}".split("/")).read_text(encoding="utf-8")


def load(name: str) -> Case:
    """The case of that name.

    Raises:
        UnknownName: no case is called so.
    """
    return Case.from_dict(decode(text(name).encode()))
