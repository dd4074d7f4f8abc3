"""Side conditions of a grasp search: approach direction, table, and fingers that oppose the thumb."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graspforce.core.arrays import Array

_APPROACH_COS = float(np.cos(np.radians(30.0)))  # of the largest angle between approach direction and palm normal
OPPOSED_COS = float(np.cos(np.radians(25.0)))  # of the largest angle between opposed normals
_COSINE_LENGTH = 0.02  # m: a cosine that lacks 1 counts as this length


@dataclass(frozen=True, eq=False, slots=True)
class SideConditions:
    """Further requirements on the geometry of a grasp.

    Args:
        approach_O: (3,) unit direction in O in which the hand approaches; None for any. The palm's normal is within 30° of it.
        up_O: (3,) unit vector in O away from a table; None without a table.
        table_height: distance of the table below the origin of O, m.
        table_clearance: least distance of the hand from the table, m.
        opposing: number of fingers that oppose the first finger: their normals are within 25° of the opposite of its normal.
    """

    approach_O: Array | None = None
    up_O: Array | None = None
    table_height: float = 0.0
    table_clearance: float = 0.0
    opposing: int = 0

    def margins(self, palm_normal_H: Array, R_HO: Array, normal: Array, points: Array, radii: Array) -> Array:
        """Return by how much the conditions are met, (B, K), m; negative where one is not met.

        Args:
            palm_normal_H: (3,) outward normal of the palm.
            R_HO: (B, 3, 3) axes of the object in H.
            normal: (B, N, 3) inward normals of the contacts in O.
            points: (B, S, 3) centres of spheres along the hand in O, m.
            radii: (S,) their radii, m.
        """
        columns = []
        if self.approach_O is not None:
            columns.append(_COSINE_LENGTH * ((R_HO @ self.approach_O) @ palm_normal_H - _APPROACH_COS))
        if self.up_O is not None:
            columns.append((points @ self.up_O - radii).min(axis=1) + self.table_height - self.table_clearance)
        for k in range(1, 1 + self.opposing):
            columns.append(_COSINE_LENGTH * (-(normal[:, 0] * normal[:, k]).sum(axis=1) - OPPOSED_COS))
        return np.stack(columns, axis=1) if columns else np.zeros((len(normal), 0))

    def texts(self, names: list[str]) -> list[str]:
        """Return what is wrong where each condition is not met.

        Args:
            names: names of the touching fingers.
        """
        found = [] if self.approach_O is None else ["the palm faces more than 30° from the approach direction"]
        found += [] if self.up_O is None else ["the hand is too near to the table"]
        return found + [f"{name} does not oppose {names[0]}" for name in names[1 : 1 + self.opposing]]
