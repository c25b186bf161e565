"""Base of scene and study files: quantity types, and one error for all that is wrong with a file.

Quantity types are pydantic annotations. In a file a quantity is text with a unit ("40 mm"), and a bare number is an error. Models built in
Python (no file in the validation context) also take bare floats, in SI. Either way the model holds SI floats.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self, TypeVar

from pydantic import (
    BaseModel,
    ConfigDict,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    SerializationInfo,
    ValidationError,
    ValidationInfo,
    model_validator,
)
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from magmpm.errors import InputError, SceneError, show
from magmpm.inputs.messages import (
    NOTHING,
    Instead,
    Problem,
    empty_values,
    overruled,
    python_example,
    translate,
)
from magmpm.inputs.quantities import KINDS, BadQuantity, a, as_text, format_si, parse_quantity
from magmpm.inputs.user_files import REMEDY, RULE, is_allowed
from magmpm.inputs.yaml_document import Document, Key, placed

M = TypeVar("M", bound=BaseModel)


class _Told(type(BaseModel)):  # type: ignore[misc]
    """Makes objects in Python. What pydantic refuses, its validators of the whole object among them, is told as of files."""

    def __call__(cls, *positional: Any, **given: Any) -> Any:
        if positional:
            raise InputError(
                cls.__name__,
                received=", ".join(show(value) for value in positional),
                rule="settings are given by their names",
                remedy=f"write, say, `{python_example(cls)}`",
            )
        try:
            return super().__call__(**given)
        except ValidationError as error:
            problems, left = _problems(cls, given, error)
            raise _told(problems, left, None, {}, cls.__name__) from None


_MADE: Any = _Told  # mypy knows pydantic's metaclass by a private name alone


class Settings(BaseModel, metaclass=_MADE):  # type: ignore[misc]
    """Base of every part of a scene or study: immutable, and unknown keys are errors.

    `unknown_key`: the remedy for a key of which nothing is known. `one_of`: keys of which one must be given; `written`: such a one.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")
    unknown_key: ClassVar[str] = "remove it"
    one_of: ClassVar[tuple[str, ...]] = ()
    written: ClassVar[str] = ""

    @model_validator(mode="after")
    def _one_is_given(self) -> Self:
        given = sum(getattr(self, key) is not None for key in self.one_of)
        if self.one_of and given != 1:
            *others, last = (f"`{key}`" for key in self.one_of)
            raise fault(
                f"give {', '.join(others)} or {last}, one of them",
                "keep one of them" if given else f"write, say, `{self.written}`",
            )
        return self

    @property
    def given(self) -> str:
        """The key of `one_of` that is given."""
        return next(key for key in self.one_of if getattr(self, key) is not None)

    @staticmethod
    def by_other_keys(key: str, values: Any) -> Instead | None:
        """Return what to write in place of an unknown key that people use; values: what stands beside it. None: nothing is known of it."""
        return None


def standing_for(data: Any, keys: Mapping[Any, str]) -> Any:
    """The mapping for which an object of one of these classes stands, by its key; other data as they are."""
    return next(({key: data} for kind, key in keys.items() if isinstance(data, kind)), data)


def fault(rule: str, remedy: str, at: Key = ()) -> PydanticCustomError:
    """Error for a validator to raise: the rule broken, what to do, and where below the validated key."""
    return PydanticCustomError("fault", "{rule}", {"rule": rule, "remedy": remedy, "at": list(at)})


def check_rising(values: Sequence[float], named: str, unit: str, *key: str) -> None:
    """Raises PydanticCustomError (see `fault`) for a value that is not above the one before; key: where below the value's number."""
    for k, (before, now) in enumerate(pairwise(values), start=1):
        if not now > before:
            raise fault(
                f"{named} must rise: {now:g} {unit} follows {before:g} {unit}",
                "sort them, each once",
                (k, *key),
            )


def from_file(info: ValidationInfo) -> bool:
    """True if the validated value was written in a file (with units) rather than given in Python (in SI)."""
    return bool(info.context and info.context.get("file"))


def _with_units(info: ValidationInfo | SerializationInfo) -> bool:
    """True if quantities are text with a unit, as files have them."""
    return bool(info.context and info.context.get("units"))


