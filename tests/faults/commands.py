"""Kills of commands that write over complete results: accuracy, map, fit, report, render, and a study of an insertion."""

import json
import random
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from kinds import Row, _note, environment, finished
from swing import scene as motion_scene
from swing import text

ROOT = Path(__file__).parents[2]
ENDS = {
    ".png": b"IEND\xaeB`\x82",
    ".html": b"</html>\n",
    ".csv": b"\n",
    ".json": b"}\n",
    ".yaml": b"\n",
}  # of whole files


def kills_of_commands(base: Path, count: int, drawn: random.Random) -> list[Row]:
    """SIGKILL of each command over results that are complete: `count` kills at random moments each.

    After each, every file is whole: as it was, or as it becomes. Run again, the command ends well and leaves the same files.
    """
    static = base / "rest.yaml"
    table = base / "tips.csv"
    static.write_text(text(), encoding="utf-8")
    table.write_text(
        "field_z_mT,tip_x_mm,tip_z_mm\n10,14.92,4.64\n15,13.7,6.5\n20,12.5,8.1\n", encoding="utf-8"
    )
    study = base / "insertion.yaml"
    shutil.copy(ROOT / "data" / "targets" / "vessel_s.csv", base / "vessel.csv")
    guide = (ROOT / "data" / "scenes" / "insertion.yaml").read_text(encoding="utf-8")
    (base / "guide.yaml").write_text(
        re.sub(r"cells_across: \d+", "cells_across: 2", guide), encoding="utf-8"
    )
    study.write_text(
        "scene: guide.yaml\nvary: {magnetization: {}, field: {max: 10 mT, at: each depth}}\nmatch:"
        " {path: vessel.csv}\ninsertion: {depths: 4}\nsampler: gauss-newton\ntrials: 2\n",
        encoding="utf-8",
    )
    motion = motion_scene(base, "duration: 20 ms, output_every: 1 ms")
    swung = base / "swung"
    inserted = base / "inserted"
    for before in (["run", motion, "--out", swung], ["design", study, "--out", inserted]):
        subprocess.run(_command(before), env=environment(), check=True, capture_output=True)
    return [
        _killed(
            "accuracy",
            ["accuracy", static, "--cells", "2,3", "--overwrite"],
            base / "accuracy",
            count,
            drawn,
        ),
        _killed(
            "map", ["map", static, "--fields", "40", "--cells", "2"], base / "map", count, drawn
        ),
        _killed(
            "fit", ["fit", table, static, "--vary", "shear_modulus"], base / "fit", count, drawn
        ),
        _killed(
            "report", ["report", inserted, "--quick", "--no-pdf"], base / "report", count, drawn
        ),
        _killed("render", ["render", swung, "--frames", "0,20"], base / "render", count, drawn),
        _killed("design, insertion", ["design", study], base / "design", count, drawn),
    ]


def _command(words: Sequence[object]) -> list[str]:
    return [sys.executable, "-m", "magmpm", *(str(word) for word in words)]


def _killed(kind: str, words: list[object], out: Path, count: int, drawn: random.Random) -> Row:
    row = Row(f"SIGKILL, {kind} (files)")
    command = _command([*words, "--out", out])
    begun = time.monotonic()
    first = subprocess.run(command, env=environment(), capture_output=True, text=True)
    seconds = time.monotonic() - begun
    wanted = _files(out)
    if first.returncode:
        row.wrong.append(f"uninterrupted: status {first.returncode}, {first.stderr[-200:]}")
        return row
    for _ in range(count):
        if "insertion" in kind:  # a finished study has nothing to do: kills meet its trials
            shutil.rmtree(out)
        child = subprocess.Popen(
            command, env=environment(), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        )
        moment = begun = time.monotonic()
        while (
            child.poll() is None
            and "insertion" in kind
            and not finished(out)
            and moment < begun + 120
        ):
            time.sleep(0.01)
            moment = time.monotonic()
        time.sleep(drawn.uniform(0.0, 0.3 if "insertion" in kind else 0.9) * seconds)
        if child.poll() is None:
            child.kill()
            row.injected += 1
        child.communicate()
        whole = {name for name, path in _files(out).items() if _whole(path)}
        kept = set(_files(out)) if "insertion" in kind else set(wanted)
        row.met = row.met + bool(whole)
        row.completed = row.completed + len(kept)
        row.lost = row.lost + len(kept - whole)
        row.wrong += [f"{name} is cut" for name in sorted(kept - whole)]
    again = subprocess.run(command, env=environment(), capture_output=True, text=True)
    _note(row, again.stderr)
    left = set(_files(out)) ^ set(wanted)
    if again.returncode or left or "Traceback" in again.stderr:
        row.wrong.append(
            f"afterwards: status {again.returncode}, files {sorted(left)}, {again.stderr[-200:]}"
        )
    row.wrong += [
        f"{name} is cut afterwards" for name, path in _files(out).items() if not _whole(path)
    ]
    return row


def _files(out: Path) -> dict[str, Path]:
    """Results by name, without numbers that Optuna draws for its artifacts."""
    found = {
        str(path.relative_to(out)): path
        for path in out.rglob("*")
        if path.is_file() and path.name != ".lock"
    }
    return {
        re.sub(r"[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}", "ID", name): path
        for name, path in found.items()
    }


def _whole(path: Path) -> bool:
    """Return True if a file ends as its kind does, and JSON can be read."""
    content = path.read_bytes()
    if path.suffix == ".json":
        try:
            json.loads(content)
        except ValueError:
            return False
    return path.name.startswith(".") or (
        bool(content) and content.rstrip(b"\n").endswith(ENDS.get(path.suffix, b"").rstrip(b"\n"))
    )
