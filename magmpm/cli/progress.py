"""Progress of long work on standard error, with the time left: one line that is overwritten, or without a terminal a line now and then."""

from __future__ import annotations

import sys
import threading
import time
from types import TracebackType

EVERY = 8.0  # s between lines where there is no terminal


class Progress:
    """One line that is overwritten again and again; a context manager that clears it at the end."""

    def __init__(self, title: str) -> None:
        self._title, self._begun, self._shown = title, time.monotonic(), 0
        self._visible, self._last, self._over = sys.stderr.isatty(), title, threading.Event()
        self._first: tuple[float, int] | None = None  # time and parts done of the first report: compiling, and a resumed part, come before

    def __enter__(self) -> Progress:
        if not self._visible:
            threading.Thread(target=self._lines, daemon=True).start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._over.set()
        self._write("")

    def _lines(self) -> None:
        """Lines for a file or a pipe: what was last reported, again and again, whether the work reports or not."""
        while not self._over.wait(EVERY):
            print(f"magmpm: {self._last}; {_duration(time.monotonic() - self._begun)}", file=sys.stderr, flush=True)

    def note(self, text: str) -> None:
        """Print the current activity, if its end can't be predicted."""
        self._line(f"{self._title}: {text}")

    def at(self, done: int, total: int, text: str = "") -> None:
        """`done` of `total` parts are finished; the time left is estimated from those since the first call."""
        now = time.monotonic()
        begun, before = self._first = self._first or (now, done)
        left = f", about {_duration((now - begun) / (done - before) * (total - done))} left" if done > before else ""
        self._line(f"{self._title}: {done} of {total}{left}{'; ' if text else ''}{text}")

    def _line(self, text: str) -> None:
        self._last = text
        if time.monotonic() - self._begun >= 1.0:  # short work shows nothing
            self._write(text)

    def _write(self, text: str) -> None:
        if self._visible and (text or self._shown):
            sys.stderr.write("\r" + text.ljust(self._shown) + ("" if text else "\r"))
            sys.stderr.flush()
            self._shown = len(text)


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min"
