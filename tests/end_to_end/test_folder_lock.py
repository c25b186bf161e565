"""One process at a time writes to a results folder; a second one names the first and changes nothing."""

import os
import signal
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from reference.commands import started, wait_for
from reference.folders import holding
from swing import scene
from test_commands import SCENE, STUDY

from magmpm.results import folder_lock as lock
from magmpm.results.file_names import CHECKPOINT, ENERGIES
from magmpm.results.folder_lock import LOCK, FolderInUse, folder_lock


@pytest.fixture(autouse=True)
def _impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lock, "SECONDS_FOR_THE_KILLED", 0.1)


def frames(folder: Path) -> int:
    """Frames of a motion that another process writes: by the rows of its energies, which are whole at any moment."""
    return len((folder / ENERGIES).read_text(encoding="utf-8").splitlines())


def test_two_motions_into_one_folder(tmp_path: Path, told) -> None:
    """The second ends at once with status 2 and the number of the first process; the first continues, and all files are its own."""
    path = scene(tmp_path, "duration: 100 s, output_every: 1 ms")
    out = tmp_path / "out"
    with started("run", path, "--out", out) as first:
        try:
            wait_for((out / CHECKPOINT).exists, first)
            says = (
                f"{out}: in use by process {first.pid} on ",
                "\n  rule: ",
                "\n  remedy: wait for it, end it, or use another --out",
            )
            for more in ((), ("--resume",)):
                told("run", path, "--out", out, *more, status=2, says=says)
            wait_for(lambda: frames(out) > 0, first)
            seen = frames(out)
            wait_for(lambda: frames(out) > seen, first)
            assert frames(out) > seen
            assert first.poll() is None, "the first went on"
        finally:
            first.kill()
    rows = (out / ENERGIES).read_text().splitlines()
    times = [float(row.split(",")[0]) for row in rows[1:-1]]  # the last may be truncated
    assert times == sorted(set(times)), "rows of one motion"
    assert times[0] == 0.0


@pytest.mark.parametrize(
    "command",
    [
        ["run", "scene.yaml"],
        ["accuracy", "scene.yaml", "--cells", "2,3"],
        ["design", "study.yaml", "--no-pictures"],
        ["render", "out"],
    ],
)
def test_every_command_that_writes_a_folder_waits_its_turn(
    command, tmp_path, monkeypatch, told
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MAGMPM_RENDER", "matplotlib")
    Path("scene.yaml").write_text(SCENE)
    Path("study.yaml").write_text(STUDY)
    Path("target.csv").write_text("s_mm,x_mm,y_mm,z_mm\n0,0,0,0\n10,10,0,0\n20,20,0,0\n")
    Path("out").mkdir()
    if command[0] == "render":
        told("run", "scene.yaml", "--out", "out")
    before = sorted(Path("out").iterdir())
    with holding(tmp_path / "out") as pid:
        assert (
            told(
                *command,
                "--out",
                "out",
                status=2,
                says=(f"in use by process {pid} on ", " since 20"),
            ).out
            == ""
        )
    assert [path for path in sorted(Path("out").iterdir()) if path.name != LOCK] == [
        path for path in before if path.name != LOCK
    ]


def test_the_lock_goes_with_its_process(tmp_path: Path) -> None:
    with holding(tmp_path) as pid:
        os.kill(pid, signal.SIGKILL)
        lock.SECONDS_FOR_THE_KILLED = 5.0  # the system may need a moment
        with folder_lock(tmp_path):
            pass


def test_a_thread_may_take_it_again_and_another_may_not(tmp_path: Path) -> None:
    """A command locks its folder, and so does the solver that it calls."""
    found: list[BaseException] = []

    def other() -> None:
        try:
            with folder_lock(tmp_path):
                pass
        except FolderInUse as error:
            found.append(error)

    with folder_lock(tmp_path):
        with folder_lock(tmp_path / "." / ""):
            pass
        thread = threading.Thread(target=other)
        thread.start()
        thread.join()
    assert f"process {os.getpid()} on" in str(found[0])
    other()
    assert len(found) == 1, "free again"


def test_a_lock_of_someone_unknown(tmp_path: Path) -> None:
    """The content of the file does not matter, only the lock on it."""
    with holding(tmp_path):
        for text in ("", "null", "{", "4711"):
            (tmp_path / LOCK).write_text(text)
            with (
                pytest.raises(FolderInUse, match="in use by another process"),
                folder_lock(tmp_path),
            ):
                pass


def test_the_lock_leaves_no_file_and_one_that_waits_for_it_locks_the_next(tmp_path: Path) -> None:
    """Five threads, one at a time, although each deletes the file."""
    inside = [0]
    most = [0]

    def work(_: int) -> None:
        for _ in range(20):
            with folder_lock(tmp_path):
                inside[0] += 1
                most[0] = max(most[0], inside[0])
                time.sleep(0.0005)
                inside[0] -= 1

    lock.SECONDS_FOR_THE_KILLED = 60.0
    with ThreadPoolExecutor(5) as threads:
        assert list(threads.map(work, range(5))) == [None] * 5
    assert most == [1]
    assert list(tmp_path.iterdir()) == []
