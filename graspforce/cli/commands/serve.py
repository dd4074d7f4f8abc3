"""``graspforce serve`` and ``graspforce demo``: run the service, and show it with a client."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from graspforce.cli.commands.output_arguments import AsJson, Force
from graspforce.cli.completions import complete_hand

if TYPE_CHECKING:
    from graspforce.service import Server

app = typer.Typer()


@app.command(epilog="Example: graspforce serve --hand allegro_right --listen tcp/127.0.0.1:7451")
def serve(
    config: Annotated[Path | None, typer.Option(metavar="FILE", help="Zenoh configuration file.")] = None,
    listen: Annotated[
        str | None, typer.Option(metavar="ENDPOINT", help="Zenoh endpoint to listen on (default: tcp/127.0.0.1:7450).")
    ] = None,
    connect: Annotated[
        list[str] | None,
        typer.Option(metavar="ENDPOINT", help="Zenoh router to join, such as tcp/127.0.0.1:7447 of ROS 2; repeatable."),
    ] = None,
    hand: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME", help="Hand to serve: a name or a description file; repeatable.", autocompletion=complete_hand
        ),
    ] = None,
    watch: Annotated[
        bool, typer.Option("--watch", help="Read the description files of --hand again when they change; open streams go on.")
    ] = False,
    insecure: Annotated[
        bool,
        typer.Option("--insecure", help="Listen beyond this machine without TLS: anybody there can drive the hands."),
    ] = False,
    secure: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Directory of `graspforce secure init`: TLS, and access by role.")
    ] = None,
    log_level: Annotated[
        str, typer.Option(metavar="LEVEL", help="Lowest level of the log: debug, info, warning or error.")
    ] = "warning",
    log_format: Annotated[str, typer.Option(metavar="FORMAT", help="Format of the log: text or json.")] = "text",
    metrics: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="HOST:PORT of metrics and health over HTTP (extra `metrics`).")
    ] = None,
    workers: Annotated[int, typer.Option(metavar="N", min=1, help="Number of workers for small requests.")] = 2,
    large_workers: Annotated[
        int, typer.Option(metavar="N", min=1, help="Number of workers for large problems and explanations.")
    ] = 1,
    worker_processes: Annotated[
        bool,
        typer.Option(
            "--worker-processes/--worker-threads", help="Workers as processes, so that requests do not delay streams."
        ),
    ] = True,
    realtime: Annotated[
        int | None,
        typer.Option(metavar="PRIORITY", min=1, max=49, help="Highest real-time priority of the server, such as 10 (Linux)."),
    ] = None,
    lease: Annotated[
        float | None,
        typer.Option(metavar="SECONDS", help="Silence after which another replica takes over (default with --connect: 0.5)."),
    ] = None,
    limit: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=VALUE", help="Limit of `ServerLimits`, such as streams=8 or idle_timeout=5; repeatable."),
    ] = None,
    ros2: Annotated[
        str | None,
        typer.Option(
            metavar="ENDPOINT", help="Zenoh router of ROS 2, such as tcp/127.0.0.1:7447: show a grasp there (extra `ros2`)."
        ),
    ] = None,
    grasp: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Grasp of the node of ROS 2, saved by `graspforce grasp --save`.")
    ] = None,
    ros2_setting: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=VALUE", help="Setting of the node, such as rate=500 or namespace=/left; repeatable."),
    ] = None,
    record: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Record requests, states and replies as .mcap, for `graspforce replay`."),
    ] = None,
    view: Annotated[
        str | None,
        typer.Option(metavar="KIND", help="Show the streams beside the server: browser (a web page, in a process of its own)."),
    ] = None,
    force: Force = False,
    print_config: Annotated[
        bool, typer.Option("--print-config", help="Print the Zenoh configuration with all defaults, and stop.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Serve force problems and hands over Zenoh until Ctrl-C, SIGTERM or SIGHUP."""
    from graspforce.service import ServeOptions, Server, run_server
    from graspforce.service.server.limits import read_limits

    if print_config:
        from graspforce.service.server.configuration import server_configuration
        from graspforce.service.zenoh_session import show_configuration

        print(show_configuration(server_configuration(config, listen, secure, connect or (), lease)))
        return
    from graspforce.cli.output_files import check_new_file
    from graspforce.core.errors import InvalidInput
    from graspforce.service.server.log_format import configure_logging

    check_new_file(record, "--record", force)
    if ros2 is None:
        for option, value in (("--grasp", grasp), ("--ros2-setting", ros2_setting)):
            if value:
                raise InvalidInput(option, str(value), "given with --ros2 only")
    if record is not None:
        record.parent.mkdir(parents=True, exist_ok=True)
    configure_logging(log_level, log_format)
    hands = hand or []
    attach = None if ros2 is None else _ros2_node(ros2, grasp, ros2_setting or (), hands, insecure)
    if view is not None:
        attach = _with_view(view, attach, hands, secure)

    def ready(server: Server) -> None:
        if as_json:
            print(json.dumps({"addresses": server.addresses, "hands": hands, "connect": connect or []}), flush=True)
            return
        routers = [*(connect or ()), *([] if ros2 is None else [ros2])]
        where = ", ".join(server.addresses) + (f", and at the router {', '.join(routers)}" if routers else "")
        print(f"Serving on {where}; hands: {', '.join(hands) or 'none'}. Ctrl-C stops.", flush=True)

    server = Server(
        hands,
        listen=listen,
        config=config,
        solver_threads=workers,
        large_threads=large_workers,
        limits=read_limits(limit or ()),
        insecure=insecure,
        secure=secure,
        connect=connect or (),
        worker_processes=worker_processes,
        lease=lease,
        record=record,
        realtime=realtime,
    )
    run_server(
        server, ServeOptions(on_ready=ready, metrics=metrics, attach=attach, watch=hands if watch else (), end_process=True)
    )


