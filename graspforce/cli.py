"""The command ``graspforce``: solve problem files, look at cases and hands, race solvers, serve, plan and simulate.

Exit codes: 0 an answer, 2 a proof that there is none, 1 an error (also a wrong command line). Errors are one line on stderr,
in the words of the Python exception. Rooms that take long to import are imported by the command that needs them.
"""

from __future__ import annotations

import dataclasses
import importlib.util
import io
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

import graspforce
from graspforce.errors import GraspForceError, InvalidInput
from graspforce.json_text import decode
from graspforce.problem import Cone, ForceProblem
from graspforce.solution import Solution, Status

INFEASIBLE = 2
_USAGE: Any = typer.BadParameter.__mro__[1]  # UsageError, which Typer raises on a wrong command line and does not export

app = typer.Typer(
    help="Fingertip forces inside their friction cones with least motor torque, certified.",
    epilog="Example: graspforce problems show ring/3-force | graspforce solve -",
    invoke_without_command=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
problems_app = typer.Typer(help="The force problems with known answers that ship.", epilog="Example: graspforce problems")
hands_app = typer.Typer(help="The hands that ship, and a check of hand models.", epilog="Example: graspforce hands")
app.add_typer(problems_app, name="problems", invoke_without_command=True)
app.add_typer(hands_app, name="hands", invoke_without_command=True)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    Args:
        arguments: what follows the command's name; by default what the shell gave.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal without μ shows ? rather than a traceback
    try:
        code = app(args=arguments, prog_name="graspforce", standalone_mode=False)
    except _USAGE as error:
        return _error(f"{error.format_message()} (graspforce --help lists what there is)")
    except GraspForceError as error:
        return _error(str(error))
    return code if isinstance(code, int) else 0


def _error(message: str) -> int:
    print(f"Error: {message}", file=sys.stderr)
    return 1


def _print(report: object) -> None:
    """Print a table or text, in colour where the output is a terminal; what files say is not taken for markup."""
    from rich.console import Console

    Console(highlight=False, markup=False, emoji=False).print(report)


def _version(asked: bool) -> None:
    if asked:
        print(f"graspforce {graspforce.__version__}")
        raise typer.Exit


@app.callback()
def _top(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Say the version and stop.")
    ] = False,
) -> None:
    """Fingertip forces inside their friction cones with least motor torque, certified."""
    if context.invoked_subcommand is None:
        print(context.get_help())


# ── solve ──────────────────────────────────────────────────────────────────────────────────────────────────────────────────


@app.command(epilog="Example: graspforce solve problem.json --cone inner:8 --backend proxqp")
def solve(
    file: Annotated[str, typer.Argument(metavar="FILE", help="A problem file, or - for standard input.")],
    backend: Annotated[str | None, typer.Option(metavar="NAME", help="A solver of `graspforce backends`.")] = None,
    cone: Annotated[
        str | None, typer.Option(metavar="CONE", help="exact, inner:FACETS or outer:FACETS instead of the file's own.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the answer's record and nothing else.")] = False,
) -> None:
    """Solve a problem file: forces, torques and the proof, or why there are none.

    Exit code 0: an answer. 2: a proof that there is none. 1: an error, or no answer of either kind.
    """
    problem = graspforce.load(file) if file != "-" else ForceProblem.from_dict(decode(sys.stdin.buffer.read()))
    if cone is not None:
        problem = dataclasses.replace(problem, cone=_cone(cone))
    answer = graspforce.solve(problem, backend)
    if as_json:
        print(json.dumps(answer.to_dict()))
    else:
        from graspforce.report import solution_report

        _print(solution_report(problem, answer))
    raise typer.Exit(_verdict(answer))


def _cone(text: str) -> Cone:
    """exact, inner:8, outer:16."""
    if text == "exact":
        return Cone()
    side, _, facets = text.partition(":")
    if side not in ("inner", "outer") or not facets.isdecimal():
        raise InvalidInput("cone", text, "exact, inner:FACETS or outer:FACETS")
    try:
        return Cone("pyramid", int(facets), side)
    except InvalidInput as error:
        raise error.inside("cone") from None


