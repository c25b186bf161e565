"""Faults that are injected into studies and motions, each with what was complete before it and what is there afterwards."""

import os
import random
import resource
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import optuna
import psutil

TESTS = Path(__file__).resolve().parents[1]
for folder in ("", "studies", "workers", "end_to_end"):
    sys.path.insert(0, str(TESTS / folder))

from reference.commands import started, wait_for  # noqa: E402
from rod_solve import STUDY, write_study  # noqa: E402
from swing import scene as motion_scene  # noqa: E402

from magmpm.results.file_names import CHECKPOINT  # noqa: E402
from magmpm.results.trajectory import Motion  # noqa: E402

SESSION = TESTS / "workers" / "session.py"
Trials = dict[int, tuple[Any, ...]]


@dataclass
class Row:
    """Outcome of one kind of fault: how many were injected, how many completed trials (or frames) there were and were lost."""

    kind: str
    injected: int = 0
    met: int = 0  # how many of them met completed trials (or frames)
    completed: int = 0
    lost: int = 0
    said: list[str] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)  # what else was not as it has to be


def environment(**more: str) -> dict[str, str]:
    path = [str(TESTS.parent), *(str(TESTS / folder) for folder in ("", "studies", "workers"))]
    return {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([*path, os.environ.get("PYTHONPATH", "")]),
        **more,
    }


def study_of(folder: Path, trials: int) -> Path:
    return write_study(
        folder,
        STUDY.replace("trials: 8", f"trials: {trials}").replace("sampler: random", "sampler: tpe"),
    )


def begin(study: Path, out: Path, workers: int, **more: str) -> subprocess.Popen[str]:
    """A session; workers: 0 for one that solves by itself."""
    limits = {"preexec_fn": _limited(int(more.pop("LIMIT")))} if "LIMIT" in more else {}
    command = [sys.executable, str(SESSION), str(study), str(out), str(workers)]
    return subprocess.Popen(
        command,
        env=environment(**more),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **limits,
    )  # type: ignore


def _limited(size: int) -> Callable[[], None]:
    def limit() -> None:  # as a quota: no file may grow beyond this
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)

    return limit


def complete(out: Path, url: str | None = None) -> Trials:
    """Number, parameters and values of the trials that are complete."""
    if url is None and not (out / "study.db").exists():
        return {}
    try:
        study = optuna.load_study(study_name="probe", storage=url or f"sqlite:///{out}/study.db")
        trials = study.get_trials(deepcopy=False, states=(optuna.trial.TrialState.COMPLETE,))
    except Exception:  # it was killed before the tables were there
        return {}
    return {t.number: (tuple(sorted(t.params.items())), tuple(t.values)) for t in trials}


def finished(out: Path) -> int:
    """How many trials are complete, asked for again and again, so without Optuna."""
    if not (out / "study.db").exists():
        return 0
    with (
        suppress(sqlite3.Error),
        closing(sqlite3.connect(f"file:{out}/study.db?mode=ro", uri=True)) as connection,
    ):
        return int(
            connection.execute("SELECT count(*) FROM trials WHERE state = 'COMPLETE'").fetchone()[0]
        )
    return 0  # it was killed before the tables were there


def compare(row: Row, before: Trials, after: Trials) -> None:
    row.met = min(row.met + bool(before), row.injected)
    row.completed += len(before)
    row.lost += sum(after.get(number) != trial for number, trial in before.items())


def awaited(row: Row, child: subprocess.Popen[str], seconds: float = 300) -> str:
    """Standard error of a process that is waited for; one that takes too long is killed, and the row says so."""
    try:
        return child.communicate(timeout=seconds)[1]
    except subprocess.TimeoutExpired:
        child.kill()
        row.wrong.append(f"process {child.pid} did not end within {seconds:g} s")
        return child.communicate()[1]


