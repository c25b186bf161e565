"""Closed meshes from formulas, for tests of STL parts."""

import numpy as np
from scipy.spatial.transform import Rotation

from magmpm.bodies.surface_mesh import Mesh


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> Mesh:
    """A box between two corners: 12 triangles."""
    corner = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))]
    return Mesh(np.array(low) + corner * (np.array(high) - np.array(low)), np.array(faces))


def ball(center: tuple[float, float, float], radius: float, rings: int = 12) -> Mesh:
    """A ball made of rings of triangles between two poles."""
    polar = np.pi * np.arange(1, rings) / rings
    around = np.pi * np.arange(2 * rings) / rings
    p, a = np.meshgrid(polar, around, indexing="ij")
    middle = np.stack([np.sin(p) * np.cos(a), np.sin(p) * np.sin(a), np.cos(p)], axis=-1).reshape(
        -1, 3
    )
    vertices = np.concatenate([middle, [[0, 0, 1], [0, 0, -1]]])
    n = 2 * rings
    faces = []
    top = len(middle)
    bottom = len(middle) + 1
    for k in range(n):
        after = (k + 1) % n
        faces.append((top, k, after))
        faces.append((bottom, (rings - 2) * n + after, (rings - 2) * n + k))
        for r in range(rings - 2):
            a0 = r * n + k
            b0 = r * n + after
            a1 = (r + 1) * n + k
            b1 = (r + 1) * n + after
            faces += [(a0, a1, b1), (a0, b1, b0)]
    return Mesh(np.array(center) + radius * vertices, np.array(faces))


def between(one: np.ndarray, other: np.ndarray, half: float) -> Mesh:
    """A prism along y, from -half to half (m), between two curves of as many points (n, 2) x, z m; `other` is to the right of `one` as
    they are followed, with x to the right and z up."""
    profile = np.concatenate([one, other[::-1]])
    count = len(profile)
    vertices = np.concatenate([np.insert(profile, 1, y, axis=1) for y in (-half, half)])
    faces = []
    for k in range(count):
        after = (k + 1) % count
        faces += [(k, after, count + after), (k, count + after, count + k)]
    for k in range(len(one) - 1):
        corners = (k, k + 1, count - 2 - k, count - 1 - k)
        for a, b, c in ((0, 1, 2), (0, 2, 3)):
            faces.append((corners[a], corners[c], corners[b]))
            faces.append((count + corners[a], count + corners[b], count + corners[c]))
    return Mesh(vertices, np.array(faces))


def turned(mesh: Mesh, axis: tuple[float, float, float], angle: float) -> Mesh:
    """The mesh rotated about an axis through the origin, by an angle in rad."""
    rotation = Rotation.from_rotvec(angle * np.array(axis) / np.linalg.norm(axis))
    return Mesh(rotation.apply(mesh.vertices), mesh.faces)


def stl_text(mesh: Mesh) -> str:
    """A mesh as text STL."""
    lines = ["solid s"]
    for triangle in mesh.triangles:
        corners = [f"vertex {x:.9g} {y:.9g} {z:.9g}" for x, y, z in triangle]
        lines += ["facet normal 0 0 0", "outer loop", *corners, "endloop", "endfacet"]
    return "\n".join([*lines, "endsolid s", ""])
