"""Text from strangers, made safe for logs and terminals."""

from __future__ import annotations

import re

# C0 and C1 control characters (terminal commands, line breaks), line and paragraph separators, characters that reverse the
# direction of text, and lone surrogates, which no terminal can encode.
_CONTROL = re.compile("[\x00-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")


def escape_controls(text: str) -> str:
    r"""Return a text of one line in which control characters are escaped as in Python: ``\x1b``, ``\u202e``.

    Args:
        text: any text.
    """
    return _CONTROL.sub(lambda match: _escape(ord(match[0])), text)


def has_controls(text: str) -> bool:
    """Return whether `escape_controls` would change a text.

    Args:
        text: any text.
    """
    return _CONTROL.search(text) is not None


def _escape(code: int) -> str:
    """Return the escape sequence of a character."""
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}"
