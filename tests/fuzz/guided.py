"""`make fuzz-coverage`: the readers of meshes and tables under atheris, which looks for inputs that reach new code.

    python tests/fuzz/guided.py stl|axis|map|schedule|measured [-runs=N]

It begins at files that are sound, and knows the words of headers. What breaks a reader is left in runs/fuzz.
"""

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import atheris

WATCHED = [
    "magmpm.inputs",
    "magmpm.bodies.surface_mesh",
    "magmpm.fields.measured_map",
    "magmpm.studies.fitting.table",
]
with atheris.instrument_imports(include=WATCHED):
    from magmpm import load_scene
    from magmpm.bodies.shells import MeshError
    from magmpm.bodies.surface_mesh import read_stl
    from magmpm.errors import InputError
    from magmpm.fields.measured_map import read_map, read_schedule
    from magmpm.inputs.csv_tables import read_centreline
    from magmpm.studies.fitting.table import read_measured

ROOT = Path(__file__).resolve().parents[2]
SCENE = load_scene(ROOT / "data/scenes/axial_transverse.yaml")
READERS: dict[str, Callable[[Path], Any]] = {
    "stl": read_stl,
    "axis": read_centreline,
    "map": read_map,
    "schedule": read_schedule,
    "measured": lambda path: read_measured(path, SCENE),
}


BOX = [f"{x},{y},{z},0,{x + y},{z + 1}" for z in range(4) for y in range(4) for x in range(4)]
SEEDS: dict[str, list[bytes]] = {
    "stl": [(ROOT / "data/scenes/gallery/meshes/gripper_inner_1.stl").read_bytes()],
    "axis": [
        (ROOT / "data/targets/s_shape.csv").read_bytes(),
        b"s_mm,x_mm,y_mm,z_mm\n0,0,0,0\n20,20,0,0\n40,39,1,0\n",
    ],
    "map": ["\n".join(["x_mm,y_mm,z_mm,Bx_mT,By_mT,Bz_mT", *BOX, ""]).encode()],
    "schedule": [b"time_s,strength\n0,0\n1,1\n", b"time_ms,Bx_mT,By_mT,Bz_mT\n0,0,0,1\n1,1,0,2\n"],
    "measured": [
        b"field_z_mT,tip_x_mm,tip_z_mm,tip_angle_deg,marker\n3,36,14,50,a\n4,35,,55,b\n",
        b"field_mT,s_mm,x_mm,y_mm,z_mm\n3,13,12,0.1,2\n",
        b"x_mm,z_mm\n10,1\n30,8\n# note\n",
    ],
}
QUANTITIES = (
    "tip_x",
    "tip_angle",
    "field",
    "field_z",
    "s",
    "x",
    "y",
    "z",
    "t",
    "time",
    "Bx",
    "By",
    "Bz",
)
UNITS = ("mm", "m", "mT", "T", "deg", "s", "ms")
WORDS = [f"{name}_{unit}" for name in QUANTITIES for unit in UNITS] + [
    "strength",
    "solid",
    "facet normal",
    "vertex",
    "endfacet",
    "nan",
    "1e999",
]


def main(kind: str, *options: str) -> None:
    """Runs until libFuzzer stops; anything but a value, MeshError or InputError ends it with a traceback and the input in a file."""
    folder = Path(tempfile.mkdtemp(prefix="magmpm-fuzz-"))
    path = folder / "input"
    corpus = folder / "corpus"
    words = folder / "words"
    broken = ROOT / "runs/fuzz"
    corpus.mkdir()
    broken.mkdir(parents=True, exist_ok=True)
    for k, seed in enumerate(SEEDS[kind]):
        (corpus / str(k)).write_bytes(seed)
        READERS[kind](corpus / str(k))  # a seed that is refused leads no further than its refusal
    words.write_text("".join(f'"{word}"\n' for word in WORDS))

    def one(data: bytes) -> None:
        path.write_bytes(data)
        try:
            READERS[kind](path)
        except (InputError, MeshError):
            return

    atheris.Setup(
        [
            sys.argv[0],
            f"-dict={words}",
            f"-artifact_prefix={broken}/{kind}-",
            "-max_len=4096",
            *options,
            str(corpus),
        ],
        one,
    )
    atheris.Fuzz()


if __name__ == "__main__":
    main(*sys.argv[1:])
