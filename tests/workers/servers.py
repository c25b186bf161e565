"""A PostgreSQL server and Optuna's gRPC proxy for tests, on this machine's loopback alone, each ended with its test; and sessions for them.

PostgreSQL does not run as root: then it runs as the user nobody.
"""

import os
import random
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from glob import glob
from pathlib import Path

HERE = Path(__file__).parent
USER = "magmpm"
PASSWORD = "kept-to-ourselves"
NAME = "trials"


def program(name: str) -> str | None:
    """A program of PostgreSQL: Debian keeps them out of the path."""
    return shutil.which(name) or next(
        iter(sorted(glob(f"/usr/lib/postgresql/*/bin/{name}"), reverse=True)), None
    )


def free_port() -> int:
    """A port that nobody listens on, and that no client is given: one that knocks at a closed port could be answered by itself."""
    while True:
        port = random.SystemRandom().randrange(20000, 32000)
        with socket.socket() as probe, suppress(OSError):
            probe.bind(("127.0.0.1", port))
            return port


class Postgres:
    """A server with one database."""

    def __init__(self, folder: Path) -> None:
        initdb = program("initdb")
        postgres = program("postgres")
        assert initdb is not None
        assert postgres is not None
        self.folder = folder
        self.port = free_port()
        self._program = postgres
        self._as = {"user": "nobody", "group": "nogroup"} if os.geteuid() == 0 else {}
        self.process: subprocess.Popen[bytes] | None = None
        folder.mkdir(parents=True)
        (folder / "password").write_text(PASSWORD + "\n")
        if self._as:
            for path in (folder, folder / "password"):
                shutil.chown(path, "nobody", "nogroup")
        how = [
            "-U",
            USER,
            "--pwfile",
            str(folder / "password"),
            "-A",
            "scram-sha-256",
            "-E",
            "UTF8",
        ]
        self._run([initdb, "-D", str(folder / "data"), *how])
        self.start()
        import psycopg

        with psycopg.connect(
            self.url("postgres").replace("+psycopg", ""), autocommit=True
        ) as connection:
            connection.execute(f"CREATE DATABASE {NAME}")

    def _run(self, command: list[str]) -> None:
        env = {**os.environ, "LC_ALL": "C"}
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, cwd="/", env=env, **self._as)  # type: ignore[call-overload]

    def url(self, name: str = NAME) -> str:
        """Its URL, with the password."""
        return f"postgresql://{USER}:{PASSWORD}@127.0.0.1:{self.port}/{name}"

    def start(self) -> None:
        """Start it, and wait until it answers."""
        import psycopg

        until = time.monotonic() + 60
        while True:
            if (
                self.process is None or self.process.poll() is not None
            ):  # processes of a server that was stopped may still hold its memory
                self.process = self._started()
            try:
                psycopg.connect(self.url("postgres"), connect_timeout=2).close()
                return
            except psycopg.OperationalError:
                assert time.monotonic() < until, (self.folder / "log").read_text()[-2000:]
                time.sleep(0.1)

    def _started(self) -> subprocess.Popen[bytes]:
        settings = {
            "listen_addresses": "127.0.0.1",
            "unix_socket_directories": self.folder,
            "fsync": "off",
            "max_connections": 60,
        }
        options = [word for name, value in settings.items() for word in ("-c", f"{name}={value}")]
        log = (self.folder / "log").open("ab")
        with log:
            return subprocess.Popen(  # type: ignore[call-overload, no-any-return]
                [self._program, "-D", str(self.folder / "data"), "-p", str(self.port), *options],
                cwd="/",
                stdout=log,
                stderr=log,
                env={**os.environ, "LC_ALL": "C"},
                **self._as,
            )

    def stop(self) -> None:
        """Stop it at once, as in a crash: connections are cut."""
        self.process.send_signal(3)  # SIGQUIT: "immediate shutdown"
        self.process.wait()

    def cut(self) -> None:
        """Cut all connections of others, and go on."""
        import psycopg

        with psycopg.connect(self.url(), autocommit=True) as connection:
            others = "pid <> pg_backend_pid() AND datname IS NOT NULL"
            connection.execute(
                f"SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE {others}"
            )  # type: ignore[arg-type]


@contextmanager
def postgres() -> Iterator[Postgres]:
    """A server for the time of a test, in a folder of its own: those of pytest are closed to other users whenever another pytest begins."""
    folder = Path(tempfile.mkdtemp(prefix="magmpm-postgres-"))
    folder.chmod(0o755)
    try:
        server = Postgres(folder / "server")
        try:
            yield server
        finally:
            with suppress(ProcessLookupError):
                server.stop()
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def grpc_proxy(url: str) -> Iterator[str]:
    """Optuna's gRPC proxy of a database; its URL."""
    port = free_port()
    command = [
        sys.executable,
        "-m",
        "magmpm.studies.engine.workers.grpc_proxy",
        "--port",
        str(port),
    ]
    with subprocess.Popen(
        command, env={**os.environ, "MAGMPM_STORAGE": url}, stderr=subprocess.PIPE, text=True
    ) as child:
        try:
            said = child.stderr.readline()
            assert said.startswith(f"grpc://localhost:{port} serves "), said
            assert PASSWORD not in said
            yield f"grpc://localhost:{port}"
        finally:
            child.terminate()


def session(
    study: Path, out: Path, workers: int, url: str, seconds: float = 0.1, **env: str
) -> subprocess.Popen[str]:
    """A session with its workers, in a process of its own (session.py)."""
    path = os.pathsep.join(
        [str(HERE), str(HERE.parent / "studies"), os.environ.get("PYTHONPATH", "")]
    )
    known = {
        **os.environ,
        "PYTHONPATH": path,
        "MAGMPM_STORAGE": url,
        "TEST_SECONDS": str(seconds),
        **env,
    }
    command = [sys.executable, str(HERE / "session.py"), str(study), str(out), str(workers)]
    return subprocess.Popen(
        command, env=known, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
