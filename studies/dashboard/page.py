"""The dashboard's page, which calls a trial that breaks a constraint "Infeasible": dashboard 0.21 says "Complete" of it, in grey plots.

The page is one script. It is passed on with the places replaced that print a trial's state; a script of another version, in which they
are not found, is passed on as it is (tests/studies/test_dashboard.py tells).
"""

from __future__ import annotations

import gzip
import re
from collections.abc import Callable, Iterable
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs

from magmpm.compiled.arrays import Plain
from magmpm.inputs.page_guard import HEADERS, Guard

SCRIPT = "/static/bundle.js"
REFUSED = r'"Complete"===\g<trial>.state&&\g<trial>.constraints.some(c=>c>0)'
# the chip of a trial, in the list and above its details: its color and its label
CHIP = re.compile(
    r"color:(?P<color>[\w$]+)\((?P<trial>[\w$]+)\.state\),label:(?P=trial)\.state(?=[,}])"
)
NEW_CHIP = rf'color:{REFUSED}?"warning":\g<color>(\g<trial>.state),label:{REFUSED}?"Infeasible":\g<trial>.state'
# the column of the table
COLUMN = re.compile(r'\("state",\{header:"State",')
OF_ROW = (
    '(t=>"Complete"===t.state&&t.constraints.some(c=>c>0)?"Infeasible":t.state)(e.row.original)'
)
NEW_COLUMN = rf'("state",{{header:"State",cell:e=>{OF_ROW},'

Application = Callable[[Plain, Callable[..., Any]], Iterable[bytes]]


def with_refused_states(script: str) -> str:
    """Add the states of refused trials to the dashboard's script.

    Parameters
    ----------
    script : str
        The script.

    Returns
    -------
    str
        The script with them.
    """
    return COLUMN.sub(NEW_COLUMN, CHIP.sub(NEW_CHIP, script))


# Buttons that are refused without --write are not shown.
READ_ONLY = (
    "[aria-label='delete study'], [aria-label='rename study'], [aria-label='delete artifact']"
    " {display: none !important} "
)
# On a phone the page is as wide as the screen, and what is wider scrolls in a box of its own.
NARROW = "@media (max-width: 600px) {main {min-width: 0; overflow-x: auto}}"
STYLED = 'document.head.insertAdjacentHTML("beforeend", "<style>%s</style>");\n'


def page(app: Application, write: bool) -> Application:
    """Serve the dashboard with that script.

    Parameters
    ----------
    app : Application
        The dashboard, a WSGI application.
    write : bool
        Whether it may edit.

    Returns
    -------
    Application
        The application.
    """
    made: list[bytes] = []  # from the first request on

    def serve(environ: Plain, start: Callable[..., Any]) -> Iterable[bytes]:
        if environ.get("PATH_INFO") != SCRIPT or environ.get("REQUEST_METHOD") != "GET":
            return app(environ, start)
        if not made:
            body = _whole(app, environ)
            if body is None:
                return app(environ, start)
            style = STYLED % (NARROW if write else READ_ONLY + NARROW)
            made.append((style + with_refused_states(body)).encode())
        headers = [
            ("Content-Type", "text/javascript; charset=utf-8"),
            ("Content-Length", str(len(made[0]))),
        ]
        start(
            "200 OK", [*headers, ("Cache-Control", "no-store")]
        )  # another dashboard at this address has another script
        return made

    return serve


# What isn't the page itself, such as a trial's files, is shown without scripts; the page, in no other page.
SANDBOX = (
    "sandbox; default-src 'none'; img-src 'self' data:; media-src 'self'; style-src"
    " 'unsafe-inline'; frame-ancestors 'none'"
)
# Browsers send a cookie to all ports of a host: to those paths alone that show a study. The dashboard's own script and icon are public.
SECRET = ("/api", "/artifacts", "/csv", "/dashboard")
PUBLIC = ("/static/", "/favicon.ico")
ALONE = "frame-ancestors 'none'; base-uri 'none'; form-action 'self'"


