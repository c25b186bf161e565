"""Damaged compiled kernels on disk, or a cache that cannot be written: a run continues, with a message, and gives the same result."""

import json
import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from reference.commands import started
from reference.damage import cut_short, garbage
from test_commands import SCENE

from magmpm.compiled.cache import _DIGEST
from magmpm.compiled.environment import refuse_unusable
from magmpm.errors import InputError


def one_bit(path: Path) -> None:
    """One bit in the machine code of a data file: it still unpickles."""
    changed = bytearray(path.read_bytes())
    changed[_DIGEST + len(changed) // 2] ^= 1
    path.write_bytes(changed)


DAMAGED: list[tuple[str, str, Callable[[Path], None]]] = [  # kernels of statics that compile in one or two seconds
    ("kernels.frames_of", ".nbi", cut_short),
    ("block_cholesky._solve", ".nbi", garbage),
    ("block_cholesky._factor", ".nbc", one_bit),
]


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A scene of whose run nothing is on stderr but what is of the cache."""
    (tmp_path / "scene.yaml").write_text(SCENE + "advice: off\n")
    return tmp_path / "scene.yaml"


def test_a_damaged_cache_is_compiled_anew(scene: Path, tmp_path: Path, told: Callable[..., Any]) -> None:
    """Index (.nbi) and data (.nbc) of several kernels, with several kinds of damage, in a copy of the cache."""
    good = json.loads(told("run", scene, "--json", "--out", tmp_path / "good").out)
    cache = tmp_path / "cache"
    shutil.copytree(os.environ["NUMBA_CACHE_DIR"], cache)
    damaged = [path for part, ending, _ in DAMAGED for path in cache.rglob(f"{part}-*.sealed*{ending}")]  # other copies and precisions, too
    for path in damaged:
        damage = next(damage for part, ending, damage in DAMAGED if path.name.startswith(part) and path.name.endswith(ending))
        damage(path)

    def run_again() -> tuple[str, str]:
        child = started("run", scene, "--json", "--out", tmp_path / "bad", output=subprocess.PIPE, NUMBA_CACHE_DIR=str(cache))
        out, err = child.communicate()
        assert child.returncode == 0, err
        return out, err

    out, err = run_again()
    said = [path for path in damaged if f"{path}: damaged; what belongs there is compiled anew\n" in err]
    for part, ending, _ in DAMAGED:
        assert any(path.name.startswith(part) and path.name.endswith(ending) for path in said), part
    assert json.loads(out)["tip"] == good["tip"]
    assert run_again()[1] == "", "what was damaged has been replaced"


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
def test_unusable_settings_of_numba_are_refused_at_once(variable, value, rule, alone, scene, monkeypatch) -> None:
    """Before Numba reads them, which would end with a traceback; alone: seen in a process of its own as well."""
    if alone:
        child = started("run", scene, "--out", scene.parent / "out", output=subprocess.PIPE, **{variable: value})
        out, err = child.communicate()
        assert (child.returncode, out) == (2, "")
        said = err.removeprefix("magmpm: ")
    else:
        monkeypatch.setenv(variable, value)
        with pytest.raises(InputError) as refused:
            refuse_unusable()
        said = str(refused.value)
    assert said.startswith(f"{variable}: received {value}\n  rule: {rule}")
    assert "\n  remedy: " in said
    assert "Traceback" not in said
