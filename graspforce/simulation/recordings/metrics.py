"""Metrics of a simulation: tracking errors, slip margins, force errors, and counts of steps with faults."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graspforce.core.arrays import Array
from graspforce.simulation.recordings.recording import Recording

_SLIP_TOLERANCE = 1e-6  # of the friction limit; contacts with a smaller margin slip


@dataclass(frozen=True, slots=True)
class RunMetrics:
    """Metrics of a simulation.

    Attributes:
        position_error_rms: distance of the object from its reference, RMS, m.
        position_error_peak: the same, largest value.
        orientation_error_rms: angle between the object's orientation and its reference, RMS, rad.
        orientation_error_peak: the same, largest value.
        min_slip_margin: least slip margin of the plant's contacts, N.
        min_planned_margin: least slip margin of the controller's forces, N.
        force_error: RMS of planned minus true contact forces (vectors), divided by the RMS of the true forces.
        max_cone_violation: largest distance of a plant's contact force from its friction cone, N. Contacts with a planned
            margin ≤ 0 do not count.
        max_torque_fraction: largest torque divided by its motor's limit.
        lost_contact_steps: number of steps in which a fingertip does not touch.
        slip_steps: number of steps in which a touching fingertip has no slip margin. The engine keeps forces inside
            their cones,
            so a slipping contact has a force on the cone's edge.
        reused_force_steps: number of steps in which the controller reused its last forces.
        saturated_steps: number of steps in which a motor was at its limit.
    """

    position_error_rms: float
    position_error_peak: float
    orientation_error_rms: float
    orientation_error_peak: float
    min_slip_margin: float
    min_planned_margin: float
    force_error: float
    max_cone_violation: float
    max_torque_fraction: float
    lost_contact_steps: int
    slip_steps: int
    reused_force_steps: int
    saturated_steps: int


def compute_metrics(recording: Recording) -> RunMetrics:
    """Compute the metrics of a simulation, or of a part: see `Recording.since`.

    Args:
        recording: the simulation.
    """
    position_error = np.linalg.norm(recording.position_error, axis=1)
    orientation_error = np.linalg.norm(recording.orientation_error, axis=1)
    f_plant = np.einsum("sncj,snj->snc", recording.R_OC, recording.f[..., :3])  # N, in O
    f_planned = np.einsum("sncj,snj->snc", recording.planned_R_OC, recording.planned[..., :3])
    violation = np.where(recording.planned_margin > 0.0, recording.violation, 0.0)
    bound = recording.mu * recording.f[..., 2]  # N
    margin = recording.slip_margin
    slipping = (recording.touching > 0.0) & (recording.mu > 0.0) & (margin <= _SLIP_TOLERANCE * bound)
    limit = np.where(recording.tau >= 0.0, recording.torque_upper, -recording.torque_lower)
    use = np.divide(np.abs(recording.tau), limit, out=np.zeros_like(limit), where=limit > 0.0)  # not of joints without motor
    return RunMetrics(
        position_error_rms=_rms(position_error),
        position_error_peak=float(position_error.max()),
        orientation_error_rms=_rms(orientation_error),
        orientation_error_peak=float(orientation_error.max()),
        min_slip_margin=float(margin.min()),
        min_planned_margin=float(recording.planned_margin.min()),
        force_error=_rms(f_planned - f_plant) / max(_rms(f_plant), 1e-12),
        max_cone_violation=float(violation.max()),
        max_torque_fraction=float(use.max()),
        lost_contact_steps=int((recording.touching.min(axis=1) == 0.0).sum()),
        slip_steps=int(slipping.any(axis=1).sum()),
        reused_force_steps=int(recording.forces_reused.sum()),
        saturated_steps=int(recording.saturated.sum()),
    )


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(np.square(x))))
