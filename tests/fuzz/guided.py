"""`make fuzz-coverage`: the readers of meshes and tables under atheris, which looks for inputs that reach new code.

    python tests/fuzz/guided.py stl|axis|map|schedule|measured [-runs=N]
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import atheris

WATCHED = ["magmpm.inputs", "magmpm.bodies.surface_mesh", "magmpm.fields.measured_map", "studies.fitting.table"]
with atheris.instrument_imports(include=WATCHED):
    from magmpm import load_scene
    from magmpm.bodies.shells import MeshError
    from magmpm.bodies.surface_mesh import read_stl
    from magmpm.errors import InputError
    from magmpm.fields.measured_map import read_map, read_schedule
    from magmpm.inputs.csv_tables import read_centreline
    from studies.fitting.table import read_measured

ROOT = Path(__file__).resolve().parents[2]
SCENE = load_scene(ROOT / "data/scenes/axial_transverse.yaml")
READERS: dict[str, Callable[[Path], Any]] = {
    "stl": read_stl,
    "axis": read_centreline,
    "map": read_map,
    "schedule": read_schedule,
    "measured": lambda path: read_measured(path, SCENE),
}


def main(kind: str, *options: str) -> None:
    """Runs until libFuzzer stops; anything but a value, MeshError or InputError ends it with a traceback and the input in a file."""
    path = Path(tempfile.mkdtemp(prefix="magmpm-fuzz-")) / "input"

    def one(data: bytes) -> None:
        path.write_bytes(data)
        try:
            READERS[kind](path)
        except (InputError, MeshError):
            return

    atheris.Setup([sys.argv[0], *options], one)
    atheris.Fuzz()


if __name__ == "__main__":
    main(*sys.argv[1:])
