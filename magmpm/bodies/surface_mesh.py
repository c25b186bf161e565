"""Closed triangle meshes of parts: read from STL, checked, and measured.

A scene keeps a mesh as text (base64 of its arrays), so that it stays one immutable value and stands without its files: results hold the
mesh they were made with, and the scene's hash covers every vertex.
"""

from __future__ import annotations

import atexit
import base64
import itertools
import re
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import ValidationInfo

from magmpm.bodies.curves import face_normals
from magmpm.bodies.shells import (
    SAME_VERTEX,
    MeshError,
    doubled,
    facing_outward,
    overlapping_boxes,
    place,
    shell_fault,
    sides_of,
    solid_of,
    solids_of,
)
from magmpm.compiled.arrays import Array, Index
from magmpm.errors import require
from magmpm.inputs.settings import fault, from_file, named_file
from magmpm.inputs.user_files import UnfitFile, read_regular

if TYPE_CHECKING:
    from manifold3d import Manifold

PREFIX = "mesh:"  # of the text a scene keeps
MOST_FACES = 300_000
SMALLEST = 1e-6  # m: the longest side of a mesh
_VERTEX = re.compile(
    rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)", re.IGNORECASE
)  # of text STL, in small letters or capitals
_RECORD = np.dtype(
    [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("color", "<u2")]
)  # of binary STL
atexit.register(lambda: _stored_solid.cache_clear())  # type: ignore[has-type]  # manifold3d complains of solids that outlive it


@dataclass(frozen=True)
class Mesh:
    """A closed surface: vertices (v, 3) in the file's unit, faces (f, 3) with normals outward."""

    vertices: Array
    faces: Index

    @property
    def triangles(self) -> Array:
        """Corners (f, 3, 3)."""
        return self.vertices[self.faces]


def read_stl(path: Path) -> Mesh:
    """The mesh of an STL file, text or binary, checked. Raises MeshError."""
    # in any unit: 100 m in micrometres; larger ones are a damaged file's, and their cubes and squares
    # overflow
    largest_number = 1e8
    # of a file: text STL takes 200 to 300 a triangle; with fewer bytes the number of triangles is
    # checked
    most_bytes = 200_000_000
    try:
        content = read_regular(path, most_bytes)
    except UnfitFile as error:
        raise MeshError(
            f"{error.strerror}; a mesh must be a regular file of at most"
            f" {most_bytes // 1_000_000} MB",
            "export the part as STL",
        ) from None
    except OSError as error:
        raise MeshError(
            f"the file can't be read ({error.strerror})",
            "correct the path, which is relative to the scene file",
        ) from None
    corners = _corners(content)
    if corners is None or len(corners) == 0:
        raise MeshError("the file must be an STL mesh, text or binary", "export the part as STL")
    if len(corners) > MOST_FACES:
        raise MeshError(
            f"a mesh must have at most {MOST_FACES} triangles, and this one has {len(corners)}",
            "simplify it: the grid sees nothing finer than a cell",
        )
    if not np.all(np.isfinite(corners)):
        raise MeshError("every coordinate must be a finite number", "export the part again")
    largest = float(np.abs(corners).max())
    if largest > largest_number:
        raise MeshError(
            f"coordinates must be at most {largest_number:.0e} in the file's unit, and this mesh"
            f" has one of {largest:.3g}",
            "the file is damaged, or not in a unit of length: export the part again",
        )
    return checked(*_merged(corners))


def write_stl(mesh: Mesh, path: Path) -> None:
    """Write a mesh as binary STL, in its unit."""
    record = np.zeros(len(mesh.faces), _RECORD)
    record["corners"] = mesh.triangles
    normal = face_normals(mesh.triangles)
    record["normal"] = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    path.write_bytes(bytes(80) + len(record).to_bytes(4, "little") + record.tobytes())


def _corners(content: bytes) -> Array | None:
    """Corners (f, 3, 3) of an STL, binary or text, or None where the content is something else."""
    if len(content) >= 84 and len(content) == 84 + 50 * int.from_bytes(content[80:84], "little"):
        return np.frombuffer(content, _RECORD, offset=84)["corners"].astype(float)
    if content.lstrip()[:5].lower() != b"solid":
        return None
    rows = _VERTEX.findall(content)
    if not rows or len(rows) % 3:
        return None
    try:
        numbers = np.array(rows, dtype=float)
    except ValueError:  # decimal commas, which take ten times as long
        numbers = np.array([[_number(text) for text in row] for row in rows])
    return numbers.reshape(-1, 3, 3)


