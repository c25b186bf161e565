"""Private names of Numba, Optuna and VTK stand in one file for each library, which says why: the files to mend for a new version of it."""

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[3]
LIBRARIES = ("llvmlite", "numba", "optuna", "pyvista", "vtk", "vtkmodules")
ADAPTERS = {"magmpm/compiled/cache.py", "studies/search/samplers/optuna_ids.py"}


def imports(tree: ast.Module) -> Iterator[str]:
    """Full names of what a file imports from the libraries."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (one.name for one in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield from (f"{node.module}.{one.name}" for one in node.names)


def private(name: str) -> bool:
    """True for a name with one underscore in front."""
    return name.startswith("_") and not name.startswith("__")


def uses(tree: ast.Module) -> list[str]:
    """What a file that imports one of the libraries takes of private names, from them or from their objects."""
    names = [name for name in imports(tree) if name.split(".")[0] in LIBRARIES]
    found = [name for name in names if any(map(private, name.split(".")))]
    if names:
        for node in ast.walk(tree):
            of_another = isinstance(node, ast.Attribute) and not (
                isinstance(node.value, ast.Name) and node.value.id in ("self", "cls")
            )
            if of_another and private(node.attr):
                found.append(ast.unparse(node))
    return found


def test_private_names_stand_in_one_file_a_library() -> None:
    found = {
        path.relative_to(ROOT).as_posix(): uses(ast.parse(path.read_text(encoding="utf-8")))
        for top in ("magmpm", "studies", "viz")
        for path in (ROOT / top).rglob("*.py")
    }
    assert {name: used for name, used in found.items() if used}.keys() == ADAPTERS


def test_it_sees_them() -> None:
    text = "from numba.core import _dispatcher\nimport optuna\nstudy._study_id\nself._own\n"
    assert uses(ast.parse(text)) == ["numba.core._dispatcher", "study._study_id"]
