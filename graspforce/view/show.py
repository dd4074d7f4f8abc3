"""Draw a grasp or a force problem in three dimensions: object, fingers, contacts, friction cones and forces."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from graspforce.contact.contact import ContactSet
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.force.problem import ForceProblem
from graspforce.force.solution import Solution
from graspforce.geometry import Box, Cylinder, Shape, Sphere, Superquadric, TriangleMesh
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.link_grasp import LinkGrasp

OBJECT, FORCE, INSIDE, EDGE, FINGER = "#56B4E9", "#D55E00", "#009E73", "#CC3311", "#777777"  # distinct if colour-blind
_CONE_SIDES = 24
_EDGE_SHARE = 0.95  # of the friction limit: from here a cone is drawn in the colour of its edge
_LOWEST_CONE = 0.15  # height of the cone of a small force, relative to the longest arrow
_GRID = 25


def show(subject: Grasp | LinkGrasp | ForceProblem, solution: Solution | None = None) -> Figure:
    """Return a picture of a grasp or a force problem in the object's frame O.

    Cones are green, and red where the force uses more than 95 % of the friction limit. With forces, the base of a cone is at
    the tail of the arrow: the tail is in the disc of the base if the force is in the cone. In a notebook the figure appears
    by itself; elsewhere call ``figure.savefig("grasp.png")``.

    Args:
        subject: a grasp, drawn with its object and fingers, all of them if links touch; or a force problem, drawn with its
            contacts alone.
        solution: forces to draw; those of a grasp's or problem's contacts, in their order.

    Raises:
        InvalidInput: the solution has another number of contacts.
    """
    contacts = subject.contacts
    if solution is not None and solution.f.size and len(solution.forces) != len(contacts):
        raise InvalidInput("solution", f"{len(solution.forces)} contacts", f"{len(contacts)}, as the grasp or problem has")
    figure = Figure(figsize=(7.5, 6.5), layout="constrained")
    axes = figure.add_subplot(projection="3d")
    size = _object_size(contacts)
    points = [contacts.p_OC]
    if isinstance(subject, Grasp | LinkGrasp):
        if subject.body.shape is not None:
            points.append(_draw_object(axes, subject.body.shape))
        points.append(_draw_fingers(axes, subject))
    else:
        points.append(contacts.p_OC - 0.45 * size * contacts.R_OC[:, :, 2])  # the ends of the cones and forces
    _draw_contacts(axes, contacts, solution, 0.45 * size)
    _frame(axes, np.vstack(points))
    axes.set_title(_title(subject, solution), fontsize=11)
    return figure


def _title(subject: Grasp | LinkGrasp | ForceProblem, solution: Solution | None) -> str:
    if isinstance(subject, Grasp):
        what = f"{subject.hand.name}, {len(subject.fingers)} fingers"
    elif isinstance(subject, LinkGrasp):
        what = f"{subject.hand.name}, {len(set(subject.links))} links"
    else:
        what = subject.name or "force problem"
    if solution is None:
        return f"{what}: {len(subject.contacts)} contacts and their friction cones"
    if not solution.found:
        return f"{what}: {solution.status.value}"
    return f"{what}: {solution.status.value}, friction used at most {100.0 * solution.friction_used.max():.0f} %"


def _object_size(contacts: ContactSet) -> float:
    """Return the extent of the contacts, m."""
    extent = float(np.ptp(contacts.p_OC, axis=0).max())
    return extent if extent > 0.0 else 0.05


def _draw_contacts(axes: Any, contacts: ContactSet, solution: Solution | None, length: float) -> None:
    """Draw each contact with its cone outside the object, where the finger is, and its force."""
    found = solution is not None and solution.f.size > 0
    used = solution.friction_used if found and solution is not None else np.zeros(len(contacts))
    forces = solution.forces_object if found and solution is not None else np.zeros((len(contacts), 3))
    unit = length / max(float(np.linalg.norm(forces, axis=1).max(initial=0.0)), 1e-300)  # m/N
    angles = np.linspace(0.0, 2.0 * np.pi, _CONE_SIDES + 1)
    for p, R, mu, share, f in zip(contacts.p_OC, contacts.R_OC, contacts.mu, used, forces, strict=True):
        height = max(unit * float(f @ R[:, 2]), _LOWEST_CONE * length) if found else 0.6 * length
        across = np.cos(angles)[:, None] * R[:, 0] + np.sin(angles)[:, None] * R[:, 1]
        rim = p - height * (R[:, 2] + mu * across)  # outside, so that the arrow of a force in its cone is in the drawn cone
        sides = [np.array([p, rim[i], rim[i + 1]]) for i in range(_CONE_SIDES)]
        colour = EDGE if share > _EDGE_SHARE else INSIDE
        axes.add_collection3d(Poly3DCollection(sides, facecolor=colour, alpha=0.22, edgecolor="none"))
        axes.scatter(*p, color="black", s=14, depthshade=False)
        if found:
            tail = p - unit * f
            axes.quiver(*tail, *(unit * f), color=FORCE, linewidth=2.0, arrow_length_ratio=0.18)
    if found:
        _explain_colours(axes, forces, used)


def _explain_colours(axes: Any, forces: Array, used: Array) -> None:
    """Add a legend: the size of the forces and the colours of the cones."""
    sizes = np.linalg.norm(forces, axis=1)
    arrow = Line2D([], [], color=FORCE, linewidth=2.0, label=f"force on the object, {sizes.min():.3g} to {sizes.max():.3g} N")
    labels = {
        INSIDE: f"friction cone, used up to {100.0 * _EDGE_SHARE:.0f} %",
        EDGE: f"friction cone, used above {100.0 * _EDGE_SHARE:.0f} %",
    }
    drawn = [EDGE] * bool((used > _EDGE_SHARE).any()) + [INSIDE] * bool((used <= _EDGE_SHARE).any())
    cones = [Patch(facecolor=colour, alpha=0.4, label=labels[colour]) for colour in drawn]
    axes.legend(handles=[arrow, *cones], frameon=False, fontsize=9, loc="upper left")


def _draw_object(axes: Any, shape: Shape) -> Array:
    """Draw the object's surface; return the points of its bounding box (or of its surface), m."""
    if isinstance(shape, TriangleMesh):
        x, y, z = shape.vertices.T
        axes.plot_trisurf(x, y, z, triangles=shape.faces, color=OBJECT, alpha=0.3, linewidth=0.0, antialiased=True, shade=True)
        return shape.vertices
    grid = surface_grid(shape)
    if grid is None:
        return np.zeros((1, 3))
    x, y, z = grid
    axes.plot_surface(x, y, z, color=OBJECT, alpha=0.3, linewidth=0.0, antialiased=True, shade=True)
    return np.column_stack([x.ravel(), y.ravel(), z.ravel()])


