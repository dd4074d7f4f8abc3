"""The motor torques of a trajectory."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from graspforce.planning.plan import Trajectory
from graspforce.planning.task import Task
from graspforce.planning.tip_contacts import contact_jacobians_at


def with_torques(task: Task, trajectory: Trajectory) -> Trajectory:
    """The same, with the torques that make the motion and its forces."""
    hand, contacts = task.hand, task.contacts
    tau = np.zeros((len(trajectory.times), 0))
    if hand is not None:
        tau = hand.inverse_dynamics_along(trajectory.q, trajectory.v, trajectory.a, task.gravity_H)
        if contacts is not None:
            J = contact_jacobians_at(task, trajectory.q, trajectory.p_HO, trajectory.R_HO, trajectory.p_OC, trajectory.R_OC)
            tau = tau + np.einsum("mkn,mk->mn", J, trajectory.f)
    return replace(trajectory, tau=tau).frozen()
