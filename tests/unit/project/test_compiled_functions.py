"""Rules for every compiled function of the package."""

from __future__ import annotations

import ast
import importlib
import inspect
import pkgutil
import textwrap
from collections.abc import Iterator

import pytest
from numba.core.dispatcher import Dispatcher

import magmpm

MOST_ARGUMENTS = 12
STEPS = ("equilibrium", "total_lagrangian_step")


def compiled_functions() -> Iterator[tuple[str, Dispatcher]]:
    """Every compiled function of the package, by its full name."""
    for module in pkgutil.walk_packages(magmpm.__path__, "magmpm."):
        if module.name.endswith("__main__"):  # it is run when imported
            continue
        for name, value in vars(importlib.import_module(module.name)).items():
            if isinstance(value, Dispatcher) and value.py_func.__module__ == module.name:
                yield f"{module.name}.{name}", value


FUNCTIONS = dict(compiled_functions())


def test_they_are_found() -> None:
    assert len(FUNCTIONS) > 80


def test_arguments_are_few() -> None:
    """Records (NamedTuples of arrays) stand for long lists of them."""
    found = {name: len(inspect.signature(function.py_func).parameters) for name, function in FUNCTIONS.items()}
    assert {name: count for name, count in found.items() if count > MOST_ARGUMENTS} == {}


def test_parallel_functions_assign_to_no_record() -> None:
    """Numba leaves out what a parallel function itself assigns to a record's array (magmpm.compiled.jit)."""
    for name, function in FUNCTIONS.items():
        if function.targetoptions.get("parallel"):
            tree = ast.parse(textwrap.dedent(inspect.getsource(function.py_func)))
            targets = [t for node in ast.walk(tree) if isinstance(node, ast.Assign) for t in node.targets]
            targets += [node.target for node in ast.walk(tree) if isinstance(node, ast.AugAssign)]
            parts = [part for t in targets for part in (t.elts if isinstance(t, ast.Tuple) else [t])]
            records = [ast.unparse(p) for p in parts if isinstance(p, ast.Subscript) and isinstance(p.value, ast.Attribute)]
            assert records == [], name


@pytest.mark.parametrize("module", STEPS)
def test_the_steps_are_seen_by_name(module: str) -> None:
    """In equilibrium the grid's update is the linear solve and the line search (statics.newton)."""
    steps = ["particles_to_grid", "grid_to_particles"] + (["update_grid"] if module != "equilibrium" else [])
    for step in steps:
        assert f"magmpm.kernels.{module}.{step}" in FUNCTIONS
