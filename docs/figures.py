"""Draw the figures of the documentation: `python docs/figures.py [NAME …]` writes them into docs/media/."""

from __future__ import annotations

import ast
import sys
import textwrap
from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # after the choice of the backend
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch, FancyBboxPatch, Polygon

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
MEDIA = ROOT / "docs" / "media"
INK, BLUE, ORANGE, GREEN, GREY = "#222222", "#0072B2", "#D55E00", "#009E73", "#999999"  # distinct for colour-blind readers


def arrow(
    axes: plt.Axes, start: tuple[float, float], end: tuple[float, float], color: str, text: str = "", **at: float
) -> None:
    """Draw an arrow, and its label beside its head."""
    axes.add_patch(FancyArrowPatch(start, end, arrowstyle="-|>", mutation_scale=14, color=color, lw=2, shrinkA=0, shrinkB=0))
    if text:
        axes.text(end[0] + at.get("dx", 0.03), end[1] + at.get("dy", 0.0), text, color=color, fontsize=11, va="center")


def contact() -> Figure:
    """Draw a contact: frame, friction cone, force on the object."""
    figure, axes = plt.subplots(figsize=(6.4, 3.6))
    axes.add_patch(Circle((0.0, 0.0), 1.0, facecolor="#DCE6F0", edgecolor=INK, lw=1.5))
    axes.text(0.15, -0.55, "object O", fontsize=11)
    axes.add_patch(Circle((-1.42, 0.0), 0.42, facecolor="#F3E3D3", edgecolor=INK, lw=1.5))
    axes.text(-1.74, -0.05, "finger", fontsize=10)
    slope = 0.6
    axes.add_patch(
        Polygon([(-1, 0), (0.05, slope * 1.05), (0.05, -slope * 1.05)], facecolor=GREEN, alpha=0.18, edgecolor=GREEN)
    )
    axes.text(1.1, 0.62, "friction cone:\n‖f_t‖ ≤ μ f_n", color=GREEN, fontsize=11, ha="left")
    axes.plot([0.05, 1.07], [0.5, 0.66], color=GREEN, lw=0.8)
    arrow(axes, (-1, 0), (-0.45, 0), GREY, "n, inward", dx=-0.2, dy=-0.1)
    arrow(axes, (-1, 0), (-1, 0.55), GREY, "t₁", dx=-0.13, dy=0.04)
    arrow(axes, (-1, 0), (-0.2, 0.27), ORANGE, "f, on the object")
    axes.set(xlim=(-2.0, 2.0), ylim=(-1.05, 1.05), aspect="equal")
    axes.axis("off")
    axes.set_title("A finger pushes along the inward normal; its force stays inside the friction cone", fontsize=11)
    return figure


def certificate() -> Figure:
    """Draw a certificate: the cost of the forces equals the lower bound."""
    figure, axes = plt.subplots(figsize=(6.4, 3.4))
    x = np.linspace(-1.2, 1.6, 200)
    axes.plot(x, 0.5 * (x - 0.2) ** 2 + 0.35, color=BLUE, lw=2)
    axes.axvspan(-1.2, -0.55, color=GREY, alpha=0.25)
    axes.axvspan(1.1, 1.6, color=GREY, alpha=0.25)
    axes.axhline(0.35, color=GREEN, lw=2, ls="--")
    axes.plot([0.28], [0.3532], "o", color=ORANGE, ms=9)
    axes.annotate("forces of the solver: cost", (0.28, 0.36), (-0.25, 0.95), arrowprops={"arrowstyle": "->"}, fontsize=10)
    axes.annotate("lower bound from the multipliers", (-0.3, 0.35), (-0.5, 0.15), arrowprops={"arrowstyle": "->"}, fontsize=10)
    axes.text(-1.15, 0.06, "outside a cone", fontsize=9)
    axes.text(1.12, 0.06, "above a limit", fontsize=8.5)
    axes.set(xlabel="contact forces", ylabel="cost", xlim=(-1.2, 1.6), ylim=(0.0, 1.3), xticks=[], yticks=[])
    axes.set_title("Optimal: no constraint is violated, and the bound equals the cost", fontsize=11)
    return figure


