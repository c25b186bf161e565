"""Compiled functions are cached if possible; otherwise they are compiled, with one message."""

import errno
import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from reference.modules import module_of

from magmpm.compiled import cache as kernel_cache
from magmpm.compiled import environment
from magmpm.compiled.cache import kept_all

MODULE = (
    "from magmpm.compiled.cache import jit\n@jit()\ndef twice(x):\n    return 2 * x\n@jit()\ndef"
    " thrice(x):\n    return 3 * x\n"
)
LINKED = f"""import sys
import numpy as np
from magmpm.compiled.cache import compile_here
from magmpm.compiled.jit import compiled, kernel, task_body
from magmpm.compiled.parallel import over_parts, task
if "late" in sys.argv:
    compile_here()
    sys.argv.remove("late")
@compiled
def one(record):
    found = 0.0
    {"found += np.sin(found) + record.x;" * 40}  # too long to become a part of what calls it
    return found
@compiled
def total(records):
    return one(records[0]) + one(records[-1])
@kernel
def parallel(x):
    return (2.0 * x).sum()
@compiled
def caller(x):
    return 2.0 * parallel(x)
@task_body
def doubled(k, given):
    given[0][k] *= 2.0
@compiled
def tasked(x):
    over_parts(len(x), task(doubled, (x,)))
    return x.sum()
for name in sys.argv[1:]:
    print(globals()[name](np.ones(9)) if name in globals() else total(np.array([(1.0, 2.0)], [(at, "f8") for at in name])), end=" ")
"""


def linked(folder: Path, names: str) -> str:
    """What a process of its own prints of these functions, or kinds of records, with a cache in this folder."""
    (folder / "linked.py").write_text(LINKED)
    space = {**os.environ, "NUMBA_CACHE_DIR": str(folder), "PYTHONHASHSEED": "0"}
    return subprocess.check_output(
        [sys.executable, "linked.py", *names.split()], cwd=folder, env=space, text=True
    )


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Two functions in a separate file, with a separate cache."""
    monkeypatch.setattr("numba.config.CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(kernel_cache, "_noted", set())
    (tmp_path / "doubled.py").write_text(MODULE)
    return loaded(tmp_path)


def loaded(folder: Path) -> ModuleType:
    return module_of(folder / "doubled.py", "doubled", kept=False)


def test_a_function_is_kept_and_loaded(
    module: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert module.twice(2.0) == 4.0
    again = loaded(tmp_path)
    assert again.twice(2.0) == 4.0
    assert sum(again.twice.stats.cache_hits.values()) == 1
    assert capsys.readouterr().err == ""
    assert kept_all()


def test_two_processes_that_save_at_once_keep_both(
    module: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another signature is saved while the first is being written: each is found, and is the right one."""
    other = loaded(tmp_path)
    dump = kernel_cache._SealedFiles._dump

    def meanwhile(files: Any, content: Any) -> Any:
        monkeypatch.setattr(kernel_cache._SealedFiles, "_dump", dump)
        assert other.twice(3) == 6
        return dump(files, content)

    monkeypatch.setattr(kernel_cache._SealedFiles, "_dump", meanwhile)
    assert module.twice(2.5) == 5.0
    again = loaded(tmp_path)
    assert (again.twice(2.5), again.twice(3)) == (5.0, 6)
    assert sum(again.twice.stats.cache_hits.values()) == 2


def test_one_bit_is_noticed(
    module: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """At any place: otherwise content that unpickles, but differs from what was compiled, would be run."""
    assert module.twice(2.0) == 4.0
    (path,) = (tmp_path / "cache").rglob("*twice*.nbc")
    content = bytearray(path.read_bytes())
    content[-20] ^= 1
    path.write_bytes(content)
    again = loaded(tmp_path)
    assert again.twice(2.0) == 4.0
    assert sum(again.twice.stats.cache_misses.values()) == 1
    assert (
        capsys.readouterr().err
        == f"magmpm: compiled kernels on disk: {path}: damaged; the kernel is compiled"
        " again\n"
    )
    assert kept_all()
    third = loaded(tmp_path)
    assert third.twice(2.0) == 4.0
    assert sum(third.twice.stats.cache_hits.values()) == 1


COPIED = """
import magmpm
from magmpm.compiled.parallel import parts_of
assert parts_of(129) == 2
print(magmpm.__path__[0], sum(parts_of.stats.cache_hits.values()))
"""


def test_another_copy_of_the_package_takes_the_same_files(tmp_path: Path) -> None:
    """Wherever it is, and whenever its files were written: a clone, an installation, a container."""
    space = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    hits = []
    for place in ("one", "two"):
        shutil.copytree(
            environment.PACKAGE,
            tmp_path / place / "magmpm",
            ignore=shutil.ignore_patterns("__pycache__"),
        )
        for path in (tmp_path / place).rglob("*.py"):
            os.utime(path, None)
        said = subprocess.check_output(
            [sys.executable, "-c", COPIED], cwd=tmp_path / place, env=space, text=True
        )
        hits.append(said.split())
    one, two = (str(tmp_path / place / "magmpm") for place in ("one", "two"))
    assert hits == [[one, "0"], [two, "1"]]


def no_room(*_: Any, **__: Any) -> Any:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_full_disk_ends_nothing_and_is_said_once(
    module: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("magmpm.compiled.cache._SealedFiles._open_for_write", no_room)
    assert module.twice(2.0) == 4.0
    assert module.thrice(2.0) == 6.0
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    for part in (
        "No space left on device",
        "every run waits",
        "free disk space, or set NUMBA_CACHE_DIR",
    ):
        assert part in said
    assert not kept_all()


def test_neither_cache_nor_temporary_folder(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """magmpm can still be imported."""
    monkeypatch.setattr(Path, "mkdir", no_room)
    environment._folder_to_use()
    assert "every run compiles them again" in capsys.readouterr().err


def test_code_for_one_record_is_not_taken_for_that_of_another(tmp_path: Path) -> None:
    """Two kinds of records, each compiled for by a process that knows no other, then loaded by one: Numba counts both as the same."""
    assert linked(tmp_path, "xy") + linked(tmp_path, "yx") == linked(tmp_path, "xy yx")


def test_what_calls_a_loaded_parallel_kernel_starts_threads(tmp_path: Path) -> None:
    """A process compiles the kernel, one what calls it, and a third loads that alone: its first call was one to nowhere."""
    assert [linked(tmp_path, name) for name in ("parallel", "caller", "caller")] == [
        "18.0 ",
        "36.0 ",
        "36.0 ",
    ]


@pytest.mark.parametrize("how", ["", "late "])
def test_the_function_of_a_task_is_found_by_its_symbol(how: str, tmp_path: Path) -> None:
    """In the process that compiles it, and in one that loads its caller alone: the function must be loaded before."""
    assert [linked(tmp_path, f"{how}tasked"), linked(tmp_path, "tasked")] == ["18.0 ", "18.0 "]
    files = [path.name for path in tmp_path.rglob("*.nbc")]
    assert sum("doubled" in name for name in files) == 1, "it is compiled for itself, once"


def test_code_that_is_written_late_is_the_same(tmp_path: Path) -> None:
    """A process that compiles for others writes machine code for what is called alone; what it keeps of the rest is linked by others."""
    here = linked(tmp_path, "late xy caller")
    assert here == linked(tmp_path, "xy caller")
    assert linked(tmp_path, "yx") == linked(tmp_path, "late yx")
