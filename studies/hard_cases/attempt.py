"""One scene drawn at random: solved from its file, and how it ended."""

from __future__ import annotations

import signal
import sys
import traceback
from pathlib import Path
from time import process_time
from typing import Any

from magmpm.errors import InputError, SolveError
from magmpm.precompile import prepare_kernels
from magmpm.results.result import Result
from magmpm.scene import Scene, load_scene
from magmpm.simulate import run

CONVERGED, STOPPED, WRONG, REFUSED, TRACEBACK, HUNG = "converged", "stopped", "wrong", "refused", "traceback", "hung"
Outcome = dict[str, Any]


def attempt(path: Path, folder: Path, limit: float) -> Outcome:
    """Solve the scene of a file. limit: s of processor time, after which the process is ended (SIGPROF); folder: for what is saved.

    The outcome has `ended`, one of
    converged: an answer that the independent checks confirm;
    stopped: SolveError or BudgetError, with `reason` and `saved` (whether a last good state was there, saved and read back);
    wrong: an answer that a check refutes; `reason` says which;
    refused: InputError: the scene was not valid, a fault of the generator or of a rule;
    traceback: any other exception.
    """
    begun = process_time()
    try:
        scene = load_scene(path)
        prepare_kernels(scene)
        begun = process_time()
        out_of_time(limit)
        found = _solved(scene, folder)
    except InputError as error:
        found = {"ended": REFUSED, "reason": str(error)}
    except Exception as error:
        found = {"ended": TRACEBACK, "reason": f"{type(error).__name__}: {error}", "traceback": traceback.format_exc()}
    finally:
        out_of_time(0.0)
    return {"file": path.name, "seconds": process_time() - begun, **found}


def out_of_time(limit: float) -> None:
    """End this process after so many more seconds of processor time, even within compiled code; 0: no longer."""
    if sys.platform != "win32":
        signal.signal(signal.SIGPROF, signal.SIG_DFL)
        signal.setitimer(signal.ITIMER_PROF, limit)


def _solved(scene: Scene, folder: Path) -> Outcome:
    try:
        result = run(scene)
    except SolveError as error:
        return {"ended": STOPPED, "kind": type(error).__name__, "reason": error.reason, "saved": _kept(error.state, folder)}
    return {"ended": CONVERGED, "warnings": len(result.warnings)}


def _kept(state: Any, folder: Path) -> bool:
    """Whether there is a last good state, which a folder gives back as it was."""
    if not isinstance(state, Result):
        return False
    back = Result.load(state.save(folder))
    return bool((back.particle_position == state.particle_position).all()) and not back.converged
