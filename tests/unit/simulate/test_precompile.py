"""Kernels count as ready only if Numba will actually load them."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from reference.scenes import rod_scene

from magmpm.solving import precompile as warmup


def test_another_clone_and_touched_sources_are_not_ready(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Numba compiles the same text again at another place or with other times; a valid marker would let this process compile it."""
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


@pytest.fixture
def empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(warmup, "_ready", set())
    return tmp_path


def test_who_waits_is_told_what_is_compiled_and_that_it_is_once(empty_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lines: list[str] = []
    monkeypatch.setattr(warmup, "_compiled_elsewhere", lambda *_: True)
    scene = rod_scene(field=(0.0, 0.0, 5e-3), gravity=(0.0, 0.0, -9.81))
    assert warmup.fill_cache(scene, lines.append)
    assert "statics with gravity + magnetic_torque" in lines[0] or "statics with magnetic_torque + gravity" in lines[0]
    assert "once on this machine" in lines[0]
    assert not warmup.fill_cache(scene, lines.append), "a second time there is nothing to do"
    assert len(lines) == 2


def test_only_what_is_used_is_compiled(empty_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A plain run asks for no kernels of derivatives; who asks for them later waits for these alone."""
    asked: list[list[str]] = []
    lines: list[str] = []
    monkeypatch.setattr(warmup, "_compiled_elsewhere", lambda small, uses, tell: asked.append(list(uses)) or True)
    scene = rod_scene(field=(0.0, 0.0, 5e-3))
    for uses in ([warmup.SOLVE], [warmup.SOLVE, warmup.DERIVATIVES], [warmup.SOLVE, warmup.DERIVATIVES, warmup.RODS]):
        warmup.fill_cache(scene, lines.append, uses)
    assert asked == [["solve"], ["sensitivities"], ["rods"]]
    assert "compiling kernels for sensitivities; once on this machine" in lines[2]
    assert not warmup.fill_cache(rod_scene(gravity=(0.0, 0.0, -9.81)), lines.append, [warmup.RODS]), "the same rods for any effects"


def test_one_process_compiles_and_others_wait_for_it(empty_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two processes need the same kernels: one compiles them, the other finds them ready."""
    begun, go_on = threading.Event(), threading.Event()

    def slow(*_: object) -> bool:
        begun.set()
        return go_on.wait(60)

    monkeypatch.setattr(warmup, "_compiled_elsewhere", slow)
    scene, lines, found = rod_scene(field=(0.0, 0.0, 5e-3)), list[str](), list[bool]()
    one = threading.Thread(target=lambda: found.append(warmup.fill_cache(scene, lambda _: None)))
    one.start()
    assert begun.wait(60)
    other = threading.Thread(target=lambda: found.append(warmup.fill_cache(scene, lines.append)))
    other.start()
    while not lines and other.is_alive():
        time.sleep(0.01)
    go_on.set()
    one.join()
    other.join()
    assert lines == ["another magmpm is compiling kernels; waiting for it"]
    assert sorted(found) == [False, True]


def test_nothing_is_compiled_where_a_compiling_process_fails(empty_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A cache that could not be filled is not marked as filled."""
    monkeypatch.setattr(warmup, "_compiled_elsewhere", lambda *_: False)
    assert warmup.fill_cache(rod_scene(), lambda _: None)
    assert warmup.fill_cache(rod_scene(), lambda _: None), "it is tried again"


def test_without_room_on_the_disk_nothing_is_compiled_ahead(empty_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The kernels could not be stored: each run compiles its own, once instead of twice."""
    lines: list[str] = []
    monkeypatch.setattr(warmup, "_compiled_elsewhere", lambda *_: pytest.fail("compiled"))
    monkeypatch.setattr("magmpm.solving.precompile.ROOM", 1e30)
    assert warmup.fill_cache(rod_scene(), lines.append)
    (line,) = lines
    assert str(empty_cache) in line
    assert "no room" in line


RUN = """
import gc, sys
from numba.core.dispatcher import Dispatcher
from magmpm.scene import load_scene
from magmpm.simulate import run, sensitivities
scene = load_scene(sys.argv[1])
if sys.argv[3:]:
    derivatives = sensitivities(scene)
    derivatives.adjoint(derivatives.centreline[:, :, 0])
else:
    run(scene, folder=sys.argv[2])
found = [d for d in gc.get_objects() if isinstance(d, Dispatcher) and str(d.py_func.__module__).startswith("magmpm")]
assert any(d.stats.cache_hits for d in found), "kernels were loaded"
print(*sorted({d.py_func.__qualname__ for d in found if d.stats.cache_misses}))
"""


@pytest.mark.parametrize(
    ("solver", "more"),
    [
        ("static: {}", []),
        pytest.param("static: {}", ["derivatives"], marks=pytest.mark.slow),
        ("dynamic: {duration: 0.1 ms}", []),
    ],
)
def test_a_run_compiles_nothing_itself(solver: str, more: list[str], tmp_path: Path) -> None:
    """Every kernel of a run or of sensitivities, also those for frames, is compiled before the clock starts, and then loaded."""
    scene = tmp_path / "scene.yaml"
    text = (Path(__file__).parents[3] / "data/scenes/five_segments.yaml").read_text(encoding="utf-8")
    scene.write_text(text.replace("static: {}", solver).replace("cells_across: 4", "cells_across: 2"), encoding="utf-8")
    command = [sys.executable, "-c", RUN, str(scene), str(tmp_path / "out"), *more]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.strip()) == (0, ""), done.stderr
