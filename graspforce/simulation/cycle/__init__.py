"""Grasp cycles in simulation: an object on a table, from the empty hand to the release."""
