"""Small tables of records: as text for `print`, as HTML for notebooks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape


@dataclass(frozen=True, slots=True)
class Table:
    """A table of texts.

    Args:
        header: the column titles.
        rows: the cells; every row has one cell for each column.
        title: a line above the table; empty for none.
    """

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    title: str = ""

    def __str__(self) -> str:
        lines = [self.header, *self.rows]
        widths = [max(len(line[k]) for line in lines) for k in range(len(self.header))]
        right = [_is_numeric([row[k] for row in self.rows]) for k in range(len(self.header))]
        text = []
        for line in lines:
            cells = [cell.rjust(w) if r else cell.ljust(w) for cell, w, r in zip(line, widths, right, strict=True)]
            text.append(("  " + "  ".join(cells)).rstrip())
        return "\n".join([self.title, *text] if self.title else text)

    def to_html(self) -> str:
        """Return the table as HTML."""
        title = f"<caption>{escape(self.title)}</caption>" if self.title else ""
        head = "".join(f"<th>{escape(cell)}</th>" for cell in self.header)
        body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in self.rows)
        return f"<table>{title}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _is_numeric(cells: Sequence[str]) -> bool:
    """Return whether all cells are numbers or empty; such a column is aligned to the right."""
    return all(cell.replace("−", "-").strip("-+.0123456789e") == "" for cell in cells)
