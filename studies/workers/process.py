"""What runs in a worker process: designs come through a pipe, and what became of them goes back.

Ctrl-C is for the session to act on. The process ends with the pipe; or, in the middle of a solve, when its standard input closes, which
happens when the session dies, however it dies.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
import threading
from multiprocessing.connection import Connection
from typing import Any


def main(argv: list[str]) -> None:
    """argv: ignored, file descriptor of the pipe."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    pipe: Any = Connection(int(argv[1]))
    try:
        sys.path[:] = pipe.recv()
        payload = pipe.recv_bytes()
        try:
            judge = _judge(payload)
        except Exception as error:
            _send(pipe, "raised", error)
            raise
        pipe.send(("ready", None))
        while True:
            number, params = pipe.recv()
            try:
                found = judge.judged(number, params)
            except Exception as error:  # a disk that is full, say: the session ends as it would without workers
                _send(pipe, "raised", error)
            else:
                pipe.send(("done", found))
    except (EOFError, OSError):
        os._exit(0)


def _send(pipe: Any, kind: str, error: Exception) -> None:
    """Send an exception, or what it says where it can't be sent."""
    try:
        pipe.send((kind, error))
    except (pickle.PicklingError, TypeError, AttributeError):
        pipe.send((kind, RuntimeError(f"{type(error).__name__}: {error}")))


def _judge(payload: bytes) -> Any:
    from magmpm.studies.judge import Judge

    return Judge(*pickle.loads(payload))  # from the session that started this process


def _end_with_parent() -> None:
    """Blocks until standard input closes."""
    os.read(0, 1)
    os._exit(1)