def ended(row: Row, study: Path, out: Path, workers: int, trials: int, **more: str) -> None:
    """Run the study to its end, and see that it has what it was asked for."""
    child = begin(study, out, workers, **more)
    said = awaited(row, child)
    found = complete(out)
    if (
        child.returncode != 0
        or len(found) != trials
        or len({params for params, _ in found.values()}) != trials
    ):
        row.wrong.append(
            f"afterwards: status {child.returncode}, {len(found)} of {trials} trials; {said[-200:]}"
        )
    if "Traceback" in said:
        row.wrong.append("a traceback")


def until_met(row: Row, count: int) -> Iterator[int]:
    """Numbers of attempts, until so many kills have met something complete, or hopelessly many have been tried (the row then says so).

    One in five of the kills of studies is meant for a start, and some attempts end before their kill, so three for each are enough.
    """
    for attempt in range(3 * count + 20):
        if row.met >= count:
            return
        yield attempt
    if row.met < count:
        row.wrong.append(f"{row.met} of {count} kills met something complete")


def kills_of_studies(base: Path, count: int, drawn: random.Random, workers: int) -> Row:
    """SIGKILL of the session, or of one of its workers, at random moments, until `count` of them have met completed trials."""
    row = Row(f"SIGKILL, studies, {'one process' if not workers else f'{workers} workers'}")
    trials = 40
    attempts = until_met(row, count)
    for number in attempts:
        folder = base / f"kills-{workers}-{number}"
        study = study_of(folder, trials)
        out = folder / "out"
        for _ in attempts:
            if finished(out) >= trials:
                break
            child = begin(study, out, workers, TEST_SECONDS="0.02")
            begun = time.monotonic()
            known = finished(out)
            early = (
                drawn.random() < 0.2
            )  # some kills meet the start: tables, locks, the first trial
            while child.poll() is None and time.monotonic() < begun + 90:
                if (out / ".lock").exists() and (early or finished(out) > known):
                    break
                time.sleep(0.02)
            time.sleep(drawn.uniform(0.0, 1.0))
            before = complete(out)
            victim = psutil.Process(child.pid)
            family = victim.children() if child.poll() is None else []
            if workers and family and drawn.random() < 0.5:
                drawn.choice(family).kill()
                row.injected += 1
                compare(row, before, complete(out))
                time.sleep(drawn.uniform(0.0, 1.0))
                before = complete(out)
            if killed := child.poll() is None:
                child.kill()
                row.injected += 1
            child.communicate()
            if killed:
                compare(row, before, complete(out))
        ended(row, study, out, workers, trials)
    return row


def kills_of_motions(base: Path, count: int, drawn: random.Random) -> Row:
    """SIGKILL of motions at random moments, until `count` of them have met frames, each resumed.

    At the end all frames are there, and the last state is bit for bit the same."""
    row = Row("SIGKILL, motions (frames)")
    attempts = until_met(row, count)
    dynamic = "duration: 200 ms, output_every: 1 ms"
    whole = base / "whole"
    _motion(motion_scene(base, dynamic), whole).communicate()
    wanted = Motion.load(whole)
    for number in attempts:
        out = base / f"motion-{number}"
        scene = motion_scene(base, dynamic)
        more = []
        for _ in attempts:
            child = _motion(scene, out, *more)
            wait_for((out / CHECKPOINT).exists, child)
            time.sleep(drawn.uniform(0.0, 1.0))
            if child.poll() is not None:
                break
            frames = _frames(out)
            child.kill()
            child.communicate()
            row.injected = row.injected + 1
            more = ["--resume"] if (out / CHECKPOINT).exists() else ["--overwrite"]
            row.met += frames > 0
            row.completed += frames
            row.lost += max(0, frames - _frames(out))
        _, said = (child := _motion(scene, out, *more)).communicate()
        found = Motion.load(out)
        if (
            child.returncode
            or len(found) != len(wanted)
            or not (found.position(-1) == wanted.position(-1)).all()
        ):
            row.wrong.append(f"the motion is another one: {said[-200:]}")
    return row


def _motion(scene: Path, out: Path, *more: str) -> subprocess.Popen[str]:
    return started("run", scene, "--out", out, *more, output=subprocess.PIPE)


