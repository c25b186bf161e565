"""Damaged compiled kernels on disk, or a cache that cannot be written: a run continues, with a message, and gives the same result."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from test_commands import SCENE

from magmpm.cli import main
from magmpm.compiled.cache import _DIGEST
from magmpm.compiled.environment import refuse_unusable
from magmpm.errors import InputError

ROOT = Path(__file__).parents[2]


def command(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    paths = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    code = "import sys; from magmpm.cli import main; sys.exit(main(sys.argv[1:]))"
    return subprocess.run(
        [sys.executable, "-c", code, *arguments], env={**os.environ, "PYTHONPATH": paths, **environment},
        capture_output=True, text=True, check=False,
    )  # fmt: skip


def truncated(content: bytes) -> bytes:
    return content[: len(content) // 2]


def garbage(content: bytes) -> bytes:
    return np.random.default_rng(1).bytes(len(content))


def one_bit(content: bytes) -> bytes:
    """One bit in the machine code of a data file: it still unpickles."""
    changed = bytearray(content)
    changed[_DIGEST + len(content) // 2] ^= 1
    return bytes(changed)


DAMAGED: list[tuple[str, str, Callable[[bytes], bytes]]] = [  # kernels of statics that compile in one or two seconds
    ("kernels.frames_of", ".nbi", truncated),
    ("block_cholesky._solve", ".nbi", garbage),
    ("block_cholesky._factor", ".nbc", one_bit),
]


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A scene of whose run nothing is on stderr but what is of the cache."""
    (tmp_path / "scene.yaml").write_text(SCENE + "advice: off\n")
    return tmp_path / "scene.yaml"


def test_a_damaged_cache_is_compiled_anew(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Index (.nbi) and data (.nbc) of several kernels, with several kinds of damage, in a copy of the cache."""
    assert main(["run", str(scene), "--json", "--out", str(tmp_path / "good")]) == 0
    good = json.loads(capsys.readouterr().out)
    cache = tmp_path / "cache"
    shutil.copytree(os.environ["NUMBA_CACHE_DIR"], cache)
    damaged = [path for part, ending, _ in DAMAGED for path in cache.rglob(f"{part}-*.sealed*{ending}")]  # other copies and precisions, too
    for path in damaged:
        damage = next(damage for part, ending, damage in DAMAGED if path.name.startswith(part) and path.name.endswith(ending))
        path.write_bytes(damage(path.read_bytes()))
    done = command("run", str(scene), "--json", "--out", str(tmp_path / "bad"), NUMBA_CACHE_DIR=str(cache))
    assert done.returncode == 0, done.stderr
    said = [path for path in damaged if f"{path}: damaged; what belongs there is compiled anew\n" in done.stderr]
    for part, ending, _ in DAMAGED:
        assert any(path.name.startswith(part) and path.name.endswith(ending) for path in said), part
    assert json.loads(done.stdout)["tip"] == good["tip"]
    again = command("run", str(scene), "--json", "--out", str(tmp_path / "bad"), NUMBA_CACHE_DIR=str(cache))
    assert (again.returncode, again.stderr) == (0, ""), "what was damaged has been replaced"


@pytest.mark.parametrize(
    ("variable", "value", "rule", "alone"),
    [
        ("NUMBA_DISABLE_JIT", "1", "", True),
        ("NUMBA_NUM_THREADS", "0", "must be a whole number from 1 to ", False),
        ("NUMBA_NUM_THREADS", "two", "must be a whole number from 1 to ", False),
        ("NUMBA_NUM_THREADS", "1" + 9 * "0", "must be a whole number from 1 to ", False),
        ("NUMBA_THREADING_LAYER", "foo", "must be one of default, ", False),
    ],
)
def test_unusable_settings_of_numba_are_refused_at_once(
    variable: str, value: str, rule: str, alone: bool, scene: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before Numba reads them, which would end with a traceback; alone: seen in a process of its own as well."""
    if alone:
        done = command("run", str(scene), "--out", str(scene.parent / "out"), **{variable: value})
        assert (done.returncode, done.stdout) == (2, "")
        said = done.stderr.removeprefix("magmpm: ")
    else:
        monkeypatch.setenv(variable, value)
        with pytest.raises(InputError) as refused:
            refuse_unusable()
        said = str(refused.value)
    assert said.startswith(f"{variable}: received {value}\n  rule: {rule}")
    assert "\n  remedy: " in said
    assert "Traceback" not in said
