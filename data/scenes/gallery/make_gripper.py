"""Writes meshes/gripper_*.stl, the parts of gripper.yaml, in millimeters, and prints the `meshes` of the scene.

    python data/scenes/gallery/make_gripper.py

Six flat arms, each of two halves, extend from the sides of a hexagonal hub, between z = 0 and 1 mm; a ball lies below the hub.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from magmpm.bodies.surface_mesh import Mesh, write_stl
from magmpm.compiled.arrays import Array

HUB = 3.0  # mm, from the axis to its sides
INNER, OUTER = 4.0, 4.5  # lengths of the two halves of an arm
WIDTH, THICKNESS = 2.0, 1.0
BALL, BALL_AT = 2.5, -4.75  # radius, and height of its center
TILT = 60.0  # degrees: angle of the magnetization of the outer half out of the plane


def box(lower: Array, upper: Array) -> Mesh:
    """A block with edges along the axes."""
    corner = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    faces = [
        [0, 1, 3],
        [0, 3, 2],
        [4, 6, 7],
        [4, 7, 5],
        [0, 4, 5],
        [0, 5, 1],
        [2, 3, 7],
        [2, 7, 6],
        [0, 2, 6],
        [0, 6, 4],
        [1, 5, 7],
        [1, 7, 3],
    ]
    return Mesh(lower + corner * (upper - lower), np.array(faces))


def turned(mesh: Mesh, angle: float) -> Mesh:
    """A mesh rotated about the z axis by `angle` (radians)."""
    c, s = math.cos(angle), math.sin(angle)
    return Mesh(mesh.vertices @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]), mesh.faces)


def hub() -> Mesh:
    """The hexagonal prism."""
    radius = HUB / math.cos(math.pi / 6)
    ring = np.array(
        [[radius * math.cos(a), radius * math.sin(a)] for a in (np.arange(6) + 0.5) * math.pi / 3]
    )
    points = np.vstack(
        [[0, 0, 0], [0, 0, THICKNESS], np.c_[ring, np.zeros(6)], np.c_[ring, np.full(6, THICKNESS)]]
    )
    faces = []
    for k in range(6):
        a, b = 2 + k, 2 + (k + 1) % 6
        faces += [[0, b, a], [1, a + 6, b + 6], [a, b, b + 6], [a, b + 6, a + 6]]
    return Mesh(points, np.array(faces))


def ball(levels: int = 3) -> Mesh:
    """An icosahedron whose triangles are subdivided and projected to a sphere, scaled to the volume of the ball."""
    g = (1 + math.sqrt(5)) / 2
    points = [
        np.array(p, float)
        for p in (
            (-1, g, 0),
            (1, g, 0),
            (-1, -g, 0),
            (1, -g, 0),
            (0, -1, g),
            (0, 1, g),
            (0, -1, -g),
            (0, 1, -g),
            (g, 0, -1),
            (g, 0, 1),
            (-g, 0, -1),
            (-g, 0, 1),
        )
    ]
    faces = [
        (0, 11, 5),
        (0, 5, 1),
        (0, 1, 7),
        (0, 7, 10),
        (0, 10, 11),
        (1, 5, 9),
        (5, 11, 4),
        (11, 10, 2),
        (10, 7, 6),
        (7, 1, 8),
        (3, 9, 4),
        (3, 4, 2),
        (3, 2, 6),
        (3, 6, 8),
        (3, 8, 9),
        (4, 9, 5),
        (2, 4, 11),
        (6, 2, 10),
        (8, 6, 7),
        (9, 8, 1),
    ]
    for _ in range(levels - 1):
        middle: dict[tuple[int, int], int] = {}
        split = []
        for face in faces:
            between = []
            for a, b in zip(face, (*face[1:], face[0]), strict=True):
                key = (min(a, b), max(a, b))
                if key not in middle:
                    middle[key] = len(points)
                    points.append(
                        points[a] / np.linalg.norm(points[a])
                        + points[b] / np.linalg.norm(points[b])
                    )
                between.append(middle[key])
            a, b, c = face
            ab, bc, ca = between
            split += [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        faces = split
    unit = np.array([p / np.linalg.norm(p) for p in points])
    triangles = unit[np.array(faces)]
    volume = (
        np.einsum("ij,ij->i", triangles[:, 0], np.cross(triangles[:, 1], triangles[:, 2])).sum() / 6
    )
    radius = BALL * (4 / 3 * math.pi / volume) ** (1 / 3)
    return Mesh(radius * unit + [0, 0, BALL_AT], np.array(faces))


if __name__ == "__main__":
    folder = Path(__file__).with_name("meshes")
    folder.mkdir(exist_ok=True)
    write_stl(hub(), folder / "gripper_hub.stl")
    write_stl(ball(), folder / "gripper_ball.stl")
    outer = math.radians(TILT)
    for k in range(6):
        angle = k * math.pi / 3
        for name, begin, length, tilt in (
            ("inner", HUB, INNER, 0.0),
            ("outer", HUB + INNER, OUTER, outer),
        ):
            half = box(
                np.array([begin, -WIDTH / 2, 0]), np.array([begin + length, WIDTH / 2, THICKNESS])
            )
            write_stl(turned(half, angle), folder / f"gripper_{name}_{k + 1}.stl")
            m = (math.cos(tilt) * math.cos(angle), math.cos(tilt) * math.sin(angle), math.sin(tilt))
            text = ", ".join(f"{x:.4f}" for x in m)
            print(
                f"      - {{mesh: meshes/gripper_{name}_{k + 1}.stl, material: magnetic silicone, magnetization: [{text}]}}"
            )
