"""``graspforce hands``: list and show hands, describe a new one, check hand models, and identify friction."""

from __future__ import annotations

import dataclasses
import io
import json
import sys
from typing import Annotated

import typer

from graspforce.cli.commands.output_arguments import AsJson, Force
from graspforce.cli.completions import complete_hand
from graspforce.cli.console import print_report
from graspforce.cli.output_files import check_new_file

app = typer.Typer()
hands_app = typer.Typer(
    help="List, show and describe hands, check models, identify friction.", epilog="Example: graspforce hands"
)
app.add_typer(hands_app, name="hands", invoke_without_command=True)


@hands_app.callback()
def _hands(context: typer.Context, as_json: AsJson = False) -> None:
    """List the hands that ship. `new` describes your own; `show`, `lint` and `identify` serve one hand."""
    if context.invoked_subcommand is None:
        from graspforce.hand.descriptions.description import find, read_description, shipped_hands

        titles = {name: read_description(find(name)).title for name in shipped_hands()}
        if as_json:
            print(json.dumps({"hands": [{"name": name, "title": title} for name, title in titles.items()]}))
        else:
            for name, title in titles.items():
                print(f"{name:20}{title}")


@hands_app.command("show", epilog="Example: graspforce hands show four_finger")
def show_hand(
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME", help="A name of `graspforce hands`, or a description file.", autocompletion=complete_hand
        ),
    ],
    as_json: AsJson = False,
) -> None:
    """Describe a hand: fingers, joints, limits, couplings and sources."""
    from graspforce.hand.hand import Hand

    record = Hand.load(name).describe()
    if as_json:
        print(json.dumps(record))
    else:
        from graspforce.cli.hand_tables import hand_report

        print_report(hand_report(record))


@hands_app.command(epilog="Example: graspforce hands lint my_hand.urdf")
def lint(
    file: Annotated[str, typer.Argument(metavar="FILE", help="A URDF, a description file, or a shipped hand's name.")],
    samples: Annotated[
        int, typer.Option(metavar="N", help="Random postures to check for collisions of links; 0 for none.")
    ] = 300,
    seed: Annotated[int, typer.Option(metavar="N", help="Seed of the postures.")] = 0,
    as_json: AsJson = False,
) -> None:
    """Check a hand model for physically impossible values, and show their effect. Exit code 1: errors were found."""
    from graspforce.cli.hand_tables import findings_report
    from graspforce.hand.hand import Hand
    from graspforce.hand.lint.lint_hand import lint_hand
    from graspforce.hand.lint.posture_checks import check_postures

    findings = lint_hand(file)
    is_loadable = not file.endswith(".urdf") and not any(finding.severity == "error" for finding in findings)
    if samples > 0 and is_loadable:
        findings += check_postures(Hand.load(file), samples, seed)
    if as_json:
        print(json.dumps({"findings": [dataclasses.asdict(finding) for finding in findings]}))
    else:
        print_report(findings_report(findings))
    raise typer.Exit(int(any(finding.severity == "error" for finding in findings)))


