"""magmpm doctor: its checks by name, broken libraries and folders, and the stored answers."""

import configparser
import json
from pathlib import Path

import pytest

from magmpm.cli import doctor, main, self_test

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


def test_all_that_is_looked_at(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """An installation with a library that is there, one missing, one too old, one that crashes, one that hangs; parts there, absent
    and too old; no place for the cache. Every failure has a remedy; versions compare as numbers."""
    for name, text in {"magmpm": NEEDED, **{name: f"Name: {name}\nVersion: 2\n" for name in ("deadly", "hanging")}}.items():
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
    failed = {name: check["found"] for name, check in checks.items() if check["status"] == doctor.FAIL}
    words = {"nothing_here": "missing", "numpy": "99 or newer", "deadly": "killed by signal 6", "hanging": "no answer within 8 s"}
    assert failed.keys() == {"cache of kernels", *(f"library {name}" for name in words)}
    assert all(word in failed[f"library {name}"] for name, word in words.items())
    assert all("pip install" in checks[f"library {name}"]["remedy"] for name in words)
    assert checks["cache of kernels"]["remedy"]
    assert told["failed"] == 5
    assert checks.keys() >= {"Python", "library llvmlite", "threads", "folder of results", "self-test"}
    assert [name for name, check in checks.items() if check["status"] == doctor.WARN] == ["extra render", "self-test"]
    parts = checks["optional parts"]
    assert parts["status"] == doctor.OK
    assert parts["found"].startswith("there: magnets, render; not there: postgresql (studies in PostgreSQL); ")
    assert parts["found"].endswith("pip install 'magmpm[NAME]'")


def test_every_optional_part_says_what_it_is_for() -> None:
    told = configparser.ConfigParser()
    told.read(ROOT / "setup.cfg", encoding="utf-8")
    assert set(told["options.extras_require"]) == set(doctor.EXTRAS_FOR)


def test_the_known_answer_is_that_of_the_reference() -> None:
    last = (ROOT / "data/references/axial_transverse_5mT.csv").read_text(encoding="utf-8").strip().splitlines()[-1]
    s, x, _, z = (float(cell) * 1e-3 for cell in last.split(","))
    assert (s, x, z) == pytest.approx((self_test.KNOWN_AT, *self_test.KNOWN))


def test_the_stored_equilibrium() -> None:
    """And that a wrong one would be seen."""
    found = self_test._run(2)
    row = self_test._row("equilibrium", self_test._away(found.tip, self_test.EQUILIBRIUM), 1e-6, "", found)
    assert row["passed"], row
    assert not self_test._row("x", 1e-3, 1e-6, "", type("R", (), {"seconds": {"compile": 0, "setup": 0, "solve": 0}}))["passed"]
