"""Physical constants."""

from __future__ import annotations

STANDARD_GRAVITY = 9.81  # m/s²

LARGEST_DISTANCE = 1e3
"""Bound on the coordinates in records of poses, contacts and bodies, m: products of several stay far from overflow."""

LARGEST_MOTION = 1e6
"""Bound on the other numbers in records of states and motions: rad, m/s, rad/s, m/s², rad/s², N and N·m."""
