"""A user's function of a result or a motion as a measure: `python: FILE.py:FUNCTION`."""

from __future__ import annotations

import math
import sys
import traceback
from collections.abc import Callable
from contextlib import redirect_stdout
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from magmpm.errors import InputError, MagmpmError


def function_of(text: str, folder: Path, at: str) -> Callable[[Any], Any]:
    """The function that FILE.py:FUNCTION names. Raises InputError."""
    file, _, name = text.rpartition(":")
    path = folder / file

    def wrong(what: str) -> InputError:
        return InputError(
            f"{at}.python",
            received=repr(text),
            rule=what,
            remedy="write FILE.py:FUNCTION, a file beside the study and a function in it",
        )

    if not file or not path.is_file():
        raise wrong(f"there is no file {path}" if file else "must name a file and a function")
    module = ModuleType(f"magmpm_goal_{path.stem}")
    module.__file__ = str(path)
    try:
        # from its text: kept bytecode may be that of an edit within the same second
        with redirect_stdout(sys.stderr):  # the program's own has its answers
            exec(compile(path.read_bytes(), path, "exec"), vars(module))
    except (Exception, SystemExit) as error:
        raise wrong(f"{path} raises {type(error).__name__}: {error}") from error
    function = getattr(module, name, None)
    if not callable(function):
        raise wrong(f"{path} has no function {name}")
    return function  # type: ignore[no-any-return]


def source_of(text: str, folder: Path) -> str:
    """The text of the file that FILE.py:FUNCTION names: what decides what it measures."""
    return (folder / text.rpartition(":")[0]).read_text(encoding="utf-8")


def called(function: Callable[[Any], Any], given: Any, at: str) -> float:
    """Call a user's function of a Result or a Motion. Raises MagmpmError where it raises, or returns no finite number."""
    try:
        with redirect_stdout(sys.stderr):
            found = function(given)
    except (Exception, SystemExit) as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        raise MagmpmError(
            f"{at}: it raised {type(error).__name__}: {error}"
            f" ({Path(place.filename).name}, line {place.lineno})"
        ) from error
    if isinstance(found, np.ndarray) and found.ndim == 0:
        found = found.item()
    number = isinstance(found, (int, float, np.integer, np.floating)) and type(found) is not bool
    if not (number and math.isfinite(found)):
        shown = found if number else type(found).__name__
        raise MagmpmError(f"{at}: it returned {shown}, and must return a finite number")
    return float(found)
