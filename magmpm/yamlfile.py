"""YAML files as users write them: plain data, the line of every key, and errors that say where and what to do.

Read by the rules of YAML 1.2 rather than PyYAML's 1.1: `1e-9` is a number, `yes`, `no` and `off` are words, `12:30` is
text and not 750, and a key that stands twice is an error rather than the last one winning.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Hashable
from pathlib import Path
from typing import Any

import yaml

from magmpm.errors import InputError

Key = tuple[str | int, ...]

MAX_BYTES = 1_000_000
MAX_NODES = 100_000


class Document(dict[str, Any]):
    """The top-level mapping of a YAML file, with its path and the line of each key path: lines[("a", 2, "b")]."""

    def __init__(self, data: dict[str, Any], path: Path, lines: dict[Key, int]) -> None:
        super().__init__(data)
        self.path = path
        self.lines = lines


class _Loader(yaml.SafeLoader):
    """SafeLoader that decides by YAML 1.2 which plain words are numbers, booleans and nulls."""

    yaml_implicit_resolvers: dict[str, list[tuple[str, re.Pattern[str]]]] = {}  # noqa: RUF012 (PyYAML's protocol)


for _tag, _pattern, _first in (
    ("bool", r"true|True|TRUE|false|False|FALSE", "tTfF"),
    ("int", r"[-+]?[0-9]+", "-+0123456789"),
    (
        "float",
        r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)",
        "-+.0123456789",
    ),
    ("null", r"~|null|Null|NULL|", "~nN\0"),
    ("merge", r"<<", "<"),
):
    _Loader.add_implicit_resolver(
        f"tag:yaml.org,2002:{_tag}",
        re.compile(rf"^(?:{_pattern})$"),
        [c if c != "\0" else "" for c in _first],
    )


def read_yaml(path: Path | str) -> Document:
    """The file's top-level mapping.

    Raises InputError with file and line: no such file, not a text file, not YAML, a key that stands twice, a file that
    is empty or holds something other than `key: value` lines.
    """
    path = Path(path)
    text = _read_text(path)
    try:
        loader = _Loader(text)
        root = loader.get_single_node()
    except yaml.MarkedYAMLError as error:
        raise InputError(_explain(error, path, text)) from None
    except yaml.YAMLError as error:
        raise InputError(
            f"{path}: not a YAML text file ({str(error).splitlines()[0]})\n  {_REMEDY}"
        ) from None
    except RecursionError:
        raise InputError(f"{path}: brackets nested too deeply\n  {_REMEDY}") from None
    if root is None:
        raise InputError(f"{path}: the file is empty\n  {_REMEDY}")
    if not isinstance(root, yaml.MappingNode):
        what = "a list" if isinstance(root, yaml.SequenceNode) else f'the text "{str(root.value)[:40]}"'
        raise InputError(
            f"{path}:1: received {what}\n  rule: the file must hold `key: value` lines\n  {_REMEDY}"
        )
    builder = _Builder(path, loader)
    data = builder.mapping(root, ())
    return Document(data, path, builder.lines)


_REMEDY = "remedy: start from one of the files in data/scenes or data/studies"


def _read_text(path: Path) -> str:
    """The file as text. Raises InputError."""
    try:
        if path.is_dir():
            raise InputError(
                f"{path}: this is a folder, and a YAML file is wanted\n  remedy: name a file in it"
            )
        if path.stat().st_size > MAX_BYTES:
            raise InputError(
                f"{path}: received {path.stat().st_size} bytes\n  rule: the file must not exceed {MAX_BYTES} bytes"
                f"\n  {_REMEDY}"
            )
        return path.read_bytes().decode("utf-8-sig")
    except FileNotFoundError:
        near = []
        if path.parent.is_dir():
            near = difflib.get_close_matches(path.name, sorted(p.name for p in path.parent.iterdir()), n=1)
        hint = (
            f'did you mean "{path.parent / near[0]}"?' if near else "check the path and the folder you are in"
        )
        raise InputError(f"{path}: no such file\n  remedy: {hint}") from None
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: not a text file (byte {error.object[error.start]:#04x} at {error.start} is not UTF-8)\n  {_REMEDY}"
        ) from None
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise InputError(
            f"{path}: cannot be read ({reason})\n  remedy: check the path and its permissions"
        ) from None


def _explain(error: yaml.MarkedYAMLError, path: Path, text: str) -> str:
    """PyYAML's complaint as file:line, what was met there, and what to do."""
    mark = error.problem_mark or error.context_mark
    line = mark.line if mark else 0
    lines = text.splitlines()
    shown = lines[line].strip()[:60] if line < len(lines) else ""
    problem = (error.problem or "not YAML").replace("\\t", "tab")
    if "\t" in (lines[line] if line < len(lines) else ""):
        rule, remedy = "a tab cannot indent YAML", "indent with spaces"
    elif "expected a single document" in str(error.context) or "another document" in problem:
        rule, remedy = "the file must hold one document", "remove the second `---`"
    else:
        rule = " ".join(part for part in (error.context, problem) if part)
        remedy = "check indentation, brackets, quotes, and the space after each colon, in this line and the one before"
    return f'{path}:{line + 1}: received "{shown}"\n  rule: not valid YAML: {rule}\n  remedy: {remedy}'


