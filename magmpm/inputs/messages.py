"""Messages on faults in a file, in the terms of the file: line, key, value received, rule broken, what to do.

pydantic reports errors with locations and types of its own. Here they become `Problem`s, with the nearest known key, the place where a
misplaced key belongs, and an example from the key's own documentation.
"""

import difflib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, NamedTuple, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from magmpm.errors import Key, dotted, flow, report, show


class Instead(NamedTuple):
    """Text to write in place of a key that people use and that is not known: `by_other_keys(key, values)` of a part of a file returns it.

    remedy: what to do; key: the known key that says the same, where one key does.
    """

    remedy: str
    key: str | None = None


@dataclass(frozen=True)
class Problem:
    """One thing wrong with the data, in the words of the user's file. meant: the known key in whose place an unknown one stands."""

    at: Key
    received: str
    rule: str
    remedy: str
    meant: Key | None = None

    def line(self, lines: Mapping[Key, int]) -> int:
        """Line of the key, or of the nearest part around it that the file has."""
        return next(
            (lines[self.at[:n]] for n in range(len(self.at), -1, -1) if self.at[:n] in lines), 1
        )

    def text(self, path: Path | None, lines: Mapping[Key, int], of: str) -> str:
        place = f"{path}:{self.line(lines)}" if path is not None else of
        key = dotted(self.at) or "(whole file)"
        return report(f"{place}: {key}", received=self.received, rule=self.rule, remedy=self.remedy)


def overruled(error: Mapping[str, Any]) -> bool:
    """True if pydantic calls a list too short only because it left out the entries that it refused."""
    return error["type"] == "too_short" and len(error["input"]) >= error["ctx"]["min_length"]


NOTHING = "nothing"  # what is received where a key or a value is missing


def empty_values(data: Any, at: Key = ()) -> list[Problem]:
    """`key:` with nothing after it: a reader may take it for the default, so the file must say what is meant."""
    if data is None:
        remedy = "write {} for the defaults, or remove the key"
        return [Problem(at, NOTHING, "a key must have a value", remedy)]
    if isinstance(data, dict):
        return [p for key, value in data.items() for p in empty_values(value, (*at, key))]
    if isinstance(data, list):
        return [
            problem
            for i, value in enumerate(data)
            if value is not None  # `null` in a list is written, not forgotten
            for problem in empty_values(value, (*at, i))
        ]
    return []


def translate(model: type[BaseModel], data: Any, error: dict[str, Any]) -> Problem:
    """One of pydantic's errors as a Problem."""
    kind = error["type"]
    context = error.get("ctx", {})
    at, value, there = _locate(data, error["loc"], absent=kind == "missing")
    if kind == "fault":
        at, value, there = _locate(data, (*at, *context["at"]), absent=True)
        return Problem(at, show(value) if there else NOTHING, context["rule"], context["remedy"])
    if kind == "extra_forbidden":
        return _unknown_key(model, data, at, value)
    remedy = _write_example(at, _field_at(model, at))
    if kind == "missing":
        rule = "this key is required" if isinstance(at[-1], str) else "this entry is required"
        return Problem(at, NOTHING, rule, remedy)
    rule = _RULES.get(kind, "").format(**context) if kind in _RULES else str(error["msg"])
    if kind == "literal_error":
        near = difflib.get_close_matches(
            str(value), re.findall("'([^']*)'", context["expected"]), n=1
        )
        remedy = f'did you mean "{near[0]}"?' if near else remedy
    elif (
        kind in {"int_type", "float_type"}
        and isinstance(value, str)
        and re.match(r"[-+.\d]", value)
    ):
        remedy = f"a plain number, without quotes or unit; {remedy}"
    elif kind == "string_type" and not isinstance(value, (dict, list)):
        remedy = f'put it in quotes: "{value}"'
    return Problem(at, show(value), rule, remedy)


_RULES = {
    "model_type": "must be a mapping of keys",
    "dict_type": "must be a mapping of keys",
    "tuple_type": "must be a list",
    "list_type": "must be a list",
    "too_short": "must have {min_length} or more entries",
    "too_long": "must have {max_length} or fewer entries",
    "string_too_short": "must not be empty",
    "string_too_long": "must have {max_length} or fewer characters",
    "string_type": "must be text",
    "int_type": "must be a whole number",
    "float_type": "must be a number",
    "bool_type": "must be true or false",
    "finite_number": "must be a finite number",
    "literal_error": "must be {expected}",
    "greater_than": "must be greater than {gt}",
    "greater_than_equal": "must be at least {ge}",
    "less_than": "must be less than {lt}",
    "less_than_equal": "must be at most {le}",
}


def _locate(data: Any, location: tuple[Any, ...], *, absent: bool) -> tuple[Key, Any, bool]:
    """Key path without pydantic's union tags, value, whether it exists. absent: the last part may be a missing key rather than a tag."""
    at: Key = ()
    for n, part in enumerate(location):
        inside = isinstance(data, Mapping) and part in data
        inside = inside or (
            isinstance(data, (list, tuple)) and isinstance(part, int) and part < len(data)
        )
        if inside:
            at = (*at, part)
            data = data[part]
        elif isinstance(data, BaseModel) and part in data.model_fields_set:  # made in Python
            at = (*at, part)
            data = getattr(data, part)
        elif absent and n == len(location) - 1:
            return (*at, part), None, False
    return at, data, True


