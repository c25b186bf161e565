"""YAML files as users write them: plain data, the line of every key, errors that say where and what to do.

Read by the rules of YAML 1.2, not PyYAML's 1.1: `1e-9` is a number, `yes`, `no` and `off` are text, `12:30` is text and not 750, and a
key that appears twice is an error, where PyYAML would take the last one.
"""

import difflib
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml

from magmpm.errors import InputError, Key, SceneError, dotted, report, show, undotted
from magmpm.inputs.user_files import UnfitFile, read_regular

MOST_YAML_BYTES = 1_000_000


class Document(dict[str, Any]):
    """The top-level mapping of a YAML file, its path, and the line of each key path: lines[("a", 2, "b")]."""

    def __init__(self, data: dict[str, Any], path: Path, lines: dict[Key, int]) -> None:
        super().__init__(data)
        self.path = path
        self.lines = lines


class _Loader(yaml.SafeLoader):
    """SafeLoader that follows YAML 1.2 in which plain words are numbers, booleans and nulls."""

    yaml_implicit_resolvers: dict[str, list[tuple[str, re.Pattern[str]]]] = {}  # noqa: RUF012 (PyYAML's protocol)
    depth = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        """A node and what is in it. Raises RecursionError where it is too deep: PyYAML's time grows as the square of the depth."""
        most_depth = 100  # of brackets in brackets
        self.depth += 1
        if self.depth > most_depth:
            raise RecursionError
        try:
            return super().compose_node(parent, index)
        finally:
            self.depth -= 1


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

    Raises InputError with file and line: no such file, no text, no YAML, a key that appears twice, nothing or no `key: value` lines.
    """
    path = Path(path)
    text = _read_text(path)
    try:
        loader = _Loader(text)
        root = loader.get_single_node()
    except yaml.MarkedYAMLError as error:
        raise InputError(_explain(error, path, text)) from None
    except yaml.YAMLError as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{path}: not a text file ({reason})", rule=_RULE, remedy=_START) from None
    except RecursionError:
        raise InputError(f"{path}: brackets nested too deeply", rule=_RULE, remedy=_START) from None
    if root is None:
        raise InputError(f"{path}: the file is empty", rule=_RULE, remedy=_START)
    if not isinstance(root, yaml.MappingNode):
        received = "a list" if isinstance(root, yaml.SequenceNode) else show(str(root.value))
        raise InputError(f"{path}:1", received=received, rule=_RULE, remedy=_START)
    builder = _Builder(path, loader)
    return Document(builder.mapping(root, ()), path, builder.lines)


def read_value(text: str) -> Any:
    """A value as it may stand in a file. Raises ValueError for text that is no YAML."""
    loader = _Loader(text)
    try:
        node = loader.get_single_node()
        return None if node is None else _Builder(Path(), loader).value(node, ())
    except (yaml.YAMLError, RecursionError, InputError):
        raise ValueError(text) from None


def placed(error: SceneError, path: Path | str) -> InputError:
    """An error about a key of a scene, with the scene's file, the line of the key or of what is around it, and the value the file has."""
    document = read_yaml(path)
    at: Key = ()
    value: Any = document
    for part in undotted(error.key.split(", ")[0]):
        if isinstance(part, int) and isinstance(value, dict):
            continue  # one, where a list might stand
        if isinstance(value, (dict, list)) and (*at, part) in document.lines:
            value = value[part]  # type: ignore[index,call-overload]
            at = (*at, part)
        else:
            value = None
            break
    line = document.lines.get(at, 1)
    received = error.received if value is None else show(value)
    return InputError(
        SceneError.text(
            f"{path}:{line}: {error.key}", received, error.found, error.rule, error.remedy
        )
    )


@contextmanager
def of_file(path: Path | str) -> Iterator[None]:
    """A SceneError raised within becomes an InputError that also names the scene's file and line, as those of load_scene do."""
    try:
        yield
    except SceneError as error:
        raise placed(error, path) from None


_RULE = "the file must hold `key: value` lines, in YAML"
_START = "start from one of the files in data/scenes or data/studies"