class _Builder:
    """Plain data from YAML nodes, noting lines and refusing keys that stand twice."""

    def __init__(self, path: Path, loader: _Loader) -> None:
        self.path = path
        self.loader = loader
        self.lines: dict[Key, int] = {}
        self.nodes = 0
        self.open: set[int] = set()  # nodes being built: an alias to one of them would never end

    def value(self, node: yaml.Node, at: Key) -> Any:
        self.nodes += 1
        if self.nodes > MAX_NODES or id(node) in self.open:
            line = node.start_mark.line + 1
            raise InputError(
                f"{self.path}:{line}: aliases repeat without end\n  remedy: write the values out"
            )
        if isinstance(node, yaml.ScalarNode):
            return self.scalar(node)
        self.open.add(id(node))
        try:
            if isinstance(node, yaml.MappingNode):
                return self.mapping(node, at)
            items = []
            for index, child in enumerate(node.value):
                self.lines[(*at, index)] = child.start_mark.line + 1
                items.append(self.value(child, (*at, index)))
            return items
        finally:
            self.open.discard(id(node))

    def mapping(self, node: yaml.MappingNode, at: Key) -> dict[str, Any]:
        first: dict[Hashable, int] = {}
        for key_node, _ in node.value:
            line = key_node.start_mark.line + 1
            if not isinstance(key_node, yaml.ScalarNode):
                raise InputError(f"{self.path}:{line}: a key must be a word\n  remedy: write `key: value`")
            if key_node.value in first:
                raise InputError(
                    f'{self.path}:{line}: {dotted((*at, key_node.value))}: received the key "{key_node.value}" a second '
                    f"time\n  rule: a key may stand once (the first is in line {first[key_node.value]})"
                    f"\n  remedy: remove or rename one of the two"
                )
            first[key_node.value] = line
        try:
            self.loader.flatten_mapping(node)  # `<<: *defaults`: the merged pairs come first, so own keys win
        except yaml.MarkedYAMLError as error:
            raise InputError(
                f"{self.path}:{node.start_mark.line + 1}: {error.problem}\n  {_REMEDY}"
            ) from None
        data: dict[str, Any] = {}
        for key_node, value_node in node.value:
            key = str(key_node.value)
            self.lines[(*at, key)] = key_node.start_mark.line + 1
            data[key] = self.value(value_node, (*at, key))
        return data

    def scalar(self, node: yaml.ScalarNode) -> Any:
        kind = node.tag.rsplit(":", 1)[-1]
        text = str(node.value)
        try:
            if kind == "bool":
                return text.lower() == "true"
            if kind == "null":
                return None
            if kind == "int":
                return int(text)
            if kind == "float":
                return float(re.sub(r"\.(inf|nan)", r"\1", text.lower()))
        except ValueError:
            return text  # thousands of digits, say: whoever wants a number refuses the text
        if kind == "str" or node.tag == "!":
            return text
        raise InputError(
            f"{self.path}:{node.start_mark.line + 1}: received the tag {node.tag}\n  rule: plain YAML only"
            f"\n  remedy: remove the tag"
        )


def dotted(at: Key) -> str:
    """("segments", 2, "length") -> "segments[2].length"; keys that are no plain word stand in quotes."""
    out = ""
    for part in at:
        if isinstance(part, int):
            out += f"[{part}]"
        else:
            word = part if re.fullmatch(r"[\w<>-]+", part) else f'"{part}"'
            out += f".{word}" if out else word
    return out