def _number(text: bytes) -> float:
    """A coordinate of a text STL, with a point or a comma before its decimals. Raises MeshError."""
    try:
        return float(text.rstrip(b",").replace(b",", b"."))
    except ValueError:
        word = text.decode(errors="replace")
        raise MeshError(
            f"every coordinate must be a number, and this file has {word[:40]!r}",
            "export the part again",
        ) from None


def _merged(corners: Array) -> tuple[Array, Index]:
    """Vertices and faces of separate triangles (f, 3, 3): near vertices are merged, triangles without area left out."""
    points, of = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    from scipy.sparse import (
        coo_matrix,
    )  # only where a scene has a mesh: scipy takes a fifth of a second
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    pairs = cKDTree(points).query_pairs(
        SAME_VERTEX * float(np.ptp(points, axis=0).max()), output_type="ndarray"
    )
    if len(pairs):
        links = coo_matrix((np.ones(len(pairs)), tuple(pairs.T)), shape=(len(points), len(points)))
        count, group = connected_components(links, directed=False)
        first = np.full(count, len(points), np.int64)
        np.minimum.at(first, group, np.arange(len(points)))
        points = points[first]
        of = group[of.ravel()].astype(np.int64)
    faces = of.reshape(-1, 3).astype(np.int64)
    a, b, c = faces.T
    return points, faces[(a != b) & (b != c) & (c != a)]


def checked(vertices: Array, faces: Index) -> Mesh:
    """The mesh, if it encloses a volume once with its normals outward. Raises MeshError with what is wrong and how to mend it."""
    # of the mesh's size: more than what the touching pieces of a drawing cross each other by
    crossed = 0.01
    if (found := doubled(vertices, faces)) is not None:
        raise MeshError(*found)
    edges, low, first, of, used = sides_of(faces)
    balance = np.bincount(of, np.where(edges[:, 0] == low, 1.0, -1.0))
    odd_edges = np.flatnonzero((used > 2) & (used % 2 == 1))
    if len(odd_edges):
        raise MeshError(
            f"triangles of a mesh must meet in pairs at each edge, and at {len(odd_edges)} edges of"
            " this one there is one too many or too few, the first near"
            f" {place(vertices[low[first[odd_edges[0]]]])}: three or more meet there",
            "remove the triangle that belongs to no solid, or close the hole (in Blender: Select >"
            " All by Trait > Non Manifold), and export the part again",
        )
    open_edges = np.flatnonzero(used == 1)
    if len(open_edges):
        raise MeshError(
            f"a mesh must be watertight, and {len(open_edges)} edges of this one have a hole beside"
            f" them, the first near {place(vertices[low[first[open_edges[0]]]])}",
            "close the holes, for example with MeshLab's or Blender's repair, and export the part"
            " again",
        )
    if np.any(balance != 0):
        raise MeshError(
            f"all triangles of a mesh must face outward, and {int(np.sum(balance != 0))} edges join"
            " two that face opposite ways",
            "make the normals consistent (in Blender: Mesh > Normals > Recalculate Outside) and"
            " export the part again",
        )
    mesh = Mesh(vertices, faces)
    # no triangle is left where all vertices count as one: next to a vertex that is far away
    volume = volume_of(mesh.triangles) if len(faces) else 0.0
    size = float(np.prod(np.ptp(vertices, axis=0)))
    if volume < -1e-9 * size:
        raise MeshError(
            "the triangles of a mesh must face outward, and those of this one face inward: its"
            " volume is negative",
            "flip the normals (in Blender: Mesh > Normals > Flip) and export the part again",
        )
    if not volume > 1e-9 * size:
        raise MeshError(
            "a mesh must enclose a volume, and this one encloses none: a part without volume has no"
            " mass",
            "export the solid part, not a surface",
        )
    if (found := shell_fault(vertices, faces, size)) is not None:
        raise MeshError(*found)
    twice = _covered_twice(solid_of(vertices, faces), mesh)
    if twice > crossed * float(np.ptp(vertices, axis=0).max()):
        raise MeshError(
            f"the surface of a mesh must not cross itself: along a line of {twice:.3g} inside "
            "this one, material counts twice or negatively",
            "merge overlapping solids (in Blender: the Boolean modifier, Union, with Self "
            "Intersection), and export the part again",
        )
    return mesh


