"""Which sessions of workers count as dead, without processes."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

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
