"""Warnings, a log and progress bars for Python users. The command line prints its own.

Warnings are of the class MagmpmWarning and point at the line that called magmpm, each once a scene. The log is the
logger `magmpm` of Python's logging, which is silent until the user gives it a handler. Bars are tqdm's, on standard
error where that is a terminal, and in notebooks; `progress=False`, or MAGMPM_PROGRESS=0 in the environment, hides them.
"""

from __future__ import annotations

import inspect
import logging
import os
import sys
import time
import warnings
from collections.abc import Callable, Iterable
from importlib import import_module
from types import FrameType, TracebackType
from typing import Any

from magmpm.errors import MagmpmError, installed, quantity, require

log = logging.getLogger("magmpm")
log.addHandler(logging.NullHandler())

SWITCH = "MAGMPM_PROGRESS"  # of the environment: 0 hides the bars
_told: set[tuple[str, str]] = set()  # what warnings are of, and their texts


class MagmpmWarning(UserWarning):
    """Warning about an answer: the text of one of `Result.warnings`, given once a scene."""


def _inside(frame: FrameType) -> bool:
    """True if a frame runs code of this package."""
    name = str(frame.f_globals.get("__name__", ""))
    return name == "magmpm" or name.startswith("magmpm.")


def called_by_user() -> bool:
    """Check whether the function that calls this one was called from outside of magmpm; else its caller tells the user.

    Returns
    -------
    bool
        True if it was.
    """
    frame = inspect.currentframe()
    for _ in range(2):
        frame = None if frame is None else frame.f_back
    return frame is None or not _inside(frame)


def warn(texts: Iterable[str], of: str) -> None:
    """Warn the user of each of these texts, unless it was told before.

    Parameters
    ----------
    texts : iterable of str
        Warnings, as results carry them.
    of : str
        What they are about, such as the hash of a scene: each text is told once for it.

    Warns
    -----
    MagmpmWarning
        At the line outside of magmpm that led here.
    """
    level = 1
    frame = inspect.currentframe()
    while frame is not None and _inside(frame):
        frame = frame.f_back
        level += 1
    for text in texts:
        if (of, text) not in _told:
            _told.add((of, text))
            warnings.warn(text, MagmpmWarning, stacklevel=level)


def _in_notebook() -> bool:
    """True in a Jupyter kernel."""
    ipython: Any = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    return shell is not None and hasattr(shell, "kernel")


def shows_bars(progress: bool | None, seen: bool) -> bool:
    """Decide whether bars are shown.

    Parameters
    ----------
    progress : bool or None
        What the user says; None: bars are shown where they would be seen, unless the
        environment hides them.
    seen : bool
        Whether someone would see them.

    Returns
    -------
    bool
        True if they are.
    """
    if progress is not None:
        return progress
    if os.environ.get(SWITCH, "").strip().lower() in ("0", "off", "false", "no"):
        return False
    return seen


class Watched:
    """Long work that a user waits for: a bar of tqdm where bars are wanted, and lines in the log.

    Parameters
    ----------
    title : str
        Name of the work.
    total : float, optional
        Its length, in `unit`; None where it is not known, or the work reports nothing.
    unit : str
        Of `total`, such as "s" or "trials".
    progress : bool, optional
        Whether a bar is wanted, at once; None: after a second where someone sees it (`shows_bars`) and tqdm is installed.
    """

    def __init__(self, title: str, total: float | None, unit: str, progress: bool | None) -> None:
        delay = 1.0  # s before a bar is drawn that was not asked for: short work shows nothing
        self._title = title
        self._total = total
        self._unit = unit
        seen = sys.stderr.isatty() or _in_notebook()
        self._shown = shows_bars(progress, seen=seen and installed("tqdm"))
        if self._shown:
            require("tqdm", "motion", key="progress", use="progress bars")
        self._delay = 0.0 if progress else delay
        self._bar: Any = None
        self._logged = time.monotonic()

    def __enter__(self) -> Watched:
        log.info("%s: begins", self._title)
        if self._shown and self._total is not None:
            self._drawn()  # now, so that its clock counts from the beginning
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._bar is not None:
            self._bar.close()
        if isinstance(error, MagmpmError):
            log.error("%s: %s", self._title, error)

    def at(self, done: float, note: str = "") -> None:
        """Tell how much of the total is done.

        Parameters
        ----------
        done : float
            So much, in the total's unit.
        note : str, default ''
            What to show beside it.
        """
        said = f"{done:.6g} of {self._total:.6g} {self._unit}" if self._total is not None else ""
        self._say(", ".join(part for part in (said, note) if part))
        if self._shown:
            bar = self._drawn()
            bar.set_postfix_str(note, refresh=False)
            bar.update(done - bar.n)

    def note(self, text: str) -> None:
        """Tell what is being done, where its end is not known.

        Parameters
        ----------
        text : str
            In words.
        """
        self._say(text)
        if self._shown:
            bar = self._drawn()
            bar.set_postfix_str(text, refresh=False)
            bar.update(1)

    def also(
        self, on_progress: Callable[[int, float], None] | None
    ) -> Callable[[int, float], None]:
        """Make a function that moves the bar and calls the user's own, for runs.

        Parameters
        ----------
        on_progress : callable or None
            The user's own, `on_progress(step, time)`.

        Returns
        -------
        callable
            The function, with the same arguments.
        """

        def tell(step: int, at: float) -> None:
            self.at(at, f"step {step}")
            if on_progress is not None:
                on_progress(step, at)

        return tell

    def ended(self, answer: object) -> None:
        """Tell the log what came out.

        Parameters
        ----------
        answer : object
            It is shown by its repr.
        """
        log.info("%s: %r", self._title, answer)

    def _say(self, text: str) -> None:
        """A line of progress in the log, now and then."""
        logged = 10.0  # s between two lines of progress in the log
        now = time.monotonic()
        if now - self._logged >= logged:
            self._logged = now
            log.info("%s: %s", self._title, text)

    def _drawn(self) -> Any:
        """The bar. It is made only where it is shown: tqdm takes a while to import."""
        if self._bar is None:
            # in a notebook tqdm.auto draws with ipywidgets, and warns where there are none
            tqdm = import_module("tqdm.auto" if installed("ipywidgets") else "tqdm.std").tqdm
            if self._total is None:
                form = "{desc}: {elapsed}{postfix}"
            elif self._unit == "s":
                whole = quantity(self._total, "s")
                form = (
                    "{desc}: {percentage:3.0f}%|{bar}| of "
                    + whole
                    + " [{elapsed}<{remaining}{postfix}]"
                )
            else:
                form = (
                    "{desc}: {percentage:3.0f}%|{bar}| {n_fmt}/{total_fmt}"
                    " [{elapsed}<{remaining}{postfix}]"
                )
            quiet = type(
                "Bar", (tqdm,), {"monitor_interval": 0}
            )  # no thread that watches it: threads and forks don't mix
            self._bar = quiet(
                desc=self._title,
                total=self._total,
                unit=self._unit,
                bar_format=form,
                delay=self._delay,
                mininterval=0.1 if self._unit == "s" else 0.0,  # each trial, however quick
                leave=False,
                file=sys.stderr,
            )
        return self._bar