def _with_view(
    view: str, attach: Callable[[Server], AbstractContextManager[object]] | None, hands: Sequence[str], secure: Path | None
) -> Callable[[Server], AbstractContextManager[object]]:
    """Return the function that opens the view of a server's streams, and another context, beside it.

    Raises:
        InvalidInput: another kind of view.
        MissingLibrary: a library of the view is not installed.
    """
    from graspforce.cli.view_process import view_process
    from graspforce.core import fields
    from graspforce.core.optional_libraries import require_libraries

    fields.check_choice(view, "--view", ("browser",))
    require_libraries("mujoco", "viser")

    def attach_both(server: Server) -> AbstractContextManager[object]:
        opened = ExitStack()
        opened.enter_context(view_process(server.addresses[0], hands, secure))
        if attach is not None:
            opened.enter_context(attach(server))
        return opened

    return attach_both


def _ros2_node(
    router: str, file: Path | None, settings: Sequence[str], hands: Sequence[str], insecure: bool
) -> Callable[[Server], AbstractContextManager[object]]:
    """Return the function that opens the node of a grasp beside a server.

    Raises:
        InvalidInput: the file is no grasp, a setting is not allowed, or the server does not serve the hand.
    """
    from graspforce.core.errors import InvalidInput
    from graspforce.grasp.grasp import Grasp
    from graspforce.hand.hand import Hand
    from graspforce.service.ros2.grasp_node import GraspNode
    from graspforce.service.ros2.hold_control import HoldControl
    from graspforce.service.ros2.node_settings import read_settings

    if file is None:
        raise InvalidInput("--grasp", None, "a file that `graspforce grasp --save` wrote, with --ros2")
    if len(hands) != 1:
        raise InvalidInput("--hand", list(hands), "one hand, with --ros2")
    node, hold = read_settings(settings, insecure)
    control = HoldControl(Grasp.load(file, Hand.load(hands[0])), hold)
    return lambda server: GraspNode(control, server.begin_plan, node, router, server.priorities)


@app.command(epilog="Example: graspforce demo --steps 200 --plot carry.png")
def demo(
    steps: Annotated[int, typer.Option(metavar="N", help="Number of instants along the path, one query each.")] = 500,
    plot: Annotated[Path, typer.Option(metavar="PNG", help="File of the picture.")] = Path("out/carry.png"),
    as_json: AsJson = False,
) -> None:
    """Start a service, carry a box with the four-finger hand, and show the forces as a table and a picture."""

    from graspforce.cli.json_output import result_console
    from graspforce.cli.run_demo import run

    raise typer.Exit(0 if run(steps, plot, result_console(as_json)) else 1)