def named_file(info: ValidationInfo, name: str | Path) -> Path:
    """The file that a path in the validated data names. Raises PydanticCustomError (see `fault`) for one that it may not name."""
    file = info.context.get("file") if info.context else None
    if not file:
        return Path(name)
    path = Path(file).parent / name
    if not is_allowed(path, Path(file)):
        raise fault(RULE, REMEDY)
    return path


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
            raise fault(f"{a(kind.name)} is expected here", write)
        elif not abs(value) <= 1e300:  # compares integers of any size too, and refuses nan
            raise fault(f"{a(kind.name)} must be a finite number", write)
        elif _with_units(info):
            raise fault(f"{a(kind.name)} needs a unit", write)
        else:
            si = float(value)
        self._check_bounds(si)
        return si

    def write(self, si: float, info: SerializationInfo) -> float | str:
        """The value as plain data hold it: in SI, or with the context `units` as files have it, text that reads as the same float."""
        return as_text(si, KINDS[self.kind]) if _with_units(info) else si

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

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        written = core_schema.plain_serializer_function_ser_schema(self.write, info_arg=True)
        return core_schema.with_info_before_validator_function(
            self.read, handler(source), serialization=written
        )

    def __get_pydantic_json_schema__(
        self, _: CoreSchema, __: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        kind = KINDS[self.kind]
        words = {"above": self.above, "at least": self.at_least, "at most": self.at_most}
        bounds = ", ".join(f"{word} {bound}" for word, bound in words.items() if bound is not None)
        return {
            "type": "string",
            "title": f"{kind.name} {bounds}".strip(),
            "pattern": r"^\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*(1/)?[^\s\d.,+-].*$",
            "examples": [kind.example],
        }


Length = Annotated[float, Quantity("length", above="0 mm", at_most="10 m")]
Width = Annotated[float, Quantity("length", above="0 mm", at_most="1 m")]
Angle = Annotated[float, Quantity("angle", at_least="-360 deg", at_most="360 deg")]
Duration = Annotated[float, Quantity("time", above="0 s", at_most="1e6 s")]
Bytes = Annotated[float, Quantity("size", above="0 B", at_most="1e15 B")]


def validate(
    model: type[M],
    data: Mapping[str, Any],
    path: Path | str | None = None,
    *,
    units: bool = False,
) -> M:
    """`data` as the model, or one InputError that lists everything wrong with it.

    data: what `read_yaml` returned (values have units, messages have line numbers), or any mapping, whose plain numbers are SI where `path`
    is None and `units` is False. Raises InputError.
    """
    if path is None and isinstance(data, Document):
        path = data.path
    file = Path(path) if path is not None else None
    problems = empty_values(data) if file is not None else []
    left = 0
    empty = {problem.at for problem in problems}
    try:
        context = {"file": file, "units": units or file is not None}
        result = model.model_validate(dict(data), context=context)
        if not problems:
            return result
    except ValidationError as error:
        found, left = _problems(model, data, error)
        problems += [problem for problem in found if problem.at not in empty]
    except SceneError as error:  # of a value that needs a package
        raise error if file is None else placed(error, file) from None
    raise _told(problems, left, file, data.lines if isinstance(data, Document) else {})


def _problems(
    model: type[BaseModel], data: Any, error: ValidationError
) -> tuple[list[Problem], int]:
    """Pydantic's errors in words, and the number of those that are not."""
    # problems that are put into words, a millisecond each, of which the first in the file are reported
    most_worded = 500
    errors = [e for e in error.errors(include_url=False) if not overruled(e)]
    found = [translate(model, data, dict(e)) for e in errors[:most_worded]]
    # a misspelled key that is required is one mistake, not two
    meant = {p.meant for p in found if p.meant is not None}
    kept = [p for p in found if not (p.received == NOTHING and p.at in meant)]
    return kept, max(0, len(errors) - most_worded)


def _told(
    problems: list[Problem],
    left: int,
    file: Path | None,
    lines: Mapping[Key, int],
    of: str = "input",
) -> InputError:
    """One error for all problems; left: how many more there are; lines: of keys in the file; of: what has the keys if no file does."""
    most_shown = 20  # problems of a file: more would hide the first
    shown = sorted(problems, key=lambda p: p.line(lines))[:most_shown]
    text = "\n".join(problem.text(file, lines, of) for problem in shown)
    count = len(problems) + left
    if count > most_shown:
        text += f"\n... and {count - most_shown} more"
    if count > 1:
        text = f"{count} problems in {file if file is not None else of}\n{text}"
    return InputError(text)


class _InputSchema(GenerateJsonSchema):
    """JSON schema of what a file may say: a key is there with a value, or it is not there."""

    def field_title_should_be_set(self, schema: Any) -> bool:
        return False  # the key says it

    def nullable_schema(self, schema: core_schema.NullableSchema) -> JsonSchemaValue:
        return self.generate_inner(schema["schema"])

    def default_schema(self, schema: core_schema.WithDefaultSchema) -> JsonSchemaValue:
        # defaults are SI floats inside; the descriptions name them as a file would
        return self.generate_inner(schema["schema"])


def json_schema(model: type[BaseModel]) -> dict[str, Any]:
    """JSON schema (2020-12) of the files that describe this model, as editors use it."""
    schema = model.model_json_schema(schema_generator=_InputSchema)
    for part in (schema, *schema.get("$defs", {}).values()):
        part.pop("title", None)  # names of our classes
        if "description" in part:  # of a docstring its first paragraph: editors show little more
            part["description"] = part["description"].partition("\n\n")[0]
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def write_json_schema(model: type[BaseModel], path: Path | str) -> None:
    """Writes `json_schema(model)` to a file."""
    text = json.dumps(json_schema(model), indent=2, ensure_ascii=False)
    Path(path).write_text(text + "\n", encoding="utf-8")
