"""Metrics of a recording, against values computed by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.simulated_runs import simulate_three_fingers

from graspforce.simulation.recordings.metrics import compute_metrics


def test_metrics_match_their_definitions():
    """Values by hand, for three steps with overwritten arrays."""
    r = simulate_three_fingers(duration=0.003)
    p = r.p_desired + np.array([[3e-3, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, -4e-3]])
    R = Rotation.from_rotvec([[0.0, 0.2, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]).as_matrix() @ r.R_desired
    f = np.tile([0.3, 0.4, 1.0, 0.0], (3, 3, 1))  # ‖f_t‖ = 0.5, μ = 0.7: a margin of 0.2
    f[1, 2] = [0.0, 0.9, 1.0, 0.0]  # 0.2 N outside, with a planned margin of 0.1 N
    f[2, 0] = [0.0, 1.7, 1.0, 0.0]  # 1.0 N outside, with a negative planned margin
    margin = np.full((3, 3), 0.1)
    margin[2, 0] = -0.1
    planned = f.copy()
    planned[..., 2] += 0.1
    tau = np.zeros_like(r.tau)
    tau[1, 4] = -0.35  # of 0.7
    touching = np.ones((3, 3))
    touching[1, 1] = 0.0
    made = replace(
        r, p_HO=p, R_HO=R, f=f, planned=planned, planned_R_OC=r.R_OC, planned_margin=margin, tau=tau, touching=touching,
        forces_reused=np.array([0.0, 1.0, 1.0]), saturated=np.array([0.0, 0.0, 1.0]),
    )  # fmt: skip
    metrics = compute_metrics(made)
    assert metrics.position_error_rms == pytest.approx(np.sqrt((9e-6 + 16e-6) / 3.0))
    assert metrics.position_error_peak == pytest.approx(4e-3)
    assert metrics.orientation_error_peak == pytest.approx(0.2)
    assert metrics.orientation_error_rms == pytest.approx(0.2 / np.sqrt(3.0))
    assert metrics.min_slip_margin == pytest.approx(-1.0)
    assert metrics.min_planned_margin == pytest.approx(-0.1)
    squares = 7 * 1.25 + 1.81 + 3.89  # N²
    assert metrics.force_error == pytest.approx(np.sqrt(9 * 0.01 / squares))
    assert metrics.max_cone_violation == pytest.approx(0.2)
    assert metrics.max_torque_fraction == pytest.approx(0.5)
    assert (metrics.lost_contact_steps, metrics.slip_steps, metrics.reused_force_steps, metrics.saturated_steps) == (1, 2, 2, 1)
    np.testing.assert_allclose(made.orientation_error[0], [0.0, 0.2, 0.0], atol=1e-12)
    assert compute_metrics(made.since(2e-3)).reused_force_steps == 1
