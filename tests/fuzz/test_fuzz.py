"""Whatever a file holds, its reader gives a sound value, or an InputError that says what to do: no traceback, hang or nonsense.

`make fuzz` runs 10 000 inputs, INPUTS=N another number; `make test` runs a few of each kind. A hang ends the process with a traceback.
Every input is a base with changes. Each base is accepted as it is, and `make fuzz` and `make test-long` run it: a mutant of a base that is
refused gets no further than that refusal.
"""

import faulthandler
import functools
import json
import math
import os
import struct
import tempfile
import traceback
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from reference.solids import box

import magmpm
from fuzz.hostile import (
    PARTS,
    REAL_ROBOTS,
    ROBOTS,
    ROOT,
    SCENES,
    STUDIES,
    damaged,
    documents,
    table,
    tables,
)
from magmpm.bodies.surface_mesh import write_stl
from magmpm.errors import InputError
from magmpm.inputs.csv_tables import read_centreline
from magmpm.results.file_names import ARRAYS, NUMBERS
from magmpm.results.result import Result
from magmpm.scene import Scene, load_scene
from magmpm.scene.magnetic_mpm_import import import_robot

INPUTS = int(os.environ.get("INPUTS", "0"))
SEED = int(os.environ.get("SEED", "1"))
LONGEST = 60.0  # s for one input: readers take milliseconds
SHARES = {
    "scene": 0.27,
    "study": 0.12,
    "axis": 0.1,
    "measured": 0.1,
    "in time": 0.04,
    "map": 0.07,
    "schedule": 0.05,
    "stl": 0.12,
    "part": 0.05,
    "robot": 0.04,
    "result": 0.04,
}
SMALLEST = 25  # of each kind, in `make test`


BAD: dict[str, dict[str, str]] = {}  # kind -> where it went wrong -> the input that did it
DONE: dict[str, int] = dict.fromkeys(SHARES, 0)
ACCEPTED: dict[str, int] = dict.fromkeys(SHARES, 0)
CHECKS: dict[
    str, Callable[..., bool]
] = {}  # kind -> whether an input is accepted; an AssertionError where it is nonsense
BASES: dict[str, list[dict[str, Any]]] = {}  # kind -> inputs before any change


def inputs(kind: str) -> Callable[[Any], Any]:
    """As many inputs of a kind as are asked for, as a decorator. All are tried; those that go wrong are kept in BAD."""
    count = max(SMALLEST, math.ceil(SHARES[kind] * INPUTS))
    every = settings(
        max_examples=count,
        deadline=None,
        suppress_health_check=list(HealthCheck),
        derandomize=not INPUTS,
        database=None,
        phases=[Phase.generate],
    )

    def decorate(test: Any) -> Any:
        CHECKS[kind], BASES[kind] = test, test.bases

        @functools.wraps(test)
        def tried(**given_values: Any) -> None:
            DONE[kind] += 1
            faulthandler.dump_traceback_later(LONGEST, exit=True)
            try:
                ACCEPTED[kind] += test(**given_values)
            except Exception as error:
                last = traceback.extract_tb(error.__traceback__)[-1]
                where = (
                    f"{type(error).__name__} in {Path(last.filename).name}:{last.lineno}:"
                    f" {str(error)[:200]}"
                )
                BAD.setdefault(kind, {}).setdefault(where, repr(given_values)[:20_000])
            finally:
                faulthandler.cancel_dump_traceback_later()

        def whole() -> None:
            run = every(given(**test.strategies)(tried))
            (seed(SEED)(run) if INPUTS else run)()
            assert not BAD.get(kind), "\n\n".join(
                f"{where}\n{what}" for where, what in BAD[kind].items()
            )

        whole.__name__ = test.__name__
        whole.__doc__ = test.__doc__
        return whole

    return decorate


def drawn(bases: list[dict[str, Any]], **strategies: Any) -> Callable[[Any], Any]:
    """Decorator below `inputs`: the bases from which a test's inputs are drawn."""

    def decorate(test: Any) -> Any:
        test.strategies = strategies
        test.bases = bases
        return test

    return decorate


