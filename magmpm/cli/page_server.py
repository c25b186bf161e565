"""A small web server for one page and the person before it.

It listens on this machine alone unless requested otherwise. The page is open to all; it answers only to who has the secret
that the printed address ends with, and only under the name of this machine, so that no other page and no other user can ask.
"""

import json
import threading
from collections.abc import Callable, Mapping
from http import HTTPStatus
from pathlib import Path
from typing import Any

from magmpm.errors import InputError, MagmpmError
from magmpm.inputs.page_guard import ALL, HEADERS, LOOPBACK, Guard, GuardedHandler, GuardedServer
from magmpm.viz import page

SITE = Path(page.__file__).parent / "site"
KINDS = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
}
SECRET = "X-Magmpm-Secret"
FIRST_PORT = 8090  # and the next ones, tried in turn unless a port is requested
Answer = bytes | Mapping[str, Any]
Routes = Mapping[str, Callable[[Any], Answer]]
# The page loads nothing from elsewhere, and is shown in no other page.
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self'"
    " data: blob:; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)


class RefusedRequest(Exception):
    """A request that is not answered, with its status."""

    def __init__(self, status: HTTPStatus) -> None:
        super().__init__(status.phrase)
        self.status = status


class PageServer(GuardedServer):
    """Serves the page, and what its scripts ask for by the routes: name -> function of the request's plain data."""

    allow_reuse_address = False

    def __init__(self, routes: Routes, host: str = LOOPBACK, port: int | None = None) -> None:
        """host: the address to listen to, then other names of it, with commas; port: None: the first free one from FIRST_PORT on; 0: any.

        Raises InputError where it can't be had.
        """
        names = [name.strip() for name in host.split(",") if name.strip()] or [LOOPBACK]
        self.routes = routes
        self.guard = Guard(names)
        host = names[0]
        self.secret = self.guard.secret
        for candidate in range(FIRST_PORT, FIRST_PORT + 20) if port is None else (port,):
            try:
                super().__init__((host, candidate), _Handler)
                break
            except (OSError, OverflowError) as error:
                failure = getattr(error, "strerror", None) or str(error)
        else:
            rule = (
                "the address must be this machine's, and the port free and allowed to this user"
                f" ({failure})"
            )
            remedy = "stop the program that uses it, or choose another; --port 0 takes any free one"
            raise InputError(
                "--port", received=f"{port or FIRST_PORT} on {host}", rule=rule, remedy=remedy
            )
        name = (*names[1:], self.server_name if host in ALL else host)[0]
        self.url = f"http://{name}:{self.server_port}/#{self.secret}"

    def begin(self) -> threading.Thread:
        """Serve in a thread of its own."""
        thread = threading.Thread(target=self.serve_forever, args=(0.02,), daemon=True)
        thread.start()
        return thread


class _Handler(GuardedHandler):
    protocol_version = "HTTP/1.1"  # connections stay open: a request takes a millisecond
    disable_nagle_algorithm = True
    wbufsize = -1
    server: PageServer

    def do_GET(self) -> None:
        """A file of the page."""
        name = (
            "index.html"
            if self.path.split("?")[0] == "/"
            else self.path.split("?")[0].removeprefix("/")
        )
        files = {path.name: path for path in SITE.iterdir()}
        self._answer(lambda: self._file(files.get(name)))

    def _file(self, path: Path | None) -> tuple[bytes, str]:
        self._admit()
        if path is None or path.suffix not in KINDS:
            raise RefusedRequest(HTTPStatus.NOT_FOUND)
        return path.read_bytes(), KINDS[path.suffix]

    def do_POST(self) -> None:
        """Answer a request of the page."""
        self._answer(self._posted)

    def _posted(self) -> tuple[bytes, str]:
        request = self._read()
        self.server.waits_for(self.connection, False)
        answer = self.server.routes[self.path.removeprefix("/")](request)
        if isinstance(answer, bytes):
            return answer, "application/octet-stream"
        return json.dumps(answer).encode(), "application/json"

    def _answer(self, found: Callable[[], tuple[bytes, str]]) -> None:
        """Send what is found, or why not: a connection is never closed without an answer."""
        status = HTTPStatus.OK
        kind = "application/json"
        try:
            content, kind = found()
        except RefusedRequest as refusal:
            self.close_connection = True  # what it sends may not have been read
            status = refusal.status
            content = str(refusal).encode()
            kind = "text/plain"
        except MagmpmError as error:
            status = HTTPStatus.BAD_REQUEST
            content = json.dumps({"error": str(error)}).encode()
        except Exception as error:
            words = f"{type(error).__name__}: {error}; please report this"
            status = HTTPStatus.INTERNAL_SERVER_ERROR
            content = json.dumps({"error": words}).encode()
        self._send(status, content, kind)

    def _admit(self) -> None:
        """Raises RefusedRequest."""
        if not self.server.guard.admits(
            self.headers.get("Host"), self.headers.get("Origin"), self.connection.getsockname()[0]
        ):
            raise RefusedRequest(HTTPStatus.FORBIDDEN)

    def _read(self) -> Any:
        """The request's data. Raises RefusedRequest."""
        self._admit()
        if not self.server.guard.knows(self.headers.get(SECRET)):
            raise RefusedRequest(HTTPStatus.FORBIDDEN)
        if self.path.removeprefix("/") not in self.server.routes:
            raise RefusedRequest(HTTPStatus.NOT_FOUND)
        length = self.headers.get("Content-Length") or ""
        if (
            not length.isascii()
            or not length.isdigit()
            or len(length) > 9
            or int(length) > 1_000_000
        ):  # bytes
            raise RefusedRequest(HTTPStatus.REQUEST_ENTITY_TOO_LARGE)
        try:
            return json.loads(self.rfile.read(int(length)) or b"null")
        except (ValueError, RecursionError):
            raise RefusedRequest(HTTPStatus.BAD_REQUEST) from None

    def _send(self, status: HTTPStatus, content: bytes, kind: str) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.send_header("Cache-Control", "no-store")
        self.send_header("Content-Security-Policy", POLICY)
        for name, value in HEADERS.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(content)
