"""Statistics of requests: quantiles of the last latencies."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graspforce.service.server.request_statistics import RequestStatistics

_WINDOW = 4096  # requests whose latencies count


@given(st.lists(st.floats(1e-6, 10.0), min_size=1, max_size=300))
def test_quantiles_are_latencies_that_enough_requests_did_not_exceed(seconds: list[float]) -> None:
    statistics = RequestStatistics()
    for each in seconds:
        statistics.count("solve", "ok", each)
    latency = statistics.latency()
    assert latency["count"] == len(seconds)
    assert latency["max"] == max(seconds)
    for name, fraction in (("p50", 0.5), ("p99", 0.99)):
        found = latency[name]
        assert found in seconds
        assert np.mean(np.array(seconds) <= found) >= fraction
        assert np.mean(np.array(seconds) < found) < fraction


@pytest.mark.parametrize("extra", [0, 1, _WINDOW - 1, 3 * _WINDOW + 7])
def test_only_the_last_latencies_count(extra: int) -> None:
    statistics = RequestStatistics()
    for _ in range(extra):
        statistics.count("solve", "ok", 100.0)
    for k in range(_WINDOW):
        statistics.count("solve", "ok", 1e-3 * (k + 1))
    latency = statistics.latency()
    assert latency["count"] == _WINDOW
    assert latency["max"] == pytest.approx(1e-3 * _WINDOW)
    assert latency["p50"] == pytest.approx(1e-3 * _WINDOW / 2)


def test_requests_without_work_have_no_latency() -> None:
    statistics = RequestStatistics()
    assert statistics.latency() == {"count": 0, "p50": None, "p99": None, "max": None}
    statistics.count("solve", "overloaded")
    assert statistics.latency()["count"] == 0
    assert statistics.counts() == {"solve": {"overloaded": 1}}
