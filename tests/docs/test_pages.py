"""Every page's code runs: scenes and studies load, commands can be typed, and (slow) all of a page is followed in order.

`make test-docs` runs these alone, with the slow ones.
"""

import ast
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from page_steps import PAGES, ROOT, Step, blocks, plan, steps
from reference.commands import environment

from magmpm.cli.arguments import AFTER, COMMANDS, parser
from magmpm.effects.acting import Effects
from magmpm.errors import InputError
from magmpm.scene import Scene, load_scene
from magmpm.studies.goals.goal_file import GoalFile
from magmpm.studies.goals.goal_study import load_goal
from magmpm.studies.problem.study_file import StudyFile
from magmpm.studies.search.definition import load_study

KEY = re.compile(r"^(\w[\w ]*):", re.MULTILINE)


def name(page: Path) -> str:
    return str(page.relative_to(ROOT))


def following(kinds: tuple[str, ...]) -> list[Path]:
    return [page for page in PAGES if any(step.kind in kinds for step in steps(page))]


def parts(text: str) -> list[str]:
    """A block's alternatives: where a top key comes again, another begins; what comes out of a comment is one too."""
    text = re.sub(r"^# (?=(solver|field|effects|resolution): )", "", text, flags=re.MULTILINE)
    found: list[str] = []
    seen: set[str] = set()
    for line in text.splitlines(keepends=True):
        key = KEY.match(line)
        if key and key[1] in seen:
            found.append("")
            seen = set()
        if key:
            seen.add(key[1])
        if not found:
            found.append("")
        found[-1] += line
    return found


MATERIALS = "\n".join(
    f"  {name}: {{shear_modulus: 120 kPa, bulk_to_shear: 20, density: 1882 kg/m^3, remanence:"
    f" {remanence} mT}}"
    for name, remanence in (
        ("magnetic silicone", 138),
        ("magnetic elastomer", 140),
        ("plain silicone", 0),
    )
)
AROUND = {  # what a part of a scene is put into, where the part does not say it itself
    "name": "name: page\n",
    "materials": f"materials:\n{MATERIALS}\n",
    "body": (
        "body: {catheter: {length: 40 mm, diameter: 4 mm, material: magnetic silicone, segments:"
        " [{magnetization: [1, 0, 0]}]}}\n"
    ),
    "field": "field: {uniform: [0 mT, 6 mT, 8 mT], over_time: {ramp: {duration: 1 s}}}\n",
    "resolution": "resolution: {cells_across: 4}\n",
}
IN_ONE_OF = (  # a field with a gradient needs its force; contact and losses need motion
    {"effects": "effects: {magnetic_torque: {}}\n", "solver": "solver: {static: {}}\n"},
    {
        "effects": "effects: {magnetic_torque: {}, magnetic_force: {}}\n",
        "solver": "solver: {static: {}}\n",
    },
    {
        "effects": "effects: {magnetic_torque: {}, magnetic_force: {}}\n",
        "solver": "solver: {dynamic: {duration: 0.3 s}}\n",
    },
)


def whole_scenes(text: str, keys: set[str]) -> list[str]:
    """Scenes that a part may belong to, with the part in place of what they have under its keys."""

    def indented(under: str) -> str:
        return f"{under}:\n" + "".join(f"  {line}\n" for line in text.splitlines())

    if keys <= set(Effects.model_fields):
        text = indented("effects")
        keys = {"effects"}
    return [
        "".join(part for key, part in {**AROUND, **more}.items() if key not in keys) + text
        for more in IN_ONE_OF
    ]


def load(text: str, folder: Path) -> Any:
    """A block's scene or study. Its files are those of `data`."""
    keys = set(KEY.findall(text))
    for inside in ("scenes", "studies"):
        (folder / inside).mkdir(exist_ok=True)
    for inside in ("targets", "references", "measured"):
        if not (folder / inside).exists():
            (folder / inside).symlink_to(ROOT / "data" / inside)
    for scene in (ROOT / "data/scenes").rglob("*.*"):
        at = folder / "scenes" / scene.relative_to(ROOT / "data/scenes")
        at.parent.mkdir(parents=True, exist_ok=True)
        if not at.exists():
            at.symlink_to(scene)
    of_studies = {*StudyFile.model_fields, *GoalFile.model_fields} - set(Scene.model_fields)
    if "scene" in keys or keys & of_studies:
        path = folder / "studies/page.yaml"
        path.write_text(text, encoding="utf-8")
        return load_goal(path) if "goal" in keys else load_study(path)
    path = folder / "scenes/page.yaml"
    refusals = []
    for whole in [text] if {"materials", "body", "name"} <= keys else whole_scenes(text, keys):
        path.write_text(whole, encoding="utf-8")
        try:
            return load_scene(path)
        except InputError as error:
            refusals.append(error)
    raise refusals[0]


