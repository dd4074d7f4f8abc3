"""Each example runs, prints something, and writes its picture; the documentation shows that picture."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import matplotlib
import pytest
from matplotlib import image

matplotlib.use("Agg")
ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))


@pytest.mark.parametrize("script", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_prints_and_draws(script, tmp_path, monkeypatch, capsys):
    picture = tmp_path / f"{script.stem}.png"
    monkeypatch.setattr(sys, "argv", [str(script), str(picture)])
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(script), run_name="__main__")
    assert capsys.readouterr().out.strip()
    height, width, *_ = image.imread(picture).shape
    assert min(height, width) >= 200
    assert image.imread(picture)[..., :3].std() > 0.02  # not a blank page


@pytest.mark.parametrize("script", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_short_and_has_its_picture_in_the_documentation(script):
    assert len(script.read_text().splitlines()) <= 60
    assert (ROOT / "docs" / "media" / "examples" / f"{script.stem}.png").exists()
