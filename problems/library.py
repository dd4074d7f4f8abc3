"""The problem library: load cases by name (``collection/case``).

Each collection is a folder. It holds files with one case each (``case.json``), bundles with one case on each line
(``cases.jsonl``), sequences of cases (``sequences.jsonl``), or several of these. To add a case, add a file; to add a
collection, add a folder.
"""

from __future__ import annotations

import difflib
import hashlib
import os
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import msgspec

from graspforce.core.errors import InvalidInput, UnknownName
from graspforce.core.json_text import decode
from graspforce.problems.case import Case
from graspforce.problems.json_format import format_case, format_case_line
from graspforce.problems.sequences import apply_changes, step_name

FOLDER_VARIABLE = "GRASPFORCE_PROBLEMS"  # environment variable: folder of collections that replaces the library
_CASE_SUFFIX, _BUNDLE_SUFFIX, _SEQUENCES = ".json", ".jsonl", "sequences.jsonl"
DATA_VERSION = "2.0.0"  # major: answers or formats changed; minor: cases added; patch: texts and proofs added or corrected
TEXTBOOK = ("fixture", "nose-cone", "opposed", "ring")  # collections whose answers are derived
_DESCRIPTIONS = {
    "batch": "first members of four batches of ten thousand small problems, which `load_batch` returns",
    "closed-loop": "control periods of 1 ms of hands that move an object, in ideal and in real worlds, for warm starts",
    "fixture": "textbook: frictionless locators and clamps",
    "hard": "loads near the boundary of feasibility, rank-deficient grasps, extreme units, low friction, idle contacts",
    "infeasible": "infeasible problems of every kind, each with its proof",
    "ist": "the objects of the IST object set in eight grasp classes, with and without motor limits",
    "large": "500 contacts, exact cones, with and without friction, torsion and overload",
    "nose-cone": "textbook: contacts inside a paraboloid (Lobo et al. 1998)",
    "opposed": "textbook: two opposed contacts",
    "pyramid": "friction pyramids of 3 to 32 facets, every objective",
    "ring": "textbook: contacts evenly spaced around an axis, and a sphere on three fingertips",
    "robust": "forces that hold for errors of friction, load and normals",
    "scaling": "3 to 1000 contacts",
    "soft": "soft fingers, every objective",
    "trajectory": "sequences of problems along a motion, for warm starts",
    "whole-hand": "several contacts on a finger, on inner links and the palm, and joints that all fingers share",
}


class _CaseName(msgspec.Struct):
    """Name of the case in a line of a bundle."""

    name: str


class _Sequence(msgspec.Struct):
    """A line of a file of sequences; see `graspforce.problems.sequences`."""

    name: str
    first: dict[str, Any]
    steps: list[dict[str, Any]]


class _Step(msgspec.Struct):
    """A case of a sequence: its name, the first case, and the fields that differ."""

    name: str
    first: dict[str, Any]
    changes: dict[str, Any]

    def text(self) -> str:
        """Return the case on one line."""
        changed = apply_changes(self.first, self.changes)
        return format_case_line({"schema": changed["schema"], "name": self.name, **changed})


def choose_folder(folder: str | Path) -> None:
    """Use the collections of a folder instead of the library, in this process and in processes that it starts.

    Args:
        folder: folder with one folder for each collection, which holds ``.json`` or ``.jsonl`` files as the library does.

    Raises:
        InvalidInput: the folder holds no case.
    """
    path = Path(folder)
    if not any(path.glob(f"*/*{_CASE_SUFFIX}")) and not any(path.glob(f"*/*{_BUNDLE_SUFFIX}")):
        raise InvalidInput("dir", str(folder), "a folder of collections: <collection>/<case>.json or <collection>/cases.jsonl")
    os.environ[FOLDER_VARIABLE] = str(path.resolve())


def collections() -> tuple[str, ...]:
    """Return the names of the collections, in alphabetical order."""
    return tuple(dict.fromkeys(name.split("/")[0] for name in names()))


def describe(collection: str) -> str:
    """Return a description of a collection in one line; empty if there is none."""
    return _DESCRIPTIONS.get(collection, "")


