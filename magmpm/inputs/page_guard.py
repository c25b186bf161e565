"""Access to a server of pages, and its time limit: names, origin, secret, time and count of connections. For `view` and `dashboard`.

Another page whose name leads to this machine (DNS rebinding) sends its own name as Host; another page's script, its own Origin; other users
of this machine do not know the secret. Connections that ask nothing are closed.
"""

import secrets
import socket
import threading
import time
from collections.abc import Iterable
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from ipaddress import ip_address
from typing import Any

LOOPBACK = "127.0.0.1"
ALL = ("0.0.0.0", "::")
SECONDS_OF_REQUEST = 20.0  # s for a request to be sent, and for an answer to be taken
MOST_CONNECTIONS = 64  # a browser opens six
HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
}


class Guard:
    """Names that a server answers to, and its secret."""

    def __init__(self, names: Iterable[str] = (LOOPBACK,)) -> None:
        """names: of --host: the address that is listened to, then others under which the page is opened."""
        given = {name.lower() for name in names}
        self.secret = secrets.token_urlsafe(18)
        self._everywhere = bool(given & set(ALL))
        own = (
            {socket.gethostname().lower(), socket.getfqdn().lower()} if self._everywhere else set()
        )
        self._names = (given - set(ALL)) | own | {"localhost", LOOPBACK, "[::1]"}

    def admits(self, host: str | None, origin: str | None, reached: str = "") -> bool:
        """True if a request is meant for this server and comes from its own page, or from none.

        host, origin: its headers. reached: the address at which it arrived; with --host 0.0.0.0 this is a name as well.
        """
        host = (host or "").lower()
        name = host if host.endswith("]") else host.rpartition(":")[0] or host
        if name not in self._names and not (self._everywhere and _same_address(name, reached)):
            return False
        return origin is None or origin.lower() in (f"http://{host}", f"https://{host}")

    def knows(self, secret: str | None) -> bool:
        """True if this is the secret, compared in constant time."""
        return secrets.compare_digest((secret or "").encode(), self.secret.encode())


def _same_address(name: str, reached: str) -> bool:
    with suppress(ValueError):
        return ip_address(name.strip("[]")) == ip_address(reached)
    return False


class GuardedServer(ThreadingHTTPServer):
    """A server that closes connections which ask nothing within SECONDS_OF_REQUEST, and keeps at most MOST_CONNECTIONS.

    Where one more comes, the one that has requested nothing for longest is closed, or the new one if all are being answered.
    """

    daemon_threads = True

    def __init__(self, *arguments: Any, **options: Any) -> None:
        self._lock = threading.Lock()
        self._since: dict[
            Any, float | None
        ] = {}  # since when a connection requests nothing; None: it is being answered
        super().__init__(*arguments, **options)

    def waits_for(self, connection: Any, waits: bool = True) -> None:
        """Say whether the server waits for what a connection sends."""
        with self._lock:
            if connection in self._since:
                self._since[connection] = time.monotonic() if waits else None

    def process_request(self, request: Any, client_address: Any) -> None:
        """Begin to answer a connection, if there is room."""
        with self._lock:
            room = len(self._since) < MOST_CONNECTIONS or self._close_oldest()
            if room:
                self._since[request] = time.monotonic()
        if room:
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def _close_oldest(self, least: float = 0.0) -> bool:
        """Close the connection that has requested nothing for longest, if for `least` s; whether there was one."""
        since, found = min(
            ((t, c) for c, t in self._since.items() if t is not None),
            key=lambda pair: pair[0],
            default=(0.0, None),
        )
        if found is None or time.monotonic() - since < least:
            return False
        del self._since[found]
        with suppress(OSError):
            found.shutdown(socket.SHUT_RDWR)  # its thread then ends
        return True

    def service_actions(self) -> None:
        """Close connections that request nothing; called by serve_forever again and again."""
        with self._lock:
            while self._close_oldest(SECONDS_OF_REQUEST):
                pass

    def close_request(self, request: Any) -> None:
        """Forget a connection that has ended."""
        with self._lock:
            self._since.pop(request, None)
        super().close_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A page that was closed in the middle is no fault."""


class GuardedHandler(BaseHTTPRequestHandler):
    """A request to a GuardedServer. With a body, the server waits until `waits_for` says that it is read."""

    timeout = SECONDS_OF_REQUEST
    server: GuardedServer

    def handle_one_request(self) -> None:
        """Wait for the next request of a connection."""
        self.server.waits_for(self.connection)
        super().handle_one_request()

    def parse_request(self) -> bool:
        """Read what comes before a request's body."""
        found = super().parse_request()
        if found and self.command in ("GET", "HEAD"):
            self.server.waits_for(self.connection, False)
        return found

    def log_message(self, format: str, *_: Any) -> None:
        """Prints no line per request."""
