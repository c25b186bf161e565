"""Processes: answers to jobs, and what becomes of jobs that end them, take too long or raise; how many threads each takes."""

import os
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import pytest

from magmpm.compiled import thread_count as threads
from magmpm.compiled.process import (
    DIED,
    DONE,
    PARTIAL,
    RAISED,
    Died,
    Process,
    answers,
    started,
    threads_each,
)
from magmpm.compiled.thread_count import Threads

STARTS = 120.0  # s, on a busy machine


class Unsendable(Exception):
    def __init__(self, one: int, two: int) -> None:
        super().__init__(f"{one} and {two}")


def begin(pipe: Any, base: int) -> Callable[[Any], Any]:
    def work(job: Any) -> Any:
        if job == "killed":
            os.kill(os.getpid(), signal.SIGPROF)
        if job == "ended":
            os._exit(3)
        if job == "raises":
            raise Unsendable(1, 2)
        if job == "slow":
            time.sleep(600)
        pipe.send((PARTIAL, job))
        return base + job

    return work


def refuses(_: Any) -> None:
    raise ValueError("it can't begin")


def test_jobs_are_answered_and_what_ends_a_process_is_named() -> None:
    jobs = deque([1, "killed", 2, "ended", "raises", 3])
    with started(2, begin, 10) as processes:
        found = {(job, kind): content for job, kind, content in answers(jobs, processes)}
    assert {job: content for (job, kind), content in found.items() if kind == DONE} == {
        1: 11,
        2: 12,
        3: 13,
    }
    assert {job for job, kind in found if kind == PARTIAL} == {1, 2, 3}
    assert (str(found["killed", DIED]), found["killed", DIED].status) == (
        "ended by SIGPROF",
        -signal.SIGPROF,
    )
    assert (str(found["ended", DIED]), found["ended", DIED].status) == ("ended with status 3", 3)
    assert str(found["raises", RAISED]) == "Unsendable: 1 and 2"
    assert all(process.process.returncode is not None for process in processes)


def test_one_that_takes_too_long_is_replaced() -> None:
    with started(1, begin, 10) as [process]:
        process.ask(timeout=STARTS)
        with pytest.raises(Died, match="no answer in 1 s"):
            process.ask("slow", timeout=1.0)
        process.start()
        assert process.ask(5, timeout=STARTS) == 15
        [late, done] = [
            (job, kind)
            for job, kind, _ in answers(iter(["slow", 6]), [process], limit=1.0)
            if kind != PARTIAL
        ]
        assert (late, done) == (("slow", DIED), (6, DONE))
        with pytest.raises(Exception, match=r"[Pp]ickle|local object"):
            process.ask(lambda: None)
        assert process.ask(7, timeout=STARTS) == 17


def test_one_that_cannot_begin_says_why() -> None:
    process = Process(refuses)
    with pytest.raises(ValueError, match="it can't begin"):
        process.ask(timeout=STARTS)
    assert process.end(STARTS) == "ended with status 0"


def test_it_ends_with_its_caller_in_the_middle_of_a_job() -> None:
    script = (
        "import os, signal, time, test_process\nfrom magmpm.compiled.process import"
        " Process\nprocess = Process(test_process.begin,"
        " 1)\nprocess.ask()\nprocess.give('slow')\nprint(process.process.pid,"
        " flush=True)\ntime.sleep(0.5)\nos.kill(os.getpid(), signal.SIGKILL)\n"
    )
    env = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(
            [str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")]
        ),
    }
    child = int(
        subprocess.run(
            [sys.executable, "-c", script],
            capture_output=True,
            text=True,
            env=env,
            check=False,
            timeout=STARTS,
        ).stdout
    )
    until = time.monotonic() + STARTS
    while (
        Path(f"/proc/{child}/stat").exists()
        and Path(f"/proc/{child}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    ):
        assert time.monotonic() < until
        time.sleep(0.1)


def test_threads_are_split(monkeypatch: pytest.MonkeyPatch) -> None:
    cores = len(os.sched_getaffinity(0))
    monkeypatch.delenv("NUMBA_NUM_THREADS", raising=False)
    assert [threads_each(n) for n in (1, cores, 2 * cores)] == [cores, 1, 1]
    monkeypatch.setenv("NUMBA_NUM_THREADS", "1")
    assert threads_each(1) == 1


several = pytest.mark.skipif(numba.config.NUMBA_NUM_THREADS < 2, reason="there is one thread only")


@several
@pytest.mark.parametrize("slow", [1, 2])
def test_the_quicker_number_is_taken_and_the_other_tried_again(slow: int) -> None:
    """One number of threads takes far longer than the other."""
    before = numba.get_num_threads()
    taken = []

    def work() -> tuple[int, bool]:
        taken.append(numba.get_num_threads())
        time.sleep(0.05 if numba.get_num_threads() == slow else 0.0)
        return 10, False

    numba.set_num_threads(2)
    try:
        chosen = Threads(500)
        for _ in range(2 * threads.RETRIED):
            assert chosen.run(work) == (10, False)
            assert numba.get_num_threads() == 2
    finally:
        numba.set_num_threads(before)
    start = taken[: 2 * threads.TRIALS_OF_EACH_COUNT]
    assert start.count(1) == start.count(2) == threads.TRIALS_OF_EACH_COUNT
    rest = taken[2 * threads.TRIALS_OF_EACH_COUNT :]
    assert rest.count(slow) == 1, "once in RETRIED calls"
    assert taken[threads.RETRIED] == slow


@several
def test_a_large_body_takes_all_threads() -> None:
    found = []
    Threads(threads.MANY).run(lambda: (found.append(numba.get_num_threads()) or 1, False))  # type: ignore[func-returns-value]
    assert found == [numba.get_num_threads()]


@several
def test_the_number_is_put_back_where_steps_fail() -> None:
    before = numba.get_num_threads()
    with pytest.raises(ZeroDivisionError):
        Threads(10).run(lambda: (1 // 0, False))
    assert numba.get_num_threads() == before
