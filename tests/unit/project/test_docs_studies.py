"""docs/studies.md: it lists every key of study files with its range, and its example is a valid study."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from magmpm.errors import NotThereYet
from magmpm.inputs.settings import json_schema
from magmpm.studies.problem.study_file import StudyFile
from magmpm.studies.search.definition import SAMPLERS, load_study
from magmpm.studies.search.search_space import SearchSpace

ROOT = Path(__file__).resolve().parents[3]
TEXT = (ROOT / "docs/studies.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```yaml\n(.*?)```", TEXT, re.DOTALL)
ROWS = {name: row for row in TEXT.splitlines() if row.startswith("| `") for name in re.findall(r"`([^`]+)`", row.split("|")[1])}


def leaves(part: dict[str, Any], schema: dict[str, Any], at: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    """Every key of the schema that holds a value, dotted: ("vary.field.max", its schema)."""
    for key, item in part.get("properties", {}).items():
        name = f"{at}.{key}" if at else key
        kinds = [kind.get("items", kind) for kind in item.get("oneOf", item.get("anyOf", [item]))]  # one of several, or a list of them
        inner = [schema["$defs"][kind["$ref"].split("/")[-1]] for kind in kinds if "$ref" in kind]
        below = {dotted: leaf for kind in inner if kind.get("properties") for dotted, leaf in leaves(kind, schema, name)}
        yield from below.items() if below else [(name, item)]


SCHEMA = json_schema(StudyFile)
KEYS = dict(leaves(SCHEMA, SCHEMA))


def test_the_schema_has_its_keys() -> None:
    assert {"scene", "vary.magnetization", "vary.field.max", "stop.rms", "trials"} <= set(KEYS)


@pytest.mark.parametrize("key", KEYS)
def test_every_key_is_in_the_table(key: str) -> None:
    """With its bounds and allowed values."""
    row = ROWS[key]
    for bound in ("minimum", "maximum"):
        if bound in KEYS[key]:
            assert f"{KEYS[key][bound]:,}".replace(",", " ") in row
    for value in KEYS[key].get("enum", KEYS[key].get("items", {}).get("enum", ())):
        assert f"`{value}`" in row
    for number in re.findall(r"(?<=at most )[\d.]+ \w+", KEYS[key].get("title", "")):
        assert number in row


def test_the_table_has_no_other_keys() -> None:
    table = TEXT.split("## Keys")[1].split("\n## ")[0]
    named = {name for row in table.splitlines() if row.startswith("| `") for name in re.findall(r"`([^`]+)`", row.split("|")[1])}
    assert named == set(KEYS) | {"vary"}


def test_the_examples_name_all_keys() -> None:
    text = "".join(EXAMPLES) + (ROOT / "docs/own_target.md").read_text(encoding="utf-8")  # an insertion
    assert [key for key in KEYS if not re.search(rf"\b{key.split('.')[-1]}:", text)] == []


@pytest.mark.parametrize("number", range(len(EXAMPLES)))
def test_each_example_loads(number: int, tmp_path: Path) -> None:
    """Its parameters are in the table with their ranges."""
    for folder in ("scenes", "targets", "references"):
        (tmp_path / folder).symlink_to(ROOT / "data" / folder)
    (tmp_path / "studies").mkdir()
    path = tmp_path / "studies/s_shape.yaml"
    path.write_text(EXAMPLES[number])
    try:
        study = load_study(path)
    except NotThereYet:
        return
    space = SearchSpace.of(study)
    for name, (low, high) in space.bounds.items():
        first = re.sub(r"_of_.*_", "_of_MATERIAL_", re.sub(r"field_\d+", "field", re.sub(r"segment_\d+", "segment_1", name)))
        row = next((row for row in ROWS.values() if f"`{first}`" in row), None)
        assert row is not None, name
        assert f"{low:g} to {high:g}" in row or not name.endswith("_deg")


def test_every_sampler_has_a_row() -> None:
    assert set(SAMPLERS) <= set(ROWS)
