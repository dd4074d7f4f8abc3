"""Checks of hand models: units, shapes, limits and inertias."""