def names(collection: str | None = None) -> tuple[str, ...]:
    """Return the names of all cases, or of one collection, such as ``nose-cone/5-force``, in alphabetical order.

    Args:
        collection: its name, or "textbook" for all of `TEXTBOOK`.

    Raises:
        UnknownName: no collection has that name.
    """
    every = tuple(_texts())
    if collection is None:
        return every
    wanted = TEXTBOOK if collection == "textbook" else (collection,)
    found = tuple(name for name in every if name.split("/")[0] in wanted)
    if not found:
        raise UnknownName("collection", collection, ("textbook", *collections()))
    return found


def smoke_names() -> tuple[str, ...]:
    """Return the names of the smoke set: 160 small cases of every collection, for a race of some minutes."""
    return tuple((resources.files("graspforce.problems") / "smoke.txt").read_text(encoding="utf-8").split())


def text(name: str) -> str:
    """Return a case as indented JSON.

    Raises:
        UnknownName: no case has that name.
    """
    stored = _text(name)
    return stored if stored.endswith("\n") else format_case(decode(stored.encode())) + "\n"


def load(name: str) -> Case:
    """Return the case with the given name.

    Raises:
        UnknownName: no case has that name.
    """
    return Case.from_dict(decode(_text(name).encode()))


def data_hash(collection: str | None = None) -> str:
    """Return the SHA-256 of the stored cases, in hexadecimal: of each name and text, in alphabetical order.

    Args:
        collection: its name, as for `names`; all collections by default.

    Raises:
        UnknownName: no collection has that name.
    """
    digest = hashlib.sha256()
    for name in names(collection):
        digest.update(f"{name}\n{_text(name).strip()}\n".encode())
    return digest.hexdigest()


def _text(name: str) -> str:
    texts = _texts()
    if not isinstance(name, str) or name not in texts:
        raise UnknownName("case", name, (), _suggest_names(name))
    stored = texts[name]
    return stored if isinstance(stored, str) else stored.text()


def _suggest_names(name: object) -> str:
    """Return a text that lists similar names and the collections."""
    collection = str(name).partition("/")[0]
    few = [one for one in names() if one.startswith(f"{collection}/")] if collection else []
    near = difflib.get_close_matches(str(name), few or names(), n=10, cutoff=0.5)
    listed = "`graspforce problems list` prints all names; the collections are " + ", ".join(collections())
    return f"one of {', '.join(near)}, …; {listed}" if near else f"a case: {listed}"


def _texts() -> dict[str, str | _Step]:
    """Return the stored text, or step of a sequence, of every case by name, of the library or of the chosen folder."""
    return _texts_in(os.environ.get(FOLDER_VARIABLE, ""))


@cache
def _texts_in(chosen: str) -> dict[str, str | _Step]:
    """Return the stored text of every case by name, in alphabetical order.

    A text is either a file, with a final newline, or one line of a bundle. Cases of sequences are stored as steps.

    Args:
        chosen: path of the folder; empty for the library.
    """
    root = Path(chosen) if chosen else resources.files("graspforce.problems")
    found: dict[str, str | _Step] = {}
    naming, sequences = msgspec.json.Decoder(_CaseName), msgspec.json.Decoder(_Sequence)
    for folder in (one for one in root.iterdir() if one.is_dir()):
        for file in folder.iterdir():
            if file.name.endswith(_CASE_SUFFIX):
                found[f"{folder.name}/{file.name.removesuffix(_CASE_SUFFIX)}"] = file.read_text(encoding="utf-8")
            elif file.name == _SEQUENCES:
                for one in map(sequences.decode, file.read_text(encoding="utf-8").splitlines()):
                    names_of_steps = [step_name(one.name, i) for i in range(len(one.steps))]
                    found |= {
                        name: _Step(name, one.first, changes) for name, changes in zip(names_of_steps, one.steps, strict=True)
                    }
            elif file.name.endswith(_BUNDLE_SUFFIX):
                lines = file.read_text(encoding="utf-8").splitlines()
                found |= {naming.decode(line).name: line for line in lines}
    return dict(sorted(found.items()))
