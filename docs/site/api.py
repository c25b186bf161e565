"""The API's page, from the signatures and docstrings of the public face: shapes, units, errors, and where each is defined.

    python docs/site/api.py        prints it

No plugin: the docstrings are plain text that a test holds to saying shapes, units and errors (tests/unit/project/test_public_face.py).
"""

from __future__ import annotations

import inspect
import sys
from html import escape
from pathlib import Path
from typing import Any

import magmpm

ROOT = Path(__file__).resolve().parents[2]
HEAD = """# API

What `import magmpm` gives, made from the docstrings when this site is built. Everything is in SI; shapes stand before units: (3,) m.
Examples are on the pages [first scene](first_scene.md) and [sensitivities](sensitivities.md).
"""


def page() -> str:
    """The page as Markdown."""
    parts = [HEAD]
    for name in sorted(magmpm.__all__, key=str.lower):
        thing = getattr(magmpm, name)
        if isinstance(thing, type):
            parts += [entry(f"magmpm.{name}", thing, 2), *members(name, thing)]
        else:
            parts.append(entry(f"magmpm.{name}", thing, 2))
    return "\n".join(parts)


def members(owner: str, of: type) -> list[str]:
    """The functions and properties of a class that are defined in this project."""
    found = []
    for name, value in inspect.getmembers(
        of, lambda v: inspect.isfunction(v) or inspect.ismethod(v) or isinstance(v, property)
    ):
        function: Any = (
            value.fget if isinstance(value, property) else getattr(value, "__func__", value)
        )
        if (
            not name.startswith("_")
            and getattr(function, "__module__", "").startswith("magmpm")
            and function.__doc__
        ):
            found.append(
                entry(f"{owner}.{name}", function, 3, is_property=isinstance(value, property))
            )
    return found


def entry(name: str, thing: Any, level: int, is_property: bool = False) -> str:
    """A heading, the signature, the docstring as it is written, and the source."""
    text = inspect.cleandoc(thing.__doc__ or "")
    head = f"{'#' * level} {name}"
    if inspect.isfunction(thing) and not is_property:
        signature = (
            str(inspect.signature(thing))
            .replace("(self, ", "(")
            .replace("(self)", "()")
            .replace("(cls, ", "(")
        )
        head += f"\n\n<pre><code>{escape(name.split('.')[-1] + signature.replace(chr(39), ''))}</code></pre>"
    return f'{head}\n\n{paragraphs(text)}\n\n<p class="source">{source(thing)}</p>\n'


def paragraphs(text: str) -> str:
    """A docstring's paragraphs; lines that begin with `*`, or are indented, stay lines of their own."""
    found = []
    for part in text.split("\n\n"):
        lines = part.splitlines()
        kept = any(line.startswith(("* ", "    ")) for line in lines)
        found.append(
            f'<p class="doc">{("<br>" if kept else " ").join(escape(line) for line in lines)}</p>'
        )
    return "\n".join(found)


def source(thing: Any) -> str:
    """The file and line where it is defined, from the root."""
    path, (_, line) = Path(inspect.getsourcefile(thing) or ""), inspect.getsourcelines(thing)
    return f"{path.resolve().relative_to(ROOT)}:{line}"


if __name__ == "__main__":
    sys.stdout.write(page())
