"""A session of a study in a process of its own, which a test can kill: python session.py STUDY OUT WORKERS; storage by MAGMPM_STORAGE.

The rod solves, and takes SECONDS more for it, so that kills meet solves. LEASE and BEAT of sessions are shorter than in use.
"""

import os
import signal
import sys
import threading
import time
from typing import Any

import rod_solve

from magmpm.errors import MagmpmError
from magmpm.scene import Scene
from magmpm.studies.engine import loop
from magmpm.studies.engine.loop import run_study
from magmpm.studies.engine.workers import sessions
from magmpm.studies.search.definition import load_study

SECONDS = "TEST_SECONDS"
DEADLY = "TEST_DEADLY"  # a file: whoever finds it in a solve deletes it and dies
# a number: SIGKILL when the third design is requested, before that request's commit of this number
# (from 0)
KILLED = "TEST_KILLED"
# a file: whoever finds it in a solve deletes it and hangs, deaf to all signals that can be ignored
HANGING = "TEST_HANGING"


def slow(scene: Scene, **options: Any) -> rod_solve.RodResult:
    """The rod's shape, after a while."""
    time.sleep(float(os.environ.get(SECONDS, "0")))
    if taken(DEADLY):
        os.kill(os.getpid(), 11)
    if taken(HANGING):
        signal.pthread_sigmask(signal.SIG_BLOCK, set(signal.Signals))
        threading.Event().wait()
    return rod_solve.solve(scene, **options)


def taken(variable: str) -> bool:
    """Whether this process is the one that deletes the file that a variable of the environment names: of two that find it, one is."""
    try:
        os.unlink(os.environ.get(variable, ""))
    except FileNotFoundError:
        return False
    return True


def set_clock(offset: float) -> None:
    """Let this process see another time of day."""
    import datetime as module

    from optuna.storages._rdb import storage as rdb

    class Shifted(module.datetime):
        @classmethod
        def now(cls, tz: Any = None) -> Any:
            return module.datetime.now(tz) + module.timedelta(seconds=offset)

    clock = time.time
    time.time = lambda: clock() + offset
    rdb.datetime = sessions.datetime = Shifted  # type: ignore[attr-defined, misc]


def kill_in_ask(at: int) -> None:
    """Let this process die while it requests its third design: before one of the request's commits, or right after the last."""
    from sqlalchemy import Engine, event

    calls = 0
    commits = 0
    ask = loop._Run.ask

    def counted(run: Any) -> Any:
        nonlocal calls
        calls += 1
        pending = ask(run)
        if calls == 3:
            print(f"{commits} commits", file=sys.stderr, flush=True)
            os.kill(os.getpid(), signal.SIGKILL)
        return pending

    @event.listens_for(Engine, "commit")
    def on_commit(_: object) -> None:
        nonlocal commits
        if calls == 3:
            if commits == at:
                os.kill(os.getpid(), signal.SIGKILL)
            commits += 1

    loop._Run.ask = counted  # type: ignore[method-assign]


def main(study: str, out: str, workers: str) -> int:
    from interruptible import draw

    sessions.BEAT = 0.5
    sessions.LEASE = 4.0
    if KILLED in os.environ:
        kill_in_ask(int(os.environ[KILLED]))
    if "TEST_CLOCK" in os.environ:
        set_clock(float(os.environ["TEST_CLOCK"]))
    import session  # so that workers find `slow` by name

    how = None if workers == "0" else int(workers)
    try:
        report = run_study(
            load_study(study),
            solve=session.slow,
            differentiate=rod_solve.differentiate,
            picture=draw,
            out=out,
            storage=os.environ.get("MAGMPM_STORAGE"),
            workers=how,
            on_advice=lambda lines: print(*lines, file=sys.stderr, sep="\n"),
        )
    except MagmpmError as error:
        print(f"magmpm: {error}", file=sys.stderr)
        return error.exit_status
    print(report.ended, report.trials, flush=True)
    return 1 if report.ended == "interrupted" else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