def module_imports() -> dict[str, set[str]]:
    """Return the packages and modules that each module imports, below graspforce."""
    found: dict[str, set[str]] = {}
    for top in ("graspforce", "service", "problems"):
        for path in (ROOT / top).rglob("*.py"):
            parts = path.relative_to(ROOT).with_suffix("").parts
            name = ".".join(parts[1:] if top == "graspforce" else parts).removesuffix(".__init__")
            names = set()
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("graspforce."):
                    module = str(node.module).removeprefix("graspforce.")
                    names |= {module, *(f"{module}.{alias.name}" for alias in node.names)}
            found[name] = names
    return {name: {other for other in names if other in found and other != name} for name, names in found.items()}


def longest_chain(imports: dict[str, set[str]], first: str) -> list[str]:
    """Return the longest chain of imports from one package down to core."""
    known: dict[str, list[str]] = {}

    def below(module: str, seen: frozenset[str]) -> list[str]:
        if module not in known:
            chains = [below(other, seen | {module}) for other in sorted(imports[module]) if other not in seen | {module}]
            known[module] = [module, *max(chains, key=len, default=[])]
        return known[module]

    return max((below(name, frozenset()) for name in sorted(imports) if name.split(".")[0] == first), key=len)


def architecture() -> Figure:
    """Draw the packages in their order, and the longest chain of imports from cli to core."""
    layers = tomllib.loads((ROOT / "tests" / "architecture" / "layers.toml").read_text())["packages"]
    imports = module_imports()
    chain = longest_chain(imports, "cli")
    figure, axes = plt.subplots(figsize=(10.0, 0.66 * len(layers) + 0.8))
    for level, (package, modules) in enumerate(layers.items()):
        axes.add_patch(FancyBboxPatch((0.0, level), 1.9, 0.62, boxstyle="round,pad=0.04", facecolor="#DCE6F0", edgecolor=INK))
        axes.text(0.95, level + 0.31, package, ha="center", va="center", fontsize=10, weight="bold", color=INK)
        steps = [name.split(".", 1)[-1] for name in chain if name.split(".")[0] == package]
        lines = [(textwrap.shorten(", ".join(modules), 118, placeholder=" …"), "#555555")]
        lines += [(line, ORANGE) for line in textwrap.wrap(" → ".join(steps), 112)]
        for i, (line, color) in enumerate(lines):
            axes.text(2.2, level + 0.31 + 0.26 * ((len(lines) - 1) / 2 - i), line, va="center", fontsize=7.5, color=color)
    axes.text(
        2.2, len(layers) - 0.05, f"orange: the longest chain of imports, {len(chain)} modules", fontsize=8.5, color=ORANGE
    )
    axes.set(xlim=(-0.1, 10.5), ylim=(-0.2, len(layers) + 0.3))
    axes.axis("off")
    axes.set_title("Each package imports only from packages below it", fontsize=11, loc="left")
    (MEDIA / "longest_chain.txt").write_text("\n".join(chain) + "\n")
    return figure


def hands() -> Figure:
    """Draw shipped hands with a ball, as the simulator shows them."""
    from graspforce.geometry import Sphere
    from graspforce.grasp.body import Body
    from graspforce.grasp.search import find_grasp, relax_idle_fingers
    from graspforce.hand.hand import Hand
    from graspforce.simulation.plants.plant import Plant
    from graspforce.simulation.plants.scene import build_scene
    from graspforce.simulation.rendering import DisplayModel, capture_state, make_renderer

    down = (0.0, 0.0, -9.81)  # m/s²
    figure, grid = plt.subplots(2, 4, figsize=(10.4, 4.3))
    for axes, name in zip(grid.flat, SHOWN_HANDS, strict=True):
        grasp = find_grasp(Hand.load(name), Body.solid(Sphere(0.03), 0.05), friction=0.7, gravity_H=down)
        scene = build_scene(relax_idle_fingers(grasp), gravity_H=down)
        axes.imshow(make_renderer(DisplayModel(scene), 480, 360).render(capture_state(Plant(scene))))
        axes.set_title(name, fontsize=10)
        axes.axis("off")
    figure.tight_layout()
    return figure


