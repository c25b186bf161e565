"""Data for the page of a scene: the body's surface as it moves, its magnetization's arrows, and what stands around it."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from magmpm.compiled.arrays import Named, Plain
from magmpm.scene import Scene
from magmpm.viz import style
from magmpm.viz.binding import gradients
from magmpm.viz.body import DrawnBody
from magmpm.viz.from_motion import gravity_of
from magmpm.viz.from_result import segment_arrows
from magmpm.viz.obstacles import ground, sources, standing
from magmpm.viz.snapshot import DrawnSolid, spread


class DeformedBody(Protocol):
    """Interface of a shape to draw: as studies.explore.live.solver.DeformedShape has it."""

    @property
    def reference(self) -> np.ndarray: ...

    @property
    def position(self) -> np.ndarray: ...

    @property
    def volume(self) -> np.ndarray: ...

    @property
    def part(self) -> np.ndarray: ...

    @property
    def axis(self) -> np.ndarray: ...

    @property
    def center(self) -> np.ndarray: ...

    @property
    def remanence(self) -> np.ndarray: ...

    @property
    def field(self) -> np.ndarray: ...


class Stage:
    """Turns shapes into messages for the page. The triangles of a surface are sent once; its points every time."""

    def __init__(self) -> None:
        self._bodies: dict[str, DrawnBody] = {}

    def message(self, scene: Scene, shape: DeformedBody, known: str, about: Plain) -> bytes:
        """A shape of a scene. known: name of the surface that the page has; about: what else its header says."""
        name, body = self._body(scene, shape)
        arrays = {
            "points": np.nan_to_num(body.points(shape.position)),
            "axis": shape.axis,
            "arrows": self._arrows(scene, body, shape),
        }
        header = {
            **about,
            "surface": name,
            "field": shape.field,
            "arrow_width": style.ARROW_WIDTH * body.thickness,
        }
        if name != known:
            arrays |= surface_arrays(body)
        if name != known or scene.field.varies:
            put_obstacles(obstacles_of(scene), header, arrays)
        return packed(header, arrays)

    def _body(self, scene: Scene, shape: DeformedBody) -> tuple[str, DrawnBody]:
        """Name and surface of this undeformed body. A surface is made once and kept."""
        magnetized = np.linalg.norm(scene.region_remanence(), axis=1) > 0
        name = (
            f"{scene.length:.9g}/{len(shape.reference)}/{''.join(str(int(m)) for m in magnetized)}"
        )
        if name not in self._bodies:
            while (
                len(self._bodies) >= 24
            ):  # surfaces of bodies: one for each length outside a guide that was seen
                self._bodies.pop(next(iter(self._bodies)))
            self._bodies[name] = DrawnBody(
                scene, shape.reference, shape.volume, shape.part, _remanence(scene, shape)
            )
        return name, self._bodies[name]

    @staticmethod
    def _arrows(scene: Scene, body: DrawnBody, shape: DeformedBody) -> np.ndarray:
        """One arrow a region; where the magnetization turns within one, several along it."""
        if len(shape.axis) > 1 and scene.body.shape.magnetized_by_region:
            return segment_arrows(
                shape.axis, shape.center, shape.remanence, body.length, body.thickness
            )
        turned = gradients(shape.reference, shape.position)
        return body.arrows(
            shape.position, np.einsum("nij,nj->ni", turned, _remanence(scene, shape))
        )


def _remanence(scene: Scene, shape: DeformedBody) -> np.ndarray:
    """(n, 3) T of the undeformed particles."""
    strength = np.array(
        [scene.materials[region.material_name].remanence for region in scene.regions()]
    )
    places = _Places(shape.reference, shape.part)
    directions = scene.body.shape.magnetization(places)  # type: ignore[arg-type]
    return strength[shape.part, None] * directions


class _Places:
    """Particles as a body's magnetization requires them."""

    def __init__(self, position: np.ndarray, segment: np.ndarray) -> None:
        self.position = position
        self.segment = segment


