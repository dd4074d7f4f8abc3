"""The requests of docs/wire.md, and their exchanges with a server."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType


def load_script(path: Path) -> ModuleType:
    """Return a script of the documentation as a module."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


wire_replies = load_script(Path(__file__).parents[2] / "docs" / "wire_replies.py")
page_requests = wire_replies.page_requests
page_exchanges = wire_replies.exchanges
