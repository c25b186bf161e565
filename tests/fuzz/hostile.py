"""Hostile inputs: shipped files with parts replaced, removed, repeated and garbled, drawn by Hypothesis."""

import copy
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import yaml
from hypothesis import strategies as st

ROOT = Path(__file__).resolve().parents[2]
REAL_ROBOTS = (
    ROOT.parent / "shared/robots"
)  # robots of the magneticMPM format, if they lie beside the project


def texts(files: Iterable[Path]) -> list[str]:
    return [path.read_text(encoding="utf-8") for path in sorted(files)]


ROBOT = """name: Tiny
n_segments: 2
remenance: 0.138
segments:
- {mesh: base.STL, magnetisation_vector: [0, 0, 0], density: 927, shear_modulus: 120000, fixed: true}
- {mesh: cube.STL, magnetisation_vector: [0.8, 0, 0.6], density: 1882, shear_modulus: 120000, fixed: false}
"""
PARTS = """name: two parts
materials:
  rubber: {shear_modulus: 120 kPa, bulk_to_shear: 20, density: 1882 kg/m^3, remanence: 100 mT}
body:
  parts:
    unit: mm
    meshes:
    - {mesh: meshes/base.STL, material: rubber, clamp: true}
    - {mesh: part.stl, material: rubber, magnetization: [1, 0, 0]}
field: {uniform: [0 mT, 0 mT, 8 mT]}
effects: {magnetic_torque: {}, gravity: {}}
solver: {static: {}}
resolution: {cells_across: 2}
"""
SCENES = texts((ROOT / "data/scenes").rglob("*.yaml"))
STUDIES = texts((ROOT / "data/studies").glob("*.yaml"))
ROBOTS = [ROBOT, *texts(REAL_ROBOTS.rglob("*.yaml"))]

SCRIPT = "<script>alert(1)</script>"
_QUANTITIES = [
    "",
    "nan",
    "inf mm",
    "0 mm",
    "-1 mm",
    "1e308 m",
    "1e-320 m",
    "1e999 T",
    "40",
    "40 mm mm",
    "40 m**999",
    "1 mm^999999999",
    "1e5000 mm",
    "\u0664\u0660 mm",
    "40\xa0mm",
    "1_000 mm",
    "0x10 mm",
    "1/0 mm",
    "5 %",
    "-5 %",
    "120 kPa",
    "8 mT",
    "1 GB",
    "30 deg",
    "1 s",
    "1000000 s",
    "5 us",
    "9.81 m/s^2",
    "auto",
    "off",
    "static",
]
_NAMES = [
    "../../../../../etc/passwd",
    "/etc/passwd",
    "/dev/zero",
    "/dev/random",
    "/proc/self/mem",
    ".",
    "..",
    "~",
    "file.csv",
    "\x00",
    "a\x00b",
    "CON",
    "a/b",
    "..\\..\\x",
    SCRIPT,
    "'; DROP TABLE trials; --",
    "$(touch /tmp/magmpm-owned)",
    "`id`",
    "%s%n{0.__class__}",
    "{self}",
    "\u202etxt.exe",
    "\ud7ff",
    "\U0001f4a5" * 50,
    "x" * 5000,
    "!!python/object/apply:os.system ['id']",
    "__import__('os').system('id')",
    "mesh:AAAA",
    "mesh:eJwDAAAAAAE=",
]
_PARTS: list[Any] = [
    [],
    [[]],
    {},
    [0, 0, 0],
    ["0 mT"] * 3,
    [1, 0],
    [1, 0, 0, 0],
    [1e200, 1e200, 0],
    [1e-200, 0, 0],
    ["nan mT"] * 3,
    [None] * 3,
    {"a": 1},
    {"__class__": "x"},
    {"steps": 10**9},
    {"cells_across": 10**6},
    {"error": "1e-30 %"},
    {"seconds": "1e-9 s"},
    [["0 s", "1 s"]] * 50,
    [{"magnetization": [1, 0, 0]}] * 300,
    {"static": {}, "dynamic": {}},
    {"dynamic": {"duration": "1e4 s", "output_every": "1 us"}},
    {"azimuth": "30 deg"},
    {"keyframes": []},
    {"max": "1e9 T"},
    {"depths": 10**9},
    {"point": [0, 0, 0]},
]
_NUMBERS: list[Any] = [
    None,
    True,
    False,
    0,
    -1,
    1,
    2,
    10**9,
    10**400,
    -(10**30),
    -0.0,
    1e308,
    5e-324,
    float("nan"),
    float("inf"),
]
NASTY: list[Any] = [*_NUMBERS, *_QUANTITIES, *_NAMES, *_PARTS]  # values that programs stumble over
short = st.text(max_size=30) | st.binary(max_size=8).map(lambda b: b.decode("latin-1"))
values = st.sampled_from(NASTY) | st.floats() | st.integers() | short
numbers = (
    st.floats(allow_nan=True, allow_infinity=True)
    | st.integers()
    | st.sampled_from([1e308, -1e308, 5e-324, 1e-300, 0.0, -0.0, 1e16])
)


