"""Collisions of a scene: the hand's links, the held object, and obstacles."""