def size_fault(mesh: Mesh, unit: str, scale: float) -> tuple[str, str] | None:
    """Rule and remedy where a mesh in this unit (of `scale` m) is too far away, or too small; else None."""
    farthest_coordinate = 10.0  # m, as of all places in a scene
    far = scale * float(np.abs(mesh.vertices).max())
    size = scale * float(np.ptp(mesh.vertices, axis=0).max())
    remedy = f"check the unit ({unit}), and the place of the mesh"
    if far > farthest_coordinate * (1 + 1e-9):
        return (
            f"coordinates must be at most {farthest_coordinate:g} m, and this mesh reaches"
            f" to {far:.3g} m",
            remedy,
        )
    if size < SMALLEST * (1 - 1e-9):
        return (
            (
                f"a mesh must be at least {1e6 * SMALLEST:g} um long, and this one is"
                f" {1e6 * size:.3g} um"
            ),
            remedy,
        )
    return None


def volume_of(triangles: Array) -> float:
    """Volume enclosed by triangles (f, 3, 3), by the divergence theorem."""
    a, b, c = (triangles[:, k] - triangles[0, 0] for k in range(3))
    return float(np.einsum("fi,fi->", a, np.cross(b, c)) / 6)


def outline(text: str, within: float) -> Array:
    """Corners (f, 3, 3) of a stored mesh in its unit, without the triangles that are not needed to come this near to it, and needles."""
    found = _stored_solid(text).as_original().simplify(within).to_mesh64()
    return np.asarray(found.vert_properties[:, :3][found.tri_verts])


def pack_mesh(mesh: Mesh) -> str:
    """The text a scene keeps."""
    counts = np.array([len(mesh.vertices), len(mesh.faces)], "<i8")
    parts = (counts, mesh.vertices.astype("<f8"), mesh.faces.astype("<i4"))
    return (
        PREFIX + base64.b64encode(zlib.compress(b"".join(p.tobytes() for p in parts), 6)).decode()
    )


@lru_cache(maxsize=256)
def unpack_mesh(text: str) -> Mesh:
    """The mesh of a scene's text. Raises MeshError where the text is damaged."""
    try:
        packed = base64.b64decode(text.removeprefix(PREFIX), validate=True)
        stream = zlib.decompressobj()
        content = stream.decompress(
            packed, 16 + 84 * MOST_FACES
        )  # three vertices a face: a small text may stand for terabytes
        if not stream.eof:
            raise ValueError("it is cut off, or too large")
        v, f = (int(count) for count in np.frombuffer(content, "<i8", 2))
        if not (0 < v <= 3 * MOST_FACES and 0 < f <= MOST_FACES):
            raise ValueError("no mesh has so many vertices or faces")
        vertices = np.frombuffer(content, "<f8", 3 * v, 16).reshape(-1, 3)
        faces = np.frombuffer(content, "<i4", 3 * f, 16 + 24 * v).reshape(-1, 3)
        if not (np.isfinite(vertices).all() and faces.min() >= 0 and faces.max() < v):
            raise ValueError("a face names no vertex, or a vertex is nowhere")
    except (ValueError, zlib.error):
        raise MeshError(
            "the stored mesh is damaged", "make the scene from its file again"
        ) from None
    return Mesh(vertices, faces.astype(np.int64))


def read_mesh(value: Any, info: ValidationInfo, key: str) -> Any:
    """Validator of a key that names a mesh: the file's mesh as the text a scene keeps; such a text is taken as it is.

    Raises MissingPackage, about `key`, for a file's mesh without the package that meshes need.
    """
    if from_file(info):
        require("manifold3d", "parts", key=key, use="closed meshes")
    if not isinstance(value, (str, Path)):
        raise fault("must be the path of an STL file", "write, say, `mesh: meshes/base.stl`")
    try:
        if isinstance(value, str) and value.startswith(PREFIX):
            stored = unpack_mesh(value)
            if from_file(
                info
            ):  # a scene that magmpm keeps has been checked; one that is written need not have been
                checked(stored.vertices, stored.faces)
            return value
        return pack_mesh(read_stl(named_file(info, value)))
    except MeshError as error:
        raise fault(error.rule, error.remedy) from None


@lru_cache(maxsize=256)
def _stored_solid(text: str) -> Manifold:
    mesh = unpack_mesh(text)
    return solid_of(mesh.vertices, mesh.faces)


