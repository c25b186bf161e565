"""Pieces of a page: escaped text, tables, and files as data within it."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

from magmpm.errors import MagmpmError

KINDS = {".png": "image/png", ".svg": "image/svg+xml", ".mp4": "video/mp4", ".gif": "image/gif"}
BEGINS = {
    ".png": (b"\x89PNG\r\n\x1a\n",),
    ".svg": (b"<?xml", b"<svg"),
    ".gif": (b"GIF8",),
}  # of a file that is what its name says


class PictureError(MagmpmError):
    """A file that can't go into a page as a picture."""


@dataclass(frozen=True)
class Markup:
    """HTML that is ready: everything else is escaped."""

    text: str

    def __add__(self, other: Markup) -> Markup:
        return Markup(self.text + other.text)


NOTHING = Markup("")


def safe(value: Any) -> str:
    """A value as HTML."""
    return value.text if isinstance(value, Markup) else escape(str(value), quote=True)


def joined(parts: Iterable[Markup], between: str = "\n") -> Markup:
    """Pieces one after the other."""
    return Markup(between.join(part.text for part in parts))


def tag(name: str, *content: Any, **attributes: Any) -> Markup:
    """An element; `class_` is its class."""
    words = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{safe(value)}"'
        for key, value in attributes.items()
        if value is not None
    )
    return Markup(f"<{name}{words}>{''.join(safe(part) for part in content)}</{name}>")


def wide(content: Markup) -> Markup:
    """Content that may be wider than a narrow window: it scrolls by itself there, and not the page with it."""
    return tag("div", content, class_="wide")


def table(head: Sequence[Any], rows: Iterable[Sequence[Any]], class_: str | None = None) -> Markup:
    """A table; cells that are numbers in text are aligned by the style sheet's class `n`."""
    body = [tag("tr", *(tag("td", cell) for cell in row)) for row in rows]
    return wide(
        tag(
            "table",
            tag("thead", tag("tr", *(tag("th", cell) for cell in head))),
            tag("tbody", *body),
            class_=class_,
        )
    )


def pairs(rows: Iterable[tuple[Any, Any]]) -> Markup:
    """A table of names and what they are."""
    return wide(
        tag(
            "table",
            tag("tbody", *(tag("tr", tag("th", name), tag("td", value)) for name, value in rows)),
            class_="pairs",
        )
    )


def data_uri(path: Path) -> str:
    """A picture's or movie's content as a URI. Raises PictureError where it is none, or too large."""
    try:
        kind = KINDS[path.suffix]
        content = _read(path)
    except KeyError:
        raise PictureError(
            f"{path}: is no picture that a page can hold ({', '.join(KINDS)})"
        ) from None
    except OSError as error:
        raise PictureError(f"{path}: can't go into the page ({error.strerror or error})") from None
    whole = (
        content[4:8] == b"ftyp"
        if path.suffix == ".mp4"
        else content.startswith(BEGINS[path.suffix])
    )
    if not whole:
        raise PictureError(f"{path}: is not the {path.suffix[1:]} file that its name says")
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"


def _read(path: Path) -> bytes:
    """A regular file of a bounded size. Raises OSError."""
    most_embedded_bytes = 32_000_000  # bytes of a picture or movie within a page
    if not path.is_file() or path.stat().st_size > most_embedded_bytes:
        raise OSError(0, f"must be a file of at most {most_embedded_bytes // 1_000_000} MB")
    return path.read_bytes()


def figure(path: Path, caption: str, **attributes: Any) -> Markup:
    """A picture with what it shows."""
    picture = Markup(f'<img alt="{safe(caption)}" src="{data_uri(path)}">')
    return tag("figure", picture, tag("figcaption", caption), **attributes)


def movie(path: Path, caption: str) -> Markup:
    """A movie with its controls; on paper its caption says that it is in the page."""
    if path.suffix == ".gif":
        return figure(path, caption)
    video = Markup(
        f'<video controls muted loop playsinline preload="metadata" src="{data_uri(path)}"></video>'
    )
    return tag("figure", video, tag("figcaption", caption), class_="movie")
