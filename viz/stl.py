"""The deformed surface of a result as an STL file, in millimeters, as other programs expect."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from magmpm.results.whole_file import whole_file
from magmpm.viz.from_result import deformed_surface

TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])  # binary STL, 50 bytes


def write_stl(result: Any, path: Path) -> Path:
    """Write the deformed surface of a result into a binary STL file, whole or not at all; lengths in mm. Returns the path."""
    surface = deformed_surface(result)
    corners = 1e3 * np.asarray(surface.points, dtype=float)[surface.triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    rows = np.zeros(len(corners), dtype=TRIANGLE)
    rows["corners"] = corners
    rows["normal"] = across / np.maximum(np.linalg.norm(across, axis=1), 1e-300)[:, None]
    with whole_file(path) as part:
        part.write_bytes(b"magmpm, millimeters".ljust(80) + np.uint32(len(rows)).tobytes() + rows.tobytes())
    return path
