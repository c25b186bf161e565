"""Meshes that are written into a scene as text, as magmpm keeps them: from someone else they may hold anything."""

from __future__ import annotations

import base64
import zlib
from pathlib import Path

import numpy as np
import pytest
import yaml

from magmpm.bodies.surface_mesh import PREFIX, MeshError, read_stl, unpack_mesh
from magmpm.errors import InputError
from magmpm.scene import load_scene


def text_of(content: bytes) -> str:
    return PREFIX + base64.b64encode(zlib.compress(content, 9)).decode()


def triangle(last: int) -> bytes:
    """One triangle of three vertices; last: the number of its last vertex."""
    return np.array([3, 1], "<i8").tobytes() + np.eye(3).tobytes() + np.array([0, 1, last], "<i4").tobytes()


HOSTILE = {"bomb": bytes(50_000_000), "far": triangle(10**6), "negative": triangle(-1), "empty": b"", "none": bytes(16)}
TEXTS = {name: text_of(content) for name, content in HOSTILE.items()} | {"cut off": text_of(triangle(2))[:-8]}


@pytest.mark.parametrize("text", TEXTS.values(), ids=TEXTS)
def test_a_damaged_text_is_refused(text: str) -> None:
    """Before memory is taken for what a small text stands for, and before a face's number is used."""
    with pytest.raises(MeshError, match="damaged"):
        unpack_mesh(text)


def test_a_text_in_a_file_is_checked_as_a_mesh_is(tmp_path: Path) -> None:
    part = {"mesh": text_of(triangle(2)), "material": "s", "clamp": True}
    materials = {"s": {"shear_modulus": "100 kPa", "bulk_to_shear": 20}}
    file = tmp_path / "scene.yaml"
    data = {"name": "x", "materials": materials, "body": {"parts": {"unit": "mm", "meshes": [part]}}}
    file.write_text(yaml.safe_dump(data), encoding="utf-8")
    with pytest.raises(InputError, match="watertight"):
        load_scene(file)


def test_a_mesh_whose_vertices_all_count_as_one_is_refused(tmp_path: Path) -> None:
    """A vertex that is far away makes all others near each other, so that no triangle is left (found by `make fuzz-coverage`)."""
    corners = np.zeros((4, 3, 3), "<f4")
    corners[:, 1], corners[:, 2] = [1e-3, 0, 0], [0, 1e-3, 0]  # mm
    corners[3, 2] = [1e8, 0, 0]
    corners[3, 1] = [1e8, 0, 0]
    records = np.zeros(4, np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]))
    records["corners"] = corners
    path = tmp_path / "far.stl"
    path.write_bytes(bytes(80) + len(records).to_bytes(4, "little") + records.tobytes())
    with pytest.raises(MeshError, match="encloses none"):
        read_stl(path)
