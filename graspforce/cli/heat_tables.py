"""Table of the motors' temperatures after a run: how long the load can be held, and which finger should rest."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rich.table import Table

from graspforce.core.json_text import JsonRecord
from graspforce.hand.hand import Hand
from graspforce.hand.heat import HeatReport


def heat_table(hand: Hand, report: HeatReport, fingers: Sequence[str], duration: float) -> Table:
    """Return the hottest winding of each finger, and how long the finger can bear its load.

    Args:
        hand: the hand.
        report: heat at the end of the run.
        fingers: names of the fingers in contact.
        duration: of the run, s.
    """
    rest = "every finger can hold on" if report.finger is None else f"let {report.finger} rest first"
    table = Table("finger", "hottest winding", "°C", "can hold for", title=f"Motors after {duration:.3g} s: {rest}")
    for name in fingers:
        joints = list(hand.finger(name).joints)
        winding, times = report.temperatures.winding[joints], report.hold_times[joints]
        hottest = int(winding.argmax())
        table.add_row(name, hand.joints[joints[hottest]].name, f"{winding[hottest]:.1f}", duration_text(float(times.min())))
    return table


def duration_text(seconds: float) -> str:
    """Return a time in words, such as "12 min".

    Args:
        seconds: the time, s; infinite for no end.
    """
    if math.isinf(seconds):
        return "no limit"
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 7200.0 else f"{seconds / 3600.0:.1f} h"


def heat_record(report: HeatReport) -> JsonRecord:
    """Return a plain record of the heat: temperatures, °C, hold times, s, null for no limit, and the finger to rest.

    Args:
        report: the heat.
    """
    return {
        "winding": report.temperatures.winding.tolist(),
        "housing": report.temperatures.housing.tolist(),
        "hold_times": [None if math.isinf(each) else each for each in report.hold_times.tolist()],
        "finger_to_rest": report.finger,
    }
