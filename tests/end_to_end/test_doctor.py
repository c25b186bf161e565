"""magmpm doctor: its checks by name, broken libraries and folders, and the stored answers."""

import configparser
import json
import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from reference.commands import started
from reference.damage import cut_short, garbage
from test_commands import SCENE

from magmpm.cli import doctor, main, self_test
from magmpm.compiled.cache import _DIGEST
from magmpm.compiled.environment import refuse_unusable
from magmpm.errors import InputError

ROOT = Path(__file__).resolve().parents[2]
NEEDED = """Metadata-Version: 2.1
Name: magmpm
Version: 1
Requires-Dist: llvmlite>=0.8
Requires-Dist: nothing_here>=0.61
Requires-Dist: numpy>=99
Requires-Dist: deadly
Requires-Dist: hanging
Requires-Dist: llvmlite; extra == 'magnets'
Requires-Dist: nothing_here; extra == 'postgresql'
Requires-Dist: numpy>=99; extra == 'render'
"""


def test_all_that_is_looked_at(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """An installation with a library that is there, one missing, one too old, one that crashes, one that hangs; parts there, absent
    and too old; no place for the cache. Every failure has a remedy; versions compare as numbers."""
    for name, text in {
        "magmpm": NEEDED,
        **{name: f"Name: {name}\nVersion: 2\n" for name in ("deadly", "hanging")},
    }.items():
        (tmp_path / f"{name}-1.dist-info").mkdir()
        (tmp_path / f"{name}-1.dist-info/METADATA").write_text(text)
    (tmp_path / "deadly.py").write_text("import os; os.abort()")
    (tmp_path / "hanging.py").write_text("import time; time.sleep(60)")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "deadly.py/cache"))
    monkeypatch.setitem(doctor.PATIENCE, "import", 8.0)
    assert main(["doctor", "--json"]) == 1
    told = json.loads(capsys.readouterr().out)
    checks = {check["name"]: check for check in told["checks"]}
    failed = {
        name: check["found"] for name, check in checks.items() if check["status"] == doctor.FAIL
    }
    words = {
        "nothing_here": "missing",
        "numpy": "99 or newer",
        "deadly": "killed by signal 6",
        "hanging": "no answer within 8 s",
    }
    assert failed.keys() == {"cache of kernels", *(f"library {name}" for name in words)}
    assert all(word in failed[f"library {name}"] for name, word in words.items())
    assert all("pip install" in checks[f"library {name}"]["remedy"] for name in words)
    assert checks["cache of kernels"]["remedy"]
    assert told["failed"] == 5
    assert checks.keys() >= {
        "Python",
        "library llvmlite",
        "threads",
        "folder of results",
        "self-test",
    }
    assert [name for name, check in checks.items() if check["status"] == doctor.WARN] == [
        "extra render",
        "self-test",
    ]
    parts = checks["optional parts"]
    assert parts["status"] == doctor.OK
    assert parts["found"].startswith(
        "there: magnets, render; not installed: postgresql (studies in PostgreSQL); "
    )
    assert parts["found"].endswith("[NAME]'")


def test_every_optional_part_says_what_it_is_for() -> None:
    told = configparser.ConfigParser()
    told.read(ROOT / "setup.cfg", encoding="utf-8")
    assert set(told["options.extras_require"]) == {"all", *doctor.EXTRAS_FOR}


def test_the_known_answer_is_that_of_the_reference() -> None:
    last = (
        (ROOT / "data/references/axial_transverse_5mT.csv")
        .read_text(encoding="utf-8")
        .strip()
        .splitlines()[-1]
    )
    s, x, _, z = (float(cell) * 1e-3 for cell in last.split(","))
    assert (s, x, z) == pytest.approx((self_test.KNOWN_AT, *self_test.KNOWN))


def test_the_stored_equilibrium() -> None:
    """And that a wrong one would be seen."""
    found = self_test._run(2)
    row = self_test._row(
        "equilibrium", self_test._away(found.tip, self_test.EQUILIBRIUM), 1e-6, "", found
    )
    assert row["passed"], row
    assert not self_test._row(
        "x", 1e-3, 1e-6, "", type("R", (), {"seconds": {"compile": 0, "setup": 0, "solve": 0}})
    )["passed"]


# Damaged compiled kernels on disk, or a cache that cannot be written: a run continues, with a message, and gives the same result


def one_bit(path: Path) -> None:
    """One bit in the machine code of a data file: it still unpickles."""
    changed = bytearray(path.read_bytes())
    changed[_DIGEST + len(changed) // 2] ^= 1
    path.write_bytes(changed)


DAMAGED: dict[
    str, Callable[[Path], None]
] = {  # kernels of statics that compile in one or two seconds
    "kernels.frames_of": cut_short,
    "block_cholesky._solve": garbage,
    "block_cholesky._factor": one_bit,
}


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A scene of whose run nothing is on stderr but what is of the cache."""
    (tmp_path / "scene.yaml").write_text(SCENE + "advice: off\n")
    return tmp_path / "scene.yaml"


@pytest.mark.slow
def test_a_damaged_cache_is_compiled_anew(scene: Path, tmp_path: Path, told) -> None:
    """Several kernels, with several kinds of damage, in a copy of the cache."""
    good = json.loads(told("run", scene, "--json", "--out", tmp_path / "good").out)
    cache = tmp_path / "cache"
    shutil.copytree(os.environ["NUMBA_CACHE_DIR"], cache)
    damaged = [
        (part, path) for part in DAMAGED for path in cache.rglob(f"{part}-*.sealed*.nbc")
    ]  # other copies and precisions, too
    for part, path in damaged:
        DAMAGED[part](path)

    def run_again() -> tuple[str, str]:
        child = started(
            "run",
            scene,
            "--json",
            "--out",
            tmp_path / "bad",
            output=subprocess.PIPE,
            NUMBA_CACHE_DIR=str(cache),
        )
        out, err = child.communicate()
        assert child.returncode == 0, err
        return out, err

    out, err = run_again()
    assert {
        part for part, path in damaged if f"{path}: damaged; the kernel is compiled again\n" in err
    } == set(DAMAGED)
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
def test_unusable_settings_of_numba_are_refused_at_once(
    variable, value, rule, alone, scene, monkeypatch
) -> None:
    """Before Numba reads them, which would end with a traceback; alone: seen in a process of its own as well."""
    if alone:
        child = started(
            "run", scene, "--out", scene.parent / "out", output=subprocess.PIPE, **{variable: value}
        )
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
