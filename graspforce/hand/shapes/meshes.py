"""The meshes of a hand: their links and the paths of their files. The files are not opened."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path, PurePosixPath

from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import ModelError
from graspforce.hand.descriptions.description import ROBOT_DATA_PREFIX, HandSource, robot_data_folders
from graspforce.hand.descriptions.urdf import UrdfShape
from graspforce.hand.kinematics.kinematic_tree import Mesh

Directories = Sequence[str | os.PathLike[str]]
CarrierLookup = Callable[[str], tuple[int, Array, Array]]  # `CoupledModel.carrier_of` of a URDF link


def visual_meshes(files: HandSource, carrier_of: CarrierLookup, directories: Directories = ()) -> tuple[Mesh, ...]:
    """Return the visual meshes of all links of a URDF.

    Args:
        files: the description and the URDF.
        carrier_of: the moving link that carries a URDF link, and the URDF link's pose on it.
        directories: directories to search first; see `find_mesh_file`.

    Raises:
        ModelError: a file is not found.
    """
    links = files.urdf.links.values()
    return tuple(mesh for link in links for mesh in _meshes_of_shapes(link.name, link.visuals, files, carrier_of, directories))


def contact_mesh(files: HandSource, tip: str, carrier_of: CarrierLookup, directories: Directories = ()) -> Mesh:
    """Return the collision mesh of a tip link, or its visual mesh if no collision shape is a mesh.

    Args:
        files: the description and the URDF.
        tip: name of the URDF link.
        carrier_of: the moving link that carries a URDF link, and the URDF link's pose on it.
        directories: directories to search first; see `find_mesh_file`.

    Raises:
        ModelError: the link has no mesh or more than one, or the file is not found.
    """
    link = files.urdf.links[tip]
    shapes = next((shapes for shapes in (link.shapes, link.visuals) if any(shape.mesh for shape in shapes)), ())
    found = _meshes_of_shapes(tip, shapes, files, carrier_of, directories)
    if len(found) != 1:
        name = files.description.name
        raise ModelError(f"{name}: the tip link {tip} must have exactly one mesh, but {files.urdf_path} gives {len(found)}")
    return found[0]


def _meshes_of_shapes(
    link: str, shapes: Sequence[UrdfShape], files: HandSource, carrier_of: CarrierLookup, directories: Directories
) -> tuple[Mesh, ...]:
    """Return the meshes among the shapes of a URDF link, placed on the moving link that carries it."""
    carrier, p, R = carrier_of(link)
    found = []
    for shape in shapes:
        if shape.mesh is not None:
            file = find_mesh_file(shape.mesh.name, files.urdf_path, directories)
            found.append(Mesh(link, carrier, file, shape.mesh.scale, freeze(p + R @ shape.p), freeze(R @ shape.R)))
    return tuple(found)


def find_mesh_file(named: str, urdf: Path, directories: Directories = ()) -> Path:
    """Return the path of a mesh file.

    ``package://NAME/PATH`` is PATH in a directory NAME: a given directory, a subdirectory of one, or a parent directory of the
    URDF. The installed package example-robot-data is found too. Any other name is a path relative to the URDF, or an absolute
    path. Finally, each given directory is searched for the bare file name.

    Args:
        named: the name in the URDF.
        urdf: path of the URDF.
        directories: directories to search first.

    Raises:
        ModelError: the file is in none of these places; lists them.
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
        places += [directory / inside for directory in (*given, urdf.parent)]  # an absolute path ignores the directory
    places += [directory / inside.name for directory in given]
    for place in dict.fromkeys(places):
        if place.is_file():
            return place
    searched = ", ".join(str(place) for place in dict.fromkeys(places)) or "no place; give the directory of its package"
    raise ModelError(f"{urdf}: the mesh {named} is not found; searched: {searched}")
