"""Shapes of links and fingertips, from meshes and primitives of the URDF."""
