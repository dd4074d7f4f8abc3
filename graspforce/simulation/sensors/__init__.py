"""Sensors: errors of measured states, and measurements of a plant in a world."""
