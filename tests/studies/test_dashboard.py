"""optuna-dashboard shows every trial's numbers and picture."""

import json
import re
import socket
from collections.abc import Iterator
from pathlib import Path

import optuna
import pytest
from dashboard_client import Dashboard, dashboard
from interruptible import draw
from rod_solve import solve, write_study

from magmpm.studies.engine.loop import run_study
from magmpm.studies.search.definition import load_study
from magmpm.studies.search.samplers.optuna_ids import set_constraints

pytest.importorskip("optuna_dashboard", reason="an extra: pip install -e '.[dashboard]'")


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a study of four trials, each with its picture."""
    folder = tmp_path_factory.mktemp("study")
    run_study(
        load_study(write_study(folder)), solve=solve, picture=draw, out=folder / "out", trials=4
    )
    return folder / "out"


@pytest.fixture(scope="module")
def served(out: Path) -> Iterator[Dashboard]:
    """`magmpm dashboard` on that folder, at a free port of this machine."""
    with dashboard(out) as running:
        yield running


def test_pictures_are_listed_and_can_be_downloaded(served: Dashboard, out: Path) -> None:
    assert served.ask("/api/meta")["artifact_is_available"] is True
    (study,) = served.ask("/api/studies")["study_summaries"]
    assert study["study_name"] == "probe"
    detail = served.ask(f"/api/studies/{study['study_id']}?after=0")
    assert len(detail["trials"]) == 4
    for trial in detail["trials"]:
        (artifact,) = trial["artifacts"]
        assert artifact["filename"] == f"trial_{trial['number']:03d}.png"
        assert artifact["mimetype"] == "image/png"
        content = served.get(
            f"/artifacts/{study['study_id']}/{trial['trial_id']}/{artifact['artifact_id']}"
        )
        assert content == (out / "pictures" / artifact["filename"]).read_bytes()


def test_numbers_are_shown(served: Dashboard) -> None:
    (study,) = served.ask("/api/studies")["study_summaries"]
    detail = served.ask(f"/api/studies/{study['study_id']}?after=0")
    assert detail["objective_names"] == ["rms (mm)"]
    for trial in detail["trials"]:
        (stored,) = (float(a["value"]) for a in trial["user_attrs"] if a["key"] == "rms_m")
        assert trial["values"][0] == pytest.approx(1e3 * stored, rel=1e-12)
    names = {attribute["key"] for attribute in detail["trials"][0]["user_attrs"]}
    assert {
        "rms_m",
        "tip_error_m",
        "min_det_F",
        "max_det_F",
        "newton_steps",
        "feasible",
        "seconds",
    } <= names
    assert len(detail["trials"][0]["params"]) == 10


def test_the_best_trial_is_a_feasible_one(tmp_path: Path) -> None:
    """Where one is, in either direction, whoever asks the storage; of constraints as they are stored now, and were."""
    from magmpm.studies.dashboard.view import FeasibleFirst

    for direction, best in (("minimize", 2), ("maximize", 1)):
        storage = FeasibleFirst(f"sqlite:///{tmp_path}/{direction}.db")
        study = optuna.create_study(storage=storage, direction=direction)
        with pytest.raises(ValueError, match="complete"):
            storage.get_best_trial(1)
        for value, beyond in ((1.0, 0.5), (3.0, 0.0), (2.0, -0.5), (4.0, 0.1)):
            trial = study.ask()
            if value < 3.0:
                set_constraints(trial, [beyond, -1.0])
            else:
                trial.set_constraint("as before", beyond)
            study.tell(trial, value)
            if beyond == 0.5:
                assert storage.get_best_trial(1).number == 0
        assert storage.get_best_trial(1).number == best == study.best_trial.number


def test_the_page_tells_what_was_refused(served: Dashboard) -> None:
    """Two chips (list and details) and the table's column; the rest of the dashboard's script is as it was."""
    import optuna_dashboard

    from magmpm.studies.dashboard.page import CHIP, COLUMN, NARROW, READ_ONLY, SCRIPT, STYLED

    script = (Path(optuna_dashboard.__file__).parent / "public/bundle.js").read_text(
        encoding="utf-8"
    )
    assert len(CHIP.findall(script)) == 2
    assert len(COLUMN.findall(script)) == 1
    told = served.get(SCRIPT).decode()
    assert told.count('?"Infeasible":') == 3
    chip = r'"Complete"===(\w+)\.state&&\1\.constraints\.some\(c=>c>0\)\?"(?:warning|Infeasible)":'
    for pattern in (r"cell:e=>\(t=>.*?\)\(e\.row\.original\),", chip):
        told = re.sub(pattern, "", told)
    assert told == STYLED % (READ_ONLY + NARROW) + script


def test_a_port_in_use_is_refused(out: Path, told) -> None:
    """No address is announced."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        says = f"--port: received {port}\n  rule: the port must be free", "\n  remedy: "
        assert "shows" not in told("dashboard", out, "--port", port, status=2, says=says).err


