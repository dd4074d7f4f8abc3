"""Rules of language that a program can check. `python tests/support/language.py PATH …` prints what breaks them."""

from __future__ import annotations

import ast
import io
import re
import sys
import tokenize
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

MAX_WORDS = 25  # of a sentence that a user reads
DOCUMENT_NUMBER = re.compile(r"(?<![\w./#-])00[0-4](?![\w.-])|\bD24\b")  # a source cited by the number of its file
# Names of the first edition that had to be decoded, and the word "feet" for closest points.
BANNED_NAMES = frozenset(
    [
        "Hold",
        "find_hold",
        "ways_of",
        "Wanted",
        "Settled",
        "Touched",
        "Wish",
        "HoldWish",
        "Refusal",
        "Refused",
        "Way",
        "Room",
        "ANYWHERE",
        "Course",
        "Watch",
        "Ties",
        "feet",
        "led",
        "ahead",
        "stepped",
        "Entrant",
        "Said",
        "Claim",
        "lied",
        "Lane",
        "_desk",
        "paced",
        "kept_back",
        "Taken",
        "Kept",
        "Placed",
        "Asked",
        "Found",
        "Drawn",
        "Made",
        "_Made",
    ]
)
_ENDS = re.compile(r"(?<=[.!?:;])\s+|\n\s*\n|\n\s*[-*|]")


@dataclass(frozen=True)
class Finding:
    path: str
    line: int
    rule: str
    text: str

    def __str__(self) -> str:
        return f"{self.path}:{self.line}: {self.rule}: {self.text}"


def sentences(text: str) -> Iterator[str]:
    """Sentences of a text; clauses after a colon or semicolon count by themselves."""
    for part in _ENDS.split(text):
        yield " ".join(part.split())


def word_count(sentence: str) -> int:
    return len(re.findall(r"[A-Za-z][\w'’-]*", sentence))


def check_python(path: Path) -> list[Finding]:
    """Return the findings in one Python file: sources, names, and the length of sentences that users read."""
    text, found, where = path.read_text(), [], str(path)
    tree = ast.parse(text)
    for node in ast.walk(tree):
        if isinstance(node, (ast.FunctionDef, ast.ClassDef, ast.Module)):
            docstring = ast.get_docstring(node) or ""
            first = node.body[0].lineno if docstring else 1
            found += [
                Finding(where, first, "docstring sentence", s) for s in sentences(docstring) if word_count(s) > MAX_WORDS + 5
            ]
        for literal in _user_texts(node):
            found += [Finding(where, node.lineno, "message", s) for s in sentences(literal) if word_count(s) > MAX_WORDS]
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.NAME and token.string in BANNED_NAMES:
            found.append(Finding(where, token.start[0], "name", token.string))
        if token.type in (tokenize.STRING, tokenize.COMMENT) and DOCUMENT_NUMBER.search(token.string):
            found.append(Finding(where, token.start[0], "document number", DOCUMENT_NUMBER.search(token.string).group()))
    return found


def _user_texts(node: ast.AST) -> Iterator[str]:
    """Texts that a user reads: arguments of raised errors, help texts, and docstrings of commands."""
    calls = []
    if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
        calls = [*node.exc.args, *(k.value for k in node.exc.keywords)]
    if isinstance(node, ast.Call):
        calls = [k.value for k in node.keywords if k.arg in ("help", "epilog")]
    for value in calls:
        parts = [part.value for part in ast.walk(value) if isinstance(part, ast.Constant) and isinstance(part.value, str)]
        yield " ".join(parts)
    if isinstance(node, ast.FunctionDef) and any(
        "command" in ast.unparse(d) or "callback" in ast.unparse(d) for d in node.decorator_list
    ):
        yield ast.get_docstring(node) or ""


def check_text(path: Path) -> list[Finding]:
    """Return the findings in a text file: sources cited by document number."""
    lines = path.read_text().splitlines()
    return [
        Finding(str(path), i + 1, "document number", line.strip()[:80])
        for i, line in enumerate(lines)
        if DOCUMENT_NUMBER.search(line)
    ]


def main(arguments: list[str]) -> int:
    found: list[Finding] = []
    for argument in arguments:
        top = Path(argument)
        files = [top] if top.is_file() else sorted(top.rglob("*.py"))
        for path in files:
            found += check_python(path) if path.suffix == ".py" else check_text(path)
    print(*found, sep="\n")
    print(f"{len(found)} findings")
    return bool(found)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