@pytest.fixture(autouse=True)
def _here(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder with the tables and meshes that scenes and robots name, beside the hostile file."""
    folder = tmp_path_factory.mktemp("project")
    for name in ("targets", "references", "measured", "scenes"):
        (folder / name).symlink_to(ROOT / "data" / name)
    meshes = folder / "hostile" / "meshes"
    meshes.mkdir(parents=True)
    for path in (ROOT / "data/scenes/gallery").glob("*.csv"):
        (folder / "hostile" / path.name).symlink_to(path)
    for path in [*(ROOT / "data/scenes/gallery/meshes").iterdir(), *REAL_ROBOTS.glob("*/meshes/*")]:
        (meshes / path.name).symlink_to(path)
    write_stl(box((0, 0, -1), (1, 1, 0)), meshes / "base.STL")
    (meshes / "cube.STL").write_bytes(cube(False))
    monkeypatch.chdir(folder / "hostile")


def judged(read: Callable[[], Any]) -> Any:
    """Return what a reader gives; None for an input that it refuses with a rule and a remedy."""
    try:
        return read()
    except InputError as error:
        said = str(error)
    if not said.strip() or len(said) > 100_000:
        raise AssertionError("an error says something that can be read")
    return None


def sound(value: Any) -> bool:
    """Return True if all numbers in plain data are finite."""
    if isinstance(value, dict):
        return all(sound(item) for item in value.values())
    if isinstance(value, list | tuple):
        return all(sound(item) for item in value)
    return not isinstance(value, float) or math.isfinite(value)


def written(name: str, content: str | bytes) -> Path:
    path = Path(name)
    path.write_bytes(
        content.encode("utf-8", "surrogatepass") if isinstance(content, str) else content
    )
    return path


@inputs("scene")
@drawn([{"text": text} for text in SCENES], text=documents(SCENES))
def test_scenes(text: str) -> bool:
    """A scene that is taken has finite numbers, and is the same after a trip through plain data."""
    scene = judged(lambda: load_scene(written("scene.yaml", text)))
    if scene is not None:
        data = scene.to_si()
        assert sound(data)
        assert Scene.from_si(json.loads(json.dumps(data))).hash() == scene.hash()
        assert scene.name
        assert "/" not in scene.name
    return scene is not None


@inputs("study")
@drawn([{"text": text} for text in STUDIES], text=documents(STUDIES))
def test_studies(text: str) -> bool:
    from magmpm.studies.search.definition import load_study

    study = judged(lambda: load_study(written("study.yaml", text)))
    if study is not None:
        assert 1 <= study.trials <= 1_000_000
        assert np.isfinite(study.target).all()
    return study is not None


def of_tables(headers: list[str], rows: list[list[str]]) -> dict[str, Any]:
    """Bases of tables with these headers, and what is drawn from them."""
    return {
        "bases": [{"content": table(header, rows).encode()} for header in headers],
        "content": tables(headers, rows),
    }


AXIS = [["0", "0", "0", "0"], ["10", "9", "0", "1"], ["20", "18", "0", "3"]]


@inputs("axis")
@drawn(**of_tables(["s_mm,x_mm,y_mm,z_mm", "x_mm,s_mm,z_mm,y_mm"], AXIS))
def test_tables_of_axes(content: bytes) -> bool:
    rows = judged(lambda: read_centreline(written("axis.csv", content)))
    if rows is not None:
        assert np.isfinite(rows).all()
        assert np.all(np.diff(rows[:, 0]) > 0)
        assert np.abs(rows).max() <= 10.0
    return rows is not None


AT_REST = of_tables(
    [
        "field_z_mT,tip_x_mm,tip_z_mm",
        "field_mT,tip_x_mm,tip_angle_deg",
        "s_mm,x_mm,y_mm,z_mm",
        "field_x_mT,field_y_mT,x_mm,z_mm",
        "x_mm,z_mm",
        "marker,s_mm,x_mm",
    ],
    [["1", "39", "5"], ["2", "38", "10"], ["3", "36", "15"]],
)
IN_MOTION = of_tables(
    ["t_ms,s_mm,x_mm,y_mm,z_mm", "t_ms,tip_x_mm"],
    [["1", "39", "5"], ["2", "38", "10"], ["3", "36", "15"]],
)
STATIC = load_scene(ROOT / "data/scenes/axial_transverse.yaml")
MOVING = Scene.from_si(
    {
        **STATIC.to_si(),
        "solver": {"dynamic": {"duration": 0.1}},
        "materials": {
            "magnetic silicone": {
                "shear_modulus": 120e3,
                "bulk_to_shear": 20.0,
                "remanence": 0.1,
                "density": 1882.0,
            }
        },
    }
)


def measured_by(content: bytes, scene: Scene) -> bool:
    from magmpm.studies.fitting import read_measured

    measured = judged(lambda: read_measured(written("tips.csv", content), scene))
    if measured is not None:
        assert measured.numbers > 0
        for state in measured.states:
            assert state.field is None or np.isfinite(state.field).all()
            assert not np.isinf(state.points).any()
    return measured is not None


@inputs("measured")
@drawn(**AT_REST)
def test_measurements(content: bytes) -> bool:
    return measured_by(content, STATIC)


@inputs("in time")
@drawn(**IN_MOTION)
def test_measurements_in_time(content: bytes) -> bool:
    return measured_by(content, MOVING)


MAP = [
    [str(x), str(y), str(z), "1", "0", "2"] for x in range(4) for y in range(4) for z in range(4)
]


@inputs("map")
@drawn(**of_tables(["x_mm,y_mm,z_mm,Bx_mT,By_mT,Bz_mT", "x_m,y_m,z_m,Bx_T,By_T,Bz_T"], MAP))
def test_maps(content: bytes) -> bool:
    from magmpm.fields.measured_map import read_map

    found = judged(lambda: read_map(written("map.csv", content)))
    assert found is None or all(np.isfinite(part).all() for part in found)
    return found is not None


@inputs("schedule")
@drawn(
    **of_tables(
        ["time_s,strength", "time_ms,Bx_mT,By_mT,Bz_mT"],
        [["0", "0", "0", "1"], ["1", "1", "0", "2"]],
    )
)
def test_schedules(content: bytes) -> bool:
    from magmpm.fields.measured_map import read_schedule

    return judged(lambda: read_schedule(written("schedule.csv", content))) is not None


def cube(text: bool) -> bytes:
    """A unit cube as STL."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    sides = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    faces = [corner for a, b, c, d in sides for corner in ((a, b, c), (a, c, d))]
    if text:
        of = (
            "\n".join("vertex " + " ".join(f"{x:g}" for x in corners[v]) for v in face)
            for face in faces
        )
        facets = "\n".join(
            f"facet normal 0 0 0\nouter loop\n{loop}\nendloop\nendfacet" for loop in of
        )
        return f"solid cube\n{facets}\nendsolid".encode()
    records = b"".join(
        struct.pack("<12fH", 0, 0, 0, *corners[list(face)].ravel(), 0) for face in faces
    )
    return bytes(80) + struct.pack("<I", 12) + records


@st.composite
def meshes(draw: Callable[..., Any]) -> bytes:
    """An STL file with bytes damaged, its count of triangles false, or coordinates replaced."""
    content = cube(draw(st.booleans()))
    change = draw(st.sampled_from(["bytes", "count", "coordinate", "random"]))
    if change == "bytes":
        return bytes(draw(damaged(content)))
    if change == "random":
        return bytes(draw(st.binary(max_size=300)))
    binary = bytearray(cube(False))
    if change == "count":
        binary[80:84] = struct.pack("<I", draw(st.integers(0, 2**32 - 1)))
    for _ in range(draw(st.integers(0, 4))):
        at = 84 + 50 * draw(st.integers(0, 11)) + 12 + 4 * draw(st.integers(0, 8))
        binary[at : at + 4] = struct.pack("<f", draw(st.floats(width=32)))
    return bytes(binary)


CUBES = [{"content": cube(text)} for text in (True, False)]


@inputs("stl")
@drawn(CUBES, content=meshes())
def test_meshes(content: bytes) -> bool:
    """A mesh that is taken encloses a volume."""
    from magmpm.bodies.shells import MeshError
    from magmpm.bodies.surface_mesh import read_stl, volume_of

    def read() -> Any:
        try:
            return read_stl(written("part.stl", content))
        except MeshError as error:
            raise InputError(f"{error.rule} {error.remedy}") from None

    mesh = judged(read)
    assert mesh is None or (np.isfinite(mesh.vertices).all() and volume_of(mesh.triangles) > 0)
    return mesh is not None


@inputs("part")
@drawn(
    [{"text": PARTS, **base} for base in CUBES],
    text=st.just(PARTS) | documents([PARTS]),
    content=meshes(),
)
def test_parts(text: str, content: bytes) -> bool:
    """Bodies of two parts, one of them this mesh."""
    written("part.stl", content)
    return CHECKS["scene"](text)


@inputs("robot")
@drawn([{"text": text} for text in ROBOTS], text=documents(ROBOTS))
def test_robots(text: str) -> bool:
    return (
        judged(lambda: import_robot(written("robot.yaml", text), Path("made.yaml"), overwrite=True))
        is not None
    )


def saved() -> dict[str, bytes]:
    """Both files of a result that has a small value of each field's type."""
    small = {
        "str": "x",
        "bool": True,
        "int": 1,
        "float": 1.0,
        "dict": {},
        "list": [],
        "Array": np.ones((2, 4)),
        "NDArray": np.ones(2, int),
    }
    folder = Path(tempfile.mkdtemp(prefix="magmpm-fuzz-"))
    Result(**{f.name: small[str(f.type).split("[")[0].split(" ")[0]] for f in fields(Result)}).save(
        folder
    )  # type: ignore[arg-type]
    return {"content": (folder / NUMBERS).read_bytes(), "arrays": (folder / ARRAYS).read_bytes()}


SAVED = saved()
nonsense = st.recursive(st.none() | st.floats() | st.text(), st.lists).map(
    lambda data: json.dumps(data).encode()
)


@inputs("result")
@drawn(
    [SAVED],
    content=st.just(SAVED["content"]) | damaged(SAVED["content"]) | nonsense,
    arrays=st.just(SAVED["arrays"]) | damaged(SAVED["arrays"]) | st.binary(max_size=200),
)
def test_saved_results(content: bytes, arrays: bytes) -> bool:
    folder = Path("run")
    folder.mkdir(exist_ok=True)
    (folder / NUMBERS).write_bytes(content)
    (folder / ARRAYS).write_bytes(arrays)
    return judged(lambda: Result.load(folder)) is not None


@pytest.mark.parametrize("kind", SHARES)
def test_bases_are_accepted(kind: str) -> None:
    for base in BASES[kind]:
        assert CHECKS[kind](**base)


def coarse(scene: Scene) -> Scene:
    """The scene with two cells across, and 0.1 ms of its motion."""
    data = scene.to_si()
    data["resolution"] = {"cells_across": 2}
    if data["solver"]["dynamic"]:
        data["solver"]["dynamic"].update(duration=1e-4, output_every=1e-4)
    return Scene.from_si(data)


RUN = [
    (kind, number)
    for kind in ("scene", "part", "robot", "study")
    for number in range(len(BASES[kind]))
]


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "number"), RUN)
def test_bases_run(kind: str, number: int, tmp_path: Path) -> None:
    """Scenes (among them one with a measured map and one with a table over time), parts, robots, and one trial of each study."""
    base = BASES[kind][number]
    if "content" in base:
        written("part.stl", base["content"])
    path = written(f"{kind}.yaml", base["text"])
    if kind == "study":
        assert magmpm.design(path, folder=tmp_path, trials=1).best is not None
        return
    if kind == "robot":
        import_robot(path, path := Path("made.yaml"), overwrite=True)
    assert magmpm.run(coarse(load_scene(path))).particles > 0


def test_table_of_all() -> None:
    """Table that `make fuzz` prints: inputs of each kind, how many were accepted, and the kinds of failure."""
    rows = [
        f"{kind:<12}{DONE[kind]:>8}{ACCEPTED[kind]:>10}{len(BAD.get(kind, {})):>8}"
        for kind in SHARES
    ]
    total = f"{'all':<12}{sum(DONE.values()):>8}{sum(ACCEPTED.values()):>10}{sum(map(len, BAD.values())):>8}"
    print("\n".join(["", f"{'inputs':<12}{'tried':>8}{'accepted':>10}{'bad':>8}", *rows, total]))
    assert not BAD