SHOWN_HANDS = (
    "leap_right",
    "shadow_right",
    "ability_right",
    "barrett",
    "dex3_right",
    "parallel_jaws",
    "dlr_hit2",
    "anthropomorphic15",
)


def workspace() -> Figure:
    """Draw the points that the fingertips of a hand reach."""
    from graspforce.hand.hand import Hand
    from graspforce.hand.workspace import sample_workspace
    from graspforce.view.hand_plots import plot_workspace

    hand = Hand.load("allegro_right")
    return plot_workspace(hand, [sample_workspace(hand, finger.name) for finger in hand.fingers])


def mesh_grasp() -> Figure:
    """Draw a grasp of a mesh: a lump with three bulges, held by four fingers."""
    from graspforce import Contact, ContactSet, solve
    from graspforce.geometry import TriangleMesh
    from graspforce.grasp.body import Body
    from graspforce.grasp.grasp import Grasp
    from graspforce.hand.hand import Hand
    from graspforce.view import show

    latitude, longitude = np.linspace(-np.pi / 2, np.pi / 2, 20)[1:-1], np.linspace(0.0, 2.0 * np.pi, 36, endpoint=False)
    v, u = np.meshgrid(latitude, longitude, indexing="ij")
    radius = 0.03 * (1.0 + 0.15 * np.cos(3.0 * u) * np.cos(v) ** 2)  # m
    points = np.stack([radius * np.cos(v) * np.cos(u), radius * np.cos(v) * np.sin(u), 0.9 * radius * np.sin(v)], axis=-1)
    rows, columns = v.shape
    south, north = rows * columns, rows * columns + 1
    faces = []
    for j in range(columns):
        k = (j + 1) % columns
        faces += [(j, south, k), ((rows - 1) * columns + j, (rows - 1) * columns + k, north)]
        for i in range(rows - 1):
            a, b, c, d = i * columns + j, i * columns + k, (i + 1) * columns + k, (i + 1) * columns + j
            faces += [(a, b, c), (a, c, d)]
    mesh = TriangleMesh([*points.reshape(-1, 3), [0.0, 0.0, -0.027], [0.0, 0.0, 0.027]], faces, spacing=0.002)
    hand, names, p_HO = Hand.load("four_finger"), ("finger_1", "finger_2", "finger_3", "finger_4"), [0.0, 0.0, 0.055]
    p_OC = mesh.project_to_surface([[x, y, 0.0] for x, y in ((0.04, 0.03), (0.04, -0.03), (-0.04, -0.03), (-0.04, 0.03))])
    contacts = ContactSet.stack([Contact(p, n, 0.6) for p, n in zip(p_OC, mesh.inward_normal(p_OC), strict=True)])
    q = hand.grasp_posture(names, contacts, p_HO, np.eye(3))
    grasp = Grasp(hand, Body.solid(mesh, 0.1), names, contacts, q, p_HO, np.eye(3))
    figure = show(grasp, solve(grasp.force_problem()))
    for name in ("set_xlim", "set_ylim", "set_zlim"):
        getattr(figure.axes[0], name)(-0.06, 0.06)  # m
    return figure


FIGURES = {
    "contact": contact,
    "certificate": certificate,
    "architecture": architecture,
    "hands": hands,
    "workspace": workspace,
    "mesh_grasp": mesh_grasp,
}


def main(names: list[str]) -> None:
    """Write the named figures, or all."""
    MEDIA.mkdir(exist_ok=True)
    for name in names or FIGURES:
        figure = FIGURES[name]()
        figure.savefig(MEDIA / f"{name}.png", dpi=150, bbox_inches="tight")
        plt.close(figure)
        print(f"docs/media/{name}.png")


if __name__ == "__main__":
    main(sys.argv[1:])
