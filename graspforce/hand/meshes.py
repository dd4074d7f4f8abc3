"""The meshes of a hand: on which link, and where their files lie. Nothing here opens one."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path, PurePosixPath

from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import ModelError
from graspforce.hand.description import ROBOT_DATA_PREFIX, HandSource, robot_data_folders
from graspforce.hand.kinematic_tree import Mesh
from graspforce.hand.urdf import UrdfShape

Directories = Sequence[str | os.PathLike[str]]
CarrierLookup = Callable[[str], tuple[int, Array, Array]]  # of a URDF link: `CoupledModel.carrier_of`


def visual_meshes(files: HandSource, carrier_of: CarrierLookup, directories: Directories = ()) -> tuple[Mesh, ...]:
    """The meshes by which the URDF's links look.

    Raises:
        ModelError: a file that is not there.
    """
    links = files.urdf.links.values()
    return tuple(mesh for link in links for mesh in _meshes_of_shapes(link.name, link.visuals, files, carrier_of, directories))


def contact_mesh(files: HandSource, tip: str, carrier_of: CarrierLookup, directories: Directories = ()) -> Mesh:
    """The mesh of a tip link: of its collision shapes, and where these are primitives, of its visual ones.

    Raises:
        ModelError: it has no mesh, or several, or the file is not there.
    """
    link = files.urdf.links[tip]
    shapes = next((shapes for shapes in (link.shapes, link.visuals) if any(shape.mesh for shape in shapes)), ())
    found = _meshes_of_shapes(tip, shapes, files, carrier_of, directories)
    if len(found) != 1:
        name = files.description.name
        raise ModelError(
            f"{name}: its tip link {tip} must have one mesh to touch with, but {files.urdf_path} gives {len(found)}"
        )
    return found[0]


def _meshes_of_shapes(
    link: str, shapes: Sequence[UrdfShape], files: HandSource, carrier_of: CarrierLookup, directories: Directories
) -> tuple[Mesh, ...]:
    """The meshes among the shapes of a URDF link, on the moving link that carries it."""
    carrier, p, R = carrier_of(link)
    found = []
    for shape in shapes:
        if shape.mesh is not None:
            file = find_mesh_file(shape.mesh.name, files.urdf_path, directories)
            found.append(Mesh(link, carrier, file, shape.mesh.scale, freeze(p + R @ shape.p), freeze(R @ shape.R)))
    return tuple(found)


def find_mesh_file(named: str, urdf: Path, directories: Directories = ()) -> Path:
    """The file that a URDF calls ``named``.

    ``package://NAME/PATH`` is PATH in a directory called NAME: one of those given, one inside them, or one that the URDF lies
    in; example-robot-data is found where it is installed. Another name is a path from the URDF's own directory, or a whole
    one. What is not there may also lie in a directory given by itself.

    Args:
        named: as the URDF says it.
        urdf: the URDF file.
        directories: where to look first.

    Raises:
        ModelError: it is in none of these places; names them.
    """
    given = [Path(directory) for directory in directories]
    scheme, mark, rest = named.partition("://")
    inside = PurePosixPath(rest if mark else named)
    places: list[Path] = []
    if scheme == "package":
        package, path = inside.parts[0] if inside.parts else "", Path(*inside.parts[1:])
        for directory in given:
            places += [directory / package / path, *([directory / path] if directory.name == package else [])]
        places += [folder / path for folder in urdf.absolute().parents if folder.name == package]
        if f"package://{package}/" == ROBOT_DATA_PREFIX:
            places += [share / path for share in robot_data_folders()]
    else:
        places += [directory / inside for directory in (*given, urdf.parent)]  # a whole path stays what it is
    places += [directory / inside.name for directory in given]
    for place in dict.fromkeys(places):
        if place.is_file():
            return place
    looked = ", ".join(str(place) for place in dict.fromkeys(places)) or "no place: give the directory that its package lies in"
    raise ModelError(f"{urdf}: its mesh {named} is not there; looked for at {looked}")
