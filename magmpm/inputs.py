"""What scene and study files share: quantity types, and one error for all that is wrong with a file.

Quantity types are pydantic annotations. In a file a quantity is text with a unit ("40 mm") and a bare number is an
error; models built in Python (no file in the validation context) also take bare floats, in SI. Either way the model
holds SI floats.
"""

from __future__ import annotations

import difflib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, ClassVar, TypeVar, Union, get_args, get_origin

from pydantic import (
    BaseModel,
    ConfigDict,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    ValidationError,
    ValidationInfo,
)
from pydantic.fields import FieldInfo
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from magmpm.errors import InputError, NotThereYet
from magmpm.units import KINDS, BadQuantity, a, format_si, parse_quantity
from magmpm.yamlfile import Document, Key, dotted, read_yaml

__all__ = [
    "Acceleration",
    "Angle",
    "Density",
    "FluxDensity",
    "Length",
    "Part",
    "Pressure",
    "Quantity",
    "Time",
    "fault",
    "folder_of",
    "from_file",
    "read_yaml",
    "validate",
    "write_json_schema",
]

M = TypeVar("M", bound=BaseModel)


class Part(BaseModel):
    """Base of every part of a scene or study: immutable, and unknown keys are errors.

    `not_there_yet` names keys of the published contract that this version does not have, with what they will do.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", validate_default=False)
    not_there_yet: ClassVar[Mapping[str, str]] = {}


def fault(rule: str, remedy: str, at: Key = ()) -> PydanticCustomError:
    """What a validator raises: the rule broken, what to do, and where below the validated key."""
    return PydanticCustomError("fault", "{rule}", {"rule": rule, "remedy": remedy, "at": list(at)})


def from_file(info: ValidationInfo) -> bool:
    """Whether the value being validated was written in a file (units due) rather than given in Python (SI)."""
    return bool(info.context and info.context.get("file"))


def folder_of(info: ValidationInfo) -> Path:
    """The folder that paths in the validated data are relative to."""
    return Path(info.context["file"]).parent if info.context and info.context.get("file") else Path()


@dataclass(frozen=True)
class Quantity:
    """Annotation that makes a float out of text with a unit; bounds are texts with units too."""

    kind: str
    above: str | None = None
    at_least: str | None = None
    at_most: str | None = None

    def read(self, value: Any, info: ValidationInfo) -> float:
        """The value in SI. Raises PydanticCustomError (see `fault`)."""
        kind = KINDS[self.kind]
        write = f'write a number and its unit, such as "{kind.example}"'
        if isinstance(value, str):
            try:
                si = parse_quantity(value, kind)
            except BadQuantity as error:
                raise fault(error.rule, error.remedy) from None
        elif isinstance(value, bool) or not isinstance(value, (int, float)):
            raise fault(f"{a(kind.name)} is due here", write)
        elif from_file(info):
            rule = (
                f"{a(kind.name)} needs a unit"
                if math.isfinite(value)
                else f"{a(kind.name)} must be a finite number"
            )
            raise fault(rule, write)
        else:
            try:
                si = float(value)
            except OverflowError:
                si = math.inf
            if not math.isfinite(si):
                raise fault(
                    f"{a(kind.name)} must be a finite number (in {kind.si})", f'such as "{kind.example}"'
                )
        self._check_bounds(si)
        return si

    def _check_bounds(self, si: float) -> None:
        kind = KINDS[self.kind]
        rules = []
        if self.above is not None and not si > parse_quantity(self.above, kind):
            rules.append(f"must be greater than {self.above}")
        if self.at_least is not None and not si >= parse_quantity(self.at_least, kind):
            rules.append(f"must be at least {self.at_least}")
        if self.at_most is not None and not si <= parse_quantity(self.at_most, kind):
            rules.append(f"must be at most {self.at_most}")
        if rules:
            raise fault(rules[0], f"check number and unit: this reads as {format_si(si, kind)}")

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.with_info_before_validator_function(self.read, handler(source))

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        bounds = [
            f"{word} {bound}"
            for word, bound in (("above", self.above), ("at least", self.at_least), ("at most", self.at_most))
            if bound is not None
        ]
        kind = KINDS[self.kind]
        return {
            "type": "string",
            "title": f"{kind.name}{' (' + ', '.join(bounds) + ')' if bounds else ''}",
            "pattern": r"^\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*[^\s\d.,+-].*$",
            "examples": [kind.example],
        }


Length = Annotated[float, Quantity("length")]
Pressure = Annotated[float, Quantity("pressure")]
Density = Annotated[float, Quantity("density")]
FluxDensity = Annotated[float, Quantity("flux density")]
Angle = Annotated[float, Quantity("angle")]
Acceleration = Annotated[float, Quantity("acceleration")]
Time = Annotated[float, Quantity("time")]


@dataclass(frozen=True)
class _Problem:
    """One thing wrong with the data, in the words of the user's file."""

    at: Key
    received: str
    rule: str
    remedy: str
    later: bool = False

    def text(self, path: Path | None, lines: Mapping[Key, int]) -> str:
        line = next((lines[self.at[:n]] for n in range(len(self.at), -1, -1) if self.at[:n] in lines), 1)
        place = f"{path}:{line}" if path is not None else "input"
        key = dotted(self.at) or "(whole file)"
        return f"{place}: {key}: received {self.received}\n  rule: {self.rule}\n  remedy: {self.remedy}"


