"""`magmpm dashboard`: optuna-dashboard on a study."""

import argparse
import os
import sys
from pathlib import Path
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer, make_server

from magmpm.cli.answers import is_study
from magmpm.cli.design import saved_report
from magmpm.cli.goals import saved_goal
from magmpm.errors import InputError, require
from magmpm.inputs.page_guard import LOOPBACK, Guard, GuardedHandler, GuardedServer
from magmpm.results.folder_lock import refuse_links


class _Server(GuardedServer, WSGIServer):
    """Serves pictures while numbers are requested."""


class _DashboardHandler(GuardedHandler, WSGIRequestHandler):
    """A request to the dashboard."""

    server: _Server  # type: ignore[assignment]


def _url(saved: str, option: str | None) -> str:
    """The storage of a study. Raises InputError where its password is not known."""
    from magmpm.studies.engine.storage_url import VARIABLE, known_url

    url = known_url(saved, option, os.environ)
    if url is None:
        raise InputError(
            f"storage {saved}",
            rule="the password is not stored",
            remedy=f"put the whole URL into the environment variable {VARIABLE}",
        )
    return url


def command(options: argparse.Namespace) -> int:
    """optuna-dashboard on a study's database and pictures, until it is stopped. Returns the exit status. Raises InputError."""
    from magmpm.studies.problem import REPORT

    folder = Path(options.folder)
    port = options.port
    if not is_study(folder):
        raise InputError(
            f"{folder}: holds no study ({REPORT} is missing); give the folder of a study, such as"
            " runs/s_shape"
        )
    if not 0 < port < 65536:
        raise InputError(f"--port: received {port}; must be between 1 and 65535")
    require("optuna_dashboard", "dashboard", key="dashboard", use="its pages")
    import optuna  # what reads trials and serves them, after the checks
    from optuna_dashboard import wsgi

    from magmpm.studies.dashboard.goal_notes import GoalNotes
    from magmpm.studies.dashboard.page import guarded, page
    from magmpm.studies.dashboard.view import FeasibleFirst, Notes
    from magmpm.studies.engine.records import artifact_store
    from magmpm.studies.engine.storage import must_exist, open_storage
    from magmpm.studies.engine.storage_url import shown_url
    from magmpm.studies.search.samplers.optuna_ids import study_id

    refuse_links(folder)
    goal = saved_goal(folder)
    saved = saved_report(folder) if goal is None else goal
    url = _url(saved["storage"], options.storage)
    must_exist(url, folder)
    storage = open_storage(url, kind=FeasibleFirst)
    artifacts = artifact_store(saved.get("artifacts"), folder)
    try:
        study = optuna.load_study(study_name=saved["name"], storage=storage)
    except KeyError:
        raise InputError(
            f"storage {shown_url(url)}",
            rule=f"must hold the study {saved['name']}",
            remedy="name its database with --storage",
        ) from None
    notes = Notes if goal is None else GoalNotes
    notes(study, folder, artifacts).keep_up()
    guard = Guard()
    start = f"/dashboard/studies/{study_id(study)}"
    app = guarded(
        page(wsgi(storage, artifact_store=artifacts), options.write),
        guard,
        start,
        options.write,
    )
    try:
        server = make_server(LOOPBACK, port, app, _Server, _DashboardHandler)
    except OSError as error:
        rule = f"the port must be free on this machine, and allowed to this user ({error.strerror})"
        raise InputError(
            "--port",
            received=str(port),
            rule=rule,
            remedy="stop the program that uses it, or choose another, such as --port "
            f"{port + 1 if port < 65535 else 8080}",
        ) from None
    with server:
        print(
            f"http://{LOOPBACK}:{port}{start}?secret={guard.secret} shows {folder}; Ctrl-C ends it",
            file=sys.stderr,
            flush=True,
        )
        server.serve_forever()
    return 0
