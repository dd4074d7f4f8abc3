"""Campaigns: outcomes, workers, results files, groups of failures."""

from __future__ import annotations

import json
import math

import pytest
from support.campaigns import LABEL, campaign_setup, crashing, draw, raising

from graspforce import InvalidInput
from graspforce.simulation.campaigns.campaign import CampaignFile, group_failures, read_campaign, run_campaign
from graspforce.simulation.campaigns.outcome import RunOutcome
from graspforce.simulation.campaigns.trial import CampaignSetup, TrialRecord, run_trial
from graspforce.simulation.worlds.world import World

TRIALS = [(LABEL, seed) for seed in range(4)]


def outcome(result="held", sign="none", t=None):
    return RunOutcome(result, sign, t, 1e-4, 1e-5, 2e-5, 0.01, 2.5)


def record(seed, result="held", sign="none", exact=None, grasp=LABEL):
    return TrialRecord(grasp, seed, draw(seed, 0.7), outcome(result, sign), exact, 1.0)


def without_time(record):
    return {name: value for name, value in record.to_dict().items() if name != "seconds"}


def test_trials_in_processes_are_those_of_this_process():
    setup = CampaignSetup(**campaign_setup())
    seen = []
    records = run_campaign(setup, TRIALS, workers=2, on_trial=seen.append)
    assert seen == records
    here = [run_trial(setup, *trial) for trial in TRIALS]
    assert [without_time(r) for r in sorted(records, key=lambda r: r.seed)] == [without_time(r) for r in here]
    for r in here:
        assert r.controller.result == ("dropped" if r.seed % 2 else "held")
        assert (r.exact is None) == r.controller.is_held  # full knowledge runs where the controller failed


def test_comparison_runs_always_or_never():
    for comparison, expected in (("always", "held"), ("never", None)):
        trial = run_trial(CampaignSetup(**campaign_setup(comparison=comparison)), LABEL, 0)
        assert (trial.exact and trial.exact.result) == expected


def test_an_exception_is_an_outcome_with_its_text():
    trial = run_trial(CampaignSetup(**campaign_setup(controller=raising)), LABEL, 0)
    assert (trial.controller.result, trial.controller.sign) == ("error", "error")
    assert trial.controller.message == "ZeroDivisionError: a fault of the controller"
    trial = run_trial(CampaignSetup(**campaign_setup(wall_limit=1e-6)), LABEL, 0)
    assert "took longer than 1e-06 s" in trial.controller.message


def test_a_grasp_that_cannot_hold_its_told_weight_is_not_started():
    setup = campaign_setup(draw=lambda seed, limit: World(tip_offset=0.0, friction_factor=1.0, seed=seed))
    (label, grasp), *_ = setup["grasps"]
    heavy = type(grasp)(grasp.hand, type(grasp.body).solid(grasp.body.shape, 50.0), *_rest(grasp))
    trial = run_trial(CampaignSetup(**{**setup, "grasps": ((label, heavy),)}), label, 0)
    assert trial.controller.result == "not started"
    assert "cannot hold" in trial.controller.message


def _rest(grasp):
    return grasp.fingers, grasp.contacts, grasp.q, grasp.p_HO, grasp.R_HO


def test_a_crash_of_a_worker_is_an_error_and_the_campaign_goes_on():
    records = run_campaign(CampaignSetup(**campaign_setup(controller=crashing)), TRIALS[:2], workers=1)
    assert [r.controller.result for r in records] == ["error", "error"]
    assert records[0].controller.message == "the worker process ended with exit code 3"


def test_an_exception_of_the_callback_ends_the_campaign_and_its_processes():
    def stop(record):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_campaign(CampaignSetup(**campaign_setup()), TRIALS, workers=1, on_trial=stop)


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"grasps": ()}, "grasps"),
        ({"duration": 0.0}, "duration"),
        ({"plant": "clay"}, "plant"),
        ({"comparison": "sometimes"}, "comparison"),
    ],
)
def test_impossible_campaigns_are_rejected(changes, field):
    with pytest.raises(InvalidInput) as error:
        CampaignSetup(**campaign_setup(**changes))
    assert error.value.field == field


def test_unknown_grasps_and_no_workers_are_rejected():
    setup = CampaignSetup(**campaign_setup())
    with pytest.raises(InvalidInput, match="trials = 'moon'"):
        run_campaign(setup, [("moon", 0)])
    with pytest.raises(InvalidInput, match="workers = 0"):
        run_campaign(setup, TRIALS, workers=0)
    assert run_campaign(setup, []) == []


# ── results ───────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_results_are_continued_after_an_interruption(tmp_path):
    path, conditions = tmp_path / "new" / "results.jsonl", {"duration": 0.1, "plant": "links"}
    with CampaignFile(path, conditions) as file:
        file.append(record(0))
        file.append(record(1, "dropped", "slip", outcome()))
    with path.open("a") as broken:
        broken.write('{"grasp": "allegro b')  # the process was killed while it wrote
    with CampaignFile(path, conditions) as again:
        assert [r.to_dict() for r in again.records] == [r.to_dict() for r in file.records]
        assert again.missing(TRIALS) == TRIALS[2:]
        again.append(record(2))
    found, records = read_campaign(path)
    assert found == {"schema": "graspforce/campaign/1", **conditions}
    assert [r.seed for r in records] == [0, 1, 2]


def test_results_of_another_campaign_are_not_continued(tmp_path):
    path = tmp_path / "results.jsonl"
    CampaignFile(path, {"duration": 0.1, "plant": "links"}).close()
    with pytest.raises(InvalidInput, match="differs in duration, plant"):
        CampaignFile(path, {"duration": 0.2})
    for text in ("", "no JSON\n", '{"schema": "another"}\n', '{"schema": "graspforce/campaign/1"}\n{"grasp": 1}\n'):
        path.write_text(text)
        with pytest.raises(InvalidInput):
            read_campaign(path)
    with pytest.raises(InvalidInput, match="results"):
        read_campaign(tmp_path / "missing.jsonl")


def test_record_of_a_trial_survives_json():
    first = record(1, "dropped", "slip", outcome("lost contact", "contact lost", 0.4))
    assert TrialRecord.from_dict(json.loads(json.dumps(first.to_dict()))).to_dict() == first.to_dict()
    for change in ({"result": "fell"}, {"sign": 1}, {"sliding": -1.0}, {"message": None}, {"t": math.inf}):
        with pytest.raises(InvalidInput, match=r"outcome\."):
            RunOutcome.from_dict({**outcome().to_dict(), **change})


def test_failures_are_grouped_by_kind_with_their_seeds():
    held, dropped = outcome(), outcome("dropped", "slip")
    records = [
        record(5, "dropped", "slip", held), record(2, "dropped", "slip", dropped), record(1),
        record(3, "slipped", "slip", held),
        record(4, "dropped", "no forces", None), record(9, "error", "error", None, grasp="a box"),
    ]  # fmt: skip
    groups = [(g.grasp, g.result, g.sign, g.seeds, g.avoidable) for g in group_failures(records)]
    assert groups == [
        ("a box", "error", "error", (9,), ()),
        (LABEL, "dropped", "slip", (2, 5), (5,)),
        (LABEL, "dropped", "no forces", (4,), ()),
        (LABEL, "slipped", "slip", (3,), (3,)),
    ]
