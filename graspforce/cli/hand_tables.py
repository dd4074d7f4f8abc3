"""Reports of hands: their joints, the findings of their checks, and new descriptions."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import Any

import numpy as np
from rich.console import Group, RenderableType
from rich.padding import Padding
from rich.text import Text

from graspforce.cli.tables import NO_VALUE, count_text, make_table, range_text
from graspforce.hand.authoring import NewDescription
from graspforce.hand.hand import Hand
from graspforce.hand.lint.findings import Finding
from graspforce.hand.workspace import JointSweep, TipMeasures, speed_unit


def hand_report(record: dict[str, Any]) -> RenderableType:
    """Return the report of a hand: joints, limits, couplings and sources.

    Args:
        record: the record of `Hand.describe`.
    """
    title = Text.assemble((record["name"], "bold"), f": {record['title']}")
    finger_of = {joint: finger["name"] for finger in record["fingers"] for joint in finger["joints"]}
    joints = record["joints"]
    kinds = sorted({joint["is_prismatic"] for joint in joints})
    position, torque = " or ".join(("rad", "m")[kind] for kind in kinds), " or ".join(("N·m", "N")[kind] for kind in kinds)
    columns = [
        ("joint", [joint["name"] for joint in joints]),
        ("finger", [finger_of.get(joint["name"], NO_VALUE) for joint in joints]),
        (f"range ({position})", [range_text(joint["lower"], joint["upper"]) for joint in joints]),
        (f"rate ({position}/s)", [f"{joint['velocity']:g}" for joint in joints]),
        (f"torque ({torque})", [f"{joint['torque']:g}" for joint in joints]),
    ]
    notes = [f"{c['follower']} follows {c['leader']}: {c['ratio']:g} q + {c['offset']:g}." for c in record["couplings"]]
    notes += [f"{locked['joint']} is locked at {locked['position']:g} rad." for locked in record["locked"]]
    notes += [*record["notes"], f"Source: {record['source']}", f"Licence: {record['license']}"]
    return Group(title, "", make_table(columns, left=2), "", *map(Text, notes))


def reach_report(hand: Hand, workspaces: Sequence[TipMeasures], sweeps: Sequence[tuple[JointSweep, ...]]) -> RenderableType:
    """Return the report of a hand's workspaces: extent and mobility of each fingertip.

    Args:
        hand: the hand.
        workspaces: a sample of each finger's workspace.
        sweeps: the sweeps of each finger's joints.
    """
    spans = [1e3 * np.ptp(each.p_HF, axis=0) for each in workspaces]  # mm
    worst = [min(each, key=lambda sweep: sweep.tip.min_singular_value.min()) for each in sweeps]
    units = [speed_unit(hand, each.finger) for each in workspaces]
    medians = [factor * np.median(each.min_singular_value) for each, (factor, _) in zip(workspaces, units, strict=True)]
    least = [factor * sweep.tip.min_singular_value.min() for sweep, (factor, _) in zip(worst, units, strict=True)]
    columns = [
        ("finger", [each.finger for each in workspaces]),
        ("x × y × z (mm)", [" × ".join(f"{size:.0f}" for size in span) for span in spans]),
        ("hull (cm³)", [f"{1e6 * each.hull_volume:.0f}" for each in workspaces]),
        ("σ_min: median", [f"{value:.3g}" for value in medians]),
        ("least", [f"{value:.2g}" if value > 1e-9 else "0" for value in least]),
        ("along", [sweep.joint for sweep in worst]),
    ]
    title = Text.assemble((hand.name, "bold"), f": fingertips in {len(workspaces[0].q):,} random postures of each finger")
    names = ", ".join(dict.fromkeys(name for _, name in units))
    notes = f"σ_min ({names}) is the tip's speed per joint rate in its slowest direction; "
    return Group(
        title, "", make_table(columns, left=1), "", Text(notes + "the least is along the range of one joint from neutral.")
    )


def findings_report(findings: Sequence[Finding]) -> RenderableType:
    """Return the report of lint findings: problem, consequence and remedy. Findings with one remedy are grouped.

    Args:
        findings: the findings.
    """
    parts: list[RenderableType] = []
    for (severity, consequence, remedy), alike in groupby(findings, lambda f: (f.severity, f.consequence, f.remedy)):
        style = {"error": "bold red", "warning": "bold yellow"}.get(severity, "bold")
        parts.append(Text(severity.capitalize(), style=style))
        parts += [Padding.indent(Text(f"{finding.location}: {finding.problem}"), 2) for finding in alike]
        parts.append(Padding.indent(Text.assemble(("Consequence:", "dim"), f" {consequence}"), 4))
        parts += [Padding.indent(Text.assemble(("Remedy:", "dim"), f" {remedy}"), 4), ""]
    errors = sum(finding.severity == "error" for finding in findings)
    warnings = sum(finding.severity == "warning" for finding in findings)
    return Group(*parts, Text(f"{count_text(errors, 'error')}, {count_text(warnings, 'warning')}."))


def new_hand_report(described: NewDescription, path: str) -> RenderableType:
    """Return the report of a new description: fingers, remarks, numbers to fill in, and the next steps.

    Args:
        described: the description.
        path: where it was written.
    """
    fingers = described.record["fingers"]
    radii = [finger.get("tip_radius") for finger in fingers]
    columns = [
        ("finger", [finger["name"] for finger in fingers]),
        ("tip frame", [finger["tip"] for finger in fingers]),
        ("tip radius (mm)", [NO_VALUE if radius is None else f"{1e3 * radius:.1f}" for radius in radii]),
    ]
    steps = [
        f"graspforce hands lint {path}",
        f"graspforce hands show {path}",
        f"graspforce simulate --hand {path} --reference still",
    ]
    parts: list[RenderableType] = [Text(f"Written: {path}", style="bold"), "", make_table(columns, left=2), ""]
    parts += [Padding.indent(Text(remark), 2) for remark in described.remarks]
    if described.unfilled:
        parts += ["", Text("Fill in, from the data sheet of the motors:", style="bold yellow")]
        parts += [Padding.indent(Text(name), 2) for name in described.unfilled]
    parts += ["", Text("Next steps:", style="bold"), *(Padding.indent(Text(step), 2) for step in steps), ""]
    return Group(*parts)
