"""Tables of records as text and as HTML."""

from __future__ import annotations

from graspforce.core.text_table import Table

TABLE = Table(("name", "N·m"), (("index", "1.25"), ("a < b", "-10")), "Torques")


def test_numbers_are_aligned_to_the_right_and_texts_to_the_left():
    assert str(TABLE).splitlines() == ["Torques", "  name    N·m", "  index  1.25", "  a < b   -10"]


def test_html_escapes_the_cells():
    html = TABLE.to_html()
    assert "<caption>Torques</caption>" in html
    assert "<td>a &lt; b</td><td>-10</td>" in html
