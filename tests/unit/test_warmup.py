"""Kernels are taken as ready only where Numba will really load them."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from magmpm import warmup


def test_another_clone_and_touched_sources_are_not_ready(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same text elsewhere, or with other times, is compiled again by Numba; a marker that held would let this process compile it."""
    stamps = [warmup._stamp("kinds")]
    for clone in ("one", "two"):
        folder = tmp_path / clone
        folder.mkdir()
        (folder / "kernels.py").write_text("x = 1\n")
        os.utime(folder / "kernels.py", (1e9, 1e9))
        monkeypatch.setattr(warmup, "PACKAGE", folder)
        stamps.append(warmup._stamp("kinds"))
    os.utime(tmp_path / "two" / "kernels.py", (1e9, 2e9))
    stamps.append(warmup._stamp("kinds"))
    stamps.append(warmup._stamp("other kinds"))
    assert len(set(stamps)) == len(stamps)
    assert warmup._stamp("kinds") == warmup._stamp("kinds")
