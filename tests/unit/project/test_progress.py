"""Progress of long work where standard error is no terminal."""

import time

import pytest

from magmpm.cli import answers as progress


def test_without_a_terminal_lines_come_though_the_work_reports_nothing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Progress is reported at least every EVERY seconds (8), and not at all for work shorter than that."""
    assert progress.EVERY < 10.0
    with progress.Progress("short"):
        pass
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(progress, "EVERY", 0.05)
    with progress.Progress("fit of tube") as shown:
        shown.note("12 solves")
        time.sleep(0.4)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) >= 2
    assert all(line.startswith("magmpm: fit of tube: 12 solves; ") for line in lines)


def test_the_time_left_counts_no_compiling_and_nothing_done_before(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A motion that compiled for 60 s, and one that was resumed after 900 of 1000 parts: 10 parts a second are left to be done."""
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    for before, total, left in (
        (0, 1000, "about 90 s left"),
        (890, 1000, "about 1 s left"),
        (0, 1988, "about 3 min 9 s left"),
        (0, 9999, "about 16 min left"),
    ):
        with progress.Progress("swing") as shown:
            now[0] += 60.0
            shown.at(before, total)
            assert "left" not in shown._last
            now[0] += 10.0
            shown.at(before + 100, total)
            assert left in shown._last


def test_no_time_is_left_once_all_parts_are_done(monkeypatch: pytest.MonkeyPatch) -> None:
    """What comes after the last trial, such as pictures, is no part of them: nothing is said of its time."""
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    with progress.Progress("arc") as shown:
        shown.at(1, 3)
        now[0] += 5.0
        shown.at(2, 3)
        assert "about 5 s left" in shown._last
        shown.at(3, 3, "best 0.40 mm")
        assert shown._last == "arc: 3 of 3; best 0.40 mm"


def test_parts_that_are_no_counts_have_their_unit() -> None:
    with progress.Progress("swing") as shown:
        shown.at(0.05, 0.3, "step 12", "s")
        assert shown._last == "swing: 0.05 of 0.3 s; step 12"
