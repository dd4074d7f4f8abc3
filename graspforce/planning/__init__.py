"""Minimum-time moves of a held object, and of fingers alone."""