def _verdict(answer: Solution) -> int:
    """The exit code of an answer; what is less than proven is said on stderr too."""
    if answer.status is Status.INFEASIBLE:
        return INFEASIBLE
    if answer.status is Status.FAILED:
        return _error(answer.status.sentence)
    if answer.status is Status.INACCURATE:
        print(f"Warning: {answer.status.sentence}", file=sys.stderr)
    return 0


@app.command(epilog="Example: graspforce backends")
def backends() -> None:
    """List the solvers found here, and what each does with a small problem of either kind of cone."""
    from rich.table import Table

    from graspforce import problems

    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("solver")
    for kind in ("exact cones", "pyramids"):
        table.add_column(kind)
    for name in graspforce.solvers():
        tried = (_try(name, problems.load(case).problem) for case in ("ring/3-force", "ring/3-inner-8"))
        table.add_row(name, *tried)
    _print(table)


def _try(backend: str, problem: ForceProblem) -> str:
    try:
        answer = graspforce.solve(problem, backend)
    except GraspForceError:
        return "no"
    return "yes, verified" if answer.backend == backend else f"not verified: {answer.backend} answered instead"


# ── problems ───────────────────────────────────────────────────────────────────────────────────────────────────────────────


@problems_app.callback()
def _problems(context: typer.Context) -> None:
    """Name the collections of force problems with known answers; `list` lists cases, `show` prints one, `verify` checks all."""
    if context.invoked_subcommand is None:
        from graspforce import problems
        from graspforce.report import collection_list

        _print(collection_list([(name, len(problems.names(name)), problems.about(name)) for name in problems.collections()]))


@problems_app.command("list", epilog="Example: graspforce problems list nose-cone")
def list_problems(
    collection: Annotated[
        str | None, typer.Argument(metavar="COLLECTION", help="A collection, or textbook for all derived ones; all by default.")
    ] = None,
) -> None:
    """List cases: contacts, objective, cone, the known answer and the source."""
    from graspforce import problems
    from graspforce.report import case_list

    _print(case_list([problems.load(name) for name in problems.names(collection)]))


@problems_app.command("show", epilog="Example: graspforce problems show opposed/torque-limit | graspforce solve -")
def show_problem(name: Annotated[str, typer.Argument(metavar="NAME", help="A name of `graspforce problems list`.")]) -> None:
    """Print a case file: the problem as JSON, with its known answer."""
    from graspforce import problems

    print(problems.text(name), end="")


@problems_app.command("verify", epilog="Example: graspforce problems verify hard soft")
def verify_problems(
    collection: Annotated[
        list[str] | None, typer.Argument(metavar="[COLLECTION]...", help="Collections to check; all by default.")
    ] = None,
) -> None:
    """Find every optimum again and certify it, and check every proof by the law. Exit code 1 where something does not hold."""
    from rich.progress import track

    from graspforce import problems
    from graspforce.bench.verify import tallies, verify
    from graspforce.report import tally_table

    names = [name for one in collection or problems.collections() for name in problems.names(one)]
    console = _progress_console()
    checks = [verify(problems.load(name)) for name in track(names, "Verifying", console=console, transient=True)]
    found = list(tallies(checks))
    _print(tally_table(found))
    raise typer.Exit(int(any(tally.failed for tally in found)))


def _progress_console() -> Any:
    """Where progress is shown: standard error, so that what is piped stays clean."""
    from rich.console import Console

    return Console(stderr=True)


# ── bench ──────────────────────────────────────────────────────────────────────────────────────────────────────────────────


