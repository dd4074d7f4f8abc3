"""Control characters are escaped, other text stays."""

from __future__ import annotations

import unicodedata

from hypothesis import given
from hypothesis import strategies as st

from graspforce.core.printable import escape_controls, has_controls


@given(st.text())
def test_escaped_text_has_no_control_characters(text):
    escaped = escape_controls(text)
    assert not has_controls(escaped)
    assert not any(unicodedata.category(c) in ("Cc", "Cs", "Zl", "Zp") for c in escaped)
    assert has_controls(text) == (escaped != text)


def test_terminal_commands_and_line_breaks_are_escaped():
    assert escape_controls("a\x1b[2J\nb\u202ec\ud800") == r"a\x1b[2J\x0ab\u202ec\ud800"
    assert escape_controls("größer, 漢字, 🙂") == "größer, 漢字, 🙂"
