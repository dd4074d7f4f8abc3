"""Conditions of a race: versions, problem data and the machine, with its clock rates and throttling."""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import graspforce
from graspforce import problems
from graspforce.bench.registry import version

_DEVICES = Path("/sys/devices/system/cpu")
_CPU_INFO = Path("/proc/cpuinfo")
_THROTTLED_SHARE = 0.9  # a clock rate below this share of the earlier one counts as throttled


def race_conditions(solvers: Sequence[str], limit: float) -> dict[str, Any]:
    """Return the conditions of a race that must not change when it is resumed: machine, versions, limit and problem data.

    Args:
        solvers: names of its solvers.
        limit: processor time of one solve, s.
    """
    packages = {name: metadata.version(name) for name in ("numpy", "scipy")}
    versions = {"graspforce": graspforce.__version__, **packages, **{solver: version(solver) for solver in solvers}}
    data = {"version": problems.DATA_VERSION, "sha256": problems.data_hash()}
    return {"machine": processor(), "cores": os.cpu_count(), "python": platform.python_version(), "limit": limit} | {
        "versions": versions,
        "problems": data,
    }


def processor() -> str:
    """Return the name of the processor, or of the machine type if the system does not provide it."""
    names = _cpu_info("model name")
    return names[0] if names else platform.processor() or platform.machine()


def clock_state() -> dict[str, Any]:
    """Return the frequency governor, the mean clock rate in MHz, and the count of throttling events.

    A value is None if the system does not report it, as in most virtual machines.
    """
    governors = sorted({text for path in _DEVICES.glob("cpu[0-9]*/cpufreq/scaling_governor") if (text := _text(path))})
    rates = [float(rate) for rate in _cpu_info("cpu MHz")]
    throttled = [int(text) for path in _DEVICES.glob("cpu[0-9]*/thermal_throttle/core_throttle_count") if (text := _text(path))]
    return {
        "governor": ", ".join(governors) or None,
        "mhz": round(sum(rates) / len(rates), 1) if rates else None,
        "throttle_count": sum(throttled) if throttled else None,
    }


def clock_sentence(clock: Mapping[str, Any]) -> str:
    """Return a sentence about the clock of one session of a race.

    Args:
        clock: `clock_state` under "before" and "after", and the number of tasks at once under "workers".
    """
    before, after = clock["before"], clock["after"]
    governor = f"governor {before['governor']}" if before["governor"] else "governor not reported"
    rates = [before["mhz"], after["mhz"]]
    if None in rates:
        return f"Clock: {governor}, rate not reported."
    return f"Clock: {governor}, {rates[0]:.0f} MHz before and {rates[1]:.0f} MHz after; {_throttling(before, after)}."


def _throttling(before: Mapping[str, Any], after: Mapping[str, Any]) -> str:
    counts = (before["throttle_count"], after["throttle_count"])
    if None not in counts:
        return f"{counts[1] - counts[0]} throttling events"
    slower = after["mhz"] < _THROTTLED_SHARE * before["mhz"]
    return "throttling events not counted, " + ("slower at the end" if slower else "no slowdown seen")


def _cpu_info(key: str) -> list[str]:
    """Return the values of a key for all cores."""
    lines = (_text(_CPU_INFO) or "").splitlines()
    return [line.partition(":")[2].strip() for line in lines if line.partition(":")[0].strip() == key]


def _text(path: Path) -> str | None:
    try:
        return path.read_text().strip()
    except OSError:
        return None
