"""A small web server for one page and the person before it.

It listens on this machine alone unless asked otherwise. The page is open to all; what it asks for is answered only to who has the secret
that the printed address ends with, and only under the name of this machine, so that no other page and no other user can ask.
"""

from __future__ import annotations

import json
import secrets
import threading
from collections.abc import Callable, Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from magmpm.errors import InputError, MagmpmError, report

SITE = Path(__file__).parent / "site"
KINDS = {".html": "text/html; charset=utf-8", ".js": "text/javascript; charset=utf-8", ".css": "text/css; charset=utf-8"}
SECRET = "X-Magmpm-Secret"
LOOPBACK = "127.0.0.1"
MOST = 1_000_000  # bytes of a request
FIRST_PORT, PORTS = 8090, 20  # tried in turn unless a port is asked for
Answer = bytes | Mapping[str, Any]
Routes = Mapping[str, Callable[[Any], Answer]]
# The page loads nothing from elsewhere, and is shown in no other page.
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' data: blob:; "
    "frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)


class Refused(Exception):
    """A request that is not answered, with its status."""

    def __init__(self, status: HTTPStatus) -> None:
        super().__init__(status.phrase)
        self.status = status


class PageServer(ThreadingHTTPServer):
    """Serves the page, and what its scripts ask for by the routes: name -> function of the request's plain data."""

    daemon_threads = True
    allow_reuse_address = False

    def __init__(self, routes: Routes, host: str = LOOPBACK, port: int | None = None) -> None:
        """port: None: the first free one from FIRST_PORT on; 0: any. Raises InputError where it can't be had."""
        self.routes, self.secret = routes, secrets.token_urlsafe(18)
        for candidate in range(FIRST_PORT, FIRST_PORT + PORTS) if port is None else (port,):
            try:
                super().__init__((host, candidate), _Handler)
                break
            except (OSError, OverflowError) as error:
                trouble = getattr(error, "strerror", None) or str(error)
        else:
            rule = f"the address must be this machine's, and the port free and allowed to this user ({trouble})"
            remedy = "end what uses it, or name another, say, --port 0 for any that is free"
            raise InputError(report("--port", received=f"{port or FIRST_PORT} on {host}", rule=rule, remedy=remedy))
        name = self.server_name if host in ("0.0.0.0", "::") else host
        self.url = f"http://{name}:{self.server_port}/#{self.secret}"
        self._names = None if host in ("0.0.0.0", "::") else {f"{h}:{self.server_port}" for h in (host, "localhost")}

    def admits(self, host: str | None) -> bool:
        """Whether a request under this host's name is meant for this server: another name would be another page's trick."""
        return self._names is None or host in self._names

    def begin(self) -> threading.Thread:
        """Serve in a thread of its own."""
        thread = threading.Thread(target=self.serve_forever, args=(0.02,), daemon=True)
        thread.start()
        return thread

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A page that was closed in the middle is no fault."""


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"  # connections stay open: a request takes a millisecond
    disable_nagle_algorithm = True
    wbufsize = -1
    server: PageServer
    timeout = 3600

    def do_GET(self) -> None:
        """A file of the page."""
        name = "index.html" if self.path.split("?")[0] == "/" else self.path.split("?")[0].removeprefix("/")
        files = {path.name: path for path in SITE.iterdir()}
        try:
            if not self.server.admits(self.headers.get("Host")):
                raise Refused(HTTPStatus.FORBIDDEN)
            if name not in files or files[name].suffix not in KINDS:
                raise Refused(HTTPStatus.NOT_FOUND)
            self._send(HTTPStatus.OK, files[name].read_bytes(), KINDS[files[name].suffix])
        except Refused as refusal:
            self._send(refusal.status, str(refusal).encode(), "text/plain")

    def do_POST(self) -> None:
        """What the page asks for."""
        try:
            asked = self._read()
            answer = self.server.routes[self.path.removeprefix("/")](asked)
            if isinstance(answer, bytes):
                self._send(HTTPStatus.OK, answer, "application/octet-stream")
            else:
                self._send(HTTPStatus.OK, json.dumps(answer).encode(), "application/json")
        except Refused as refusal:
            self.close_connection = True  # what it sends may not have been read
            self._send(refusal.status, str(refusal).encode(), "text/plain")
        except MagmpmError as error:
            self._send(HTTPStatus.BAD_REQUEST, json.dumps({"error": str(error)}).encode(), "application/json")

    def _read(self) -> Any:
        """The request's data. Raises Refused."""
        if not self.server.admits(self.headers.get("Host")):
            raise Refused(HTTPStatus.FORBIDDEN)
        if not secrets.compare_digest((self.headers.get(SECRET) or "").encode(), self.server.secret.encode()):
            raise Refused(HTTPStatus.FORBIDDEN)
        if self.path.removeprefix("/") not in self.server.routes:
            raise Refused(HTTPStatus.NOT_FOUND)
        length = self.headers.get("Content-Length") or ""
        if not length.isascii() or not length.isdigit() or len(length) > 9 or int(length) > MOST:
            raise Refused(HTTPStatus.REQUEST_ENTITY_TOO_LARGE)
        try:
            return json.loads(self.rfile.read(int(length)) or b"null")
        except (ValueError, RecursionError):
            raise Refused(HTTPStatus.BAD_REQUEST) from None

    def _send(self, status: HTTPStatus, content: bytes, kind: str) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.send_header("Cache-Control", "no-store")
        self.send_header("Content-Security-Policy", POLICY)
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Referrer-Policy", "no-referrer")
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *_: Any) -> None:
        """Prints no line per request."""