def _inward(mesh: Mesh, count: int) -> tuple[Array, Array]:
    """Points (count, 3) of the surface, drawn by area, and unit normals (count, 3) inward there."""
    triangles = mesh.triangles
    normal = face_normals(triangles)
    double = np.linalg.norm(normal, axis=1)
    rng = np.random.default_rng(0)
    share = np.cumsum(double) / double.sum()
    face = np.minimum(
        np.searchsorted(share, (np.arange(count) + rng.random(count)) / count), len(double) - 1
    )
    u = np.sqrt(rng.random((1, count)))
    v = rng.random((1, count))
    weights = np.concatenate([1 - u, u * (1 - v), u * v]).T
    return np.einsum("rk,rki->ri", weights, triangles[face]), -normal[face] / double[face, None]


def _covered_twice(solid: Manifold, mesh: Mesh) -> float:
    """Largest length of a line through the surface that is inside it more than once, or less than not at all."""
    lines = 100  # through the mesh, along which its surface is tried for crossing itself
    size = float(np.ptp(mesh.vertices, axis=0).max())
    most = 0.0
    for start, along in zip(*_inward(mesh, lines), strict=True):
        hits = solid.ray_cast(start - 2 * size * along, start + 2 * size * along)
        inside = -np.cumsum([np.sign(np.dot(hit.normal, along)) for hit in hits])[:-1]
        far = 4 * size * np.diff([hit.distance for hit in hits])
        most = max(most, float(far[(inside < 0) | (inside > 1)].sum()))
    return most


@lru_cache(maxsize=256)
def thickness_of(text: str) -> float:
    """Thickness of a stored mesh in its unit: along the normal inward, a tenth of its surface has the opposite one this near."""
    rays = 400  # points from which the thickness is measured
    mesh = unpack_mesh(text)
    size = float(np.ptp(mesh.vertices, axis=0).max())
    solid = _stored_solid(text)
    found = []
    for begin, inward in zip(*_inward(mesh, rays), strict=True):
        far = [2 * size * hit.distance for hit in solid.ray_cast(begin, begin + 2 * size * inward)]
        found += [x for x in far if x >= 1e-6 * size][
            :1
        ]  # nearer is the surface that the ray starts from
    return float(np.quantile(found, 0.1, method="inverted_cdf"))


def overlaps(texts: Sequence[str]) -> Iterator[tuple[int, int, float, float]]:
    """Pairs (i, j) of stored meshes, with the volumes that they share and that the smaller one has, in their unit cubed."""
    solids = [_stored_solid(text) for text in texts]
    for i, j in overlapping_boxes(solids):
        yield i, j, (solids[i] ^ solids[j]).volume(), min(solids[i].volume(), solids[j].volume())


def hollow(texts: Sequence[str], least: float = 1e-3) -> Iterator[int]:
    """Numbers of the stored meshes with a cavity of which the others leave at least this share empty."""
    solids = [_stored_solid(text) for text in texts]
    for k, solid in enumerate(solids):
        for shell in solid.decompose():
            if shell.volume() > 0.0:
                continue
            cavity = facing_outward(shell)
            empty = cavity
            for other in solids[:k] + solids[k + 1 :]:
                empty -= other
            if empty.volume() > least * cavity.volume():
                yield k


@lru_cache(maxsize=256)
def nearest_solids(text: str, within: float) -> float:
    """Smallest distance between two separate solids of one stored mesh, and at most `within`, in its unit; `within` where it is one."""
    mesh = unpack_mesh(text)
    solids = solids_of(mesh.vertices, mesh.faces)
    return min((a.min_gap(b, within) for a, b in itertools.combinations(solids, 2)), default=within)


@lru_cache(maxsize=256)
def _farthest(text: str) -> float:
    """Longest distance between two corners of a stored mesh's box, in its unit."""
    return float(np.linalg.norm(np.ptp(unpack_mesh(text).vertices, axis=0)))


def distance_to(text: str, point: Array, half: float) -> float:
    """Distance from a stored mesh's solid to a cube of this half width around a point (3,), in its unit; 0 where they meet."""
    from manifold3d import Manifold

    around = Manifold.cube((2 * half,) * 3, True).translate(point.tolist())
    most = _farthest(text) + float(np.linalg.norm(point - unpack_mesh(text).vertices[0]))
    return float(_stored_solid(text).min_gap(around, most))


@lru_cache(maxsize=1024)
def gap(one: str, other: str, within: float) -> float:
    """Smallest distance between two stored meshes, and at most `within`, in their unit."""
    return float(_stored_solid(one).min_gap(_stored_solid(other), within))
