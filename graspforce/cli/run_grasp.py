"""The command ``graspforce grasp``: find a grasp or take it from a file, show what it bears, and write it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from graspforce.cli.json_output import put_result
from graspforce.cli.options import GraspOptions, is_enveloping, parse_vector
from graspforce.cli.output_files import check_new_file, check_new_folder
from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.constants import STANDARD_GRAVITY
from graspforce.core.errors import InvalidInput
from graspforce.force.problem_options import Objective
from graspforce.force.solution import Solution
from graspforce.force.solver import solve
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.link_grasp import LinkGrasp
from graspforce.grasp.posture_files import load_postures
from graspforce.grasp.posture_repair import PostureOptions
from graspforce.grasp.search import GraspSearchOptions, find_grasps
from graspforce.grasp.search.options import GraspSearchProgress

_AXES = "xyz"


@dataclass(frozen=True, slots=True)
class GraspCommandOptions:
    """The grasp that the command's options describe.

    Args:
        grasp: hand, object, fingers, gravity and seed.
        has_gravity: whether gravity was given; otherwise the grasp must bear it in six directions.
        search: requirements and budget of the search.
        count: number of different grasps.
        rank: measure that orders them.
        postures: file of postures to take instead of a search; None for a search.
        root: link whose pose the file states; None for the base.
        repair: largest distance of a posture's fingertip from the surface, m.

    Raises:
        InvalidInput: names the option and the allowed values.
    """

    grasp: GraspOptions
    has_gravity: bool
    search: GraspSearchOptions
    count: int
    rank: str
    postures: Path | None
    root: str | None
    repair: float

    def __post_init__(self) -> None:
        arrays.check_number(self.repair, "--repair", minimum=0.0)

    @property
    def gravities(self) -> Array:
        """(K, 3) load cases in H, m/s²."""
        if self.has_gravity:
            return self.grasp.gravity_H[None]
        return STANDARD_GRAVITY * np.vstack([np.eye(3), -np.eye(3)])

    @property
    def finger_names(self) -> list[str] | None:
        """The fingers to use; None for an automatic choice."""
        return None if self.grasp.fingers is None else self.grasp.fingers.split(",")


@dataclass(frozen=True, slots=True)
class GraspOutput:
    """The files of a run; None for those that are not wanted. With `force`, existing files are replaced.

    Raises:
        InvalidInput: a file or a directory cannot be written.
    """

    save: Path | None
    plots: Path | None
    force: bool = True

    def __post_init__(self) -> None:
        check_new_file(self.save, "--save", self.force)
        check_new_folder(self.plots, "--plots")


def parse_search(
    budget: float | None, grasp_class: str | None, approach: str | None, table: str | None, pad_friction: float | None
) -> GraspSearchOptions:
    """Return the requirements of the search.

    Args:
        budget: time of the search, s; None for no limit.
        grasp_class: name of a class; None for any.
        approach: x, y, z in O in which the palm faces, separated by commas; None for any.
        table: x, y, z in O away from the table, separated by commas; None without a table.
        pad_friction: torsional friction of fingertips whose description states none, m; None for point contacts.

    Raises:
        InvalidInput: a value is not allowed.
    """
    return GraspSearchOptions(
        budget=budget,
        grasp_class=grasp_class,
        approach_O=None if approach is None else parse_vector(approach, "--approach"),
        up_O=None if table is None else parse_vector(table, "--table"),
        pad_friction=pad_friction,
    )


def run(options: GraspCommandOptions, output: GraspOutput, console: Console) -> bool:
    """Find the grasp, show what it bears, and write its files.

    Args:
        options: the grasp.
        output: files.
        console: shows progress and results.

    Returns:
        Whether there is a grasp.

    Raises:
        InvalidInput: no grasp was found, or the file of postures cannot be read.
    """
    grasps = _grasps(options, console)
    found: list[dict[str, object]] = []
    for number, grasp in enumerate(grasps, start=1):
        margins = [solve(grasp.force_problem(g, objective=Objective("margin"))) for g in options.gravities]
        if number == 1:
            console.print(str(grasp), highlight=False)
            least_effort = [solve(grasp.force_problem(g), explain=False) for g in options.gravities]
            console.print(_load_table(options.gravities, margins, least_effort))
        touching = {"links": grasp.links} if isinstance(grasp, LinkGrasp) else {"fingers": grasp.fingers}
        found.append({"grasp": grasp.to_dict(), **touching, "slip_margins": [_margin(each) for each in margins]})
        _write(grasp, min(margins, key=_margin), output, "" if number == 1 else f"_{number}", console)
    put_result(console, {"gravities": options.gravities, "grasps": found})
    return bool(grasps)


def _grasps(options: GraspCommandOptions, console: Console) -> Sequence[Grasp | LinkGrasp]:
    """Return the grasps of the search, or of the file of postures."""
    if options.postures is not None:
        return _from_file(options, options.postures, console)
    if is_enveloping(options.search):
        return [_search_links(options, console)]
    return _search(options, console)


def _search_links(options: GraspCommandOptions, console: Console) -> LinkGrasp:
    """Search a grasp with contacts on inner links or the palm, with a progress bar."""
    if options.count != 1:
        raise InvalidInput("--count", options.count, "1 for this class; other seeds find other grasps")
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("Closing fingers", total=None)

        def on_progress(progress: GraspSearchProgress) -> bool:
            text = f"{progress.tried} candidates, {progress.found} meet all requirements"
            bar.update(task, total=progress.largest, completed=progress.tried, description=text)
            return True

        return options.grasp.search_links(replace(options.search, callback=on_progress), options.gravities)


def _write(grasp: Grasp | LinkGrasp, worst: Solution, output: GraspOutput, suffix: str, console: Console) -> None:
    """Write the files of a grasp."""
    if output.save is not None:
        path = output.save.with_stem(output.save.stem + suffix)
        grasp.save(path)
        console.print(f"Grasp: [bold]{path}[/]", soft_wrap=True)
    if output.plots is not None:
        from graspforce.view.figures import save_figures  # imported here: drawing is slow to import
        from graspforce.view.show import show

        for path in save_figures({f"grasp{suffix}": show(grasp, worst if worst.found else None)}, output.plots):
            console.print(f"Plot: [bold]{path}[/]", soft_wrap=True)


def _search(options: GraspCommandOptions, console: Console) -> list[Grasp]:
    """Search grasps with a progress bar, list them if there are several, and return them, the best first."""
    given = options.grasp
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("Sampling postures", total=None)

        def on_progress(progress: GraspSearchProgress) -> bool:
            text = f"{progress.tried} candidates, {progress.found} meet all requirements"
            bar.update(task, total=progress.largest, completed=progress.tried, description=text)
            return True

        ranked = find_grasps(
            given.hand,
            given.body,
            options.count,
            options.finger_names,
            rank=options.rank,
            friction=given.mu,
            gravity_H=options.gravities,
            seed=given.seed,
            options=replace(options.search, callback=on_progress),
        )
    if options.count > 1:
        table = Table("seed", "fingers", "slip margin", "robustness", "clearance", title=f"{len(ranked)} different grasps")
        for each in ranked:
            m = each.measures
            measures = (f"{m.margin:.2f} N", f"{m.robustness:.3f}", f"{1e3 * m.clearance:.1f} mm")
            table.add_row(str(each.seed), ", ".join(each.grasp.fingers), *measures)
        console.print(table)
    return [each.grasp for each in ranked]


def _from_file(options: GraspCommandOptions, path: Path, console: Console) -> list[Grasp]:
    """Make grasps of the postures of a file, list the refused ones, and return `count` with the largest slip margin."""
    given, grasps, table = options.grasp, list[Grasp](), Table("posture", "result", title=f"postures of {path.name}")
    settings = PostureOptions(repair=options.repair, friction=given.mu)
    for i, each in enumerate(load_postures(path, given.hand, root=options.root)):
        try:
            grasp = Grasp.from_posture(
                given.hand, given.body, each.q, each.p_HO, each.R_HO, options.finger_names, options=settings
            )
        except InvalidInput as error:
            table.add_row(str(i), error.allowed.partition(": ")[2] or str(error))
            continue
        moved = float(np.abs(grasp.q - each.q).max())
        table.add_row(str(i), f"holds with {', '.join(grasp.fingers)}; joints moved by at most {moved:.3f} rad")
        grasps.append(grasp)
    console.print(table)
    return sorted(grasps, key=lambda grasp: -_least_margin(grasp, options.gravities))[: options.count]


def _least_margin(grasp: Grasp, gravities: Array) -> float:
    """Return the least of the largest slip margins under several gravities, N; 0 if one cannot be borne."""
    return min(_margin(solve(grasp.force_problem(g, objective=Objective("margin")), explain=False)) for g in gravities)


def _margin(solution: Solution) -> float:
    return float(solution.objective or 0.0) if solution.found else 0.0


def _load_table(gravities: Array, solutions: list[Solution], least_effort: list[Solution]) -> Table:
    """Return a table of the largest slip margin, and of the largest torque of the least effort, under each gravity."""
    table = Table("gravity", "largest slip margin", "torque of least effort", title="under each gravity")
    for g, solution, easy in zip(gravities, solutions, least_effort, strict=True):
        axis = int(np.abs(g).argmax())
        is_axis = np.count_nonzero(g) == 1
        name = f"{'-' if g[axis] < 0.0 else '+'}{_AXES[axis]}" if is_axis else ", ".join(f"{x:.3g}" for x in g)
        if solution.found and easy.found:
            torque = np.abs(easy.torques).max(initial=0.0)
            table.add_row(name, f"{_margin(solution):.2f} N", f"{torque:.3f} N·m")
        else:
            table.add_row(name, solution.status.sentence, "")
    return table
