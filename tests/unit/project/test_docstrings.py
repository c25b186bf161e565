"""Docstrings in NumPy style: they name what functions take and return, class by class, and their examples run.

    https://numpydoc.readthedocs.io

A room is held to it once it stands in ROOMS; the public face always is.
"""

import builtins
import doctest
import importlib
import inspect
import pkgutil
import runpy
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import magmpm
from magmpm import errors
from magmpm.inputs.settings import Settings

ROOT = Path(__file__).parents[3]
ROOMS = (
    "magmpm.studies.problem",
    "magmpm.studies.search",
    "magmpm.studies.rods",
    "magmpm.studies.evaluate",
    "magmpm.studies.engine",
    "magmpm.studies.fitting",
    "magmpm.studies.hard_cases",
    "magmpm.studies.dashboard",
    "magmpm.bodies.segments",
    "magmpm.errors",
    "magmpm.materials",
    "magmpm.fields.external_field",
    "magmpm.fields.schedule",
    "magmpm.results.measures",
    "magmpm.results.notices",
    "magmpm.results.result",
    "magmpm.results.strain",
    "magmpm.rod.cosserat",
    "magmpm.rod.family",
    "magmpm.scene.addresses",
    "magmpm.scene.scene",
    "magmpm.scene.variables",
)
API = runpy.run_path(str(ROOT / "docs/site/api.py"))
sections = API["sections"]
items = API["items"]


def own(thing: Any, module: str) -> bool:
    """True for a public function or class that this module defines."""
    named = inspect.isfunction(thing) or isinstance(thing, type)
    return named and thing.__module__ == module and not thing.__name__.startswith("_")


def functions(of: type) -> Iterator[tuple[str, Callable[..., Any]]]:
    """The public functions that a class itself defines, properties apart, but for those whose docstring a base class has."""
    for name, found in vars(of).items():
        function = getattr(found, "__func__", found)
        if name.startswith("_") or not inspect.isfunction(function):
            continue
        documented = [
            base for base in of.__mro__[1:] if name in vars(base) and vars(base)[name].__doc__
        ]
        if function.__module__ == of.__module__ and not documented:
            yield f"{of.__name__}.{name}", function


def with_functions(name: str, thing: Any) -> dict[str, Any]:
    """A function; or a class and its functions, by their names."""
    if not isinstance(thing, type):
        return {name: thing}
    inside = {} if thing is not magmpm.Scene and issubclass(thing, Settings) else functions(thing)
    return {name: thing} | dict(inside)


def public() -> dict[str, Any]:
    """What the public face has, and the classes of its answers."""
    found: dict[str, Any] = {}
    for name in magmpm.__all__:
        found |= with_functions(name, getattr(magmpm, name))
    for address in API["RETURNED"]:
        module, _, name = address.rpartition(".")
        if not module.startswith(("magmpm.studies.goals", "magmpm.studies.explore")):
            found |= with_functions(name, getattr(importlib.import_module(module), name))
    return found


def of_room(room: str) -> dict[str, Any]:
    """The public functions and classes of a room, or of a single module, by their full names."""
    package = importlib.import_module(room)
    names = [room]
    if hasattr(package, "__path__"):
        names += [found.name for found in pkgutil.walk_packages(package.__path__, f"{room}.")]
    found: dict[str, Any] = {}
    for name in names:
        if name.endswith("__main__"):  # it is run when imported
            continue
        module = importlib.import_module(name)
        for thing in list(vars(module).values()):
            described = isinstance(thing, type) and issubclass(thing, Settings)  # key by key
            if own(thing, name) and not described:
                made = with_functions(thing.__name__, thing)
                found |= {f"{name}.{key}": value for key, value in made.items()}
    return found


THINGS = public() | {name: thing for room in ROOMS for name, thing in of_room(room).items()}


def taken(thing: Any) -> list[str]:
    """Names of what a function or a class takes, in their order; of a class with fields these, of settings their keys."""
    if isinstance(thing, type) and issubclass(thing, Settings):
        return list(thing.model_fields)
    fields = getattr(thing, "__dataclass_fields__", None) or getattr(thing, "_fields", None)
    own_fields = set(fields or ()) & annotated(thing)
    if isinstance(thing, type) and fields is not None:
        if not own_fields:
            return []  # what a base class says
        return [name for name in fields if not name.startswith("_")]
    if isinstance(thing, type) and "__init__" not in vars(thing):
        return []  # what a base class says
    signature = inspect.signature(thing.__init__ if isinstance(thing, type) else thing)
    marks = {inspect.Parameter.VAR_POSITIONAL: "*", inspect.Parameter.VAR_KEYWORD: "**"}
    return [
        marks.get(each.kind, "") + each.name
        for each in signature.parameters.values()
        if each.name not in ("self", "cls")
    ]


