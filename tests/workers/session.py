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
from magmpm.studies.engine import loop, study_session
from magmpm.studies.engine.loop import run_study
from magmpm.studies.engine.workers import sessions
from magmpm.studies.search.definition import load_study

SECONDS = "TEST_SECONDS"
DEADLY = "TEST_DEADLY"  # a file: whoever finds it in a solve deletes it and dies
# "open 2", "ask 2": SIGKILL while the study is opened, or its third design is requested, before the
# commit of this number (from 0) of that call
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


def kill_in(what: str, at: int) -> None:
    """Let this process die while it opens the study, or requests its third design: before one of the call's commits, or after the last."""
    from sqlalchemy import Engine, event

    owner: Any = loop._Run if what == "ask" else study_session
    name, which = ("ask", 3) if what == "ask" else ("open_study", 1)
    calls = 0
    commits = 0
    called = getattr(owner, name)

    def counted(*args: Any) -> Any:
        nonlocal calls
        calls += 1
        answer = called(*args)
        if calls == which:
            print(f"{commits} commits", file=sys.stderr, flush=True)
            os.kill(os.getpid(), signal.SIGKILL)
        return answer

    @event.listens_for(Engine, "commit")
    def on_commit(_: object) -> None:
        nonlocal commits
        if calls == which:
            if commits == at:
                os.kill(os.getpid(), signal.SIGKILL)
            commits += 1

    setattr(owner, name, counted)


def main(study: str, out: str, workers: str) -> int:
    from interruptible import draw

    sessions.BEAT = 0.5
    sessions.LEASE = 4.0
    if KILLED in os.environ:
        what, at = os.environ[KILLED].split()
        kill_in(what, int(at))
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
