"""`import magmpm`: what it offers, how it answers, and that its docstrings say what a stranger needs: shapes, units, errors."""

import ast
import builtins
import configparser
import dataclasses
import inspect
import re
import subprocess
import sys
import textwrap
from collections.abc import Callable, Iterator
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import magmpm
from magmpm import errors
from magmpm.inputs.settings import Settings

ROOT = Path(__file__).parents[3]
SCENE = ROOT / "data" / "scenes" / "axial_transverse.yaml"
UNIT = re.compile(r"(?<![\w.'])(m|mm|s|T|N|J|Pa|kg|bytes|SI|no unit)(/m\^3|\^3|\^2|/s)?\b")
SHAPE = re.compile(r"\((\w[\w +]*)?,[\w, +]*\)")
NUMBERS = re.compile(r"\bfloat\b|Array|ndarray|Numbers")
ARRAYS = re.compile(r"Array|ndarray|Numbers")


def test_a_clone_is_found_from_the_folder_that_holds_it(tmp_path: Path) -> None:
    """Python first sees there a folder `magmpm` without an `__init__.py`, and goes on to the package only where that is on a path."""
    (tmp_path / "magmpm").symlink_to(ROOT)
    code = "import magmpm; print(magmpm.__file__)"
    told = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert Path(told.stdout.strip()).samefile(ROOT / "magmpm" / "__init__.py")


def functions(of: type) -> Iterator[tuple[str, Callable[..., Any]]]:
    """The public functions a class itself defines, and those by which it is used as a sequence."""
    for name, found in vars(of).items():
        if name.startswith("_") and name not in ("__len__", "__getitem__"):
            continue
        found = found.fget if isinstance(found, property) else getattr(found, "__func__", found)
        if inspect.isfunction(found) and found.__module__.startswith("magmpm"):
            yield f"{of.__name__}.{name}", found


def public() -> dict[str, Any]:
    """Everything of the public face that has a docstring: functions, classes, the functions of these."""
    found = {name: getattr(magmpm, name) for name in magmpm.__all__}
    for thing in list(found.values()):
        # of what scenes are made of users know the settings, whose descriptions editors show
        if isinstance(thing, type) and (thing is magmpm.Scene or not issubclass(thing, Settings)):
            found.update(functions(thing))
    return found


def raised(function: Callable[..., Any]) -> set[str]:
    """Errors that a function raises itself, or by magmpm's functions that it calls by name and whose docstrings say so.

    What is raised within a `try` that has handlers is not among them."""
    found = set()
    for node in unhandled(ast.parse(textwrap.dedent(inspect.getsource(function)))):
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
            found.add(ast.unparse(node.exc.func).split(".")[-1])
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            called = function.__globals__.get(node.func.id)
            if inspect.isfunction(called) and called.__module__.startswith("magmpm"):
                found |= said_to_be_raised(called)
    return found


def unhandled(node: ast.AST) -> Iterator[ast.AST]:
    """A piece of code and all within it, but for the bodies of `try` statements that have handlers."""
    yield node
    for child in ast.iter_child_nodes(node):
        if not (isinstance(node, ast.Try) and node.handlers and child in node.body):
            yield from unhandled(child)


def known(error: str) -> type | None:
    """The error of that name."""
    return getattr(errors, error, None) or getattr(builtins, error, None)


def said_to_be_raised(function: Callable[..., Any]) -> set[str]:
    """Errors named after "Raises", up to the end of that paragraph."""
    after = re.findall(r"Raises\b((?:.|\n(?!\n))*)", inspect.getdoc(function) or "")
    return set(re.findall(r"\b[A-Z]\w*(?:Error|Yet|Use)\b", " ".join(after)))


def faults(function: Callable[..., Any]) -> list[str]:
    """List what a function's docstring leaves unsaid."""
    text = inspect.getdoc(function) or ""
    if not text:
        return ["has no docstring"]
    signature = inspect.signature(function)
    given = {
        name: str(each.annotation)
        for name, each in signature.parameters.items()
        if name not in ("self", "cls")
    }
    found = [f"does not say what {name} is" for name in given if not re.search(rf"\b{name}", text)]
    kinds = [*given.values(), str(signature.return_annotation)]
    if any(NUMBERS.search(kind) for kind in kinds) and not UNIT.search(text):
        found.append("gives no unit")
    if any(ARRAYS.search(kind) for kind in kinds) and not SHAPE.search(text):
        found.append("gives no shape")
    said = said_to_be_raised(function)
    broad = tuple(filter(None, map(known, said)))
    unsaid = [
        error
        for error in sorted(raised(function))
        if error not in said and not issubclass(known(error) or errors.InputError, broad)
    ]
    found += [f"does not say that it raises {error}" for error in unsaid]
    found += [
        f"says that it raises {error}, which is none"
        for error in sorted(said)
        if known(error) is None
    ]
    return found


