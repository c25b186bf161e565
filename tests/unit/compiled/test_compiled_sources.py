"""Kernels are compiled again where a file that they are made of has changed, and nowhere else."""

import importlib
import inspect
import pkgutil
import re
import shutil
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import magmpm
from magmpm.compiled import environment

ELSEWHERE = ("magmpm.studies", "magmpm.viz", "magmpm.cli", "magmpm.__main__")


def modules() -> list[ModuleType]:
    """Every module of the physics."""
    names = (found.name for found in pkgutil.walk_packages(magmpm.__path__, "magmpm."))
    return [importlib.import_module(name) for name in names if not name.startswith(ELSEWHERE)]


def source_of(value: Any) -> Path | None:
    """The file of the package that defines a function, a compiled one too, or a class."""
    try:
        found = inspect.getsourcefile(getattr(value, "py_func", value))
    except TypeError:
        return None
    path = None if found is None else Path(found)
    return path if path is not None and path.is_relative_to(environment.PACKAGE) else None


def test_what_compiled_functions_call_is_among_the_sources() -> None:
    """By the functions themselves, as Python has loaded them, and what their code names."""
    known = set(environment.compiled_sources())
    count = 0
    for module in modules():
        for function in vars(module).values():
            plain = getattr(function, "py_func", None)
            if plain is None or source_of(plain) is None:
                continue
            count += 1
            called = [plain.__globals__.get(name) for name in plain.__code__.co_names]
            used = {source_of(value) for value in [plain, *called] if value is not None} - {None}
            assert used <= known, (module.__name__, plain.__name__, used - known)
    assert count > 150


def test_constants_that_compiled_functions_name_are_among_the_sources() -> None:
    """Numba freezes a constant when it compiles; a change of it must reach the kernels."""
    imported = set()
    for module in modules():
        plain = [getattr(value, "py_func", None) for value in vars(module).values()]
        named = {name for function in plain if function for name in function.__code__.co_names}
        constants = {name for name in named if name.strip("_").isupper()}
        text = Path(str(module.__file__)).read_text(encoding="utf-8")
        for other, names in environment.FROM_IMPORT.findall(text):
            if constants & set(re.findall(r"\w+", names)):
                imported.add(Path(str(importlib.import_module(other).__file__)))
    assert len(imported) >= 3
    assert imported <= set(environment.compiled_sources())


@pytest.mark.parametrize(
    ("file", "again"),
    [
        ("scene/scene.py", False),
        ("statics/branch.py", False),
        ("statics/resolution.py", False),
        ("results/trajectory.py", False),
        ("kernels/equilibrium.py", True),
        ("materials.py", True),
        ("fields/spline.py", True),
        ("compiled/simd.py", True),
    ],
)
def test_an_edit_compiles_again_what_it_must(file: str, again: bool, tmp_path: Path) -> None:
    copy = tmp_path / "magmpm"
    shutil.copytree(
        environment.PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__", "studies", "viz")
    )
    hashed = environment.source_hash.__wrapped__
    before = hashed(copy)
    assert before == environment.source_hash()  # wherever the sources are
    path = copy / file
    path.write_text(path.read_text(encoding="utf-8") + "\n# edited\n", encoding="utf-8")
    assert (hashed(copy) != before) is again


def test_functions_of_tasks_are_kept_as_machine_code() -> None:
    """Kept as LLVM's code, like others that only compiled code calls, they would be written by every process that loads them."""
    files = [path.read_text(encoding="utf-8") for path in environment.PACKAGE.rglob("*.py")]
    taken = [name for text in files for name in re.findall(r"\btask\(\s*(\w+)\s*,", text)]
    marked = {
        name
        for text in files
        for name in re.findall(r"^@task_body\ndef (\w+)\(", text, flags=re.MULTILINE)
    }
    assert len(taken) > 25
    assert set(taken) - {"typingctx", "function"} == marked
