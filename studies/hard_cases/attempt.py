"""One scene drawn at random: solved from its file, and how it ended."""

from __future__ import annotations

import re
import shutil
import signal
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from time import process_time
from typing import Any

from magmpm.errors import InputError, SolveError
from magmpm.results.result import Result
from magmpm.scene import Scene, load_scene
from magmpm.scene.remedies import Remedy
from magmpm.scene.time_limit import limited
from magmpm.simulate import run
from magmpm.solving.precompile import prepare_kernels
from magmpm.studies.hard_cases.checks import checked

CONVERGED, STOPPED, WRONG, REFUSED, TRACEBACK, HUNG = "converged", "stopped", "wrong", "refused", "traceback", "hung"
OWN_SHARE = 0.8  # of the limit, after which the solver is to end by itself
Outcome = dict[str, Any]
Tell = Callable[[Outcome], None]


def attempt(path: Path, folder: Path, limit: float, tell: Tell) -> Outcome:
    """Solve the scene of a file. limit: s of processor time for the run, and as much for its checks or remedies, after
    which the process is ended (SIGPROF), if it has not ended by itself before (magmpm.scene.time_limit); folder: for what is saved.

    tell(outcome): called before remedies are tried, with what is known until then.
    The outcome has `ended`, one of
    converged: an answer that the independent checks do not refute; `checks` names them, `branches` where another equilibrium was found;
    stopped: SolveError, BudgetError, or a requested error that no grid reaches, with `reason`, `saved` (whether a last good state was
    there, saved and read back), `remedies` tried in turn, and `answered`, the one that brought an answer ("" if none did);
    wrong: an answer that a check refutes; `reason` says which;
    refused: InputError: the scene was not valid, a fault of the generator or of a rule;
    traceback: any other exception.
    """
    begun = process_time()
    try:
        scene = load_scene(path)
        if not (scene.resolution.asked or scene.effects.auto):  # which choose what they need
            prepare_kernels(scene)
        begun = process_time()
        out_of_time(limit)
        found = _solved(scene, folder, int(path.stem), limit, tell)
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


def _solved(scene: Scene, folder: Path, number: int, limit: float, tell: Tell) -> Outcome:
    try:
        with limited(OWN_SHARE * limit, process_time):
            result = run(scene, folder=folder)
    except InputError as error:
        if not (scene.resolution.asked and "resolution." in str(error).splitlines()[0]):
            raise
        return _out_of_reach(scene, error, limit)
    except SolveError as error:
        found: Outcome = {"ended": STOPPED, "kind": type(error).__name__, "reason": error.reason, "saved": _kept(error.state, folder)}
        found |= {"remedies": [remedy.words for remedy in error.remedies], "answered": ""}
        tell(found)
        out_of_time(limit)
        return found | {"answered": remedied(scene, error.remedies, limit)}
    out_of_time(limit)  # the checks are several more runs
    with limited(OWN_SHARE * limit, process_time):
        done = checked(scene, result, folder, number)
    shutil.rmtree(folder)
    found = {"warnings": result.warnings, "checks": done.done, "branches": done.branches, "solver": result.formulation}
    return {"ended": WRONG if done.wrong else CONVERGED, "reason": "; ".join(done.wrong), **found}


def _out_of_reach(scene: Scene, error: InputError, limit: float) -> Outcome:
    """An error or a time that no grid meets: known only once grids are solved, so it is no fault of the scene. Nothing is saved of it.

    Its remedy names what can be had, or to give `cells_across`.
    """
    reason = str(error)
    remedy = reason.splitlines()[-1].strip()
    found: Outcome = {"ended": STOPPED, "kind": "out of reach", "reason": reason, "saved": False, "remedies": [remedy]}
    data, share, seconds = scene.to_si(), re.search(r"ask for ([\d.e+-]+) %", reason), re.search(r"allow ([\d.e+-]+) s", reason)
    if share:
        data["resolution"]["error"] = float(share[1]) / 100
    elif seconds:
        data["resolution"]["seconds"] = float(seconds[1])
    else:
        data["resolution"] = {"cells_across": 3}
    out_of_time(limit)
    try:
        with limited(OWN_SHARE * limit, process_time):
            run(Scene.from_si(data))
    except (SolveError, InputError):
        return found | {"answered": ""}
    return found | {"answered": remedy}


class _Late(Exception):
    """A remedy took more than its share of the time."""


def remedied(scene: Scene, remedies: tuple[Remedy, ...], limit: float) -> str:
    """The first remedy that brings an answer: a converged result, finite and of positive det F. Each has the same share of the limit, s."""
    for remedy in remedies:
        until = process_time() + limit / len(remedies)

        def in_time(step: int, number: float, until: float = until) -> None:
            if process_time() > until:
                raise _Late

        try:
            result = run(remedy.applied(scene), on_progress=in_time)
        except (SolveError, _Late):
            continue
        if result.converged and result.min_det_F > 0.0 and not result.not_finite():
            return remedy.words
    return ""


def _kept(state: Any, folder: Path) -> bool:
    """True if there is a last good state, which a folder gives back as it was."""
    if not isinstance(state, Result):
        return False
    back = Result.load(state.save(folder))
    return bool((back.particle_position == state.particle_position).all()) and not back.converged
