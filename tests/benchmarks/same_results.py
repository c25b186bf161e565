"""Compares the results of two versions of magmpm, for every scene and study of data/.

    python tests/benchmarks/same_results.py run FOLDER        run them with the magmpm that Python finds, into FOLDER
    python tests/benchmarks/same_results.py compare OLD NEW   print the largest difference of each; status 1 where one differs

Numbers are compared bit for bit, or within `--tolerance` (relative to the largest number of the array). Times are ignored.
"""

import argparse
import json
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np

DATA = Path(__file__).resolve().parents[2] / "data"
TRIALS = 3  # of each study
UNTOLD = (
    "seconds",
    "wall",
    "compile",
    "rate",
    "per_second",
    "version",
    "path",
    "folder",
    "files",
    "memory",
    "threads",
    "hash",
)


def run_all(folder: Path, only: str) -> None:
    """Run each scene and study of data/ into a folder of its own."""
    for scene in sorted(path for path in (DATA / "scenes").rglob("*.yaml") if only in path.stem):
        run(["run", str(scene), "--out", str(folder / scene.stem)])
    for study in sorted(path for path in (DATA / "studies").glob("*.yaml") if only in path.stem):
        run(
            [
                "design",
                str(study),
                "--no-pictures",
                "--trials",
                str(TRIALS),
                "--out",
                str(folder / study.stem),
            ]
        )


def run(words: list[str]) -> None:
    print("magmpm", *words, flush=True)
    done = subprocess.run(
        [sys.executable, "-m", "magmpm.cli", *words], capture_output=True, text=True, check=False
    )
    if done.returncode:
        print(f"status {done.returncode}: {done.stderr.strip()}", flush=True)


def numbers(folder: Path) -> Iterator[tuple[str, np.ndarray]]:
    """Every array of numbers in a folder of results, by name."""
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.suffix == ".npz":
            with np.load(path, allow_pickle=False) as arrays:
                yield from (
                    (f"{name}:{key}", arrays[key])
                    for key in arrays.files
                    if arrays[key].dtype.kind in "fiub"
                )
        elif path.suffix == ".vtkhdf":
            with h5py.File(path) as file:
                keys: list[str] = []
                file.visit(keys.append)
                yield from (
                    (f"{name}:{key}", file[key][()])
                    for key in keys
                    if getattr(file[key], "dtype", np.dtype("O")).kind in "fiub"
                )
        elif path.name == "result.json":
            yield from (
                (f"{name}:{key}", np.array([value]))
                for key, value in leaves(json.loads(path.read_text()), "")
            )
        elif path.suffix == ".db":
            with sqlite3.connect(path) as base:
                for table, column in (("trial_params", "param_value"), ("trial_values", "value")):
                    rows = base.execute(f"SELECT {column} FROM {table} ORDER BY 1").fetchall()
                    yield f"{name}:{table}", np.array(rows, dtype=float).ravel()


def leaves(tree: object, at: str) -> Iterator[tuple[str, float]]:
    """The numbers of plain data that do not depend on the machine."""
    if isinstance(tree, dict):
        for key, value in tree.items():
            if not any(word in key for word in UNTOLD):
                yield from leaves(value, f"{at}.{key}")
    elif isinstance(tree, list):
        for k, value in enumerate(tree):
            yield from leaves(value, f"{at}.{k}")
    elif isinstance(tree, (int, float)):
        yield at, float(tree)


def difference(a: np.ndarray, b: np.ndarray) -> float:
    """The largest difference over the largest number; infinity where shapes differ."""
    if a.shape != b.shape:
        return np.inf
    if a.size == 0 or np.array_equal(a, b):
        return 0.0
    a = a.astype(float)
    b = b.astype(float)
    return float(np.abs(a - b).max() / max(np.abs(a).max(), 1e-300))


def compare(old: Path, new: Path, tolerance: float) -> int:
    """Print one line per results folder; return 1 if one differs by more than the tolerance or is missing, else 0."""
    bad = 0
    for folder in sorted(p for p in old.iterdir() if p.is_dir()):
        before = dict(numbers(folder))
        after = dict(numbers(new / folder.name)) if (new / folder.name).exists() else {}
        apart = {key: difference(before[key], after[key]) for key in before if key in after}
        missing = [key for key in before if key not in after]
        worst = max(apart, key=lambda key: apart[key], default="")
        failed = not before or missing or apart.get(worst, np.inf) > tolerance
        bad += bool(failed)
        word = "DIFFERS" if failed else "same"
        size = apart.get(worst, np.inf)
        print(
            f"{word:<8} {folder.name:<24} {len(apart):5d} arrays, largest difference {size:.1e}"
            f" {worst if size else ''}"
        )
        if missing:
            print("    missing:", ", ".join(missing[:5]))
    return int(bad > 0)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    words = parser.add_subparsers(dest="word", required=True)
    one = words.add_parser("run")
    one.add_argument("folder", type=Path)
    one.add_argument("--only", default="")
    two = words.add_parser("compare")
    two.add_argument("old", type=Path)
    two.add_argument("new", type=Path)
    two.add_argument("--tolerance", type=float, default=0.0)
    said = parser.parse_args()
    if said.word == "run":
        run_all(said.folder.resolve(), said.only)
        return 0
    return compare(said.old, said.new, said.tolerance)


if __name__ == "__main__":
    sys.exit(main())