@app.command(epilog="Example: graspforce bench --collection textbook --solver clarabel --solver proxqp")
def bench(
    collection: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="A collection of `graspforce problems`; again for more.")
    ] = None,
    solver: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="A solver, or a module that holds one; again for more.")
    ] = None,
    settings: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="default, high or low accuracy; again for more.")
    ] = None,
    units: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="scaled (by default) or si: nothing scaled; again for both.")
    ] = None,
    most: Annotated[int, typer.Option(metavar="N", help="Cases of a collection at most, evenly through it; 0 for all.")] = 40,
    limit: Annotated[float, typer.Option(metavar="SECONDS", help="When a solver that does not end is ended.")] = 2.0,
    save: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Where outcomes go, one a line; what it holds already is not run again.")
    ] = None,
    compare: Annotated[Path | None, typer.Option(metavar="FILE", help="Another race's outcomes, to say what differs.")] = None,
    report: Annotated[Path | None, typer.Option(metavar="FOLDER", help="Where report.md and its figures go.")] = None,
) -> None:
    """Race solvers on force problems with known answers; the certificate, not the solver, says which answers count."""
    from graspforce.bench import race
    from graspforce.bench.outcome import load
    from graspforce.report import difference_table, race_tables

    planned = race.plan(solver or (), settings or (), units or (), collection or (), most, limit)
    before = None if compare is None else load(compare)[1]
    facts, outcomes = _race(planned, save)
    for table in race_tables(outcomes, limit):
        _print(table)
    if before is not None:
        _print(difference_table(before, outcomes))
    if report is not None:
        from graspforce.bench.page import write

        options = [("collection", collection), ("solver", solver), ("settings", settings), ("units", units)]
        given = [f"--{name} {value}" for name, values in options for value in values or ()]
        command = " ".join(["graspforce bench", *given, f"--most {most} --limit {limit:g} --report {report}"])
        print(f"written to {write(report, facts, outcomes, command)}")


