"""Compiled functions are cached if possible; otherwise they are compiled, with one message."""

import errno
import os
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from reference.modules import module_of

from magmpm.compiled import cache as kernel_cache
from magmpm.compiled import environment
from magmpm.compiled.cache import kept_all

MODULE = "from magmpm.compiled.cache import jit\n@jit()\ndef twice(x):\n    return 2 * x\n@jit()\ndef thrice(x):\n    return 3 * x\n"


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Two functions in a separate file, with a separate cache."""
    monkeypatch.setattr("numba.config.CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(kernel_cache, "_noted", set())
    (tmp_path / "doubled.py").write_text(MODULE)
    return loaded(tmp_path)


def loaded(folder: Path) -> ModuleType:
    return module_of(folder / "doubled.py", "doubled", kept=False)


def test_a_function_is_kept_and_loaded(module: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert module.twice(2.0) == 4.0
    again = loaded(tmp_path)
    assert again.twice(2.0) == 4.0
    assert sum(again.twice.stats.cache_hits.values()) == 1
    assert capsys.readouterr().err == ""
    assert kept_all()


def test_two_processes_that_save_at_once_keep_both(module: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another signature is saved while the first is being written: each is found, and is the right one."""
    other, dump = loaded(tmp_path), kernel_cache._SealedFiles._dump

    def meanwhile(files: Any, content: Any) -> Any:
        monkeypatch.setattr(kernel_cache._SealedFiles, "_dump", dump)
        assert other.twice(3) == 6
        return dump(files, content)

    monkeypatch.setattr(kernel_cache._SealedFiles, "_dump", meanwhile)
    assert module.twice(2.5) == 5.0
    again = loaded(tmp_path)
    assert (again.twice(2.5), again.twice(3)) == (5.0, 6)
    assert sum(again.twice.stats.cache_hits.values()) == 2


def test_one_bit_is_noticed(module: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """At any place: otherwise content that unpickles, but differs from what was compiled, would be run."""
    assert module.twice(2.0) == 4.0
    (path,) = (tmp_path / "cache").rglob("*twice*.nbc")
    content = bytearray(path.read_bytes())
    content[-20] ^= 1
    path.write_bytes(content)
    again = loaded(tmp_path)
    assert again.twice(2.0) == 4.0
    assert sum(again.twice.stats.cache_misses.values()) == 1
    assert capsys.readouterr().err == f"magmpm: compiled kernels on disk: {path}: damaged; what belongs there is compiled anew\n"
    assert kept_all()
    third = loaded(tmp_path)
    assert third.twice(2.0) == 4.0
    assert sum(third.twice.stats.cache_hits.values()) == 1


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
    for part in ("No space left on device", "every run waits", "free room, or set NUMBA_CACHE_DIR"):
        assert part in said
    assert not kept_all()


def test_neither_cache_nor_temporary_folder(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """magmpm can still be imported."""
    monkeypatch.setattr(Path, "mkdir", no_room)
    environment._cache_folder()
    assert "every run compiles its own" in capsys.readouterr().err
