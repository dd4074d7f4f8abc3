"""Kinematics and dynamics of a hand in the coordinates of its actuators."""