def _read_text(path: Path) -> str:
    """The file as text. Raises InputError."""
    try:
        if path.is_dir():
            raise InputError(f"{path}: this is a folder", rule=_RULE, remedy="name a file in it")
        return read_regular(path, MOST_YAML_BYTES).decode("utf-8-sig")
    except FileNotFoundError:
        siblings = sorted(p.name for p in path.parent.iterdir()) if path.parent.is_dir() else []
        near = difflib.get_close_matches(path.name, siblings, n=1)
        remedy = (
            f'did you mean "{path.parent / near[0]}"?'
            if near
            else "check the path and the current folder"
        )
        raise InputError(
            f"{path}: no such file", rule="the file must exist", remedy=remedy
        ) from None
    except UnicodeDecodeError as error:
        byte = f"byte {error.object[error.start]:#04x} at {error.start} is not UTF-8"
        raise InputError(f"{path}: not a text file ({byte})", rule=_RULE, remedy=_START) from None
    except UnfitFile as error:
        raise InputError(
            f"{path}: {error.strerror}",
            rule=f"must be a regular file, and must not exceed {MOST_YAML_BYTES} bytes",
            remedy=_START,
        ) from None
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise InputError(
            f"{path}: {reason}",
            rule="the file must be readable",
            remedy="check the path and its permissions",
        ) from None


def _explain(error: yaml.MarkedYAMLError, path: Path, text: str) -> str:
    """PyYAML's error as file:line, what was found there, and what to do."""
    mark = error.problem_mark or error.context_mark
    if error.context_mark is not None and re.search("quoted|flow", error.context or ""):
        mark = (
            error.context_mark
        )  # where a quote or bracket was opened, rather than where its end is missing
    number = mark.line if mark else 0
    lines = text.splitlines()
    line = lines[number] if number < len(lines) else ""
    problem = error.problem or ""
    if "\t" in line[: len(line) - len(line.lstrip())] or "\\t" in problem:
        rule = "a tab cannot indent YAML"
        remedy = "indent with spaces"
    elif "single document" in str(error.context) or "another document" in problem:
        rule = "the file must hold one YAML document"
        remedy = "remove the second `---`"
    else:
        rule = "must be valid YAML: " + " ".join(part for part in (error.context, problem) if part)
        remedy = (
            "check indentation, brackets, quotes and the space after each colon, here and in the"
            " line before"
        )
    return report(f"{path}:{number + 1}", received=show(line.strip()), rule=rule, remedy=remedy)


class _Builder:
    """Plain data from YAML nodes; notes lines and refuses keys that appear twice."""

    def __init__(self, path: Path, loader: _Loader) -> None:
        self.path = path
        self.loader = loader
        self.lines: dict[Key, int] = {}
        self.nodes = 0
        self.open: set[int] = (
            set()
        )  # nodes being built: an alias to one of them would repeat without end

    def report(self, node: yaml.Node, at: Key = (), **words: str) -> str:
        key = f": {dotted(at)}" if at else ""
        return report(f"{self.path}:{node.start_mark.line + 1}{key}", **words)

    def value(self, node: yaml.Node, at: Key) -> Any:
        most_yaml_nodes = 100_000
        self.nodes += 1
        if self.nodes > most_yaml_nodes or id(node) in self.open:
            raise InputError(
                self.report(
                    node,
                    at,
                    received="an alias",
                    rule="aliases must not contain themselves",
                    remedy="write the values out",
                )
            )
        if isinstance(node, yaml.ScalarNode):
            return self.scalar(node, at)
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
        first: dict[str, int] = {}
        for key_node, _ in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                raise InputError(
                    self.report(
                        key_node,
                        at,
                        received="brackets as a key",
                        rule="a key must be a word",
                        remedy="write `key: value`",
                    )
                )
            key = str(key_node.value)
            if key in first:
                raise InputError(
                    self.report(
                        key_node,
                        (*at, key),
                        received=f'the key "{key}" a second time',
                        rule=f"a key may appear once (the first is in line {first[key]})",
                        remedy="remove or rename one of the two",
                    )
                )
            first[key] = key_node.start_mark.line + 1
        try:
            self.loader.flatten_mapping(
                node
            )  # `<<: *defaults`: the merged pairs come first, so own keys win
        except yaml.MarkedYAMLError as error:
            rule = str(error.problem)
            raise InputError(
                self.report(
                    node, at, received="<<", rule=rule, remedy="merge a mapping: `<<: *its_name`"
                )
            ) from None
        data: dict[str, Any] = {}
        for key_node, value_node in node.value:
            key = str(key_node.value)
            self.lines[(*at, key)] = key_node.start_mark.line + 1
            data[key] = self.value(value_node, (*at, key))
        return data

    def scalar(self, node: yaml.ScalarNode, at: Key) -> Any:
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
            return (
                text  # such as thousands of digits: where a number is expected, the text is refused
            )
        if kind == "str" or node.tag == "!":
            return text
        words = {
            "received": f"the tag {node.tag}",
            "rule": "must be plain YAML",
            "remedy": "remove the tag",
        }
        raise InputError(self.report(node, at, **words))
