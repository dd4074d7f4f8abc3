"""What the closed loop makes of fingertips that are no balls: python -m benchmarks.mesh_tips [--save FILE].

The plant's fingertips are the balls that the controller believes in, or the convex hulls of Allegro's own meshes, faceted
bullets. Three of them hold a free sphere of 50 g and 30 mm radius, μ = 0.7, palm up, for 10 s, and move it 10 mm peak to peak
at 1 Hz for 2 s; RMS and greatest distances are from where it should be. A lost step is one in which a fingertip is off.
"""

from __future__ import annotations

import mujoco
import numpy as np

from benchmarks import report_page
from benchmarks.closed_loop import three_finger_grasp
from benchmarks.mujoco_loop import run
from graspforce import simulation
from graspforce.simulation import compute_metrics

TITLE = "Fingertips that are balls, and that are meshes"
HEAD = ("motion", "tips", "RMS mm", "most mm", "turned RMS °", "most °", "least slip margin N", "steps lost")


def main() -> None:
    """Measure and show."""
    options = report_page.parser("mesh_tips", __doc__).parse_args()
    grasp, rows = three_finger_grasp(), []
    for axis in (None, 0, 1, 2):
        what = "at rest" if axis is None else f"along {'xyz'[axis]}"
        travel = np.zeros(3) if axis is None else 0.01 * np.eye(3)[axis]  # m
        for tips in ("ball", "mesh"):
            duration = 10.0 if axis is None else 2.0  # s
            metrics = compute_metrics(
                run(grasp, duration, lambda start, d=travel: simulation.linear_reference(start, d, 1.0), tips=tips)
            )
            off = [f"{1e3 * metrics.position_error_rms:.4f}", f"{1e3 * metrics.position_error_peak:.4f}"]
            turned = [f"{np.degrees(metrics.orientation_error_rms):.4f}", f"{np.degrees(metrics.orientation_error_peak):.4f}"]
            rows.append([what, tips, *off, *turned, f"{metrics.min_slip_margin:.3f}", str(metrics.lost_contact_steps)])
    report_page.show(TITLE, HEAD, rows, width=120)
    if options.save:
        facts = report_page.facts(f"MuJoCo {mujoco.__version__}")
        report_page.save(options.save, TITLE, __doc__, facts, report_page.table(HEAD, rows, words=2))


if __name__ == "__main__":
    main()