@hands_app.command(epilog="Example: graspforce hands new my_hand.urdf")
def new(
    model: Annotated[str, typer.Argument(metavar="URDF", help="URDF of the hand, or of a robot with a hand.")],
    output: Annotated[
        str | None,
        typer.Option("--out", "-o", metavar="PATH", help="Description to write (default: beside the URDF, .json)."),
    ] = None,
    base: Annotated[
        str | None, typer.Option(metavar="LINK", help="Link that is the base of the hand (default: the root of the URDF).")
    ] = None,
    density: Annotated[float, typer.Option(metavar="DENSITY", help="Density of links without mass (kg/m³).")] = 1500.0,
    meshes: Annotated[list[str] | None, typer.Option(metavar="DIR", help="Folder of mesh packages; repeatable.")] = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Write a description of your own hand from its URDF: fingertips, couplings, missing inertias, motors to fill in."""
    from pathlib import Path

    from graspforce.cli.hand_tables import findings_report, new_hand_report
    from graspforce.hand.authoring import AuthoringOptions, describe_urdf
    from graspforce.hand.lint.lint_hand import lint_hand

    target = Path(model).with_suffix(".json") if output is None else Path(output)
    check_new_file(target, "--out", force)
    described = describe_urdf(model, target, AuthoringOptions(base, density, tuple(meshes or ())))
    described.write(target, replace=force)
    findings = lint_hand(target)
    if as_json:
        print(json.dumps({"file": str(target), "findings": [dataclasses.asdict(finding) for finding in findings]}))
    else:
        print_report(new_hand_report(described, str(target)))
        print_report(findings_report(findings))


@hands_app.command(epilog="Example: graspforce hands reach dlr_hit2 --plots reach")
def reach(
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME", help="A name of `graspforce hands`, or a description file.", autocompletion=complete_hand
        ),
    ],
    samples: Annotated[int, typer.Option(metavar="N", help="Random postures of each finger.")] = 20_000,
    seed: Annotated[int, typer.Option(metavar="N", help="Seed of the postures.")] = 0,
    plots: Annotated[
        str | None, typer.Option(metavar="DIR", help="Write workspace.png and mobility_FINGER.png into a new folder.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Measure where the fingertips can be, and how well they move there."""
    from pathlib import Path

    from graspforce.cli.hand_tables import reach_report
    from graspforce.cli.output_files import check_new_folder
    from graspforce.hand.hand import Hand
    from graspforce.hand.workspace import sample_workspace, sweep_joints

    folder = None if plots is None else Path(plots)
    check_new_folder(folder, "--plots")
    hand = Hand.load(name)
    workspaces = [sample_workspace(hand, finger.name, samples, seed) for finger in hand.fingers]
    sweeps = [sweep_joints(hand, finger.name) for finger in hand.fingers]
    if as_json:
        print(json.dumps({"hand": hand.name, "samples": samples, "fingers": [each.to_dict() for each in workspaces]}))
    else:
        print_report(reach_report(hand, workspaces, sweeps))
    if folder is not None:
        from graspforce.view.hand_plots import save_hand_plots

        written = save_hand_plots(hand, workspaces, sweeps, folder)
        print(f"wrote {len(written)} plots to {plots}", file=sys.stderr)


@hands_app.command(epilog="Example: graspforce hands codegen allegro_right --out build/hand")
def codegen(
    name: Annotated[str, typer.Argument(metavar="NAME", help="A name of `graspforce hands`, or a description file.")],
    out: Annotated[str, typer.Option("--out", metavar="PATH", help="Folder of the files; made if it is missing.")],
    prefix: Annotated[
        str | None, typer.Option("--prefix", metavar="NAME", help="Name of the hand in C (default: that of its description).")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Write a hand as C source: kinematics, dynamics, couplings and limits for control without Python."""
    from pathlib import Path

    from graspforce.hand.hand import Hand
    from graspforce.hand.model_source import write_hand_source

    hand, folder = Hand.load(name), Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    written = [str(path) for path in write_hand_source(hand, folder, prefix)]
    print(json.dumps({"files": written}) if as_json else "\n".join(written))


@hands_app.command(epilog="Example: graspforce hands schema > hand.json")
def schema() -> None:
    """Print the JSON Schema of description files, for editors that complete and check them."""
    from graspforce.hand.descriptions.description_schema import description_schema

    print(json.dumps(description_schema(), indent=2, ensure_ascii=False))


@hands_app.command(epilog="Example: graspforce hands identify my_hand.json motion.csv")
def identify(
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME", help="A name of `graspforce hands`, or a description file.", autocompletion=complete_hand
        ),
    ],
    recording: Annotated[
        str,
        typer.Argument(metavar="FILE", help="Recording of a free motion (.npz or .csv: t, q, tau, v); - for a stream of CSV."),
    ],
    gravity: Annotated[str, typer.Option(metavar="X,Y,Z", help="Gravity in the hand's frame (m/s²).")] = "0,0,-9.81",
    slowest_rate: Annotated[float, typer.Option(metavar="RATE", help="Ignore slower samples (rad/s).")] = 0.05,
    window: Annotated[float, typer.Option(metavar="TIME", help="Length of the smoothing filter (s).")] = 0.05,
    as_json: AsJson = False,
) -> None:
    """Identify the friction of the joints from a recorded motion without contact. Exit code 1: no joint moved enough."""
    from graspforce.cli.options import parse_vector
    from graspforce.hand.hand import Hand
    from graspforce.hand.identification.friction_identification import IdentificationSettings, identify_friction
    from graspforce.hand.identification.joint_recording import load_joint_recording, read_joint_recording

    hand = Hand.load(name)
    x, y, z = parse_vector(gravity, "--gravity")
    settings = IdentificationSettings(slowest_rate, window, gravity_H=(x, y, z))
    joints = [joint.name for joint in hand.joints]
    if recording == "-":
        samples = read_joint_recording(io.TextIOWrapper(sys.stdin.buffer, encoding="utf-8", errors="replace"), joints)
    else:
        samples = load_joint_recording(recording, joints)
    identified = identify_friction(hand, samples, settings)
    if as_json:
        print(json.dumps(identified.to_dict()))
    else:
        print(identified)
        entries = identified.description("identified with graspforce hands identify")
        print('\n"friction": ' + json.dumps(entries, indent=2, ensure_ascii=False))
    raise typer.Exit(int(not identified.is_identified.any()))