def test_a_study_without_its_database_is_refused(out: Path, tmp_path: Path, told) -> None:
    """Otherwise an empty study would be shown, and an empty database created."""
    report = json.loads((out / "study.json").read_text())
    report["storage"] = f"sqlite:///{tmp_path}/gone.db"
    (tmp_path / "study.json").write_text(json.dumps(report))
    told("dashboard", tmp_path, status=2, says="gone.db is missing")
    assert not (tmp_path / "gone.db").exists()
    (tmp_path / "study.json").write_text("null")
    told("dashboard", tmp_path, status=2, says=f"{tmp_path}/study.json: can't be read")


STUDIES = "/api/studies"


@pytest.mark.parametrize(
    ("headers", "words"),
    [
        ({"Host": "evil.example"}, "name"),
        ({"Host": "evil.example:8080"}, "name"),
        ({"Host": "127.0.0.1.evil.example"}, "name"),
        ({"Origin": "http://evil.example"}, "page"),
        ({"Origin": "null"}, "page"),
        ({"Origin": "http://127.0.0.1:1"}, "page"),
        ({"Cookie": ""}, "whole address"),
        ({"Cookie": "magmpm-{port}=wrong"}, "whole address"),
    ],
)
@pytest.mark.parametrize("method", ["GET", "DELETE"])
def test_only_its_own_page_is_answered(
    served: Dashboard, method: str, headers: dict[str, str], words: str
) -> None:
    """Another name that leads here (DNS rebinding), another page, another user of this machine."""
    asked = {name: value.format(port=served.port) for name, value in headers.items()}
    status, told, content = served.request(method, STUDIES, **{"Cookie": served.cookie, **asked})
    assert status == 403
    assert words in content.decode()
    assert b"probe" not in content
    assert told["x-content-type-options"] == "nosniff"


@pytest.mark.parametrize(
    ("method", "path"),
    [
        ("DELETE", "/api/studies/1"),
        ("POST", "/api/studies/1/rename"),
        ("PUT", "/api/studies/1/note"),
        ("POST", "/api/trials/1/tell"),
        ("DELETE", "/api/artifacts/1/1/0"),
        ("POST", "/api/studies"),
        ("PATCH", "/api/studies/1"),
        ("OPTIONS", "/api/studies/1"),
    ],
)
def test_nothing_is_edited_unless_asked_for(served: Dashboard, method: str, path: str) -> None:
    """Not even by who has the secret."""
    status, _, content = served.request(method, path, "{}", Cookie=served.cookie)
    assert status == 403
    assert b"--write" in content
    assert len(served.ask(STUDIES)["study_summaries"]) == 1


def test_the_printed_address_opens_the_study(served: Dashboard) -> None:
    """It gives the secret to the browser, which no script reads and no other site makes it send."""
    status, headers, _ = served.request("GET", served.url.removeprefix(served.address))
    assert status == 303
    assert headers["location"].startswith("/dashboard/studies/")
    paths = [
        line.removeprefix(f"{served.cookie}; HttpOnly; SameSite=Strict; Path=")
        for line in headers["set-cookie"].split(", ")
    ]
    assert paths == [
        "/api",
        "/artifacts",
        "/csv",
        "/dashboard",
    ], "not /, which other servers of this machine have"
    without = {
        path: served.request("GET", path)[0]
        for path in (STUDIES, "/artifacts/1", "/csv/1", "/dashboard", "/", "/static/bundle.js")
    }
    assert {path: status for path, status in without.items() if status != 403} == {
        "/": 302,
        "/static/bundle.js": 200,
    }, "they show no study"
    status, page, _ = served.request("GET", headers["location"], Cookie=served.cookie)
    assert status == 200
    assert page["x-content-type-options"] == "nosniff"
    assert "script-src 'self'" in page["content-security-policy"]
    assert "frame-ancestors 'none'" in page["content-security-policy"]
    assert served.request("GET", STUDIES, Cookie=served.cookie)[1][
        "content-security-policy"
    ].startswith("sandbox; default-src 'none'")


def test_with_write_a_study_can_be_deleted(tmp_path: Path) -> None:
    """By its own page alone."""
    run_study(load_study(write_study(tmp_path)), solve=solve, out=tmp_path / "out", trials=1)
    with dashboard(tmp_path / "out", "--write") as served:
        evil = served.request(
            "DELETE", "/api/studies/1", Cookie=served.cookie, Origin="http://evil.example"
        )
        assert evil[0] == 403
        assert (
            served.request("DELETE", "/api/studies/1", Origin=served.address)[0] == 403
        )  # no secret
        assert len(served.ask(STUDIES)["study_summaries"]) == 1
        assert (
            served.request("DELETE", "/api/studies/1", Cookie=served.cookie, Origin=served.address)[
                0
            ]
            == 204
        )
        assert served.ask(STUDIES)["study_summaries"] == []
