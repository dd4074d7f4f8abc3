"""Checks of the files and folders that a command will write."""

from __future__ import annotations

import os
from pathlib import Path

from graspforce.core.errors import InvalidInput


def check_new_file(path: Path | None, option: str, force: bool = True) -> None:
    """Raise an error if a file cannot be written, before there is anything to write.

    Args:
        path: the file; None skips the check.
        option: name of the option in errors.
        force: whether an existing file may be replaced.

    Raises:
        InvalidInput: a directory, an existing file without `force`, or no permission to write.
    """
    if path is None:
        return
    if os.path.isdir(path):  # unlike Path.is_dir, this accepts names that are too long
        raise InvalidInput(option, str(path), "a file, not a directory")
    if os.path.exists(path):
        if not force:
            raise InvalidInput(option, str(path), "a new file, or given with --force to replace the existing one")
        if not os.access(path, os.W_OK):
            raise InvalidInput(option, str(path), "a writable file")
        return
    _check_writable(path.parent, path, option)


def check_new_folder(path: Path | None, option: str) -> None:
    """Raise an error if a directory can neither be written to nor created.

    Args:
        path: the directory; None skips the check.
        option: name of the option in errors.

    Raises:
        InvalidInput: no permission to write.
    """
    if path is not None:
        _check_writable(path, path, option)


def _check_writable(folder: Path, path: Path, option: str) -> None:
    """Raise an error if the nearest existing folder above a path is not writable."""
    there = next(each for each in (folder, *folder.absolute().parents) if os.path.exists(each))
    if not os.path.isdir(there):
        raise InvalidInput(option, str(path), f"in a directory; {there} is a file")
    if not os.access(there, os.W_OK | os.X_OK):
        raise InvalidInput(option, str(path), f"in a writable directory; {there} is not writable")
