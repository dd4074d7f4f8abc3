"""Files that are written whole or not at all: a full disk or a killed process leaves the previous file."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def replace_file(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield the path of a temporary file beside a file, which replaces it at the end of the ``with`` block.

    If the block raises, the temporary file is removed and the file stays as it was. A path that exists but is no regular file,
    such as ``/dev/stdout``, is yielded as it is. The mode of an existing file is kept. Missing folders are made.

    Args:
        path: the file. A symbolic link is followed.

    Raises:
        OSError: the file cannot be written.
    """
    import tempfile  # imported here to keep `import graspforce` fast

    target = Path(os.path.realpath(path))
    target.parent.mkdir(parents=True, exist_ok=True)
    if target.exists() and not target.is_file():
        yield target
        return
    number, name = tempfile.mkstemp(prefix=f".{target.stem}-", suffix=target.suffix, dir=target.parent)
    os.close(number)
    temporary = Path(name)
    try:
        yield temporary
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        temporary.chmod(_mode_of(target))
        temporary.replace(target)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write a text file in UTF-8, as `replace_file`.

    Args:
        path: the file.
        text: its content.

    Raises:
        OSError: the file cannot be written.
    """
    with replace_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _mode_of(target: Path) -> int:
    """Return the permissions of a file; those of a new file if it does not exist."""
    try:
        return target.stat().st_mode & 0o7777
    except FileNotFoundError:
        mask = os.umask(0)
        os.umask(mask)
        return 0o666 & ~mask
