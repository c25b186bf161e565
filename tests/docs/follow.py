"""Follow a page as a reader does: its commands and its Python, in order, in one process and the current folder.

    python follow.py STEPS.json [--quick]

STEPS.json: a list of [kind, text, line, name], as tests/docs/page_steps.py makes it. It uses the standard library alone, so that any
Python with magmpm installed can run it. --quick: studies make two trials. Ends at the first step that fails, with its line and status 1.
"""

import json
import os
import re
import shlex
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

SERVERS = ("dashboard", "view")
MAGMPM = [sys.executable, "-m", "magmpm.cli"]
PATIENCE = 120.0  # s until a server answers


def command(words: list[str], quick: bool) -> list[str]:
    """Command that is run for a line of a page."""
    if words[0] == "magmpm":
        fewer = (
            ["--trials", "2"] if quick and words[1] == "design" and "--trials" not in words else []
        )
        return [*MAGMPM, *words[1:], *fewer]
    if words[0] == "python":
        return [sys.executable, *words[1:]]
    return words


def serve(words: list[str]) -> None:
    """Start a server on a free port, open the address that it prints as a browser does, and end it."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    command = [*MAGMPM, *words[1:], "--port", str(port)]
    server = subprocess.Popen(command, start_new_session=True, stderr=subprocess.PIPE, text=True)
    browser = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
    try:
        assert server.stderr is not None
        begun = time.monotonic()
        address = next(
            found[0]
            for line in server.stderr
            if (found := re.search(rf"http://\S+:{port}\S*", line))
        )
        while True:
            try:
                with browser.open(address, timeout=10) as answer:
                    assert answer.status == 200
                return
            except OSError:
                if server.poll() is not None or time.monotonic() - begun > PATIENCE:
                    raise
                time.sleep(0.2)
    finally:
        if server.poll() is None:
            os.killpg(server.pid, signal.SIGTERM)
            server.wait(30)


def main(arguments: list[str]) -> int:
    """Follow the steps. Returns the exit status."""
    quick = "--quick" in arguments
    names: dict[str, object] = {"__name__": "__page__"}
    for kind, text, line, name in json.loads(Path(arguments[0]).read_text(encoding="utf-8")):
        begun = time.monotonic()
        try:
            if kind == "python":
                exec(compile(text, f"line {line}", "exec"), names)
            elif kind == "file":
                Path(name).parent.mkdir(parents=True, exist_ok=True)
                Path(name).write_text(text, encoding="utf-8")
            elif kind == "sh":
                words = shlex.split(text, comments=True)
                if words[0] == "magmpm" and words[1] in SERVERS:
                    serve(words)
                else:
                    subprocess.run(command(words, quick), check=True, timeout=1800)
        except Exception as error:
            print(
                f"line {line}: {kind}: {text.strip().splitlines()[0]}: {type(error).__name__}:"
                f" {error}",
                file=sys.stderr,
            )
            return 1
        print(f"line {line}: {kind}: {time.monotonic() - begun:.1f} s", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
