"""magmpm doctor: its checks by name, broken libraries and folders, and the stored answers."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from magmpm.cli import doctor, main, self_test

ROOT = Path(__file__).resolve().parents[2]


def by_name(checks: list[doctor.Check]) -> dict[str, doctor.Check]:
    return {check.name: check for check in checks}


def test_all_that_is_looked_at(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Without what takes long: imports and OpenGL are replaced by their answers."""
    monkeypatch.setattr(doctor, "_tried", lambda arguments, patience: ('["pyvista", ""]', ""))
    assert main(["doctor", "--quick", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    names = {check["name"] for check in told["checks"]}
    assert {"Python", "library numba", "optional parts", "threads", "cache of kernels", "folder of results", "OpenGL"} <= names
    assert told["failed"] == 0
    assert all(check["remedy"] for check in told["checks"] if check["status"] == doctor.FAIL)


def test_a_library_that_is_missing_old_or_broken(monkeypatch: pytest.MonkeyPatch) -> None:
    needed = [doctor._Needed("numba", "0.61", ""), doctor._Needed("numpy", "2.0", ""), doctor._Needed("scipy", "1.14", "")]
    monkeypatch.setattr(doctor, "_needed", lambda: needed)
    monkeypatch.setattr(doctor, "_installed", {"numpy": "1.26.4", "scipy": "1.17.0"}.get)
    monkeypatch.setattr(doctor, "_tried", lambda arguments, patience: ("", "killed by signal 11: without a word"))
    found = by_name(list(doctor._libraries()))
    assert "missing" in found["library numba"].found
    assert "2.0 or newer" in found["library numpy"].found
    assert "signal 11" in found["library scipy"].found
    assert all(check.status == doctor.FAIL and "pip install" in check.remedy for check in found.values())


def test_optional_parts_are_one_list_without_a_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each with what it is for, and one command that a wheel's users can type; what is there but too old is a warning."""
    monkeypatch.setattr(doctor, "_installed", {"magmpm": "1", "magpylib": "6.1", "pyvista": "0.49"}.get)
    (told,) = doctor._extras()
    assert told.status == doctor.OK
    assert told.found.startswith("there: magnets; not there: render (pictures by PyVista, and movies), ")
    assert "postgresql (studies in PostgreSQL)" in told.found
    assert told.found.endswith("pip install 'magmpm[NAME]'")
    monkeypatch.setattr(doctor, "_installed", {"magmpm": "1", "pyvista": "0.1"}.get)
    assert [check.name for check in doctor._extras() if check.status == doctor.WARN] == ["extra render"]
    assert {needed.extra for needed in doctor._needed()} - {""} == set(doctor.EXTRAS_FOR)


def test_versions_compare_as_numbers() -> None:
    assert doctor._numbers("0.61") < doctor._numbers("0.101.0rc1")
    assert doctor._numbers("5.0") == doctor._numbers("5.0.0") == (5,)


def test_a_crash_and_a_hang_are_told() -> None:
    import sys

    assert "signal 6" in doctor._tried([sys.executable, "-c", "import os; os.abort()"], 30)[1]
    assert "no answer within" in doctor._tried([sys.executable, "-c", "import time; time.sleep(30)"], 0.5)[1]


def test_a_cache_that_takes_no_files(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "file" / "cache"))
    assert by_name(list(doctor._room()))["cache of kernels"].status == doctor.FAIL


def test_the_known_answer_is_that_of_the_reference() -> None:
    last = (ROOT / "data/references/axial_transverse_5mT.csv").read_text(encoding="utf-8").strip().splitlines()[-1]
    s, x, _, z = (float(cell) * 1e-3 for cell in last.split(","))
    assert (s, x, z) == pytest.approx((self_test.KNOWN_AT, *self_test.KNOWN))


def test_the_stored_equilibrium() -> None:
    """And that a wrong one would be seen."""
    row = self_test._stored()
    assert row["passed"], row
    assert not self_test._row("x", 1e-3, self_test.SOLVED, "", type("R", (), {"seconds": {"compile": 0, "setup": 0, "solve": 0}}))["passed"]
