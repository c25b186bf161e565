"""Scenes by the thousand: drawn, solved in processes side by side, checked, counted.

They have a file of outcomes, from which an interrupted run goes on.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import signal
import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from time import process_time
from typing import Any

import yaml

from magmpm.compiled.process import (
    DIED,
    PARTIAL,
    RAISED,
    Died,
    answers,
    started,
)
from magmpm.errors import InputError, SolveError
from magmpm.results.result import Result
from magmpm.scene import Scene, load_scene
from magmpm.scene.remedies import Remedy
from magmpm.scene.time_limit import limited
from magmpm.simulate import run
from magmpm.solving.precompile import prepare_kernels
from random_scenes.checks import checked
from random_scenes.drawn import drawn

CONVERGED = "converged"
STOPPED = "stopped"
WRONG = "wrong"
REFUSED = "refused"
TRACEBACK = "traceback"
HUNG = "hung"
OWN_SHARE = 0.8  # of the limit, after which the solver is to end by itself
Outcome = dict[str, Any]  # of a random scene
Tell = Callable[[Outcome], None]
OUTCOMES = "outcomes.jsonl"
SCENES = "scenes"
STATES = "states"
ORDER = "order.json"
Job = tuple[int, Path, Path]  # number, scene file, folder for what is saved
BROKEN = (WRONG, REFUSED, TRACEBACK, HUNG)
ENDS = (CONVERGED, STOPPED, *BROKEN)


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
        if not (scene.resolution.requested or scene.effects.auto):  # which choose what they need
            prepare_kernels(scene)
        begun = process_time()
        out_of_time(limit)
        found = _solved(scene, folder, int(path.stem), limit, tell)
    except InputError as error:
        found = {"ended": REFUSED, "reason": str(error)}
    except Exception as error:
        found = {
            "ended": TRACEBACK,
            "reason": f"{type(error).__name__}: {error}",
            "traceback": traceback.format_exc(),
        }
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
        if not (scene.resolution.requested and "resolution." in str(error).splitlines()[0]):
            raise
        return _out_of_reach(scene, error, limit)
    except SolveError as error:
        found: Outcome = {
            "ended": STOPPED,
            "kind": type(error).__name__,
            "reason": error.reason,
            "saved": _kept(error.state, folder),
        }
        found |= {"remedies": [remedy.words for remedy in error.remedies], "answered": ""}
        tell(found)
        out_of_time(limit)
        return found | {"answered": remedied(scene, error.remedies, limit)}
    out_of_time(limit)  # the checks are several more runs
    with limited(OWN_SHARE * limit, process_time):
        done = checked(scene, result, folder, number)
    shutil.rmtree(folder)
    found = {
        "warnings": result.warnings,
        "checks": done.done,
        "branches": done.branches,
        "solver": result.formulation,
    }
    return {"ended": WRONG if done.wrong else CONVERGED, "reason": "; ".join(done.wrong), **found}


def _out_of_reach(scene: Scene, error: InputError, limit: float) -> Outcome:
    """An error or a time that no grid meets: known only once grids are solved, so it is no fault of the scene. Nothing is saved of it.

    Its remedy names what can be had, or to give `cells_across`.
    """
    reason = str(error)
    remedy = reason.splitlines()[-1].strip()
    found: Outcome = {
        "ended": STOPPED,
        "kind": "out of reach",
        "reason": reason,
        "saved": False,
        "remedies": [remedy],
    }
    data = scene.to_si()
    share = re.search(r"ask for ([\d.e+-]+) %", reason)
    seconds = re.search(r"allow ([\d.e+-]+) s", reason)
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


def run_random(
    count: int, seed: int, folder: Path, *, on_done: Callable[[int, int], None] | None = None
) -> dict[str, Any]:
    """Draw and solve scenes 0 to count - 1 of a seed, each within 120 s of processor time. Scenes that did not converge stay in
    folder/scenes, their last good states in folder/states, outcomes in folder/outcomes.jsonl; those that are there already are not solved
    again.

    on_done(done, count): called after each. Returns the summary (`summary_of`). Raises InputError where folder holds another seed.
    """
    begun = time.monotonic()
    known = _known(folder, seed)
    left = [number for number in range(count) if number not in known]
    (folder / SCENES).mkdir(parents=True, exist_ok=True)
    with (folder / OUTCOMES).open("a", encoding="utf-8") as log:
        jobs = (
            (number, _written(folder, seed, number), folder / STATES / str(number))
            for number in left
        )
        for number, outcome in solved(jobs, min(2, max(1, len(left))), 120.0):
            known[number] = {"number": number, **outcome}
            log.write(json.dumps(known[number]) + "\n")
            log.flush()
            if outcome["ended"] == CONVERGED:
                _path(folder, number).unlink(missing_ok=True)
            if on_done is not None:
                on_done(len(known), count)
    return summary_of(
        [known[number] for number in sorted(known) if number < count],
        time.monotonic() - begun,
        folder,
    )


def solved(jobs: Iterable[Job], processes: int, limit: float) -> Iterator[tuple[int, Outcome]]:
    """Number and outcome of each job, in the order in which they end. limit: s of processor time for each.

    Each process compiles a kernel once, for all its scenes; one that ends or hangs is replaced.
    """
    known: dict[int, Outcome] = {}  # before remedies are tried
    # They begin with this package on their path.
    paths = [str(Path(__file__).resolve().parents[1]), os.environ.get("PYTHONPATH", "")]
    threads = os.environ.get("OMP_NUM_THREADS", "1")
    env = {**os.environ, "OMP_NUM_THREADS": threads, "PYTHONPATH": os.pathsep.join(paths)}
    with started(processes, _begin, limit, env=env) as pool:
        for (number, path, _), kind, found in answers(
            iter(jobs), pool, 20 * limit + 1200
        ):  # it compiles before its limit begins
            if kind == RAISED:
                raise found
            if kind == PARTIAL:
                known[number] = found
            else:
                yield (
                    number,
                    _without(found, path, known.get(number), limit) if kind == DIED else found,
                )


def _begin(pipe: Any, limit: float) -> Callable[[Job], Outcome]:
    return lambda job: attempt(job[1], job[2], limit, lambda known: pipe.send((PARTIAL, known)))


def _without(death: Died, path: Path, known: Outcome | None, limit: float) -> Outcome:
    """The outcome where a process ended on its own: out of time (in a remedy, which then brought no answer), or otherwise."""
    late = death.status == -signal.SIGPROF
    if late and known is not None:
        return {"file": path.name, "seconds": death.seconds, **known}
    reason = f"no answer within {limit:g} s of processor time" if late else f"the process {death}"
    return {
        "file": path.name,
        "seconds": death.seconds,
        "ended": HUNG if late or death.status == 0 else TRACEBACK,
        "reason": reason,
    }


def summary_of(outcomes: list[Outcome], seconds: float, folder: Path) -> dict[str, Any]:
    """Counts by how scenes ended, and number, reason and file of each that did not converge. seconds: of this call."""
    counts = {end: sum(outcome["ended"] == end for outcome in outcomes) for end in ENDS}
    others = [
        {
            **{key: value for key, value in outcome.items() if key != "file"},
            "file": str(folder / SCENES / outcome["file"]),
        }
        for outcome in outcomes
        if outcome["ended"] != CONVERGED
    ]
    stopped = [outcome for outcome in outcomes if outcome["ended"] == STOPPED]
    return {
        "scenes": len(outcomes),
        **counts,
        "answered": sum(bool(outcome["answered"]) for outcome in stopped),
        "state_saved": sum(outcome["saved"] for outcome in stopped),
        "checks": dict(Counter(name for outcome in outcomes for name in outcome.get("checks", ()))),
        "other_branch": sum(bool(outcome.get("branches")) for outcome in outcomes),
        "seconds": seconds,
        "folder": str(folder),
        "not_converged": others,
    }


def random_table(summary: dict[str, Any]) -> str:
    """The summary as text."""
    lines = [
        f"{summary['scenes']} scenes: "
        + ", ".join(f"{summary[end]} {end}" for end in ENDS)
        + f"; {summary['seconds']:.0f} s"
    ]
    saved = summary["state_saved"]
    answered = summary["answered"]
    lines.append(
        f"of {summary['stopped']} stopped, {saved} with a state saved, {answered} answered by a"
        " remedy"
    )
    lines.append(
        "checks: " + ", ".join(f"{count} {name}" for name, count in summary["checks"].items())
    )
    for one in summary["not_converged"]:
        lines.append(
            f"  {one['number']:>5} {one['ended']:<10} {one['reason'].splitlines()[0][:160]} "
            f" {one['file']}"
        )
    return "\n".join(lines)


def _known(folder: Path, seed: int) -> dict[int, Outcome]:
    """Outcomes that a folder holds, by number."""
    first = json.dumps(
        [drawn(seed, number) for number in range(20)], sort_keys=True
    )  # which tell whether they are drawn as before
    order = folder / ORDER
    now = {"seed": seed, "first_scenes": hashlib.sha256(first.encode()).hexdigest()}
    held = json.loads(order.read_text(encoding="utf-8")) if order.exists() else now
    if held != now:
        what = (
            f"of seed {held['seed']}, and this is seed {seed}"
            if held["seed"] != seed
            else "drawn by another version"
        )
        raise InputError(f"--out: {folder} holds the scenes {what}; give another folder")
    folder.mkdir(parents=True, exist_ok=True)
    order.write_text(json.dumps(now), encoding="utf-8")
    found = {}
    if (folder / OUTCOMES).exists():
        for line in (folder / OUTCOMES).read_text(encoding="utf-8").splitlines():
            try:
                outcome = json.loads(line)
            except ValueError:  # cut off as it was written
                continue
            found[outcome["number"]] = outcome
    return found


def _path(folder: Path, number: int) -> Path:
    return folder / SCENES / f"{number:06d}.yaml"


def _written(folder: Path, seed: int, number: int) -> Path:
    """The file of a scene, written."""
    path = _path(folder, number)
    head = f"# Scene {number} of `make stability RANDOM=N SEED={seed}`\n\n"
    path.write_text(
        head
        + yaml.safe_dump(drawn(seed, number), sort_keys=False, default_flow_style=None, width=140),
        encoding="utf-8",
    )
    return path
