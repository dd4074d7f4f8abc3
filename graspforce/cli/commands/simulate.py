"""``graspforce simulate``: simulate a held object in closed loop, in an ideal world or in one as it is."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from graspforce.cli.commands.grasp_arguments import (
    Fingers,
    Friction,
    GraspClassName,
    Gravity,
    HandName,
    Mass,
    ObjectName,
    PadFriction,
    Seed,
)
from graspforce.cli.commands.output_arguments import (
    AsJson,
    FilmCamera,
    FilmFile,
    FilmFrames,
    FilmRate,
    FilmSize,
    Force,
    McapFile,
    RunFile,
    ViewKind,
)
from graspforce.core.errors import InvalidInput
from graspforce.core.optional_libraries import require_libraries

app = typer.Typer()

_WORLD = "The world as it is (a controller from measurements then replaces the one with exact states)"
_CAMPAIGN = "Campaigns"
_FREE = "A hand without an object"


@app.command(epilog="Example: graspforce simulate --hand four_finger --reference turn --travel 0,0,0.2 --video turn.mp4")
def simulate(
    hand: HandName = "four_finger",
    object_name: ObjectName = "sphere:0.03",
    mass: Mass = None,
    friction: Friction = None,
    fingers: Fingers = None,
    gravity: Gravity = "0,0,-9.81",
    reference: Annotated[
        str, typer.Option(metavar="KIND", help="Reference motion: still, reach (out and back), sine or turn.")
    ] = "reach",
    travel: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,Z",
            help="Travel from end to end, m; for turn a rotation vector, rad (default: 10 mm upwards, or as far as the fingers "
            "can move the object; for turn 0,0,0.1).",
        ),
    ] = None,
    period: Annotated[float, typer.Option(metavar="S", help="Period of the reference motion, s.")] = 1.0,
    turn: Annotated[str, typer.Option(metavar="RX,RY,RZ", help="Rotate out and back as well: rotation vector, rad.")] = "0,0,0",
    turn_period: Annotated[float | None, typer.Option(metavar="S", help="Period of --turn, s (default: --period).")] = None,
    duration: Annotated[float, typer.Option(metavar="S", help="Simulated time, s.")] = 2.0,
    push: Annotated[
        list[str] | None,
        typer.Option(metavar="FX,FY,FZ,START,DURATION", help="Force on the object, N, with start and duration, s; repeatable."),
    ] = None,
    seed: Seed = 0,
    grasp_class: GraspClassName = None,
    pad_friction: PadFriction = None,
    drive: Annotated[
        str | None,
        typer.Option(
            metavar="MODE[,NAME=VALUE…]",
            help="Drive of all joints, such as position,stiffness=20,damping=0.1 (default: the hand's).",
        ),
    ] = None,
    connect: Annotated[
        str | None, typer.Option(metavar="ENDPOINT", help="Run the controller in the service at this Zenoh endpoint.")
    ] = None,
    serve: Annotated[bool, typer.Option("--serve", help="Start a service, and run the controller in it.")] = False,
    pace: Annotated[
        str, typer.Option(metavar="KIND", help="Time with a service: lockstep waits for each command; real runs by the clock.")
    ] = "lockstep",
    tips: Annotated[
        str, typer.Option(metavar="KIND", help="Fingertip geometry: ball, or mesh (convex hull of the hand's mesh).")
    ] = "ball",
    meshes: Annotated[
        list[Path] | None, typer.Option(metavar="DIR", help="Directory with the hand's meshes; repeatable.")
    ] = None,
    view: ViewKind = None,
    video: FilmFile = None,
    frames: FilmFrames = None,
    film_size: FilmSize = None,
    fps: FilmRate = None,
    film_camera: FilmCamera = None,
    save: RunFile = None,
    record: McapFile = None,
    plots: Annotated[Path | None, typer.Option(metavar="DIR", help="Write plots of errors, forces and torques as PNG.")] = None,
    world: Annotated[
        str | None,
        typer.Option(metavar="KIND", help="nominal: as told. real: random deviations of everything.", rich_help_panel=_WORLD),
    ] = None,
    world_seed: Annotated[int, typer.Option(metavar="N", help="Seed of the world and of noise.", rich_help_panel=_WORLD)] = 0,
    noise: Annotated[
        str | None,
        typer.Option(
            metavar="NAME=VALUE,…",
            help="Standard deviations: encoder=RAD[:RESOLUTION], velocity=RAD/S, torque=N·m, current=A, tip=N, point=M, "
            "pose=M:RAD. Constant error of the camera: bias=M[:RAD]. A sensor that is named is present.",
            rich_help_panel=_WORLD,
        ),
    ] = None,
    camera: Annotated[
        str | None,
        typer.Option(
            metavar="HZ:S", help="Images per second, and their latency, s (default: every period).", rich_help_panel=_WORLD
        ),
    ] = None,
    camera_lost: Annotated[
        list[str] | None,
        typer.Option(metavar="START:DURATION", help="Time without images, s; repeatable.", rich_help_panel=_WORLD),
    ] = None,
    no_pose: Annotated[
        bool, typer.Option("--no-pose", help="Do not measure the object's pose.", rich_help_panel=_WORLD)
    ] = False,
    rate: Annotated[
        float | None, typer.Option(metavar="HZ", help="Measurements and commands per second.", rich_help_panel=_WORLD)
    ] = None,
    delay: Annotated[
        float | None, typer.Option(metavar="S", help="From a measurement to its torque, s.", rich_help_panel=_WORLD)
    ] = None,
    friction_error: Annotated[
        float | None, typer.Option(metavar="REL", help="True friction: told × (1 + REL).", rich_help_panel=_WORLD)
    ] = None,
    mass_error: Annotated[
        float | None, typer.Option(metavar="REL", help="True mass: told × (1 + REL).", rich_help_panel=_WORLD)
    ] = None,
    centre_error: Annotated[
        str | None, typer.Option(metavar="X,Y,Z", help="Displaced centre of mass, m.", rich_help_panel=_WORLD)
    ] = None,
    contact_error: Annotated[
        str | None,
        typer.Option(metavar="M[:RAD]", help="Displaced fingertips, m, and turned surface, rad.", rich_help_panel=_WORLD),
    ] = None,
    joint_friction: Annotated[
        str | None,
        typer.Option(
            metavar="NM[:SPREAD[:STICTION]]",
            help="Coulomb friction of the joints, N·m; its spread between joints and its surplus at rest as fractions.",
            rich_help_panel=_WORLD,
        ),
    ] = None,
    torque_error: Annotated[
        float | None, typer.Option(metavar="REL", help="Largest error of a motor's torque.", rich_help_panel=_WORLD)
    ] = None,
    stiffness_error: Annotated[
        float | None, typer.Option(metavar="REL", help="Largest error of a drive's stiffness.", rich_help_panel=_WORLD)
    ] = None,
    drive_error: Annotated[
        float | None, typer.Option(metavar="REL", help="Largest error of a drive's delay and losses.", rich_help_panel=_WORLD)
    ] = None,
    pad_torsion: Annotated[
        float | None, typer.Option(metavar="M", help="Torsional friction length of soft pads, m.", rich_help_panel=_WORLD)
    ] = None,
    lose: Annotated[
        list[str] | None,
        typer.Option(metavar="FINGER:S", help="Finger without drives from a time on; repeatable.", rich_help_panel=_WORLD),
    ] = None,
    controller: Annotated[
        str | None,
        typer.Option(
            metavar="KIND",
            help="estimate: with an estimator (default). protected: the same, and no motor overheats. "
            "direct: measurements as they come. exact: full knowledge.",
            rich_help_panel=_WORLD,
        ),
    ] = None,
    assume: Annotated[
        str | None,
        typer.Option(
            metavar="NAME=VALUE,…",
            help="Errors that the controller plans for: friction=PART, mass=PART, contact=RAD, or none "
            "(default for random worlds: friction=0.4,mass=0.5,contact=0.1).",
            rich_help_panel=_WORLD,
        ),
    ] = None,
    plant: Annotated[
        str | None,
        typer.Option(
            metavar="KIND", help="links: from the hand's links (default). urdf: from its URDF.", rich_help_panel=_WORLD
        ),
    ] = None,
    campaign: Annotated[
        int | None,
        typer.Option(metavar="N", help="Simulate N random worlds for each of --hand A,B,…", rich_help_panel=_CAMPAIGN),
    ] = None,
    workers: Annotated[int, typer.Option(metavar="N", help="Number of processes.", rich_help_panel=_CAMPAIGN)] = 1,
    results: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Results as JSON lines; an existing file is continued.", rich_help_panel=_CAMPAIGN),
    ] = None,
    compare: Annotated[
        str,
        typer.Option(metavar="WHEN", help="Run full knowledge too: always, failures or never.", rich_help_panel=_CAMPAIGN),
    ] = "failures",
    free: Annotated[
        bool, typer.Option("--free", help="Move the hand without an object, by a joint-space law.", rich_help_panel=_FREE)
    ] = False,
    law: Annotated[
        str, typer.Option(metavar="LAW", help="computed_torque, pd_gravity or pid.", rich_help_panel=_FREE)
    ] = "computed_torque",
    posture: Annotated[
        str | None,
        typer.Option(metavar="JOINT=RAD,…", help="Goal (default: half-way to the limits).", rich_help_panel=_FREE),
    ] = None,
    rise: Annotated[
        float, typer.Option(metavar="S", help="Time of the way to the goal; 0: a step.", rich_help_panel=_FREE)
    ] = 0.0,
    frequency: Annotated[float, typer.Option(metavar="HZ", help="Natural frequency of the law.", rich_help_panel=_FREE)] = 3.0,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Hold and move an object in MuJoCo, in closed loop at 1 kHz.

    The classes power and lateral hold with inner links and the palm. Motions that such contacts do not allow are refused;
    --reference still only holds the object.

    With exact states by default. Options of the world simulate a real hand: a controller that knows measurements only.

    Exit code 1: a finger lost contact or slipped.

    In a world: the object was not held, or a finger slipped by more than 1 mm.

    In a campaign: a world failed in which a controller with full knowledge holds.

    Without an object: a joint did not settle.
    """
    require_libraries("mujoco")

    from graspforce.cli.json_output import result_console
    from graspforce.cli.run_simulation import service_options

    if free:
        from graspforce.cli import run_free
        from graspforce.cli.options import parse_vector
        from graspforce.cli.output_files import check_new_file

        if view is not None or video is not None or frames is not None or record is not None or pace != "lockstep":
            raise InvalidInput("--free", free, "given without --view, --video, --frames, --record and --pace")
        coulomb = 0.0 if joint_friction is None else parse_vector(joint_friction, "--joint-friction", 1)[0]
        check_new_file(save, "--save", force)
        motion = run_free.FreeOptions(hand, law, posture, rise, frequency, gravity, duration, coulomb)
        service = service_options(connect, serve)
        raise typer.Exit(0 if run_free.run(motion, save, plots, result_console(as_json), service) else 1)

    from graspforce.cli import controllers, run_campaign, run_simulation, run_world
    from graspforce.cli.film_format import parse_film_format
    from graspforce.cli.options import GraspOptions, parse_vector
    from graspforce.cli.simulate_options import SimulateOptions
    from graspforce.cli.world_options import PRESETS, WorldOptions
    from graspforce.core import fields
    from graspforce.grasp.search import GraspSearchOptions

    names = hand.split(",") if campaign is not None else [hand]
    if campaign is not None and grasp_class is not None:
        raise InvalidInput("--class", grasp_class, "absent with --campaign, whose grasps are of any class")
    requirements = GraspSearchOptions(grasp_class=grasp_class, pad_friction=pad_friction)
    options = SimulateOptions(
        grasp=GraspOptions(names[0], object_name, mass, friction, fingers, gravity, seed, drive, requirements),
        reference=reference,
        travel=None if travel is None else parse_vector(travel, "travel"),
        period=period,
        duration=duration,
        pushes=tuple(parse_vector(text, "push", 5) for text in push or []),
        tips=tips,
        meshes=tuple(meshes or ()),
        turn=parse_vector(turn, "turn"),
        turn_period=turn_period,
    )
    output = run_simulation.SimulateOutput(
        view=view,
        video=video,
        frames=frames,
        save=save,
        plots=plots,
        record=record,
        force=force,
        film=parse_film_format(film_size, fps, film_camera),
    )
    service = service_options(connect, serve, pace)
    if pace == "real" and service is None:
        raise InvalidInput("--pace", pace, "given with --serve or --connect only")
    if drive is not None and service is not None:
        raise InvalidInput("--drive", drive, "absent with a service, which has the drives of the hand's description")
    world_options = WorldOptions(
        preset=None if world is None else fields.check_choice(world, "--world", PRESETS),
        seed=world_seed,
        noise=noise,
        camera=camera,
        camera_lost=tuple(camera_lost or ()),
        no_pose=no_pose,
        rate=rate,
        delay=delay,
        friction_error=friction_error,
        mass_error=mass_error,
        centre_error=centre_error,
        contact_error=contact_error,
        joint_friction=joint_friction,
        torque_error=torque_error,
        stiffness_error=stiffness_error,
        drive_error=drive_error,
        pad_torsion=pad_torsion,
        lose=tuple(lose or ()),
    )
    console = result_console(as_json)
    if not (world_options.is_given or controller or plant or assume or campaign is not None):
        raise typer.Exit(0 if run_simulation.run(options, output, console, service) else 1)
    if service is not None:
        raise InvalidInput("--serve", serve, "absent with options of the world, whose controller runs in this process")
    is_real = world_options.preset == "real" or campaign is not None
    default = controllers.REAL_ASSUMPTIONS if is_real else controllers.Assumptions()
    runner = run_world.make_runner_options(controller, plant, assume, default)
    if campaign is None:
        raise typer.Exit(0 if run_world.run(options, world_options, runner, output, console) else 1)
    if view is not None or any(path is not None for path in (video, frames, save, record, plots)):
        raise InvalidInput("--campaign", campaign, "given without --view, --video, --frames, --save, --record and --plots")
    size = run_campaign.CampaignOptions(tuple(names), campaign, workers, results, run_campaign.check_comparison(compare))
    raise typer.Exit(0 if run_campaign.run(options, world_options, runner, size, console) else 1)