def places(data: Any, at: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths of everything in a document."""
    found = [at] if at else []
    items = (
        data.items()
        if isinstance(data, dict)
        else enumerate(data)
        if isinstance(data, list)
        else ()
    )
    return found + [place for key, value in items for place in places(value, (*at, key))]


def _into(data: Any, at: tuple[Any, ...]) -> Any:
    for key in at[:-1]:
        data = data[key]
    return data


@st.composite
def documents(draw: Callable[..., Any], sources: list[str]) -> str:
    """One of these YAML texts after one to four changes of its content or its text."""
    data = yaml.safe_load(draw(st.sampled_from(sources)))
    for _ in range(draw(st.integers(1, 4))):
        known = places(data)
        if not known:
            break
        at = draw(st.sampled_from(known))
        holder = _into(data, at)
        change = draw(
            st.sampled_from(
                ["value", "value", "value", "unit", "remove", "rename", "graft", "repeat"]
            )
        )
        if change == "value":
            holder[at[-1]] = copy.deepcopy(draw(values))  # it may be changed in turn
        elif change == "unit" and isinstance(holder[at[-1]], str):
            holder[at[-1]] = f"{draw(numbers)} {holder[at[-1]].rpartition(' ')[2]}"
        elif change == "remove":
            del holder[at[-1]]
        elif change == "rename" and isinstance(holder, dict):
            holder[
                str(
                    draw(st.text(max_size=12) | st.sampled_from(["mesh", "table", "scene", SCRIPT]))
                )
            ] = holder.pop(at[-1])
        elif change == "graft":
            holder[at[-1]] = (
                copy.deepcopy(_into(data, other)[other[-1]])
                if (other := draw(st.sampled_from(known)))
                else None
            )
        elif change == "repeat" and isinstance(holder, list):
            holder.extend([copy.deepcopy(holder[at[-1]])] * draw(st.sampled_from([1, 50, 2000])))
    text = yaml.safe_dump(
        data,
        allow_unicode=True,
        sort_keys=False,
        default_flow_style=draw(st.sampled_from([None, False])),
    )
    return str(draw(garbled(text))) if draw(st.integers(0, 4)) == 0 else text


BOMB = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{chr(98 + k)}: &{chr(98 + k)} [{', '.join(['*' + chr(97 + k)] * 9)}]\n" for k in range(12)
)
_SIGNS = ["\t", "\x00", "\r", "\ufeff", "'", '"', "? ", "---\n", "%YAML 9.9\n"]
INSERTS = [
    *_SIGNS,
    "{" * 2000,
    "[" * 2000,
    "- " * 3000,
    "&a *a",
    "<<: *x\n",
    "!!python/name:os.system ",
    BOMB,
]


@st.composite
def garbled(draw: Callable[..., Any], text: str) -> str:
    """A text with pieces cut out, doubled, and put in."""
    for _ in range(draw(st.integers(1, 3))):
        a, b = sorted((draw(st.integers(0, len(text))), draw(st.integers(0, len(text)))))
        b = min(b, a + draw(st.sampled_from([1, 10, 1000])))
        middle = draw(st.sampled_from(["", text[a:b] * 2, *INSERTS]) | st.text(max_size=20))
        text = text[:a] + middle + text[b:]
    return text


_ODD = [
    "",
    " ",
    "nan",
    "inf",
    "-inf",
    "1e400",
    "1e-400",
    "0x1F",
    "1_0",
    "\u0661",
    "1,0",
    '"1"',
    "=1+1",
    "-",
    "abc",
    "\x00",
]
CELLS = [*_ODD, "0", "-0", "1e9", "9" * 400, "1;2", SCRIPT]


def table(header: str, rows: list[list[str]]) -> str:
    """A CSV table; each row is repeated or cut to the header's width."""
    width = header.count(",") + 1
    return "\n".join([header, *(",".join((row * width)[:width]) for row in rows)])


@st.composite
def tables(draw: Callable[..., Any], headers: list[str], rows: list[list[str]]) -> bytes:
    """A CSV table after changes of its header, cells and bytes."""
    header, *lines = (
        line.split(",") for line in table(draw(st.sampled_from(headers)), rows).split("\n")
    )
    for _ in range(draw(st.integers(0, 4))):
        change = draw(st.sampled_from(["cell", "cell", "number", "header", "row", "swap", "many"]))
        if change == "header":
            k = draw(st.integers(0, len(header) - 1))
            header[k] = draw(
                st.sampled_from([*CELLS, *header, "x_mm", "tip_x_mm", "t_ms", "s_mm", "field_T"])
                | st.text(max_size=10)
            )
        elif change == "row" and lines:
            lines.insert(
                draw(st.integers(0, len(lines))), draw(st.lists(st.sampled_from(CELLS), max_size=6))
            )
        elif change == "swap" and len(lines) > 1:
            lines.reverse()
        elif change == "many" and lines:
            lines = lines * draw(st.sampled_from([2, 100]))
        elif lines:
            row = lines[draw(st.integers(0, len(lines) - 1))]
            if row:
                k = draw(st.integers(0, len(row) - 1))
                row[k] = str(draw(numbers)) if change == "number" else draw(st.sampled_from(CELLS))
    data = "\n".join(",".join(cells) for cells in [header, *lines]).encode("utf-8", "surrogatepass")
    return bytes(draw(damaged(data))) if draw(st.integers(0, 3)) == 0 else data


@st.composite
def damaged(draw: Callable[..., Any], data: bytes) -> bytes:
    """Bytes with some of them changed, cut out or put in."""
    content = bytearray(data)
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, max(0, len(content) - 1)))
        change = draw(st.sampled_from(["set", "cut", "insert", "end"]))
        if change == "set" and content:
            content[at] = draw(st.integers(0, 255))
        elif change == "cut":
            del content[at : at + draw(st.sampled_from([1, 4, 50, 1000]))]
        elif change == "insert":
            content[at:at] = draw(st.binary(max_size=60))
        else:
            del content[at:]
    return bytes(content)