def field_faults(of: type) -> list[str]:
    """Arrays and numbers of a dataclass of which neither the class's docstring nor the field's comment gives shape and unit."""
    source = inspect.getsource(of)
    text = inspect.getdoc(of) or ""
    found = []
    for field in dataclasses.fields(of):
        comment = re.search(rf"^    {field.name}: .*?#(.*)$", source, re.MULTILINE)
        above = re.search(rf"((?:^    #.*\n)+)    {field.name}: ", source, re.MULTILINE)
        words = "".join(found.group(1) for found in (comment, above) if found) + " ".join(
            re.findall(rf"\b{field.name}\b[^.;]*", text)
        )
        if ARRAYS.search(str(field.type)) and not SHAPE.search(words):
            found.append(f"{field.name}: no shape")
        if field.type in ("float", "Array") and not UNIT.search(words):
            found.append(f"{field.name}: no unit")
    return found


@pytest.mark.parametrize("name", public())
def test_docstrings_say_parameters_shapes_units_and_errors(name: str) -> None:
    thing = public()[name]
    if inspect.isfunction(thing):
        assert faults(thing) == []
    else:
        assert thing.__doc__
        assert thing.__doc__ != getattr(thing.__mro__[1], "__doc__", None)
        if dataclasses.is_dataclass(thing):
            assert field_faults(thing) == []


OBJECTS = [
    name
    for name in magmpm.__all__
    if isinstance(getattr(magmpm, name), type) and issubclass(getattr(magmpm, name), Settings)
]


@pytest.mark.parametrize("name", OBJECTS)
def test_settings_of_objects_are_described(name: str) -> None:
    for key, field in getattr(magmpm, name).model_fields.items():
        assert field.description, f"{name}.{key}"
        assert field.examples, f"{name}.{key}"


def test_the_check_of_docstrings_sees_what_is_missing() -> None:
    """A function that says nothing of its parameter, shape, unit and error, and one that says it all."""

    def poor(speed: np.typing.NDArray[np.float64]) -> float:
        """How fast."""
        raise errors.InputError(str(speed))

    def good(speed: np.typing.NDArray[np.float64]) -> float:
        """The largest of these speeds, (n,) m/s. Raises ValueError."""
        if not len(speed):
            raise ValueError("no speed")
        return float(speed.max())

    assert faults(good) == []
    assert faults(poor) == [
        "does not say what speed is",
        "gives no unit",
        "gives no shape",
        "does not say that it raises InputError",
    ]
    good.__doc__ = "The largest of these speeds, (n,) m/s. Raises TypoError."
    assert faults(good) == [
        "does not say that it raises ValueError",
        "says that it raises TypoError, which is none",
    ]


def test_names_are_found_when_they_are_asked_for() -> None:
    assert dir(magmpm) == sorted(magmpm.__all__)
    for name in magmpm.__all__:
        assert getattr(magmpm, name).__name__ == name
    with pytest.raises(AttributeError, match="nothing"):
        _ = magmpm.nothing


