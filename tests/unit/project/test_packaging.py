"""What an installation may hold: the least versions of setup.cfg are those that CI installs, and the versions it pins are new enough.

`python tests/unit/project/test_packaging.py > constraints-minimum.txt` writes the file anew.
"""

import configparser
import re
import subprocess
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parents[3]
LATER = {
    "test",
    "docs",
    "notebook",
    "browser",
    "fem",
    "gp",
}  # extras of which CI installs the newest


def least_versions() -> dict[str, str]:
    """The packages of setup.cfg that users install, in small letters, each with its least version."""
    told = configparser.ConfigParser()
    told.read(ROOT / "setup.cfg", encoding="utf-8")
    lines = told["options"]["install_requires"].split("\n")
    for extra, names in told["options.extras_require"].items():
        if extra not in LATER:
            lines += names.split("\n")
    found = {}
    for line in lines:
        match = re.match(r"([\w-]+)(?:\[\w+\])? >= ([\d.]+)$", line)
        if match:
            found[match[1].lower()] = match[2]
    return dict(sorted(found.items()))


def written() -> str:
    head = (
        "# The least versions of setup.cfg, which CI tries: tests/unit/project/test_packaging.py.\n"
    )
    return head + "".join(f"{name}=={least}\n" for name, least in least_versions().items())


def numbers(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in re.findall(r"\d+", version))


def test_the_least_versions_are_those_that_are_tried() -> None:
    assert (ROOT / "constraints-minimum.txt").read_text(encoding="utf-8") == written()
    assert len(least_versions()) > 20


def test_pinned_versions_are_new_enough() -> None:
    """constraints.txt pins every package of setup.cfg that it has, at its least version or a later one."""
    rows = re.findall(
        r"^([\w.-]+)==([\w.]+)$",
        (ROOT / "constraints.txt").read_text(encoding="utf-8"),
        re.MULTILINE,
    )
    pinned = {name.lower().replace("_", "-"): version for name, version in rows}
    for name, least in least_versions().items():
        assert numbers(pinned[name]) >= numbers(least), name


def test_every_file_of_data_is_packed() -> None:
    """Those that git knows: a pattern that leaves one out shows only when somebody without a clone needs it."""
    told = configparser.ConfigParser()
    told.read(ROOT / "setup.cfg", encoding="utf-8")
    packed = set()
    for folder, patterns in told["options.data_files"].items():
        for pattern in patterns.split():
            files = {path.relative_to(ROOT).as_posix() for path in ROOT.glob(pattern)}
            assert all(f"share/magmpm/{name}".rpartition("/")[0] == folder for name in files)
            packed |= files
    listed = subprocess.run(
        ["git", "ls-files", "data"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    known = set(listed.stdout.split())
    assert len(known) > 100
    assert known - packed == set()


def test_workflows_and_forms_are_sound() -> None:
    """They parse, name targets of the Makefile that exist, and try the Pythons of setup.cfg."""
    workflow = yaml.safe_load((ROOT / ".github/workflows/ci.yml").read_text(encoding="utf-8"))
    targets = set(
        re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    )
    commands = [
        step["run"] for job in workflow["jobs"].values() for step in job["steps"] if "run" in step
    ]
    named = {name for command in commands for name in re.findall(r"\bmake ([a-z-]+)", command)}
    assert named
    assert named <= targets
    tried = workflow["jobs"]["test"]["strategy"]["matrix"]["python"]
    said = re.findall(r"Python :: (3\.\d+)", (ROOT / "setup.cfg").read_text(encoding="utf-8"))
    assert tried == said
    forms = sorted((ROOT / ".github/ISSUE_TEMPLATE").glob("*.yml"))
    assert [form.stem for form in forms] == ["bug", "config", "feature", "wrong_number"]
    for form in forms:
        content = yaml.safe_load(form.read_text(encoding="utf-8"))
        if form.stem != "config":
            assert {"name", "description", "body"} <= set(content)
            fields = [field for field in content["body"] if field["type"] != "markdown"]
            assert all(field["id"] for field in fields)


if __name__ == "__main__":
    print(written(), end="")