def validate(model: type[M], data: Mapping[str, Any], path: Path | str | None = None) -> M:
    """`data` as the model, or one InputError that lists everything wrong with it.

    data: what `read_yaml` returned (units due, line numbers in messages), or any mapping in SI when `path` is None.
    Raises NotThereYet when all that is wrong is keys of a later version, else InputError.
    """
    if path is None and isinstance(data, Document):
        path = data.path
    file = Path(path) if path is not None else None
    problems = _empty_values(data) if file is not None else []
    empty = {problem.at for problem in problems}
    try:
        result = model.model_validate(dict(data), context={"file": file})
        if not problems:
            return result
    except ValidationError as error:
        found = [_translate(model, data, dict(e)) for e in error.errors(include_url=False)]
        meant = {p.at[:-1] + (near,) for p in found if (near := _meant(model, p.at)) is not None}
        problems += [p for p in found if p.at not in empty and not (p.received == _NOTHING and p.at in meant)]
    lines = data.lines if isinstance(data, Document) else {}
    text = "\n".join(problem.text(file, lines) for problem in problems)
    if len(problems) > 1:
        text = f"{len(problems)} problems in {file if file is not None else 'the input'}\n{text}"
    raise (NotThereYet if all(p.later for p in problems) else InputError)(text)


_NOTHING = "nothing"


def _empty_values(data: Any, at: Key = ()) -> list[_Problem]:
    """`key:` with nothing after it: too easily taken for "as usual", so the file must say what is meant."""
    if data is None:
        rule, remedy = (
            "a key must have a value",
            "write {} for a part with its usual values, or remove the key",
        )
        return [_Problem(at, _NOTHING, rule, remedy)]
    if isinstance(data, dict):
        return [p for key, value in data.items() for p in _empty_values(value, (*at, key))]
    if isinstance(data, list):
        return [p for i, value in enumerate(data) for p in _empty_values(value, (*at, i))]
    return []


def _translate(model: type[BaseModel], data: Any, error: dict[str, Any]) -> _Problem:
    """One of pydantic's error records in our words."""
    kind, context = error["type"], error.get("ctx", {})
    at, value, there = _locate(data, error["loc"])
    if kind == "fault":
        below = tuple(context["at"])
        at, value, there = _locate(data, at + below) if below else (at, value, there)
        return _Problem(at, show(value) if there else _NOTHING, context["rule"], context["remedy"])
    if kind == "extra_forbidden":
        return _unknown_key(model, at, value)
    field = _field_at(model, at)
    remedy = _write_example(at, field)
    if kind == "missing":
        rule = "this key is required" if isinstance(at[-1], str) else "this entry is required"
        return _Problem(at, _NOTHING, rule, remedy)
    rule = _RULES.get(kind, "").format(**context) if kind in _RULES else str(error["msg"])
    if kind == "literal_error":
        options = [
            option for option in str(context["expected"]).replace(" or ", ", ").replace("'", "").split(", ")
        ]
        near = difflib.get_close_matches(str(value), options, n=1)
        remedy = f'did you mean "{near[0]}"?' if near else remedy
    elif (
        kind in {"int_type", "float_type"}
        and isinstance(value, str)
        and value.strip("+-").replace(".", "").isdigit()
    ):
        remedy = f"write it without quotes and unit; {remedy}"
    elif kind == "string_type" and not isinstance(value, (dict, list)):
        remedy = f'put it in quotes: "{value}"'
    return _Problem(at, show(value), rule, remedy)


