"""Test of the documentation's page of the benchmark: it holds the runs in all units, and its history those of each group."""

from __future__ import annotations

import base64
import gzip
import importlib.util
import json
import re
from pathlib import Path

import pytest

from graspforce.bench.judge import Judgement, Verdict
from graspforce.bench.outcome import RaceOutcome, RaceTask

ROOT = Path(__file__).parents[2]


def test_page_of_the_suite_holds_runs_in_all_units(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("mkdocs")
    spec = importlib.util.spec_from_file_location("site_hooks", ROOT / "docs" / "site_hooks.py")
    assert spec is not None
    assert spec.loader is not None
    site_hooks = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(site_hooks)
    tasks = [RaceTask("clarabel", "default", units, False, False, "ring/3-force") for units in ("scaled", "si")]
    outcomes = [RaceOutcome(task, 3, True, Judgement(Verdict.WRONG, 0.5), None, None, 5) for task in tasks]
    conditions = {"machine": "m", "cores": 2, "python": "3.12", "limit": 1.0, "versions": {"clarabel": "2"}}
    monkeypatch.setattr(site_hooks.outcome, "load", lambda path: (conditions, outcomes))
    found = re.search(r'id="data">([^<]*)<', site_hooks.solver_page())
    assert found is not None
    data = json.loads(gzip.decompress(base64.b64decode(found[1])))
    assert {"scaled", "si"} <= {value for column in data["runs"] for value in column if isinstance(value, str)}
    assert {one["group"] for one in data["history"]} >= {"exact cones, default, scaled", "exact cones, default, si"}