def surface_grid(shape: Shape) -> tuple[Array, Array, Array] | None:
    """Return the surface of a shape as a grid of points (x, y, z), m; None for shapes without a parametrisation."""
    u, v = np.meshgrid(np.linspace(-np.pi, np.pi, 2 * _GRID), np.linspace(-np.pi / 2, np.pi / 2, _GRID))
    if isinstance(shape, Sphere):
        return shape.radius * np.cos(v) * np.cos(u), shape.radius * np.cos(v) * np.sin(u), shape.radius * np.sin(v)
    if isinstance(shape, Superquadric):
        e1, e2 = shape.exponents
        a, b, c = shape.axes
        ring = _signed_power(np.cos(v), e1)
        return (
            a * ring * _signed_power(np.cos(u), e2),
            b * ring * _signed_power(np.sin(u), e2),
            c * _signed_power(np.sin(v), e1),
        )
    if isinstance(shape, Cylinder):
        turn, (radius, height) = np.linspace(-np.pi, np.pi, 2 * _GRID), _cylinder_profile(shape)
        return np.outer(radius, np.cos(turn)), np.outer(radius, np.sin(turn)), np.outer(height, np.ones(2 * _GRID))
    if isinstance(shape, Box):
        half = np.asarray(shape.edges) / 2.0
        corner = np.array([-1.0, 1.0, 1.0, -1.0, -1.0])
        rows = [(0.0, -1.0), (1.0, -1.0), (1.0, 1.0), (0.0, 1.0)]  # bottom middle, bottom rim, top rim, top middle
        x = np.array([scale * half[0] * corner for scale, _ in rows])
        y = np.array([scale * half[1] * np.array([-1.0, -1.0, 1.0, 1.0, -1.0]) for scale, _ in rows])
        return x, y, np.array([level * half[2] * np.ones(5) for _, level in rows])
    return None


def _signed_power(x: Array, exponent: float) -> Array:
    return np.asarray(np.sign(x) * np.abs(x) ** exponent)


def _cylinder_profile(shape: Cylinder) -> tuple[Array, Array]:
    radius = np.array([0.0, shape.radius, shape.radius, 0.0])
    return radius, 0.5 * shape.height * np.array([-1.0, -1.0, 1.0, 1.0])


def _draw_fingers(axes: Any, grasp: Grasp | LinkGrasp) -> Array:
    """Draw the fingers that hold as lines from joint to joint, with a ball at each tip; return the points to show, m."""
    origins, tree = grasp.hand.model.joint_origins(grasp.q), grasp.hand.tree()
    seen = []
    for tip in (tip for tip in tree.tips if isinstance(grasp, LinkGrasp) or tip.finger in grasp.fingers):
        chain, link = [grasp.hand.tip_pose(grasp.q, tip.finger)[0]], tip.link
        while link >= 0:
            chain.append(origins[link])
            link = tree.links[link].parent
        line = (np.array(chain) - grasp.p_HO) @ grasp.R_HO  # from H to O
        axes.plot(*line.T, color=FINGER, linewidth=5.0, solid_capstyle="round", alpha=0.75)
        axes.scatter(*line[0], s=90, color=FINGER, alpha=0.9)
        seen.append(line[:3])  # the tip and its last two joints
    return np.vstack(seen)


def _frame(axes: Any, points: Array) -> None:
    """Set equal axes that show all points, with units."""
    middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
    half = 0.62 * max(float(np.ptp(points, axis=0).max()), 0.02)  # m
    for axis, value, name in zip((axes.xaxis, axes.yaxis, axes.zaxis), middle, "xyz", strict=True):
        getattr(axes, f"set_{name}lim")(value - half, value + half)
        axis.set_major_formatter(lambda x, _: f"{1e3 * x:.0f}")
        getattr(axes, f"set_{name}label")(f"{name} in O (mm)")
    axes.set_box_aspect((1, 1, 1))
    axes.view_init(elev=22, azim=-55)
