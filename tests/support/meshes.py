"""Closed triangle meshes of known surfaces."""

from __future__ import annotations

import numpy as np


def box_mesh(edges, centre=(0.0, 0.0, 0.0)):
    """Return vertices (8, 3) and faces (12, 3) of a box."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [(a, b, c) for a, b, c, _ in quads] + [(a, c, d) for a, _, c, d in quads]
    return corners * np.asarray(edges) + np.asarray(centre), np.array(faces)


def grid_mesh(point, nu, nv):
    """Return the mesh of a surface point(u, v) that is periodic in both parameters, u and v in [0, 1)."""
    u, v = np.meshgrid(np.arange(nu) / nu, np.arange(nv) / nv, indexing="ij")
    vertices = point(u.ravel(), v.ravel())
    faces = []
    for i in range(nu):
        for j in range(nv):
            a, b = i * nv + j, ((i + 1) % nu) * nv + j
            c, d = ((i + 1) % nu) * nv + (j + 1) % nv, i * nv + (j + 1) % nv
            faces += [(a, b, c), (a, c, d)]
    return vertices, np.array(faces)


def torus_mesh(major, minor, nu=96, nv=48):
    """Return the mesh of a torus about the z axis."""

    def point(u, v):
        ring = major + minor * np.cos(2 * np.pi * v)
        angle = 2 * np.pi * u
        return np.column_stack([ring * np.cos(angle), ring * np.sin(angle), minor * np.sin(2 * np.pi * v)])

    return grid_mesh(point, nu, nv)


def sphere_mesh(radius, divisions=3):
    """Return the mesh of a sphere: an octahedron whose faces are divided, with vertices on the sphere."""
    vertices = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=float)
    faces = np.array([(0, 2, 4), (2, 1, 4), (1, 3, 4), (3, 0, 4), (2, 0, 5), (1, 2, 5), (3, 1, 5), (0, 3, 5)])
    for _ in range(divisions):
        points, index, divided = [tuple(v) for v in vertices], {}, []

        def middle(a, b, points=points, index=index, vertices=vertices):
            key = (min(a, b), max(a, b))
            if key not in index:
                index[key] = len(points)
                m = vertices[a] + vertices[b]
                points.append(tuple(m / np.linalg.norm(m)))
            return index[key]

        for a, b, c in faces:
            ab, bc, ca = middle(a, b), middle(b, c), middle(c, a)
            divided += [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        vertices, faces = np.array(points), np.array(divided)
    return radius * vertices, faces
