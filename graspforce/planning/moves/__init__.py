"""Moves as data: they can be saved, sent, and planned elsewhere."""
