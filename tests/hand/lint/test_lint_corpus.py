"""Lint reports every defect of a corpus of faulty hands, and nothing about sound ones."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from support.faulty_hands import DEFECTS, SOUND, write_hand
from support.hands import SHIPPED_HANDS, load

from graspforce.core.errors import GraspForceError
from graspforce.hand.lint.lint_hand import lint_hand


def reports(path: Path) -> list[str]:
    """Return the findings of a hand, or the error that says why it cannot be read."""
    try:
        return [f"{finding.location}: {finding.problem}; remedy: {finding.remedy}" for finding in lint_hand(path)]
    except GraspForceError as error:
        return [str(error)]


@pytest.mark.parametrize("name", DEFECTS)
def test_defect_is_reported(name: str, tmp_path: Path) -> None:
    defect = DEFECTS[name]
    found = reports(write_hand(tmp_path, swap=defect.swap, edit=defect.edit))
    assert any(re.search(defect.words, report) for report in found), found
    assert len(found) <= 4, found  # the defect, and its direct consequences


def test_corpus_is_large_enough() -> None:
    assert len(DEFECTS) >= 60
    assert len(SOUND) >= 12


@pytest.mark.parametrize("name", SOUND)
def test_sound_hand_has_no_findings(name: str, tmp_path: Path) -> None:
    swap, edit = SOUND[name]
    assert reports(write_hand(tmp_path, swap=swap, edit=edit)) == []


@pytest.mark.parametrize("name", SHIPPED_HANDS)
def test_shipped_hand_has_no_errors(name: str) -> None:
    load(name)
    assert [finding for finding in lint_hand(name) if finding.severity == "error"] == []