_RULES = {
    "model_type": "must be a mapping of keys",
    "dict_type": "must be a mapping of keys",
    "tuple_type": "must be a list",
    "list_type": "must be a list",
    "too_short": "must have at least {min_length} entries",
    "too_long": "must have at most {max_length} entries",
    "string_too_short": "must not be empty",
    "string_too_long": "must have at most {max_length} characters",
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


def _locate(data: Any, location: tuple[Any, ...]) -> tuple[Key, Any, bool]:
    """Key path, value, and whether it is there; without the union tags that pydantic mixes into locations."""
    at: Key = ()
    for n, part in enumerate(location):
        inside = isinstance(data, Mapping) and part in data
        inside = inside or (isinstance(data, (list, tuple)) and isinstance(part, int) and part < len(data))
        if inside:
            at, data = (*at, part), data[part]
        elif n == len(location) - 1 and isinstance(data, (Mapping, list, tuple)):
            return (*at, part), None, False
    return at, data, True


def _unknown_key(model: type[BaseModel], at: Key, value: Any) -> _Problem:
    parent, key = _model_at(model, at[:-1]), str(at[-1])
    later = parent.not_there_yet.get(key) if parent is not None and issubclass(parent, Part) else None
    if later is not None:
        return _Problem(
            at, show(value), f"`{key}` ({later}) is not there yet in this version", "remove it", later=True
        )
    known = list(parent.model_fields) if parent is not None else []
    near = _meant(model, at)
    homes = [dotted(home) for home in _homes(model, key)]
    if near is not None:
        remedy = f'did you mean "{near}"?'
    elif homes:
        remedy = f"move it: it belongs in {homes[0]} (check the indentation)"
    else:
        remedy = "remove it"
    return _Problem(at, show(value), f'unknown key "{key}"; known here: {", ".join(known)}', remedy)


def _meant(model: type[BaseModel], at: Key) -> str | None:
    """The known key nearest to the unknown one that ends `at`; None when it is known, or nothing is near."""
    parent = _model_at(model, at[:-1]) if at else None
    if parent is None or str(at[-1]) in parent.model_fields:
        return None
    word = str(at[-1]).lower().replace("-", "_").replace(" ", "_")
    near = difflib.get_close_matches(word, parent.model_fields, n=1, cutoff=0.6)
    return near[0] if near else None


def _inner(annotation: Any) -> list[Any]:
    """The plain types in an annotation: Annotated and unions taken apart."""
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
        here = [child for one in here for key, child in _children(one) if key is None or key == part]
    models = [
        inner
        for one in here
        for inner in _inner(one)
        if isinstance(inner, type) and issubclass(inner, BaseModel)
    ]
    return models[0] if models else None


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
            visit(child, (*at, "<name>" if name is None else name))

    visit(model, ())
    return found


def _write_example(at: Key, field: FieldInfo | None) -> str:
    """ "write `length: 40 mm`", from the key's own example."""
    if field is None or not field.examples:
        return f"see {dotted(at) or 'the top level'} in magmpm/scene.schema.json"
    name = next((str(part) for part in reversed(at) if isinstance(part, str)), "")
    example = field.examples[0]
    return f"write, say, `{name}: {example if isinstance(example, str) else show(example)}`"


def show(value: Any) -> str:
    """A value as the user might have written it, cut to a readable length."""
    if isinstance(value, float) and not math.isfinite(value):
        return {"nan": ".nan", "inf": ".inf", "-inf": "-.inf"}[str(value)]
    try:
        text = json.dumps(value, ensure_ascii=False, default=str)
    except (TypeError, ValueError, RecursionError):
        text = str(type(value).__name__)
    return text if len(text) <= 80 else text[:77] + "..."


class _InputSchema(GenerateJsonSchema):
    """JSON schema of what a file may say: a key is there with a value, or it is not there."""

    def nullable_schema(self, schema: core_schema.NullableSchema) -> JsonSchemaValue:
        return self.generate_inner(schema["schema"])

    def default_schema(self, schema: core_schema.WithDefaultSchema) -> JsonSchemaValue:
        return self.generate_inner(
            schema["schema"]
        )  # defaults are SI floats inside; the descriptions name them


def json_schema(model: type[BaseModel]) -> dict[str, Any]:
    """JSON schema (2020-12) of the files that describe this model, as editors use it."""
    schema = model.model_json_schema(schema_generator=_InputSchema)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def write_json_schema(model: type[BaseModel], path: Path | str) -> None:
    """Writes `json_schema(model)` to a file."""
    Path(path).write_text(
        json.dumps(json_schema(model), indent=2, ensure_ascii=False) + "\n", encoding="utf-8"
    )
