"""Rules of language that a program can check, over the whole project."""

from __future__ import annotations

from pathlib import Path

import pytest
from support import language

ROOT = Path(__file__).parents[2]
PYTHON = [
    path
    for top in ("graspforce", "service", "problems", "benchmarks", "examples")
    for path in sorted((ROOT / top).rglob("*.py"))
]
TEXTS = [
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "graspforce/hand/models").glob("*.json")),
    *sorted((ROOT / "graspforce/csrc").rglob("*.[ch]")),
    *sorted((ROOT / "graspforce/csrc").rglob("*.inc")),
    *(ROOT / name for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "benchmarks/README.md")),
]


def name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@pytest.mark.parametrize("path", PYTHON, ids=name)
def test_sources_names_and_messages_are_plain(path):
    """No document numbers as sources, no names of the first edition, no long sentences in messages and help texts."""
    found = [finding for finding in language.check_python(path) if finding.rule != "docstring sentence"]
    assert not found, "\n".join(map(str, found))


@pytest.mark.parametrize("path", TEXTS, ids=name)
def test_texts_cite_sources_by_author(path):
    assert not language.check_text(path)


def test_cases_cite_sources_by_author():
    for bundle in (ROOT / "problems").rglob("*.json*"):
        for line in bundle.read_text().splitlines():
            if '"source"' in line:
                source = line.split('"source"', 1)[1].split('"', 2)[1]
                assert not language.DOCUMENT_NUMBER.search(source), f"{bundle}: {source}"


@pytest.mark.parametrize(
    ("code", "rule"),
    [
        ('def f():\n    """Return x. Source: 001 (14)."""\n', "document number"),
        ("class Wish:\n    pass\n", "name"),
        (f'raise ValueError("{"word " * 30}")\n', "message"),
        (f'option(help="{"word " * 30}")\n', "message"),
    ],
)
def test_each_rule_finds_its_fault(code, rule, tmp_path):
    file = tmp_path / "code.py"
    file.write_text(code)
    assert [finding.rule for finding in language.check_python(file)] == [rule]
