"""Closed loop with non-spherical fingertips: python -m benchmarks.mesh_tips [--save FILE].

The controller models the fingertips as spheres. The plant has these spheres, or the convex hulls of the meshes of the Allegro
fingertips. Three fingers hold a free sphere of 50 g and 30 mm radius, μ = 0.7, palm up, for 10 s, and move it 10 mm peak to
peak at 1 Hz for 2 s. Errors are between the object and its reference. Lost steps are steps in which a fingertip does not touch.
"""

from __future__ import annotations

import mujoco
import numpy as np

from benchmarks import report_page
from benchmarks.closed_loop import three_finger_grasp
from benchmarks.mujoco_loop import run
from graspforce import simulation
from graspforce.simulation import compute_metrics

TITLE = "Closed loop with non-spherical fingertips"
HEAD = (
    "motion",
    "fingertips",
    "position error RMS, mm",
    "max, mm",
    "orientation error RMS, °",
    "max, °",
    "least slip margin, N",
    "lost steps",
)


def main() -> None:
    """Measure, print the table and write the page."""
    options = report_page.parser("mesh_tips", __doc__).parse_args()
    grasp, rows = three_finger_grasp(), []
    for axis in (None, 0, 1, 2):
        motion = "at rest" if axis is None else f"along {'xyz'[axis]}"
        travel = np.zeros(3) if axis is None else 0.01 * np.eye(3)[axis]  # m
        for tips in ("ball", "mesh"):
            duration = 10.0 if axis is None else 2.0  # s
            metrics = compute_metrics(
                run(grasp, duration, lambda start, d=travel: simulation.linear_reference(start, d, 1.0), tips=tips)
            )
            position = [f"{1e3 * metrics.position_error_rms:.4f}", f"{1e3 * metrics.position_error_peak:.4f}"]
            angle = [f"{np.degrees(metrics.orientation_error_rms):.4f}", f"{np.degrees(metrics.orientation_error_peak):.4f}"]
            shape = "spheres" if tips == "ball" else "meshes"
            rows.append([motion, shape, *position, *angle, f"{metrics.min_slip_margin:.3f}", str(metrics.lost_contact_steps)])
    report_page.show(TITLE, HEAD, rows, width=120)
    if options.save:
        facts = report_page.facts(f"MuJoCo {mujoco.__version__}")
        report_page.save(options.save, TITLE, __doc__, facts, report_page.table(HEAD, rows, text_columns=2))


if __name__ == "__main__":
    main()
