"""Who is dead, who waits for whom, and which designs are given up: rules of workers, without processes."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import pytest

from magmpm.studies.engine.workers import per_trial, pool
from magmpm.studies.engine.workers.sessions import BEAT, LEASE, RECORD, Session


def session(looked: float = 0.0) -> Session:
    """One that looked so many seconds ago, and has seen the beat 7 of another."""
    found: Any = Session.__new__(Session)
    found.name, found.out, found.store = "mine", None, lambda call: call()
    found.kept = SimpleNamespace(user_attrs={}, get_trials=lambda **_: [])
    found._looked, found._seen = time.monotonic() - looked, {"other": (7, time.monotonic() - LEASE - 1)}
    return found


def test_a_session_elsewhere_is_dead_once_its_lease_is_over() -> None:
    trial: Any = SimpleNamespace(number=3, datetime_start=None)
    records = {RECORD + "other": {"host": "elsewhere", "beat": 7}}
    assert session()._is_dead("other", trial, records)
    fresh = session()
    fresh._seen["other"] = (7, time.monotonic())
    assert not fresh._is_dead("other", trial, records)


def test_beats_that_could_not_be_seen_count_for_nothing() -> None:
    for looked, known in ((0.0, 1), (2 * BEAT + 1, 0)):
        one = session(looked)
        one.sweep(set())
        assert len(one._seen) == known


def test_a_trial_waits_for_smaller_numbers_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(per_trial, "PATIENCE", 0.2)
    for other, waits in ((1, True), (3, False)):
        running = [SimpleNamespace(number=other, user_attrs={})]
        study: Any = SimpleNamespace(get_trials=lambda *_, running=running, **__: running)
        begun = time.monotonic()
        per_trial._wait_for_smaller(study, SimpleNamespace(number=2))  # type: ignore[arg-type]
        assert (time.monotonic() - begun > 0.1) is waits


def test_a_design_that_ended_two_processes_is_given_up() -> None:
    worker: Any = SimpleNamespace(job=(5, {}), ready=True, tries=0, given=[], start=lambda: None)
    worker.give = worker.given.append
    many: Any = pool.Pool.__new__(pool.Pool)
    many._failed_starts = many.deaths = 0
    assert many._replaced(worker, "ended by SIGKILL") is None
    assert (worker.given, worker.tries) == ([(5, {})], 1)
    assert "ended by SIGKILL, 2 times" in many._replaced(worker, "ended by SIGKILL")
    assert worker.job is None