def test_import_loads_nothing_that_is_slow() -> None:
    """Numba, NumPy and pydantic wait until something of magmpm is used; Numba's environment is ready by then; physics needs no Optuna."""
    code = (
        "import magmpm, os, sys; print(*sorted({'numba', 'numpy', 'pydantic', 'yaml', 'scipy',"
        " 'h5py'} & set(sys.modules)), 'NUMBA_CACHE_DIR' in os.environ); magmpm.load_scene,"
        " magmpm.run, magmpm.Result; print({'optuna', 'pyvista', 'pandas'} & {*sys.modules})"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["True", "set()"]


def test_a_path_runs_as_its_scene_does() -> None:
    """The same answer bit for bit, and a line that says what it is."""
    scene = magmpm.load_scene(SCENE).with_cells(2)
    result = magmpm.run(scene)
    assert repr(scene).startswith(
        f"Scene({scene.name!r}: catheter, 40 mm long, 4 mm thick, 1 regions; magnetic_torque;"
        " equilibrium"
    )
    line = repr(result)
    for part in (
        f"Result({scene.name!r}: equilibrium in",
        "Newton steps, tip (",
        ") mm, det F 0.",
        "unknowns",
    ):
        assert part in line
    assert "\n" not in line


@pytest.mark.parametrize(
    ("field", "words"),
    [
        ({"uniform": [0, 6e-3, 8e-3]}, "field (0, 6, 8) mT)"),
        ({}, "field none)"),
        (
            {
                "magnet": [
                    {
                        "cylinder": {"diameter": 0.02, "length": 0.02},
                        "position": [0, 0, 0.06],
                        "remanence": 1.3,
                    }
                ]
            },
            "field magnet of 1.3 T at (0, 0, 60) mm)",
        ),
        (
            {
                "uniform": [0, 0, 1e-3],
                "dipole": 2 * [{"position": [0.06, 0, 0], "moment": [0, 0, 0.5]}],
                "over_time": {"ramp": {"duration": 1.0}},
            },
            "field (0, 0, 1) mT + 2 dipoles, changing in time)",
        ),
    ],
)
def test_a_scene_tells_its_field(field: dict[str, object], words: str) -> None:
    """In its line, and in a notebook's table."""
    data = magmpm.load_scene(SCENE).to_si()
    scene = magmpm.Scene.from_si({**data, "field": field})
    assert repr(scene).endswith(words)
    assert words.removeprefix("field ").removesuffix(")") in scene._repr_html_()


def test_a_motion_tells_itself_in_a_line(tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(LATE.replace("  ground: {point: GROUND}\n", ""))
    result = magmpm.run(path, folder=tmp_path / "out")
    motion = magmpm.Motion.load(tmp_path / "out")
    assert repr(result).startswith("Result('late': motion of 1.00 ms in ")
    frames = f"{len(motion)} frames of {len(motion.reference)} particles"
    assert repr(motion) == f"Motion('late': {frames}, the last at 1.00 ms, in {motion.folder})"
    again = magmpm.run(path, folder=tmp_path / "out", resume=True)
    np.testing.assert_array_equal(again.particle_position, result.particle_position)


def test_what_is_asked_wrongly_is_said_in_words() -> None:
    scene = magmpm.load_scene(SCENE).with_cells(2)
    with pytest.raises(TypeError, match="start: received 5; must be a Result"):
        magmpm.run(scene, start=5)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="resume: received True without a folder; give the folder"):
        magmpm.run(scene, resume=True)


LATE = """\
name: late
materials:
  magnetic: {shear_modulus: 120 kPa, bulk_to_shear: 20, density: 1882 kg/m^3, remanence: 100 mT}
body:
  catheter: {length: 16 mm, diameter: 4 mm, material: magnetic, segments: [{magnetization: [1, 0, 0]}]}
field: {uniform: [0 mT, 2 mT, 20 mT]}
effects:
  magnetic_torque: {}
  ground: {point: GROUND}
solver: {dynamic: {duration: 1 ms}}
resolution: {cells_across: 2}
"""


def test_errors_from_python_are_worded_as_the_command_words_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Faults that show once the body is built, and those that show as the file is read, name file, line, key and value."""
    from magmpm.cli import main

    late = tmp_path / "late.yaml"
    early = tmp_path / "early.yaml"
    late.write_text(LATE.replace("GROUND", "[0 mm, 0 mm, 1 mm]"))
    early.write_text(
        LATE.replace("GROUND", "[0 mm, 0 mm, -9 mm]").replace("cells_across: 2", "cells_across: 1")
    )
    for path, place in (
        (late, ":9: effects.ground: received {"),
        (early, ":11: resolution.cells_across: received 1"),
    ):
        with pytest.raises(magmpm.InputError) as told:
            magmpm.run(path)
        assert f"{path}{place}" in str(told.value)
        assert main(["run", str(path), "--out", str(tmp_path / "out")]) == 2
        assert f"magmpm: {told.value}\n" in capsys.readouterr().err


def test_the_installed_command_finds_its_function(capsys: pytest.CaptureFixture[str]) -> None:
    """Scripts of earlier installations say `from magmpm.cli import main`: that stays a function, and setup.cfg names the same one."""
    setup = configparser.ConfigParser()
    setup.read(ROOT / "setup.cfg", encoding="utf-8")
    name, _, value = setup["options.entry_points"]["console_scripts"].strip().partition(" = ")
    assert (name, value) == ("magmpm", "magmpm.cli:main")
    with pytest.raises(SystemExit) as ended:
        EntryPoint(name, value, "console_scripts").load()(["--version"])
    assert ended.value.code == 0
    assert capsys.readouterr().out.startswith("magmpm ")
    light = "assert not {'numba', 'scipy', 'h5py', 'optuna', 'matplotlib'} & {*sys.modules}"
    script = f"import sys; from magmpm.cli import main; {light}; sys.exit(main(['--version']))"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert done.stdout.startswith("magmpm ")
