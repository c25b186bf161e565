"""The pages of the API, from signatures and docstrings: the public face, what its functions return, and the rooms of studies.

    python docs/site/api.py        prints the public one

No plugin. Docstrings are in NumPy style, https://numpydoc.readthedocs.io; tests/unit/project/test_docstrings.py holds them to what
functions take and return.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
import sys
from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import Any

import magmpm

ROOT = Path(__file__).resolve().parents[2]
HEAD = """# API

What `import magmpm` gives, made from the docstrings when this site is built. Everything is in SI; an array's shape stands before its
unit: `array (3,), m`. The files of the examples are those that `magmpm examples .` copies. What stands in scenes takes text with a
unit, or a number in SI.
The classes of answers come last: [what these functions return](#what-these-functions-return). Examples are also on the pages
[first scene](first_scene.md) and [sensitivities](sensitivities.md).
"""
RETURNED = (
    "magmpm.runs.GridError",
    "magmpm.runs.Comparison",
    "magmpm.results.trajectory.Frame",
    "magmpm.statics.linearized.Sensitivities",
    "magmpm.rod.cosserat.RodShape",
    "magmpm.studies.engine.report.StudyReport",
    "magmpm.studies.goals.report.GoalReport",
    "magmpm.studies.goals.sweep.SweepTable",
    "magmpm.studies.fitting.search.Fit",
    "magmpm.studies.fitting.search.Fitted",
    "magmpm.studies.explore.effects_table.EffectsTable",
    "magmpm.studies.explore.effects_table.EffectRow",
)
STUDIES = """# API of studies

The rooms of `magmpm.studies`, for those who change or extend a search: public functions and classes, from their docstrings. Users need
none of them: `magmpm.design`, `fit`, `influence` and `sweep` are on the page [API](api.md). [How it is built](design.md) says what each
room is for.
"""
ROOMS = ("problem", "search", "evaluate", "rods", "engine", "fitting", "dashboard", "hard_cases")
FIELDS = ("Parameters", "Attributes", "Returns", "Yields", "Raises", "Warns")


def page() -> str:
    """The page of the public face as Markdown."""
    parts = [HEAD]
    for name in sorted(magmpm.__all__, key=str.lower):
        parts += whole(f"magmpm.{name}", getattr(magmpm, name), 2)
    parts.append("## What these functions return\n")
    for address in RETURNED:
        module, _, name = address.rpartition(".")
        parts += whole(name, getattr(importlib.import_module(module), name), 3)
    return "\n".join(parts)


def studies_page() -> str:
    """The page of the rooms of studies as Markdown."""
    parts = [STUDIES]
    for room in ROOMS:
        parts.append(f"## studies/{room}\n")
        for module in modules(f"magmpm.studies.{room}"):
            own = [thing for thing in vars(module).values() if is_own(thing, module.__name__)]
            if own:
                path = module.__name__.removeprefix("magmpm.").replace(".", "/")
                parts.append(f"### {path}\n\n{paragraphs(inspect.getdoc(module) or '')}\n")
            for thing in own:
                parts += whole(thing.__name__, thing, 4)
    return "\n".join(parts)


def modules(package: str) -> Iterator[Any]:
    """The modules of a package, itself first."""
    root = importlib.import_module(package)
    yield root
    for found in pkgutil.walk_packages(root.__path__, f"{package}."):
        yield importlib.import_module(found.name)


def is_own(thing: Any, module: str) -> bool:
    """True for a public function or class that this module defines."""
    if not (inspect.isfunction(thing) or isinstance(thing, type)):
        return False
    return thing.__module__ == module and not thing.__name__.startswith("_")


def whole(name: str, thing: Any, level: int) -> list[str]:
    """The entry of a function, or of a class and of what it defines."""
    found = [entry(name, thing, level)]
    settings = hasattr(thing, "model_fields") and thing is not magmpm.Scene
    if isinstance(thing, type) and not settings:
        found += members(thing, level + 1)
    return found


def members(of: type, level: int) -> list[str]:
    """The public functions and properties that a class itself defines, in their order in the file."""
    found = []
    for name, value in vars(of).items():
        is_property = isinstance(value, property) or hasattr(value, "func")
        function: Any = getattr(value, "fget", None) or getattr(value, "func", None)
        function = function or getattr(value, "__func__", value)
        if name.startswith("_") or not inspect.isfunction(function) or not function.__doc__:
            continue
        if not function.__module__.startswith("magmpm"):
            continue  # of a base class elsewhere
        found.append(entry(f"{of.__name__}.{name}", function, level, is_property=is_property))
    return found


def entry(name: str, thing: Any, level: int, is_property: bool = False) -> str:
    """A heading, the signature, the docstring, and where the source is."""
    text = inspect.cleandoc(thing.__doc__ or "")
    head = f"{'#' * level} {name}"
    if inspect.isfunction(thing) and not is_property:
        head += f"\n\n<pre><code>{escape(signature(name, thing))}</code></pre>"
    return f'{head}\n\n{rendered(text)}\n\n<p class="source">{source(thing)}</p>\n'


def signature(name: str, function: Any, width: int = 90) -> str:
    """A call with its arguments and their defaults, one a line where they are many; their types stand in the docstring."""
    given = []
    for each in inspect.signature(function).parameters.values():
        if each.name in ("self", "cls"):
            continue
        bare = each.replace(annotation=inspect.Parameter.empty)
        if each.kind is each.KEYWORD_ONLY and "*" not in given:
            given.append("*")
        given.append(str(bare))
    short = name.split(".")[-1]
    line = f"{short}({', '.join(given)})"
    if len(line) <= width:
        return line
    return f"{short}(\n    " + ",\n    ".join(given) + ",\n)"


def sections(text: str) -> dict[str, list[str]]:
    """The lines of a docstring by the section they stand in; those before the first section under ""."""
    found: dict[str, list[str]] = {"": []}
    lines = text.splitlines()
    title = ""
    for k, line in enumerate(lines):
        below = lines[k + 1] if k + 1 < len(lines) else ""
        if line and below == "-" * len(line):
            title = line
            found[title] = []
        elif not (title and line == "-" * len(title) and not found[title]):
            found[title].append(line)
    return found


def items(lines: list[str]) -> list[tuple[str, str]]:
    """Entries of a section, each with its text: a name and a type at the margin, and indented lines below."""
    found: list[tuple[str, str]] = []
    for line in lines:
        if line.startswith(" "):
            head, said = found[-1]
            found[-1] = (head, f"{said} {line.strip()}".strip())
        elif line:
            found.append((line, ""))
    return found


def rendered(text: str) -> str:
    """A docstring as HTML and Markdown."""
    parts = []
    for title, lines in sections(text).items():
        if title:
            parts.append(f'<p class="rubric">{title}</p>')
        if title in FIELDS:
            parts.append(definitions(lines))
        elif title == "Examples":
            code = "\n".join(f"    {line}" for line in lines).rstrip()
            parts.append(f"    :::pycon\n{code}")
        else:
            parts.append(paragraphs("\n".join(lines).strip()))
    return "\n\n".join(parts)


def definitions(lines: list[str]) -> str:
    """Entries of a section as a list of definitions."""
    found = []
    for head, said in items(lines):
        name, _, kind = head.partition(" : ")
        shown = f"<code>{escape(name)}</code>"
        if kind:
            shown += f' <span class="kind">{escape(kind)}</span>'
        found.append(f"<dt>{shown}</dt><dd>{inline(said)}</dd>")
    return f'<dl class="doc">{"".join(found)}</dl>'


def inline(text: str) -> str:
    """Text with what stands between backquotes as code."""
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", escape(text))


def paragraphs(text: str) -> str:
    """Paragraphs of plain text; indented ones are formulas or code, and lines that begin with `*` stay lines of their own."""
    found = []
    for part in text.split("\n\n"):
        lines = part.splitlines()
        if lines and all(line.startswith("    ") for line in lines):
            found.append(f"<pre><code>{escape(inspect.cleandoc(part))}</code></pre>")
        elif any(line.startswith("* ") for line in lines):
            rows = re.sub(r"\n(?!\* )\s*", " ", part).splitlines()
            found.append(f'<p class="doc">{"<br>".join(inline(row) for row in rows)}</p>')
        else:
            found.append(f'<p class="doc">{inline(" ".join(lines))}</p>')
    return "\n".join(found)


def source(thing: Any) -> str:
    """The file and line where it is defined, from the root."""
    thing = inspect.unwrap(thing)  # of a context manager, say
    path = Path(inspect.getsourcefile(thing) or "").resolve()
    line = inspect.getsourcelines(thing)[1]
    return f"{path.relative_to(ROOT)}:{line}"


if __name__ == "__main__":
    sys.stdout.write(page())
