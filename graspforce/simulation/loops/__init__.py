"""Closed loops: reference motions, the loop with exact or measured states, and controllers to compare with."""