def annotated(thing: Any) -> set[str]:
    """Names that a class itself annotates: the others' descriptions stand with its base class."""
    return set(getattr(thing, "__annotations__", ())) if isinstance(thing, type) else set()


def named(lines: list[str]) -> list[str]:
    """Names of a section's entries."""
    return [name for head, _ in items(lines) for name in head.partition(" : ")[0].split(", ")]


def returns(function: Callable[..., Any]) -> bool:
    """True if a function's annotation says that it returns something, or yields it."""
    said = str(inspect.signature(function).return_annotation)
    return said not in ("None", "<class 'NoneType'>", "NoReturn", "typing.NoReturn")


def faults(thing: Any) -> list[str]:
    """What a docstring lacks, or says of nothing."""
    text = inspect.getdoc(thing) or ""
    said = sections(text)
    found = [
        f"{title}: {head} is not described"
        for title in API["FIELDS"]
        for head, about in items(said.get(title, []))
        if not about
    ]
    given = named(said.get("Parameters", []) + said.get("Attributes", []))
    known = taken(thing)
    if given not in (known, [name for name in known if name in annotated(thing)]):
        found.append(f"describes {given}, takes {known}")
    told = bool(said.keys() & {"Returns", "Yields"})
    if not isinstance(thing, type) and returns(thing) != told:
        found.append("Returns, and returns nothing" if told else "has no Returns")
    if isinstance(thing, type) and issubclass(thing, Settings):
        about = dict(
            zip(given, (text for _, text in items(said.get("Parameters", []))), strict=True)
        )
        for key, field in thing.model_fields.items():
            described = " ".join((field.description or "").split())
            if about.get(key) != described:
                found.append(f"{key}: {about.get(key)!r} is not the description, {described!r}")
    for name, _ in items(said.get("Raises", [])):
        kind = getattr(errors, name, None) or getattr(builtins, name, None)
        kind = kind or getattr(inspect.getmodule(thing), name, None)
        if not (isinstance(kind, type) and issubclass(kind, Exception)):
            found.append(f"Raises: {name} is no error")
    return found


def test_all_are_seen() -> None:
    assert {"run", "Scene.with_field", "Result", "Sensitivities.at"} <= set(THINGS)


@pytest.mark.parametrize("name", THINGS)
def test_docstrings_name_what_is_taken_and_returned(name: str) -> None:
    assert faults(THINGS[name]) == []


# they compile, and run several times
LONG = ("Motion", "Sensitivities", "compare", "error", "sensitivities")


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.slow] if name in LONG else [])
        for name in THINGS
        if ">>>" in (inspect.getdoc(THINGS[name]) or "")
    ],
)
def test_examples_run(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a folder with the data that `magmpm examples .` copies."""
    (tmp_path / "data").symlink_to(ROOT / "data")
    monkeypatch.chdir(tmp_path)
    text = inspect.getdoc(THINGS[name]) or ""
    test = doctest.DocTestParser().get_doctest(text, {}, name, None, None)
    told: list[str] = []
    done = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS).run(test, out=told.append)
    assert done.failed == 0, "".join(told)
    assert done.attempted > 1


def test_what_scenes_are_made_of_has_an_example() -> None:
    """Of each class that scenes and Python name."""
    settings = [
        name
        for name in dir(magmpm)
        if isinstance(getattr(magmpm, name), type) and issubclass(getattr(magmpm, name), Settings)
    ]
    assert len(settings) > 25
    assert [name for name in settings if ">>>" not in (getattr(magmpm, name).__doc__ or "")] == []


def test_what_is_missing_is_found() -> None:
    """A docstring that says it all, and the same with a parameter, a return value or a text left out, or with an error that is none."""
    text = (
        "Find the speed.\n\nParameters\n----------\nway : float, m\n    Covered.\n\n"
        "Returns\n-------\nfloat, m/s\n    The mean.\n\nRaises\n------\nValueError\n    At no time."
    )

    def speed(way: float) -> float:
        return way

    def said(text: str) -> list[str]:
        speed.__doc__ = text
        return faults(speed)

    assert said(text) == []
    assert said(text.replace("way : ", "path : ")) == ["describes ['path'], takes ['way']"]
    assert said(text.replace("Returns\n-------", "Notes\n-----")) == ["has no Returns"]
    assert said(text.replace("    The mean.\n", "")) == ["Returns: float, m/s is not described"]
    assert said(text.replace("ValueError", "Slowness")) == ["Raises: Slowness is no error"]
