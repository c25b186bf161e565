"""Pages: what they name exists, they list every key of studies, every effect and source of fields, and their examples are valid."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from magmpm.effects import acting as effects
from magmpm.effects.acting import NO_LOADS, Effects
from magmpm.fields.sources import FieldSource
from magmpm.inputs.settings import json_schema, validate
from magmpm.scene import load_scene
from magmpm.studies.problem.study_file import StudyFile
from magmpm.studies.search.definition import SAMPLERS, load_study
from magmpm.studies.search.search_space import SearchSpace

ROOT = Path(__file__).resolve().parents[3]
TEXT = (ROOT / "docs/studies.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```yaml\n(.*?)```", TEXT, re.DOTALL)
ROWS = {
    name: row
    for row in TEXT.splitlines()
    if row.startswith("| `")
    for name in re.findall(r"`([^`]+)`", row.split("|")[1])
}


def leaves(
    part: dict[str, Any], schema: dict[str, Any], at: str = ""
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Every key of the schema that holds a value, dotted: ("vary.field.max", its schema)."""
    for key, item in part.get("properties", {}).items():
        name = f"{at}.{key}" if at else key
        kinds = [
            kind.get("items", kind) for kind in item.get("oneOf", item.get("anyOf", [item]))
        ]  # one of several, or a list of them
        inner = [schema["$defs"][kind["$ref"].split("/")[-1]] for kind in kinds if "$ref" in kind]
        below = {
            dotted: leaf
            for kind in inner
            if kind.get("properties")
            for dotted, leaf in leaves(kind, schema, name)
        }
        yield from below.items() if below else [(name, item)]


SCHEMA = json_schema(StudyFile)
KEYS = dict(leaves(SCHEMA, SCHEMA))


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
    named = {
        name
        for row in table.splitlines()
        if row.startswith("| `")
        for name in re.findall(r"`([^`]+)`", row.split("|")[1])
    }
    assert named == set(KEYS) | {"vary"}


def test_the_examples_name_all_keys() -> None:
    text = "".join(EXAMPLES) + (ROOT / "docs/own_target.md").read_text(
        encoding="utf-8"
    )  # an insertion
    assert [key for key in KEYS if not re.search(rf"\b{key.split('.')[-1]}:", text)] == []


@pytest.mark.parametrize("number", range(len(EXAMPLES)))
def test_each_example_loads(number: int, tmp_path: Path) -> None:
    """Its parameters are in the table with their ranges."""
    for folder in ("scenes", "targets", "references"):
        (tmp_path / folder).symlink_to(ROOT / "data" / folder)
    (tmp_path / "studies").mkdir()
    path = tmp_path / "studies/s_shape.yaml"
    path.write_text(EXAMPLES[number])
    study = load_study(path)
    space = SearchSpace.of(study)
    for name, (low, high) in space.bounds.items():
        first = re.sub(
            r"_of_.*_",
            "_of_MATERIAL_",
            re.sub(r"field_\d+", "field", re.sub(r"segment_\d+", "segment_1", name)),
        )
        row = next((row for row in ROWS.values() if f"`{first}`" in row), None)
        assert row is not None, name
        assert f"{low:g} to {high:g}" in row or not name.endswith("_deg")


def test_every_sampler_is_explained() -> None:
    """In the list of its section, by name."""
    section = TEXT.split("\n## Samplers\n")[1].split("\n## ")[0]
    assert set(SAMPLERS) <= set(re.findall(r"\*\*`([\w-]+)`\*\*", section))


EFFECTS_PAGE = (Path(__file__).resolve().parents[3] / "docs/effects.md").read_text(encoding="utf-8")


def test_its_example_names_all_effects_but_loads() -> None:
    (block,) = re.findall(r"```yaml\n(.*?)```", EFFECTS_PAGE, re.DOTALL)
    settings = yaml.safe_load(block)
    named = validate(Effects, settings, "effects.md")
    assert set(settings) == {*NO_LOADS, "fluid"}  # of which rods at rest know the buoyancy
    assert named.ground.friction == 0.3


def test_its_table_has_every_effect() -> None:
    for key in effects.Effects.every():
        assert f"| `{key}` |" in EFFECTS_PAGE


FIELDS = re.findall(r"```yaml\n(field:.*?)```", (ROOT / "docs/fields.md").read_text(), re.DOTALL)
BENEATH = """name: example
materials: {silicone: {shear_modulus: 120 kPa, bulk_to_shear: 20, remanence: 138 mT}}
body: {catheter: {length: 40 mm, diameter: 4 mm, material: silicone, segments: [{magnetization: [1, 0, 0]}]}}
effects: {magnetic_torque: {}, magnetic_force: {}}
"""


@pytest.mark.parametrize("number", range(len(FIELDS)))
def test_example_is_valid(number: int, tmp_path: Path) -> None:
    (tmp_path / "measured").symlink_to(ROOT / "data/measured")
    (tmp_path / "scenes").mkdir()
    path = tmp_path / "scenes" / "probe.yaml"
    path.write_text(BENEATH + FIELDS[number])
    assert load_scene(path).field.acts


def test_the_examples_name_every_source() -> None:
    assert all(
        re.search(rf"^  {key}:", "".join(FIELDS), re.MULTILINE) for key in FieldSource.model_fields
    )


PAGES = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")])
HOUSES = ("magmpm/", "studies/", "viz/", "tests/", "docs/", "data/")
NAMED = re.compile(r"`([\w./*-]+/[\w./*-]*)[:`]")
LINK = re.compile(r"\]\(([^)#\s]+)[^)]*\)")


def missing(text: str, folder: Path) -> list[str]:
    """Paths that a page in a folder names and that don't exist. NAME stands for any; `*` may be used."""
    paths = {path for path in NAMED.findall(text) if path.startswith(HOUSES) and "NAME" not in path}
    links = {link for link in LINK.findall(text) if "://" not in link}
    lost = [path for path in paths if not any(ROOT.glob(path.rstrip("/")))]
    return sorted([*lost, *(link for link in links if not (folder / link).exists())])


@pytest.mark.parametrize("page", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_what_a_page_names_exists(page: Path) -> None:
    assert missing(page.read_text(encoding="utf-8"), page.parent) == []


def test_what_does_not_exist_is_found() -> None:
    text = (
        "`magmpm/model.py`, `magmpm/nothing.py`, `tests/unit/test_nothing*.py`,"
        " `magmpm/cli/NAME.py`, [a](README.md), [b](lost.md#part)"
    )
    assert missing(text, ROOT) == ["lost.md", "magmpm/nothing.py", "tests/unit/test_nothing*.py"]


def test_the_map_shows_every_room() -> None:
    """Every folder and file at the root of magmpm stands in docs/design.md's tree, and nothing that is not there."""
    tree = (ROOT / "docs" / "design.md").read_text(encoding="utf-8").split("```")[1]
    shown = set(re.findall(r"^  (\w+(?:/|\.py)) ", tree, re.MULTILINE))
    rooms = {
        f"{path.name}/"
        for path in (ROOT / "magmpm").iterdir()
        if (path / "__init__.py").exists() and not path.is_symlink()
    }
    assert shown == rooms | {
        path.name for path in (ROOT / "magmpm").glob("*.py") if path.name != "__init__.py"
    }
