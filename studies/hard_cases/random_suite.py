"""Scenes by the thousand: drawn, solved, checked, counted; with a file of outcomes from which an interrupted run goes on."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import yaml

from magmpm.compiled.process import DIED, RAISED, TOLD, Died, answers, started
from magmpm.errors import InputError
from magmpm.studies.hard_cases.attempt import (
    CONVERGED,
    HUNG,
    REFUSED,
    STOPPED,
    TRACEBACK,
    WRONG,
    Outcome,
    attempt,
)
from magmpm.studies.hard_cases.drawn import drawn

OUTCOMES, SCENES, STATES, ORDER = "outcomes.jsonl", "scenes", "states", "order.json"
FIRST = 20  # scenes by which another version of the generator is noticed
LIMIT = 120.0  # s of processor time for a scene with its checks, which a busy machine does not shorten
PATIENCE = 20.0  # times as long, and
COMPILING = 1200.0  # s more, may a process take: it compiles before its limit of processor time begins
Job = tuple[int, Path, Path]  # number, scene file, folder for what is saved
BROKEN = (WRONG, REFUSED, TRACEBACK, HUNG)
ENDS = (CONVERGED, STOPPED, *BROKEN)


def run_random(
    count: int, seed: int, folder: Path, *, processes: int = 2, limit: float = LIMIT, on_done: Callable[[int, int], None] | None = None
) -> dict[str, Any]:
    """Draw and solve scenes 0 to count - 1 of a seed. Scenes that did not converge stay in folder/scenes, their last good states in
    folder/states, outcomes in folder/outcomes.jsonl; those that are there already are not solved again.

    on_done(done, count): called after each. Returns the summary (`summary_of`). Raises InputError where folder holds another seed.
    """
    begun = time.monotonic()
    known = _known(folder, seed)
    left = [number for number in range(count) if number not in known]
    (folder / SCENES).mkdir(parents=True, exist_ok=True)
    with (folder / OUTCOMES).open("a", encoding="utf-8") as log:
        jobs = ((number, _written(folder, seed, number), folder / STATES / str(number)) for number in left)
        for number, outcome in solved(jobs, min(processes, max(1, len(left))), limit):
            known[number] = {"number": number, **outcome}
            log.write(json.dumps(known[number]) + "\n")
            log.flush()
            if outcome["ended"] == CONVERGED:
                _path(folder, number).unlink(missing_ok=True)
            if on_done is not None:
                on_done(len(known), count)
    return summary_of([known[number] for number in sorted(known) if number < count], time.monotonic() - begun, folder)


def solved(jobs: Iterable[Job], processes: int, limit: float) -> Iterator[tuple[int, Outcome]]:
    """Number and outcome of each job, in the order in which they end. limit: s of processor time for each.

    Each process compiles a kernel once, for all its scenes; one that ends or hangs is replaced.
    """
    known: dict[int, Outcome] = {}  # before remedies are tried
    env = {**os.environ, "OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS", "1")}
    with started(processes, _begin, limit, env=env) as pool:
        for (number, path, _), kind, found in answers(iter(jobs), pool, PATIENCE * limit + COMPILING):
            if kind == RAISED:
                raise found
            if kind == TOLD:
                known[number] = found
            else:
                yield number, _without(found, path, known.get(number), limit) if kind == DIED else found


def _begin(pipe: Any, limit: float) -> Callable[[Job], Outcome]:
    return lambda job: attempt(job[1], job[2], limit, lambda known: pipe.send((TOLD, known)))


def _without(death: Died, path: Path, known: Outcome | None, limit: float) -> Outcome:
    """The outcome where a process ended on its own: out of time (in a remedy, which then brought no answer), or otherwise."""
    late = death.status == -signal.SIGPROF
    if late and known is not None:
        return {"file": path.name, "seconds": death.seconds, **known}
    reason = f"no answer within {limit:g} s of processor time" if late else f"the process {death}"
    return {"file": path.name, "seconds": death.seconds, "ended": HUNG if late or death.status == 0 else TRACEBACK, "reason": reason}


def summary_of(outcomes: list[Outcome], seconds: float, folder: Path) -> dict[str, Any]:
    """Counts by how scenes ended, and number, reason and file of each that did not converge. seconds: of this call."""
    counts = {end: sum(outcome["ended"] == end for outcome in outcomes) for end in ENDS}
    others = [
        {**{key: value for key, value in outcome.items() if key != "file"}, "file": str(folder / SCENES / outcome["file"])}
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
    lines = [f"{summary['scenes']} scenes: " + ", ".join(f"{summary[end]} {end}" for end in ENDS) + f"; {summary['seconds']:.0f} s"]
    saved, answered = summary["state_saved"], summary["answered"]
    lines.append(f"of {summary['stopped']} stopped, {saved} with a state saved, {answered} answered by a remedy")
    lines.append("checks: " + ", ".join(f"{count} {name}" for name, count in summary["checks"].items()))
    for one in summary["not_converged"]:
        lines.append(f"  {one['number']:>5} {one['ended']:<10} {one['reason'].splitlines()[0][:160]}  {one['file']}")
    return "\n".join(lines)


def _known(folder: Path, seed: int) -> dict[int, Outcome]:
    """Outcomes that a folder holds, by number."""
    order, now = folder / ORDER, {"seed": seed, "first_scenes": _mark(seed)}
    held = json.loads(order.read_text(encoding="utf-8")) if order.exists() else now
    if held != now:
        what = f"of seed {held['seed']}, and this is seed {seed}" if held["seed"] != seed else "drawn by another version"
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


def _mark(seed: int) -> str:
    """Tells whether a seed's scenes are drawn as before: SHA-256 of the first of them, in hex."""
    first = json.dumps([drawn(seed, number) for number in range(FIRST)], sort_keys=True)
    return hashlib.sha256(first.encode()).hexdigest()


def _path(folder: Path, number: int) -> Path:
    return folder / SCENES / f"{number:06d}.yaml"


def _written(folder: Path, seed: int, number: int) -> Path:
    """The file of a scene, written."""
    path = _path(folder, number)
    head = f"# Scene {number} of `magmpm stability --random N --seed {seed}`\n\n"
    path.write_text(head + yaml.safe_dump(drawn(seed, number), sort_keys=False, default_flow_style=None, width=140), encoding="utf-8")
    return path