YAML = [(page, step) for page in PAGES for step in steps(page) if step.kind == "yaml"]


@pytest.mark.parametrize(
    ("page", "step"), YAML, ids=lambda x: name(x) if isinstance(x, Path) else f"{x.line}"
)
def test_scenes_and_studies_load(page: Path, step: Step, tmp_path: Path) -> None:
    for text in parts(step.text):
        assert load(text, tmp_path) is not None


@pytest.mark.parametrize("page", following(("sh",)), ids=name)
def test_commands_can_be_typed(page: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Options exist, and what they read is there: in the repository, or made by an earlier line of a page."""
    for step in blocks(page, "sh"):
        assert step.words[0] in ("magmpm", "python"), f"line {step.line}: {step.text}"
        if step.words[0] == "magmpm" and step.words[1:] not in (["--help"], ["--version"]):
            parser().parse_args(step.words[1:])
        for word in step.words:
            if word.startswith(("data/", "docs/")):
                assert (ROOT / word).exists(), f"line {step.line}: {word}"


@pytest.mark.parametrize("command", COMMANDS)
def test_examples_of_help_can_be_typed(command: str) -> None:
    """Each begins with its own command, and has its arguments."""
    for line in COMMANDS[command].examples.splitlines():
        typed = shlex.split(line)
        assert typed[:2] == ["magmpm", command]
        parser().parse_args(typed[1:])


def test_examples_of_the_first_help_can_be_typed() -> None:
    lines = [line for line in AFTER.splitlines() if line.startswith("  magmpm ")]
    assert len(lines) == 4
    for line in lines:
        words, what = re.split(r"  +", line.strip())
        parser().parse_args(words.split()[1:])
        assert what


def follow(
    page: Path, folder: Path, python: str = sys.executable, *options: str
) -> subprocess.CompletedProcess[str]:
    """Do what a page says, in a folder that has a copy of the repository's data, as `magmpm examples .` makes it."""
    shutil.copytree(ROOT / "data", folder / "data")
    (folder / "docs").symlink_to(ROOT / "docs")
    command = [python, ROOT / "tests/docs/follow.py", plan(page, folder), *options]
    return subprocess.run(
        command, cwd=folder, env=environment(), capture_output=True, text=True, check=False
    )


@pytest.mark.slow
@pytest.mark.parametrize("page", following(("sh", "python", "file")), ids=name)
def test_a_page_can_be_followed(page: Path, tmp_path: Path) -> None:
    """All its commands and all its Python, one after the other, studies with two trials."""
    done = follow(page, tmp_path, sys.executable, "--quick")
    assert done.returncode == 0, f"{name(page)}\n{done.stdout[-2000:]}\n{done.stderr[-4000:]}"


def test_what_does_not_work_is_found(tmp_path: Path) -> None:
    """Wrong Python, a command that fails and a scene with a wrong key: each is told with its line."""
    page = tmp_path / "page.md"
    page.write_text("text\n```python\nx = 1\n```\n```python\nassert x == 2\n```\n")
    folder = tmp_path / "a"
    folder.mkdir()
    done = follow(page, folder)
    assert done.returncode == 1
    assert "line 6: python: assert x == 2: AssertionError" in done.stderr
    with pytest.raises(Exception, match="gravitty"):
        load("effects: {gravitty: {}}\n", tmp_path)
    page.write_text("<!-- test: maybe -->\n```sh\nmagmpm run x\n```\n")
    with pytest.raises(ValueError, match="maybe"):
        steps(page)


# docs/fitting.md and docs/sensitivities.md: their code runs, and finds what they say


def names_of(page: str, count: int) -> dict[str, Any]:
    """Names that all blocks of a page, one after the other as a reader would type them, have made."""
    code = blocks(ROOT / "docs" / page, "python")
    assert len(code) == count
    names: dict[str, Any] = {}
    for block in code:
        exec(compile(block.text, page, "exec"), names)
    return names


@pytest.mark.slow
def test_fitting(monkeypatch: pytest.MonkeyPatch) -> None:
    """The interval holds the modulus that was hidden, and the refusal names what would tell."""
    monkeypatch.chdir(ROOT)
    constant = names_of("fitting.md", 2)["found"].constants[0]
    assert constant.low < 105e3 < constant.high
    assert constant.high - constant.low < 0.1 * 105e3


def test_sensitivities(monkeypatch: pytest.MonkeyPatch) -> None:
    """The two tips are each other's mirror."""
    monkeypatch.chdir(ROOT)
    names = names_of("sensitivities.md", 3)
    up = names["up"]
    down = names["down"]
    assert abs(up.tip[2]) > 5e-3
    np.testing.assert_allclose(down.tip, up.tip * [1, 1, -1], atol=1e-6 * 40e-3)
    assert np.linalg.norm(names["scatter"]) > 1e-4


# docs/first_hour.ipynb: it is stored without outputs, its code is that of Python, and (slow) all of it runs


NOTEBOOK = ROOT / "docs/first_hour.ipynb"
CELLS = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
CODE = ["".join(cell["source"]) for cell in CELLS if cell["cell_type"] == "code"]


def test_it_is_stored_without_outputs() -> None:
    assert len(CODE) >= 8
    for cell in CELLS:
        assert cell.get("outputs", []) == []
        assert cell.get("execution_count") is None
    assert NOTEBOOK.stat().st_size < 20_000
    for text in CODE:
        ast.parse(text)


@pytest.mark.slow
def test_all_of_it_runs(tmp_path: Path) -> None:
    (tmp_path / "data").symlink_to(ROOT / "data")
    if find_spec("nbclient") and find_spec("ipykernel"):
        import nbclient
        import nbformat

        os.environ["PYTHONPATH"] = str(ROOT)  # of the kernel
        notebook = nbformat.read(NOTEBOOK, as_version=4)  # type: ignore[no-untyped-call]
        done = nbclient.NotebookClient(
            notebook, timeout=600, resources={"metadata": {"path": str(tmp_path)}}
        ).execute()
        shown = [
            output for cell in done.cells if cell.cell_type == "code" for output in cell.outputs
        ]
        pictures = [
            output for output in shown if "<svg" in str(output.get("data", {}).get("text/html", ""))
        ]
        assert len(pictures) == 3  # the scene, the result, the best design
    else:
        script = tmp_path / "cells.py"
        script.write_text("\n".join(CODE), encoding="utf-8")
        ran = subprocess.run(
            [sys.executable, script],
            cwd=tmp_path,
            env=environment(),
            capture_output=True,
            text=True,
            check=False,
        )
        assert ran.returncode == 0, ran.stderr[-3000:]


# docs/troubleshooting.md quotes what the program says; tables hold numbers and phrases, not paragraphs


QUOTED = re.compile(r"\*\*`(.+?)`\*\*", re.DOTALL)
MOST_WORDS = 40  # of a cell: about two lines of a table of three columns


def said(path: Path) -> list[str]:
    """Texts of a module, each in one line, with a tab for what is put into it as it runs."""
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        pieces = node.values if isinstance(node, ast.JoinedStr) else [node]
        texts = [piece.value if isinstance(piece, ast.Constant) else "\t" for piece in pieces]
        if all(isinstance(text, str) for text in texts):
            found.append("".join(texts).replace("\n", " "))
    return found


def quoted(page: Path) -> list[str]:
    """Messages on a page, with their lines joined: `...` stands for what the program puts there."""
    return [" ".join(text.split()) for text in QUOTED.findall(page.read_text(encoding="utf-8"))]


def unsaid(messages: list[str], texts: str) -> list[str]:
    """Messages that none of these texts, one a line, can have said."""

    def pattern(message: str) -> str:
        return ".*".join(re.escape(part.strip()) for part in message.split("..."))

    return [message for message in messages if not re.search(pattern(message), texts)]


def test_troubleshooting_quotes_what_the_program_says() -> None:
    texts = [(ROOT / "Makefile").read_text(encoding="utf-8")]
    for package in ("magmpm", "studies", "viz"):
        for path in sorted((ROOT / package).rglob("*.py")):
            texts += said(path)
    messages = quoted(ROOT / "docs/troubleshooting.md")
    assert len(messages) > 30
    assert unsaid(messages, "\n".join(texts)) == []
    assert unsaid(["the moon is ... far"], "\n".join(texts)) == ["the moon is ... far"]


def long_cells(text: str) -> list[str]:
    """Cells of a page's tables with more than MOST_WORDS words."""
    rows = [line.strip().strip("|") for line in text.splitlines() if line.startswith("|")]
    cells = [cell.strip() for row in rows for cell in re.split(r"(?<!\\)\|", row)]
    return [cell for cell in cells if len(cell.split()) > MOST_WORDS]


@pytest.mark.parametrize("page", [*PAGES, *sorted((ROOT / "docs").glob("*/*.md"))], ids=name)
def test_cells_of_tables_are_short(page: Path) -> None:
    assert long_cells(page.read_text(encoding="utf-8")) == []


def test_a_long_cell_is_found() -> None:
    assert long_cells("| a | " + "word " * 41 + "|\n| --- | --- |") == [" ".join(["word"] * 41)]
    assert long_cells("| a | " + "word " * 40 + "|") == []
