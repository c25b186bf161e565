"""The dashboard's page, which calls a trial that was solved and refused "Infeasible": dashboard 0.21 says "Complete" of it, in grey plots.

The page is one script. It is passed on with the places replaced that print a trial's state; a script of another version, in which they
are not found, is passed on as it is (tests/studies/test_dashboard.py tells).
"""

from __future__ import annotations

import gzip
import re
from collections.abc import Callable, Iterable
from typing import Any

SCRIPT = "/static/bundle.js"
REFUSED = r'"Complete"===\g<trial>.state&&\g<trial>.constraints.some(c=>c>0)'
# the chip of a trial, in the list and above its details: its color and its label
CHIP = re.compile(r"color:(?P<color>[\w$]+)\((?P<trial>[\w$]+)\.state\),label:(?P=trial)\.state(?=[,}])")
NEW_CHIP = rf'color:{REFUSED}?"warning":\g<color>(\g<trial>.state),label:{REFUSED}?"Infeasible":\g<trial>.state'
# the column of the table
COLUMN = re.compile(r'\("state",\{header:"State",')
OF_ROW = '(t=>"Complete"===t.state&&t.constraints.some(c=>c>0)?"Infeasible":t.state)(e.row.original)'
NEW_COLUMN = rf'("state",{{header:"State",cell:e=>{OF_ROW},'

Application = Callable[[dict[str, Any], Callable[..., Any]], Iterable[bytes]]


def telling_states(script: str) -> str:
    """The dashboard's script, with the states of refused trials."""
    return COLUMN.sub(NEW_COLUMN, CHIP.sub(NEW_CHIP, script))


def page(app: Application) -> Application:
    """The dashboard, a WSGI application, with that script."""
    made: list[bytes] = []  # from the first request on

    def serve(environ: dict[str, Any], start: Callable[..., Any]) -> Iterable[bytes]:
        if environ.get("PATH_INFO") != SCRIPT or environ.get("REQUEST_METHOD") != "GET":
            return app(environ, start)
        if not made:
            body = _whole(app, environ)
            if body is None:
                return app(environ, start)
            made.append(telling_states(body).encode())
        headers = [("Content-Type", "text/javascript; charset=utf-8"), ("Content-Length", str(len(made[0])))]
        start("200 OK", [*headers, ("Cache-Control", "no-store")])  # another dashboard at this address has another script
        return made

    return serve


def _whole(app: Application, environ: dict[str, Any]) -> str | None:
    """What the application serves for a request, or None where that isn't a text."""
    told: list[Any] = []
    conditions = ("HTTP_IF_MODIFIED_SINCE", "HTTP_IF_NONE_MATCH", "HTTP_RANGE")
    asked = {name: value for name, value in environ.items() if name not in conditions}
    chunks = app({**asked, "HTTP_ACCEPT_ENCODING": "identity"}, lambda status, headers, *_: told.append((status, dict(headers))))
    try:
        body = b"".join(chunks)
    finally:
        getattr(chunks, "close", lambda: None)()
    status, headers = told[-1]
    try:
        return (gzip.decompress(body) if headers.get("Content-Encoding") == "gzip" else body).decode() if status.startswith("200") else None
    except ValueError:
        return None