def surface_arrays(body: DrawnBody) -> dict[str, np.ndarray]:
    """Triangles (m, 3) and colors (n, 3) of a body's surface."""
    colors = style.segment_colors(body.magnetized)
    colors[body.held] = style.rgb(style.HELD)
    return {"triangles": body.surface.triangles, "colors": colors[body.surface.part_of_point]}


def obstacles_of(scene: Scene, time: float | None = None) -> list[DrawnSolid]:
    """Obstacles around the body: clamps, walls and guides, and the field's sources at a time (s) or the end of their schedule."""
    return [*standing(scene), *sources(scene, time)]


def put_obstacles(
    obstacles: list[DrawnSolid], header: Plain, arrays: dict[str, np.ndarray]
) -> None:
    """Put obstacles into a message."""
    header["obstacles"] = []
    for k, one in enumerate(obstacles):
        name = f"obstacle{k}"
        header["obstacles"].append(
            {
                "id": name,
                "name": one.name,
                "color": one.color,
                "hollow": one.hollow,
                "framed": one.framed,
            }
        )
        arrays[f"{name}.points"], arrays[f"{name}.triangles"] = one.points, one.triangles


def _region_colors(scene: Scene) -> dict[str, str]:
    """The color of each region by its name, as the sliders' groups are named."""
    colors = style.segment_colors(np.linalg.norm(scene.region_remanence(), axis=1) > 0)
    names = [region.name[:1].upper() + region.name[1:] for region in scene.regions()]
    return {
        name: "#" + "".join(f"{round(255 * c):02x}" for c in color)
        for name, color in zip(names, colors.tolist(), strict=True)
    }


def about_scene(scene: Scene, target: np.ndarray | None, target_name: str) -> Plain:
    """Data of a scene that the page gets once: its size, what holds, and the colors of marks; target (q, 3) m or None."""
    plane = ground(scene)
    gravity = gravity_of(scene)
    low, high = np.array(scene.box())
    return {
        "name": scene.name,
        "length": scene.length,
        "thickness": scene.thickness,
        "box": [low.tolist(), high.tolist()],
        "gravity": None if gravity is None else gravity.tolist(),
        "ground": (
            None
            if plane is None
            else {"point": plane.point.tolist(), "normal": plane.normal.tolist()}
        ),
        "target": None if target is None else spread(np.asarray(target)[:, -3:]).tolist(),
        "target_name": target_name,
        "region_colors": _region_colors(scene),
        "colors": {
            "target": style.TARGET,
            "magnetization": style.MAGNETIZATION,
            "field": style.FIELD,
            "ink": style.INK,
            "faint": style.FAINT_INK,
            "alarm": style.ALARM,
            "floor": style.GRID,
            "trace": style.TRACE,
        },
    }


def packed(header: Named, arrays: Mapping[str, np.ndarray]) -> bytes:
    """A message to the page: a JSON header, then arrays of single precision or whole numbers, one after the other.

    4 bytes: length of the header (little-endian); the header, filled up with spaces to a multiple of 4; the arrays. The header's `arrays`
    says of each its name, kind (f: 32-bit float, u: 32-bit whole number) and count. Numbers of the header that are not finite become null.
    """
    flat = {
        name: (
            np.ascontiguousarray(
                array, dtype="<u4" if np.issubdtype(array.dtype, np.integer) else "<f4"
            ).ravel()
        )
        for name, array in arrays.items()
    }
    about = [
        {"name": name, "kind": "u" if array.dtype.kind == "u" else "f", "count": len(array)}
        for name, array in flat.items()
    ]
    head = json.dumps(finite({**header, "arrays": about})).encode()
    head += b" " * (-len(head) % 4)
    return b"".join(
        [struct.pack("<I", len(head)), head, *(array.tobytes() for array in flat.values())]
    )


def finite(value: Any) -> Any:
    """Plain data without numbers that JSON does not know."""
    if isinstance(value, Mapping):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(item) for item in value]
    if isinstance(value, np.ndarray):
        return finite(value.tolist())
    if isinstance(value, (float, np.floating)):
        return float(value) if np.isfinite(value) else None
    return int(value) if isinstance(value, np.integer) else value
