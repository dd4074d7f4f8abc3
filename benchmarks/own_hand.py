"""From a public URDF to a held object: `python -m benchmarks.own_hand`.

Describe the hands of two robots of example-robot-data with `graspforce hands new`, fill in the numbers that it asks for, and
hold a ball in MuJoCo. The page is the transcript.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.report_page import parser
from graspforce.hand.descriptions.description import robot_data_folders

ROTOR = {"rotor_inertia": 1e-7, "gear_ratio": 100.0}  # kg·m², estimates for motors of this size


@dataclass(frozen=True)
class Case:
    """A hand of a public robot.

    Attributes:
        name: name of the hand.
        urdf: path in example-robot-data.
        base: link that is the hand's base.
        torque: of motors whose torque the URDF does not give, N·m.
        radius: of the ball, m.
    """

    name: str
    urdf: str
    base: str
    torque: float
    radius: float


CASES = (
    Case("dex3", "robots/g1_description/urdf/g1_29dof_with_hand_rev_1_0.urdf", "right_hand_palm_link", 1.0, 0.03),
    Case("ability", "robots/alex_description/urdf/alex_psyonic_hands.urdf", "RightPsyonicAbilityBaseLink", 0.5, 0.02),
)


def transcript(case: Case, folder: Path) -> list[str]:
    """Return the lines of a page about one hand: commands, their output, what was typed, and the time."""
    urdf = next(share / case.urdf for share in robot_data_folders() if (share / case.urdf).is_file())
    target, start = folder / f"{case.name}.json", time.perf_counter()
    lines = [f"## {case.name}: {Path(case.urdf).name}", ""]
    lines += _run(folder, "hands", "new", str(urdf), "--base", case.base, "-o", target.name)
    record = json.loads(target.read_text())
    typed = []
    for i, motor in enumerate(record["motors"]):
        values = {key: value for key, value in ROTOR.items() if key == "gear_ratio" or motor[key] is None}
        values |= {"torque": case.torque} if motor["torque"] is None else {}
        motor |= values
        typed += [f'motors[{i}]: "{key}": {json.dumps(value)}' for key, value in values.items()]
    target.write_text(json.dumps(record))
    lines += [f"Typed, {len(typed)} lines of JSON (estimates):", "", "```text", *typed, "```", ""]
    lines += _run(folder, "hands", "lint", target.name)
    ball = f"sphere:{case.radius:g}"
    lines += _run(folder, "simulate", "--hand", target.name, "--object", ball, "--reference", "still", "--duration", "10")
    return [*lines, f"Computing time of all commands: {time.perf_counter() - start:.0f} s.", ""]


def record_transcript(name: str) -> dict[str, Any]:
    """Return the transcript of a case, with its computing time and the number of lines typed.

    Args:
        name: of one of `CASES`.
    """
    case, start = next(case for case in CASES if case.name == name), time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        lines = transcript(case, Path(folder))
    typed = next(int(line.split()[1]) for line in lines if line.startswith("Typed, "))
    return {"lines": lines, "typed": typed, "seconds": time.perf_counter() - start}


def section(results: list[dict[str, Any]]) -> list[str]:
    """Return the section of a page with the transcripts.

    Args:
        results: as `record_transcript` returns them.
    """
    transcripts = [each for each in results if "lines" in each]
    if not transcripts:
        return []
    typed = ", ".join(f"{each['typed']} lines of JSON typed and {each['seconds']:.0f} s of computing" for each in transcripts)
    about = f"From a public URDF of example-robot-data to the first held object: {typed}. Required: 30 lines and 10 min."
    lines = [line.replace("## ", "### ", 1) for each in transcripts for line in each["lines"]]
    return ["## Your own hand", about, "\n".join(lines).strip()]


def _run(folder: Path, *arguments: str) -> list[str]:
    """Run a command of graspforce; return its lines with the exit code."""
    done = subprocess.run(
        [sys.executable, "-m", "graspforce", *arguments], cwd=folder, capture_output=True, text=True, timeout=600, check=False
    )
    shown = [Path(word).name if word.endswith(".urdf") else word for word in arguments]
    output = [line.rstrip() for line in done.stdout.splitlines() if "━━━" not in line or "metric" in line]
    errors = [line.rstrip() for line in done.stderr.splitlines() if line.strip() and "━" not in line]
    return ["```text", f"$ graspforce {' '.join(shown)}", *output, *errors, f"(exit code {done.returncode})", "```", ""]


def main() -> None:
    """Run both cases, print the transcript, and write the page."""
    options = parser("own_hand", __doc__).parse_args()
    page = [
        "# From a public URDF to a held object",
        "",
        "`python -m benchmarks.own_hand --save FILE`, with example-robot-data.",
        "",
    ]
    with tempfile.TemporaryDirectory() as folder:
        for case in CASES:
            page += transcript(case, Path(folder))
    print("\n".join(page))
    if options.save:
        options.save.write_text("\n".join(page))


if __name__ == "__main__":
    main()
