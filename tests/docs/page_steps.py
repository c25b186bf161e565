"""The pages and the code on them: what a reader would type, in order.

Fenced blocks are steps: `python`, `sh` and `yaml`. A comment in the line before a block says how it is tested, if not as it stands:

    <!-- test: file scenes/mine.yaml -->   the block is the content of this file, which later steps use
    <!-- test: not run, because ... -->    with a reason

Lines of `sh` that set up a machine (SETUP) are not run: `make`, the tests of the wheel and continuous integration do that.
"""

import json
import re
import shlex
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").glob("*.md")])
SETUP = (
    "make",
    "pip",
    "apt-get",
    "sudo",
    ".",
    "cd",
    "git",
    "python3",
    "docker",
    "sbatch",
    "kubectl",
    "paraview",
)
SERVERS = ("dashboard", "view")  # commands that serve until they are ended
FENCE = re.compile(
    r"^(?:<!-- test: (?P<how>.*?) -->\n)?```(?P<kind>\w+)\n(?P<text>.*?)^```",
    re.DOTALL | re.MULTILINE,
)


@dataclass(frozen=True)
class Step:
    """A block of a page, or a line of one in `sh`. kind: python, sh, yaml or file; line: of the page, where it begins."""

    kind: str
    text: str
    line: int
    name: str = ""  # of a file

    @property
    def words(self) -> list[str]:
        return shlex.split(self.text, comments=True)


def steps(page: Path) -> list[Step]:
    """Steps of a reader of this page, in order."""
    text = page.read_text(encoding="utf-8")
    found = []
    for match in FENCE.finditer(text):
        how = match["how"] or ""
        kind = match["kind"]
        block = match["text"]
        line = text.count("\n", 0, match.start("text")) + 1
        if how.startswith("not run, because "):
            continue
        if how.startswith("file "):
            found.append(Step("file", block, line, how.removeprefix("file ").strip()))
        elif how:
            raise ValueError(f"{page.name}:{line}: a test can't be told {how!r}")
        elif kind == "sh":
            lines = block.replace("\\\n", " ").splitlines()
            found += [
                Step("sh", each, line + k)
                for k, each in enumerate(lines)
                if shlex.split(each, comments=True)
            ]
        elif kind in ("python", "yaml"):
            found.append(Step(kind, block, line))
    return [step for step in found if step.kind != "sh" or step.words[0] not in SETUP]


def plan(page: Path, folder: Path) -> Path:
    """The file of steps that follow.py takes."""
    file = folder / "steps.json"
    file.write_text(
        json.dumps([[s.kind, s.text, s.line, s.name] for s in steps(page) if s.kind != "yaml"]),
        encoding="utf-8",
    )
    return file


def blocks(page: Path, kind: str) -> list[Step]:
    """The steps of one kind."""
    return [step for step in steps(page) if step.kind == kind]