def _unknown_key(model: type[BaseModel], data: Any, at: Key, value: Any) -> Problem:
    parent = _model_at(model, at[:-1])
    key = str(at[-1])
    known = list(parent.model_fields) if parent is not None else []
    values = _locate(data, at[:-1], absent=False)[1]
    beside = values if isinstance(values, Mapping) else {}
    instead: Instead | None = getattr(parent, "by_other_keys", lambda key, values: None)(
        key, beside
    )
    near = None if parent is None else _nearest_key(parent, key, beside)
    within = sorted(
        _homes(model, key), key=lambda home: home[: len(at) - 1] != at[:-1]
    )  # first those below the place where it stands
    homes = [dotted(home) for home in within]
    if instead is not None:
        remedy = instead.remedy
    elif near is not None:
        remedy = f'did you mean "{near}"?'
    elif homes:
        remedy = f"move it: it belongs in {homes[0]} (check the indentation)"
    else:
        remedy = getattr(parent, "unknown_key", "remove it")
    meant = near if instead is None else instead.key
    rule = f'unknown key "{key}"; known here: {", ".join(known) or "none"}'
    return Problem(
        at, show(value), rule, remedy, meant=None if meant is None else (*at[:-1], meant)
    )


def plain_word(key: str) -> str:
    """A key as this program would write it: "Young's modulus" -> "youngs_modulus"."""
    return re.sub(r"[\s-]+", "_", key.strip().lower().replace("'", ""))


def _nearest_key(parent: type[BaseModel], key: str, beside: Mapping[str, Any]) -> str | None:
    """The known key nearest to an unknown one: of those that must be there and are missing, of the missing, of all. None: none is near."""
    missing = [name for name in parent.model_fields if name not in beside]
    needed = [name for name in missing if parent.model_fields[name].is_required()]
    for known in (needed, missing, parent.model_fields):
        near = difflib.get_close_matches(plain_word(key), known, n=1, cutoff=0.6)
        if near:
            return near[0]
    return None


def _inner(annotation: Any) -> list[Any]:
    """The plain types in an annotation: Annotated and unions resolved."""
    origin = get_origin(annotation)
    if origin is Annotated:
        return _inner(get_args(annotation)[0])
    if origin in (Union, UnionType):
        return [inner for arm in get_args(annotation) for inner in _inner(arm)]
    return [annotation]


def _children(annotation: Any) -> list[tuple[str | None, Any]]:
    """(key, annotation) of what an annotated value may hold; key None stands for any key or index."""
    found: list[tuple[str | None, Any]] = []
    for inner in _inner(annotation):
        if isinstance(inner, type) and issubclass(inner, BaseModel):
            found += [(name, field.annotation) for name, field in inner.model_fields.items()]
        elif get_origin(inner) in (dict, Mapping):
            found.append((None, get_args(inner)[1]))
        elif get_origin(inner) in (tuple, list):
            found.append((None, get_args(inner)[0]))
    return found


def _model_at(model: type[BaseModel], at: Key) -> type[BaseModel] | None:
    """The model class that describes the value at a key path."""
    here: list[Any] = [model]
    for part in at:
        here = [
            child for one in here for key, child in _children(one) if key is None or key == part
        ]
    found = [inner for one in here for inner in _inner(one)]
    items = [
        item
        for inner in found
        if get_origin(inner) in (list, tuple)
        for arm in get_args(inner)[:1]
        for item in _inner(arm)
    ]
    for inner in (*found, *items):  # one thing, where a list of them may stand as well
        if isinstance(inner, type) and issubclass(inner, BaseModel):
            return inner
    return None


def _field_at(model: type[BaseModel], at: Key) -> FieldInfo | None:
    """pydantic's record of the nearest named key at or above a key path."""
    for n in range(len(at) - 1, -1, -1):
        parent = _model_at(model, at[:n])
        if parent is not None and at[n] in parent.model_fields:
            return parent.model_fields[str(at[n])]
    return None


def _homes(model: type[BaseModel], key: str) -> list[Key]:
    """The parts of a file that know this key."""
    found: list[Key] = []

    def visit(annotation: Any, at: Key) -> None:
        for name, child in _children(annotation):
            if name == key:
                found.append(at or ("the top level",))
            named = any(
                get_origin(inner) in (dict, Mapping) for inner in _inner(annotation)
            )  # else one of a list
            step = (name,) if name is not None else ("<name>",) if named else ()
            visit(child, (*at, *step))

    visit(model, ())
    return found


def _write_example(at: Key, field: FieldInfo | None) -> str:
    """Remedy made from the key's own example: write, say, `length: 40 mm`."""
    if field is None or not field.examples:
        return "correct it"
    name = next((str(part) for part in reversed(at) if isinstance(part, str)), "")
    return f"write, say, `{name}: {flow(field.examples[0])}`"


def python_example(model: type[BaseModel]) -> str:
    """Text that makes an object in Python, with the settings that it needs, or with the first one if it needs none."""
    fields = model.model_fields
    needed = [name for name, field in fields.items() if field.is_required()] or list(fields)[:1]
    settings = [f"{name}={(fields[name].examples or ['...'])[0]!r}" for name in needed]
    return f"{model.__name__}({', '.join(settings)})"