def guarded(app: Application, guard: Guard, start_page: str, write: bool) -> Application:
    """Serve the dashboard to who has the secret: the printed address, ?secret=..., gives it to the browser as a cookie.

    Parameters
    ----------
    app : Application
        The dashboard, a WSGI application.
    guard : Guard
        Knows the secret.
    start_page : str
        Path to which the printed address leads.
    write : bool
        Whether it may edit.

    Returns
    -------
    Application
        The application.
    """

    def serve(environ: Plain, start: Callable[..., Any]) -> Iterable[bytes]:
        cookie = f"magmpm-{environ.get('SERVER_PORT')}"
        secret = parse_qs(environ.get("QUERY_STRING", "")).get("secret", [None])[-1]
        method = environ.get("REQUEST_METHOD")

        def refuse(words: str) -> Iterable[bytes]:
            headers = [
                ("Content-Type", "text/plain; charset=utf-8"),
                ("Content-Security-Policy", SANDBOX),
                *HEADERS.items(),
            ]
            start("403 Forbidden", headers)
            return [words.encode()]

        def begin(status: str, headers: list[tuple[str, str]], *rest: Any) -> Any:
            policy = "; ".join(
                [value for name, value in headers if name.lower() == "content-security-policy"]
                + [ALONE]
            )
            kept = [(name, value) for name, value in headers if name.lower() not in OWN]
            page = environ.get("PATH_INFO", "").startswith("/dashboard")
            return start(
                status,
                [*kept, ("Content-Security-Policy", policy if page else SANDBOX), *HEADERS.items()],
                *rest,
            )

        if not guard.admits(environ.get("HTTP_HOST"), environ.get("HTTP_ORIGIN")):
            return refuse("This name, or this page, is not the dashboard's own.")
        if method == "GET" and guard.knows(secret):
            kept = [
                ("Set-Cookie", f"{cookie}={guard.secret}; HttpOnly; SameSite=Strict; Path={path}")
                for path in SECRET
            ]
            start(
                "303 See Other",
                [("Location", start_page), *kept, ("Cache-Control", "no-store"), *HEADERS.items()],
            )
            return []
        if method == "GET" and environ.get("PATH_INFO") in (
            "",
            "/",
        ):  # to where the browser sends the cookie
            start("302 Found", [("Location", start_page), *HEADERS.items()])
            return []
        if method == "GET" and environ["PATH_INFO"].startswith(PUBLIC):
            return app(environ, begin)
        if not guard.knows(_cookie(environ.get("HTTP_COOKIE", ""), cookie)):
            return refuse(
                "This address is incomplete: open the whole address that `magmpm dashboard`"
                " printed."
            )
        if method not in ("GET", "HEAD") and not write:
            return refuse(
                "Nothing is edited or deleted here unless the dashboard was started with --write."
            )
        return app(environ, begin)

    return serve


OWN = (
    "content-security-policy",
    "access-control-allow-origin",
    *(name.lower() for name in HEADERS),
)


def _cookie(header: str, name: str) -> str | None:
    try:
        found = SimpleCookie(header).get(name)
    except CookieError:
        return None
    return None if found is None else found.value


def _whole(app: Application, environ: Plain) -> str | None:
    """Text that the application serves for a request, or None where the answer isn't a text."""
    begun: list[Any] = []
    conditions = ("HTTP_IF_MODIFIED_SINCE", "HTTP_IF_NONE_MATCH", "HTTP_RANGE")
    whole = {name: value for name, value in environ.items() if name not in conditions}
    chunks = app(
        {**whole, "HTTP_ACCEPT_ENCODING": "identity"},
        lambda status, headers, *_: begun.append((status, dict(headers))),
    )
    try:
        body = b"".join(chunks)
    finally:
        getattr(chunks, "close", lambda: None)()
    status, headers = begun[-1]
    try:
        return (
            (gzip.decompress(body) if headers.get("Content-Encoding") == "gzip" else body).decode()
            if status.startswith("200")
            else None
        )
    except ValueError:
        return None