def _race(planned: Any, save: Path | None) -> Any:
    """Run the race behind a progress bar."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from graspforce.bench import race

    columns = (BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=_progress_console(), transient=True) as bar:
        shown = bar.add_task("", total=None)
        return race.run(planned, save, lambda what, done, of: bar.update(shown, description=what, completed=done, total=of))


# ── hands ──────────────────────────────────────────────────────────────────────────────────────────────────────────────────


@hands_app.callback()
def _hands(context: typer.Context) -> None:
    """List the hands that ship; `show` describes one, `lint` looks for faults in a model."""
    if context.invoked_subcommand is None:
        from graspforce.hands.description import find, read_description, shipped_hands

        for name in shipped_hands():
            print(f"{name:20}{read_description(find(name)).title}")


@hands_app.command("show", epilog="Example: graspforce hands show four_finger")
def show_hand(
    name: Annotated[str, typer.Argument(metavar="NAME", help="A name of `graspforce hands`, or a description file.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print the description record and nothing else.")] = False,
) -> None:
    """Describe a hand: fingers, joints, limits, couplings, and where the numbers come from."""
    from graspforce.hand import Hand

    record = Hand.load(name).describe()
    if as_json:
        print(json.dumps(record))
    else:
        from graspforce.report import hand_report

        _print(hand_report(record))


@hands_app.command(epilog="Example: graspforce hands lint my_hand.urdf")
def lint(
    file: Annotated[str, typer.Argument(metavar="FILE", help="A URDF, a description file, or a shipped hand's name.")],
) -> None:
    """Say what in a hand model would make answers wrong. Exit code 1 where there are errors."""
    from graspforce.hands.lint import lint as faults
    from graspforce.report import findings_report

    findings = faults(file)
    _print(findings_report(findings))
    raise typer.Exit(int(any(finding.severity == "error" for finding in findings)))


# ── serve ──────────────────────────────────────────────────────────────────────────────────────────────────────────────────


@app.command(epilog="Example: graspforce serve --hand allegro_right --listen tcp/0.0.0.0:7447")
def serve(
    config: Annotated[Path | None, typer.Option(metavar="FILE", help="A Zenoh configuration file.")] = None,
    listen: Annotated[
        str | None, typer.Option(metavar="ENDPOINT", help="The Zenoh endpoint to listen on; by default tcp/127.0.0.1:7447.")
    ] = None,
    hand: Annotated[list[str] | None, typer.Option(metavar="NAME", help="A hand to serve; may be given again.")] = None,
) -> None:
    """Serve force problems and hands over Zenoh until Ctrl-C or SIGTERM."""
    from graspforce.service import Server
    from graspforce.service import serve as run

    hands = hand or []

    def ready(server: Server) -> None:
        where = ", ".join(server.addresses)
        print(f"Serving on {where}; hands: {', '.join(hands) or 'none'}. Ctrl-C stops.", flush=True)

    run(hands=hands, config=config, listen=listen, on_ready=ready)


# ── what plan and simulate both ask ───────────────────────────────────────────────────────────────────────────────────────────

Thing = Annotated[
    str, typer.Option("--object", metavar="THING", help="sphere:RADIUS, cylinder:RADIUS,HEIGHT, box:X,Y,Z (m), or a name.")
]
Mass = Annotated[float | None, typer.Option(metavar="KG", help="By default 0.05, or the named object's own.")]
Friction = Annotated[float | None, typer.Option(metavar="MU", help="By default 0.7, or the named object's own.")]
Fingers = Annotated[str | None, typer.Option(metavar="A,B,C", help="Which touch; by default the best few.")]
Gravity = Annotated[str, typer.Option(metavar="X,Y,Z", help="In the hand's base frame, m/s².")]
Seed = Annotated[int, typer.Option(metavar="N", help="Of the search for a hold.")]
HandName = Annotated[str, typer.Option(metavar="NAME", help="A hand of `graspforce hands`, or a description file.")]


# ── plan ───────────────────────────────────────────────────────────────────────────────────────────────────────────────────


@app.command(epilog="Example: graspforce plan --hand dlr_hit2 --to=-0.005,0,0.005 --turn 0.1,0,0.1 --plots out --execute")
def plan(
    hand: HandName = "allegro_right",
    thing: Thing = "sphere:0.03",
    to: Annotated[str, typer.Option(metavar="DX,DY,DZ", help="How far the object goes, in the hand's base, m.")] = "0,0,0",
    turn: Annotated[str, typer.Option(metavar="RX,RY,RZ", help="How it turns: rotation vector, rad.")] = "0,0,0",
    method: Annotated[str, typer.Option(metavar="NAME", help="path: the straight line. free: any way.")] = "path",
    mass: Mass = None,
    friction: Friction = None,
    fingers: Fingers = None,
    gravity: Gravity = "0,0,-9.81",
    intervals: Annotated[int | None, typer.Option(metavar="N", help="Between knots; by default 100, free 40.")] = None,
    budget: Annotated[float, typer.Option(metavar="SECONDS", help="For planning; then the best plan so far is taken.")] = 30.0,
    connect: Annotated[str | None, typer.Option(metavar="ENDPOINT", help="Plan in the service at this endpoint.")] = None,
    margin: Annotated[float, typer.Option(metavar="N", help="Friction kept back at every contact, N.")] = 1.0,
    reserve: Annotated[float, typer.Option(metavar="PART", help="Of motor torque, left to the controller.")] = 0.1,
    seed: Seed = 0,
    save: Annotated[Path | None, typer.Option(metavar="FILE", help="Write the plan: .json, .csv or .npz.")] = None,
    plots: Annotated[Path | None, typer.Option(metavar="DIR", help="Draw speed and limits, torques, forces in cones.")] = None,
    execute: Annotated[bool, typer.Option("--execute", help="Follow it in MuJoCo, under the controller.")] = False,
) -> None:
    """Plan the fastest move of a held object, checked between its knots, and say what limits it where.

    Ctrl-C stops the search and takes the best plan so far; a second one ends the command.

    Exit code 0: a plan (executed: the object arrived and nothing slipped). 2: a reason why there is none. 1: an error, no
    answer of either kind, or an executed move that slipped or missed its goal.
    """
    if execute and importlib.util.find_spec("mujoco") is None:
        raise typer.Exit(_error("the simulation needs MuJoCo: pip install 'graspforce[sim]'"))
    from rich.console import Console

    from graspforce import planned_move
    from graspforce.options import vector

    wish = planned_move.Wish(
        hand=hand,
        thing=thing,
        mass=mass,
        friction=friction,
        fingers=None if fingers is None else tuple(fingers.split(",")),
        gravity=vector(gravity, "gravity"),
        to=vector(to, "to"),
        turn=vector(turn, "turn"),
        method=method,
        intervals=intervals,
        budget=budget,
        slip_margin=margin,
        reserve=reserve,
        seed=seed,
    )
    output = planned_move.Output(save=save, plots=plots, execute=execute)
    raise typer.Exit(planned_move.run(wish, output, Console(highlight=False), connect))


# ── simulate ───────────────────────────────────────────────────────────────────────────────────────────────────────────────


@app.command(epilog="Example: graspforce simulate --hand four_finger --reference turn --travel 0,0,0.2 --video turn.mp4")
def simulate(
    hand: HandName = "four_finger",
    thing: Thing = "sphere:0.03",
    mass: Mass = None,
    friction: Friction = None,
    fingers: Fingers = None,
    gravity: Gravity = "0,0,-9.81",
    reference: Annotated[str, typer.Option(metavar="KIND", help="still, reach (out and back), sine or turn.")] = "reach",
    travel: Annotated[str, typer.Option(metavar="X,Y,Z", help="End to end, m; a turn: rotation vector, rad.")] = "0,0,0.01",
    period: Annotated[float, typer.Option(metavar="S", help="Of the motion.")] = 1.0,
    duration: Annotated[float, typer.Option(metavar="S", help="How long to simulate.")] = 2.0,
    push: Annotated[
        list[str] | None, typer.Option(metavar="FX,FY,FZ,START,DURATION", help="N and s; may be given again.")
    ] = None,
    seed: Seed = 0,
    connect: Annotated[
        str | None, typer.Option(metavar="ENDPOINT", help="Control from the service at this Zenoh endpoint.")
    ] = None,
    serve: Annotated[bool, typer.Option("--serve", help="Control from a service that is started for this.")] = False,
    pace: Annotated[
        str, typer.Option(metavar="KIND", help="With a service: lockstep (wait for each command) or real (1 kHz by the clock).")
    ] = "lockstep",
    tips: Annotated[
        str, typer.Option(metavar="KIND", help="ball, as the controller has it, or mesh: the hull of the hand's own.")
    ] = "ball",
    meshes: Annotated[
        list[Path] | None, typer.Option(metavar="DIR", help="Where the hand's meshes are looked for; may be given again.")
    ] = None,
    view: Annotated[bool, typer.Option("--view", help="Open MuJoCo's viewer; needs a display.")] = False,
    video: Annotated[Path | None, typer.Option(metavar="FILE", help="Write a film, .mp4 or .gif; needs no display.")] = None,
    frames: Annotated[Path | None, typer.Option(metavar="DIR", help="Write the film's pictures as PNG.")] = None,
    save: Annotated[Path | None, typer.Option(metavar="FILE", help="Write everything, step by step, as .npz.")] = None,
    plots: Annotated[Path | None, typer.Option(metavar="DIR", help="Draw errors, forces and torques as PNG.")] = None,
) -> None:
    """Hold an object in MuJoCo and move it, in closed loop at 1 kHz. Exit code 1: a finger let go, or a force left its cone."""
    if importlib.util.find_spec("mujoco") is None:
        raise typer.Exit(_error("the simulation needs MuJoCo: pip install 'graspforce[sim]'"))
    from rich.console import Console

    from graspforce import closed_loop
    from graspforce.options import vector

    wish = closed_loop.Wish(
        hand=hand,
        thing=thing,
        mass=mass,
        friction=friction,
        fingers=None if fingers is None else tuple(fingers.split(",")),
        gravity=vector(gravity, "gravity"),
        reference=reference,
        travel=vector(travel, "travel"),
        period=period,
        duration=duration,
        pushes=tuple(vector(text, "push", 5) for text in push or []),
        seed=seed,
        tips=tips,
        meshes=tuple(meshes or ()),
    )
    output = closed_loop.Output(view=view, video=video, frames=frames, save=save, plots=plots)
    if serve and connect is not None:
        raise InvalidInput("--connect", connect, "left out with --serve, which starts a service of its own")
    service = closed_loop.Service(connect, pace) if serve or connect is not None else None
    raise typer.Exit(0 if closed_loop.run(wish, output, Console(highlight=False), service) else 1)


# ── demo ───────────────────────────────────────────────────────────────────────────────────────────────────────────────────


@app.command(epilog="Example: graspforce demo --steps 200 --out carry.png")
def demo(
    steps: Annotated[int, typer.Option(metavar="N", help="Instants along the path, one query each.")] = 500,
    out: Annotated[Path, typer.Option(metavar="FILE", help="Where the picture goes.")] = Path("out/carry.png"),
) -> None:
    """Start a service, carry a box with the four-finger hand, one query a step; show a table and a picture of the forces."""
    from rich.console import Console

    from graspforce.demo import run

    raise typer.Exit(0 if run(steps, out, Console(highlight=False)) else 1)
