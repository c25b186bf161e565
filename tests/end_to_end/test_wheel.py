"""The wheel: installed in an empty environment, bare and then with extras, and used there without the checkout. Also: examples, citation.

`WHEEL=PATH` tries that wheel (`make release`) in place of one that is built here.
"""

import json
import os
import re
import runpy
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
import yaml

from magmpm.cli import main
from magmpm.cli.first_steps import examples_folder
from magmpm.results.result import CITATION

ROOT = Path(__file__).resolve().parents[2]
RELATIVE = re.compile(r"\]\((?!https://|#)[^()\s]*\)")


def test_examples_are_copied_once_and_changes_are_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["examples", str(tmp_path)]) == 0
    assert "magmpm run" in capsys.readouterr().out
    scene = tmp_path / "data/scenes/five_segments.yaml"
    assert scene.read_bytes() == (ROOT / "data/scenes/five_segments.yaml").read_bytes()
    assert main(["examples", str(tmp_path)]) == 0
    scene.write_text("mine")
    assert main(["examples", str(tmp_path)]) == 2
    assert "five_segments.yaml" in capsys.readouterr().err
    assert scene.read_text() == "mine"
    assert main(["examples", str(tmp_path), "--overwrite"]) == 0
    assert scene.read_text() != "mine"
    assert main(["examples", str(ROOT)]) == 2
    assert examples_folder() == ROOT / "data"


def test_how_to_cite_is_said_in_one_way() -> None:
    """CITATION.cff, setup.cfg and the pages of studies agree."""
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert {"cff-version", "message", "title", "authors"} <= set(cited)
    assert cited["title"] in CITATION
    assert cited["authors"][0]["name"] in CITATION
    assert f"version {cited['version']}" in CITATION
    assert str(cited["date-released"])[:4] in CITATION
    assert f"version = {cited['version']}\n" in (ROOT / "setup.cfg").read_text(encoding="utf-8")


def test_the_page_for_pypi_has_no_dead_link() -> None:
    """Links and pictures lead to the tag in the repository; without an address on the web there are none, and all words stay."""
    made = runpy.run_path(str(ROOT / "docs/site/release.py"))
    address = made["address"]
    assert address("git@example.org:lab/magmpm.git") == "https://example.org/lab/magmpm"
    assert address("https://example.org/lab/magmpm/") == "https://example.org/lab/magmpm"
    assert address("/srv/git/magmpm") is None
    assert address("") is None
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert readme.count("](docs/") > 10
    linked = made["page"](readme, "https://example.org/lab/magmpm", "v1")
    assert RELATIVE.findall(linked) == []
    assert "](https://example.org/lab/magmpm/raw/v1/docs/images/tentacle_hook.gif)" in linked
    assert "[Accuracy](https://example.org/lab/magmpm/blob/v1/docs/accuracy.md)" in linked
    bare = made["page"](readme, None, "v1")
    assert RELATIVE.findall(bare) == []
    assert "![" not in bare
    assert "*Accuracy* has the other" in bare
    assert re.findall(r"```.*?```", bare, re.DOTALL) == re.findall(r"```.*?```", readme, re.DOTALL)


def test_the_paper_is_as_long_as_its_journal_wants() -> None:
    """JOSS: 250 to 1000 words, with its sections, and every reference in paper.bib."""
    _, head, text = (ROOT / "paper.md").read_text(encoding="utf-8").split("---\n", 2)
    assert {"title", "tags", "authors", "affiliations", "date", "bibliography"} <= set(
        yaml.safe_load(head)
    )
    assert 250 <= len(re.findall(r"\w+", re.sub(r"\[@[^\]]*\]", "", text))) <= 1000
    for section in ("# Summary", "# Statement of need", "# State of the field"):
        assert section in text
    keys = set(re.findall(r"@\w+\{(\w+),", (ROOT / "paper.bib").read_text(encoding="utf-8")))
    assert set(re.findall(r"@(\w+)", text)) == keys


def run(*words: str | Path, cwd: Path) -> str:
    """A command's output; fails with all it said."""
    names = ("PYTHONPATH", "VIRTUAL_ENV", "NUMBA_CACHE_DIR")
    environment = {name: value for name, value in os.environ.items() if name not in names}
    done = subprocess.run(
        [str(word) for word in words],
        cwd=cwd,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, f"{words}\n{done.stdout[-2000:]}\n{done.stderr[-4000:]}"
    return done.stdout


def built(known: list[str], folder: Path) -> Path:
    """The wheel of a clean copy of what git knows."""
    source = folder / "source"
    wheels = folder / "wheels"
    for name in known:
        (source / name).parent.mkdir(parents=True, exist_ok=True)
        # magmpm/studies and magmpm/viz are links
        shutil.copy(ROOT / name, source / name, follow_symlinks=False)
    run(sys.executable, "-m", "pip", "wheel", "--no-deps", "-w", wheels, ".", cwd=source)
    (wheel,) = wheels.glob("magmpm-*.whl")
    return wheel


@pytest.mark.slow
def test_the_wheel_works_in_an_empty_environment(tmp_path: Path) -> None:
    """Every file of `data` is in it. Bare it solves; with `design` and `render` it designs and draws."""
    home = tmp_path / "home"
    home.mkdir()
    known = run("git", "ls-files", cwd=ROOT).split()
    given = os.environ.get("WHEEL")
    wheel = built(known, tmp_path) if given is None else Path(given)
    with zipfile.ZipFile(wheel) as content:
        held = {name.partition("/data/share/magmpm/")[2] for name in content.namelist()}
        assert {
            "magmpm/py.typed",
            "magmpm/scene.schema.json",
            "magmpm/studies/study.schema.json",
        } <= set(content.namelist())
        (told,) = (name for name in content.namelist() if name.endswith(".dist-info/METADATA"))
        description = content.read(told).decode()
        assert "## Fifteen lines of Python" in description
        if given is not None:
            assert RELATIVE.findall(description) == []
    assert {name for name in known if name.startswith("data/")} <= held
    run(sys.executable, "-m", "venv", tmp_path / "empty", cwd=home)
    bin_folder = tmp_path / "empty/bin"
    pip = (bin_folder / "python", "-m", "pip", "install", "-c", ROOT / "constraints.txt")
    run(*pip, wheel, cwd=home)
    magmpm = bin_folder / "magmpm"
    run(magmpm, "examples", ".", cwd=home)
    bare = json.loads(run(magmpm, "run", "data/scenes/five_segments.yaml", "--json", cwd=home))
    run(*pip, f"{wheel}[design,render]", cwd=home)
    for name in ("studies.py", "viz.py"):  # a user's own modules, with names like our folders
        (home / name).write_text(
            "raise SystemExit('a module of the user was imported')", encoding="utf-8"
        )
    told = json.loads(
        run(magmpm, "run", "data/scenes/five_segments.yaml", "--render", "--json", cwd=home)
    )
    assert told["converged"]
    assert told["tip"] == bare["tip"]
    assert (home / "runs/five-segment-catheter/picture.png").stat().st_size > 10_000
    where = run(
        bin_folder / "python",
        "-c",
        "import magmpm.viz; print(magmpm.__file__, magmpm.viz.__file__)",
        cwd=home,
    )
    assert all(str(tmp_path / "empty") in path for path in where.split())
    design = json.loads(
        run(magmpm, "design", "data/studies/c_shape.yaml", "--trials", "2", "--json", cwd=home)
    )
    assert design["trials"] == 2
    run(magmpm, "report", "runs/c_shape", "--no-pdf", cwd=home)
    assert (home / "runs/c_shape/report.html").exists()
