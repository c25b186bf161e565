"""`make optunahub`: the Gauss-Newton sampler as a package in the layout of OptunaHub's registry, in runs/optunahub, with its tests.

The package is made, not kept: its modules are those of studies/search/samplers with imports among themselves, its tests are the project's.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = Path(__file__).resolve().parents[2]
SAMPLERS = ROOT / "studies/search/samplers"
INSIDE = "magmpm.studies.search.samplers."
MODULES = {
    "blocks": "_blocks",
    "gauss_newton": "_sampler",
    "gauss_newton_steps": "_steps",
    "optuna_ids": "_optuna_ids",
}
ALLOWED = {
    "__future__",
    "abc",
    "collections",
    "dataclasses",
    "itertools",
    "math",
    "typing",
    "types",
    "numpy",
    "optuna",
    "scipy",
    "pytest",
}
FACE = '''"""Gauss-Newton for Optuna: see README.md."""

from ._sampler import Ball, Direction, GaussNewtonSampler, Number

__all__ = ["Ball", "Direction", "GaussNewtonSampler", "Number"]
'''
FIXTURE = '''"""What the tests share."""

import numpy as np
import pytest


@pytest.fixture
def rng() -> np.random.Generator:
    """A random generator with the same seed in every test."""
    return np.random.default_rng(20240229)
'''


def standalone(text: str, inside: str) -> str:
    """A module's text with its imports from the project replaced. Raises ValueError where it then needs another library."""
    text = re.sub(
        rf"from {re.escape(INSIDE)}(\w+)", lambda found: f"from {inside}{MODULES[found[1]]}", text
    )
    if (
        strange := set(re.findall(r"^\s*(?:from|import) (\w+)", text, re.MULTILINE))
        - ALLOWED
        - {"gauss_newton"}
    ):
        raise ValueError(f"the sampler must stand alone, and needs {', '.join(sorted(strange))}")
    return text


def build(out: Path) -> Path:
    """The package under `out`, which it replaces: out/package/samplers/gauss_newton."""
    shutil.rmtree(out, ignore_errors=True)
    package = out / "package/samplers/gauss_newton"
    (package / "tests").mkdir(parents=True)
    (package / "__init__.py").write_text(FACE, encoding="utf-8")
    for name, there in MODULES.items():
        text = standalone((SAMPLERS / f"{name}.py").read_text(encoding="utf-8"), ".")
        (package / f"{there}.py").write_text(text, encoding="utf-8")
    tests = (ROOT / "tests/studies/test_gauss_newton.py").read_text(encoding="utf-8")
    (package / "tests/test_gauss_newton.py").write_text(
        standalone(tests, "gauss_newton."), encoding="utf-8"
    )
    (package / "tests/conftest.py").write_text(FIXTURE, encoding="utf-8")
    for name in ("README.md", "example.py", "requirements.txt"):
        shutil.copy(HERE / name, package)
    table = re.search(
        r"<!-- table: problems -->\n(.*?)<!-- end -->",
        (HERE / "problems.md").read_text(encoding="utf-8"),
        re.DOTALL,
    )
    assert table is not None
    page = (package / "README.md").read_text(encoding="utf-8").replace("<!-- table -->\n", table[1])
    (package / "README.md").write_text(page, encoding="utf-8")
    shutil.copy(ROOT / "LICENSE", package)
    return package


def main() -> int:
    """Build it, and run its tests and its example where nothing of the project can be imported from the folder."""
    package = build(ROOT / "runs/optunahub")
    quiet = [
        "-q",
        "-p",
        "no:cacheprovider",
        "--rootdir",
        str(package),
        "-c",
        "/dev/null",
        "--import-mode=importlib",
    ]
    environment = {"PYTHONPATH": str(package.parent), "PATH": "/usr/bin:/bin"}
    for command in (
        ["-m", "pytest", *quiet, str(package / "tests")],
        [str(package / "example.py")],
    ):
        done = subprocess.run(
            [sys.executable, *command], cwd=package.parent, env=environment, check=False
        )
        if done.returncode:
            return done.returncode
    print(package)
    return 0


if __name__ == "__main__":
    sys.exit(main())
