"""Plots of problems, grasps, plans and runs."""