def _frames(out: Path) -> int:
    try:
        return len(Motion.load(out))
    except Exception:  # nothing is whole yet
        return 0


def _note(row: Row, said: str) -> None:
    lines = [line for line in said.splitlines() if line.strip() and "compil" not in line]
    line = next((line for line in lines if "rule:" in line), lines[0] if lines else "")
    if line and line.strip()[:60] not in {old[:60] for old in row.said}:
        row.said.append(line.strip())


@contextmanager
def small_disk(folder: Path, size: str, row: Row) -> Iterator[bool]:
    """A file system of its own at a folder; False where this machine does not allow that, which the row says."""
    folder.mkdir(parents=True)
    mounted = (
        subprocess.run(
            ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)],
            capture_output=True,
        ).returncode
        == 0
    )
    if not mounted:
        row.said.append("not injected: this machine lets nobody mount a disk")
    try:
        yield mounted
    finally:
        if mounted:
            subprocess.run(["umount", "-l", str(folder)], capture_output=True)


def refused_then_run(
    row: Row,
    study: Path,
    out: Path,
    trials: int,
    begin_it: Callable[[], subprocess.Popen[str]],
    mend: Callable[[], Any],
) -> None:
    """A run that fails with a message, then, with the fault gone, one that ends."""
    before = complete(out)
    child = begin_it()
    said = awaited(row, child)
    row.injected += 1
    _note(row, said)
    if child.returncode not in (1, 2) or "remedy" not in said or "Traceback" in said:
        row.wrong.append(f"status {child.returncode}: {said[-300:]}")
    mend()
    between = complete(out)
    compare(row, before, between)
    ended(row, study, out, 0, trials)
    compare(row, between, complete(out))


def disk_full(base: Path) -> Row:
    """A disk without room in the middle of a study; then there is room again."""
    row = Row("disk full")
    disk = base / "disk"
    study = study_of(base / "full", 60)
    with small_disk(disk, "1m", row) as mounted:
        if not mounted:
            return row
        more = [lambda: subprocess.run(["mount", "-o", "remount,size=64m", str(disk)], check=True)]
        refused_then_run(
            row, study, disk / "out", 60, lambda: begin(study, disk / "out", 0), more[0]
        )
    return row


def read_only(base: Path) -> Row:
    """A folder that becomes read-only between two runs, and is writable again."""
    row = Row("read-only folder")
    disk = base / "readonly"
    study = study_of(base / "ro", 20)
    with small_disk(disk, "64m", row) as mounted:
        if not mounted:
            return row
        study_of(base / "ro", 8)
        begin(study, disk / "out", 0).communicate()
        study_of(base / "ro", 20)
        subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
        back = lambda: subprocess.run(["mount", "-o", "remount,rw", str(disk)], check=True)  # noqa: E731
        refused_then_run(row, study, disk / "out", 20, lambda: begin(study, disk / "out", 0), back)
    return row


def quota(base: Path) -> Row:
    """The system lets no file grow beyond a limit, as a quota does."""
    row = Row("quota (limit of a file's size)")
    for k, limit in enumerate((700_000, 1_500_000)):
        folder = base / f"quota-{k}"
        study = study_of(folder, 60)
        limited = partial(begin, study, folder / "out", 0, LIMIT=str(limit))
        refused_then_run(row, study, folder / "out", 60, limited, lambda: None)
    return row


def clock_set_back(base: Path) -> Row:
    """A study is killed, and continued with a clock that shows the day before."""
    row = Row("clock set back a day")
    for workers in (0, 2):
        folder = base / f"clock-{workers}"
        study = study_of(folder, 20)
        out = folder / "out"
        child = begin(study, out, workers, TEST_SECONDS="0.1")
        wait_for(lambda out=out: len(complete(out)) >= 5, child)
        child.kill()
        child.communicate()
        before = complete(out)
        row.injected += 1
        ended(row, study, out, workers, 20, TEST_CLOCK="-86400")
        compare(row, before, complete(out))
    return row
