"""Physical constants."""

from __future__ import annotations

STANDARD_GRAVITY = 9.81  # m/s²
