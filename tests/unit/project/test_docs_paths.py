"""Files and folders of this project that the pages name in code spans exist, and so do the targets of links."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
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
    text = "`magmpm/model.py`, `magmpm/nothing.py`, `tests/unit/test_nothing*.py`, `magmpm/cli/NAME.py`, [a](README.md), [b](lost.md#part)"
    assert missing(text, ROOT) == ["lost.md", "magmpm/nothing.py", "tests/unit/test_nothing*.py"]


def test_the_map_shows_every_room() -> None:
    """Every folder and file at the root of magmpm stands in docs/design.md's tree, and nothing that is not there."""
    tree = (ROOT / "docs" / "design.md").read_text(encoding="utf-8").split("```")[1]
    shown = set(re.findall(r"^  (\w+(?:/|\.py)) ", tree, re.MULTILINE))
    rooms = {f"{path.name}/" for path in (ROOT / "magmpm").iterdir() if (path / "__init__.py").exists()}
    assert shown == rooms | {path.name for path in (ROOT / "magmpm").glob("*.py") if path.name != "__init__.py"}
