"""Things that several commands share: where results go, how answers are printed, and the progress of long work on standard error."""

from __future__ import annotations

import argparse
import json
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any

from magmpm.errors import InputError
from magmpm.results.folder_lock import folder_lock

SURFACE, PARTICLES = STYLES = ("surface", "particles")  # what a body at rest is drawn by
EVERY = 8.0  # s between lines where there is no terminal


def results_folder(name: str) -> Path:
    """runs/NAME for a scene or study of that name."""
    return Path("runs") / name.replace(" ", "-")


@contextmanager
def folder_of_results(options: argparse.Namespace, name: str) -> Iterator[Path]:
    """Hold the folder that a command's results go to: --out, or runs/NAME. Raises InputError where it belongs to a study, or is in use."""
    folder = options.out or results_folder(name)
    with folder_lock(folder):
        if is_study(folder):
            rule = (
                "a study's folder holds only that study: a run's result would mix with its designs"
            )
            raise InputError(f"{folder}: holds a study", rule=rule, remedy="use another --out")
        yield folder


def is_study(folder: Path) -> bool:
    """True if a folder holds a study, or the files of one that ended before its first report."""
    from magmpm.studies.goals.report import REPORT as GOAL
    from magmpm.studies.problem import DATABASE, OWNER, REPORT

    return any((folder / name).exists() for name in (REPORT, OWNER, DATABASE, GOAL))


def print_summary(options: argparse.Namespace, summary: dict[str, Any], text: str) -> None:
    """The one JSON object, or the text for people."""
    print(json.dumps(summary) if options.json else text)


def end_as_by_ctrl_c() -> None:
    """SIGTERM, by which job schedulers end a command, keeps and tells what Ctrl-C does."""

    def end(_: int, frame: FrameType | None) -> None:
        by_ctrl_c = signal.getsignal(signal.SIGINT)
        if not callable(by_ctrl_c):  # ignored, as in what a shell's script runs in the background
            by_ctrl_c = signal.default_int_handler
        by_ctrl_c(signal.SIGINT, frame)

    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, end)


class Progress:
    """Progress, with the time left: one line that is overwritten and at the end cleared, or without a terminal a line now and then."""

    def __init__(self, title: str) -> None:
        self._title = title
        self._begun = time.monotonic()
        self._shown = 0
        self._visible = sys.stderr.isatty()
        self._last = title
        self._over = threading.Event()
        self._first: tuple[float, float] | None = (
            # time and parts done at the first report: compiling and a resumed part come before
            None
        )

    def __enter__(self) -> Progress:
        if not self._visible:
            threading.Thread(target=self._lines, daemon=True).start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._over.set()
        self._write("")

    def _lines(self) -> None:
        """Lines for a file or a pipe: what was last reported, again and again, ever more rarely, whether the work reports or not."""
        passed = 0.0
        while not self._over.wait(max(EVERY, passed / 10)):
            passed = time.monotonic() - self._begun
            print(
                f"magmpm: {self._last}; {_duration(passed)}",
                file=sys.stderr,
                flush=True,
            )

    def note(self, text: str) -> None:
        """Print the current activity, if its end can't be predicted."""
        self._line(f"{self._title}: {text}")

    def at(self, done: float, total: float, text: str = "", unit: str = "") -> None:
        """`done` of `total` parts are finished; the time left is estimated from those since the first call, until all are.

        unit: of both numbers, as in "0.05 of 0.3 s".
        """
        now = time.monotonic()
        if self._first is None:
            self._first = (now, done)
        begun, before = self._first
        left = ""
        if before < done < total:
            seconds = (now - begun) / (done - before) * (total - done)
            left = f", about {_duration(seconds)} left"
        parts = f"{_amount(done)} of {_amount(total)}{unit and ' '}{unit}"
        self._line(f"{self._title}: {parts}{left}{text and '; '}{text}")

    def _line(self, text: str) -> None:
        self._last = text
        if time.monotonic() - self._begun >= 1.0:  # short work shows nothing
            self._write(text)

    def _write(self, text: str) -> None:
        if self._visible and (text or self._shown):
            sys.stderr.write("\r" + text.ljust(self._shown) + ("" if text else "\r"))
            sys.stderr.flush()
            self._shown = len(text)


def _amount(number: float) -> str:
    """A count in full, another number to four digits."""
    return str(number) if isinstance(number, int) else f"{number:.4g}"


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{minutes} min {rest} s" if minutes < 10 else f"{minutes} min"
