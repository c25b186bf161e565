"""`magmpm dashboard` as a process at a free port, and requests to it with its secret or without."""

import http.client
import json
import re
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

SERVE = "import sys; from magmpm.cli import main; sys.exit(main(sys.argv[1:]))"


@dataclass(frozen=True)
class Dashboard:
    """Its port, its secret and the address that it printed."""

    port: int
    secret: str
    url: str

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def request(
        self, method: str, path: str, body: str | None = None, **headers: str
    ) -> tuple[int, dict[str, str], bytes]:
        """Without its secret, unless a Cookie is given."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        connection.request(method, path, body, {"Content-Type": "application/json", **headers})
        answer = connection.getresponse()
        return (
            answer.status,
            {name.lower(): ", ".join(answer.headers.get_all(name, [])) for name in answer.headers},
            answer.read(),
        )

    @property
    def cookie(self) -> str:
        return f"magmpm-{self.port}={self.secret}"

    def get(self, url: str) -> bytes:
        status, _, content = self.request("GET", url.removeprefix(self.address), Cookie=self.cookie)
        assert status == 200, content
        return content

    def ask(self, url: str) -> Any:
        return json.loads(self.get(url))


@contextmanager
def dashboard(out: Path, *options: str) -> Iterator[Dashboard]:
    """Run until the block ends."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    command = [sys.executable, "-c", SERVE, "dashboard", str(out), "--port", str(port), *options]
    child = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        line = child.stderr.readline()
        address = rf"(http://127\.0\.0\.1:{port}/dashboard/studies/\d+\?secret=([\w-]+))"
        found = re.fullmatch(rf"{address} shows {re.escape(str(out))}; Ctrl-C ends it\n", line)
        assert found, line
        yield Dashboard(port, found[2], found[1])
    finally:
        child.kill()
        child.wait()
