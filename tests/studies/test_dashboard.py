"""optuna-dashboard shows every trial's numbers and picture."""

from __future__ import annotations

import json
import re
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from interruptible import draw
from rod_solve import solve, write_study

from magmpm.cli import main
from magmpm.studies.definition import load_study
from magmpm.studies.engine import run_study

pytest.importorskip("optuna_dashboard", reason="an extra: pip install -e '.[dashboard]'")

SERVE = "import sys; from magmpm.cli import main; sys.exit(main(sys.argv[1:]))"


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a study of four trials, each with its picture."""
    folder = tmp_path_factory.mktemp("study")
    run_study(load_study(write_study(folder)), solve=solve, picture=draw, out=folder / "out", trials=4)
    return folder / "out"


@pytest.fixture(scope="module")
def address(out: Path) -> Iterator[str]:
    """`magmpm dashboard` on that folder, at a free port of this machine."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    command = [sys.executable, "-c", SERVE, "dashboard", str(out), "--port", str(port)]
    child = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        assert child.stderr is not None
        assert child.stderr.readline() == f"http://127.0.0.1:{port} shows {out}; Ctrl-C ends it\n"
        urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=60).close()  # immediately: the message comes when the server is ready
        until = time.monotonic() + 60
        while True:
            assert child.poll() is None, "the server ended"
            assert time.monotonic() < until, "the server never answered"
            try:
                urllib.request.urlopen(f"http://127.0.0.1:{port}/api/studies", timeout=5).close()
                break
            except OSError:
                time.sleep(0.1)
        yield f"http://127.0.0.1:{port}"
    finally:
        child.kill()
        child.wait()


def get(url: str) -> bytes:
    with urllib.request.urlopen(url, timeout=30) as answer:
        return bytes(answer.read())


def ask(url: str) -> Any:
    return json.loads(get(url))


def test_pictures_are_listed_and_can_be_downloaded(address: str, out: Path) -> None:
    assert ask(f"{address}/api/meta")["artifact_is_available"] is True
    (study,) = ask(f"{address}/api/studies")["study_summaries"]
    assert study["study_name"] == "probe"
    detail = ask(f"{address}/api/studies/{study['study_id']}?after=0")
    assert len(detail["trials"]) == 4
    for trial in detail["trials"]:
        (artifact,) = trial["artifacts"]
        assert artifact["filename"] == f"trial_{trial['number']:03d}.png"
        assert artifact["mimetype"] == "image/png"
        content = get(
            f"{address}/artifacts/{study['study_id']}/{trial['trial_id']}/{artifact['artifact_id']}"
        )
        assert content == (out / "pictures" / artifact["filename"]).read_bytes()


def test_numbers_are_shown(address: str) -> None:
    (study,) = ask(f"{address}/api/studies")["study_summaries"]
    detail = ask(f"{address}/api/studies/{study['study_id']}?after=0")
    assert detail["objective_names"] == ["rms (mm)"]
    for trial in detail["trials"]:  # the database stays in SI
        (stored,) = (float(a["value"]) for a in trial["user_attrs"] if a["key"] == "rms_m")
        assert trial["values"][0] == pytest.approx(1e3 * stored, rel=1e-12)
    names = {attribute["key"] for attribute in detail["trials"][0]["user_attrs"]}
    assert {"rms_m", "tip_error_m", "min_det_F", "max_det_F", "newton_steps", "feasible", "seconds"} <= names
    assert len(detail["trials"][0]["params"]) == 10


def test_the_page_tells_what_was_refused(address: str) -> None:
    """Two chips (list and details) and the table's column; the rest of the dashboard's script is as it was."""
    import optuna_dashboard

    from magmpm.studies.dashboard_page import CHIP, COLUMN, SCRIPT

    script = (Path(optuna_dashboard.__file__).parent / "public/bundle.js").read_text(encoding="utf-8")
    assert len(CHIP.findall(script)) == 2
    assert len(COLUMN.findall(script)) == 1
    told = get(address + SCRIPT).decode()
    assert told.count('?"Infeasible":') == 3
    chip = r'"Complete"===(\w+)\.state&&\1\.constraints\.some\(c=>c>0\)\?"(?:warning|Infeasible)":'
    for pattern in (r"cell:e=>\(t=>.*?\)\(e\.row\.original\),", chip):
        told = re.sub(pattern, "", told)
    assert told == script


def test_a_port_in_use_is_refused(out: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """No address is announced."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert main(["dashboard", str(out), "--port", str(port)]) == 2
    said = capsys.readouterr().err
    assert f"--port: received {port}\n  rule: the port must be free" in said
    assert "\n  remedy: " in said
    assert "shows" not in said


def test_a_study_without_its_database_is_refused(out: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Otherwise an empty study would be shown, and an empty database created."""
    report = json.loads((out / "study.json").read_text())
    report["storage"] = f"sqlite:///{tmp_path}/gone.db"
    (tmp_path / "study.json").write_text(json.dumps(report))
    assert main(["dashboard", str(tmp_path)]) == 2
    assert "gone.db is missing" in capsys.readouterr().err
    assert not (tmp_path / "gone.db").exists()
    (tmp_path / "study.json").write_text("null")
    assert main(["dashboard", str(tmp_path)]) == 2
    assert f"{tmp_path}/study.json: can't be read" in capsys.readouterr().err
