"""`make tour`: a newcomer's tour. Every page is followed word for word in a clean environment, into which only the wheel was installed.

    python tests/docs/tour.py [--keep FOLDER] [PAGE ...]

The wheel is built of this checkout and installed with the extras that the pages name; each page has an empty folder with the examples
(`magmpm examples .`). A table says which pages pass and what each took; exit status 1 if one does not.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from page_steps import PAGES, ROOT, plan, steps

EXTRAS = "all"


def environment(folder: Path) -> Path:
    """The Python of a new environment with the wheel."""
    wheels = folder / "wheels"
    subprocess.run(
        [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", str(wheels), str(ROOT)],
        check=True,
    )
    (wheel,) = wheels.glob("magmpm-*.whl")
    subprocess.run([sys.executable, "-m", "venv", str(folder / "empty")], check=True)
    python = folder / "empty/bin/python"
    subprocess.run(
        [
            python,
            "-m",
            "pip",
            "install",
            "-q",
            "-c",
            ROOT / "constraints.txt",
            f"{wheel}[{EXTRAS}]",
        ],
        check=True,
    )
    return python


def follow(page: Path, folder: Path, python: Path) -> tuple[bool, float, str]:
    """Outcome of following a page: whether it can be done, the seconds it took, and what was said."""
    folder.mkdir(parents=True)
    names = ("PYTHONPATH", "NUMBA_CACHE_DIR", "VIRTUAL_ENV")
    clean = {name: value for name, value in os.environ.items() if name not in names} | {
        "XDG_CACHE_HOME": str(folder.parent / "cache")
    }
    clean["PATH"] = f"{python.parent}{os.pathsep}{clean['PATH']}"
    subprocess.run(
        [python, "-m", "magmpm.cli", "examples", "."],
        cwd=folder,
        env=clean,
        check=True,
        capture_output=True,
    )
    begun = time.monotonic()
    driver = str(ROOT / "tests/docs/follow.py")
    done = subprocess.run(
        [python, driver, plan(page, folder)],
        cwd=folder,
        env=clean,
        capture_output=True,
        text=True,
        check=False,
    )
    return done.returncode == 0, time.monotonic() - begun, done.stderr


def main(arguments: list[str]) -> int:
    """Follow the pages. Returns the exit status."""
    parser = argparse.ArgumentParser(
        description="Follow every page word for word in a clean environment."
    )
    parser.add_argument(
        "pages",
        metavar="PAGE",
        nargs="*",
        help="names of pages, such as first_scene.md; all unless given",
    )
    parser.add_argument("--python", type=Path, help="of an environment that has the wheel already")
    options = parser.parse_args(arguments)
    chosen = [page for page in PAGES if not options.pages or page.name in options.pages]
    failed = 0
    with tempfile.TemporaryDirectory(prefix="magmpm-tour-") as name:
        folder = Path(name)
        python = options.python or environment(folder)
        for page in chosen:
            count = sum(step.kind in ("sh", "python", "file") for step in steps(page))
            if not count:
                continue
            passed, seconds, said = follow(page, folder / page.stem, python)
            failed += not passed
            print(
                f"{'passes' if passed else 'FAILS':<8}{page.name:<24}{count:>3} steps "
                f" {seconds:6.0f} s",
                flush=True,
            )
            if not passed:
                print(said[-3000:], flush=True)
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
