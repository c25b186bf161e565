"""Results folders that another process is writing."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_HOLDER = """\
import sys
from magmpm.results.folder_lock import folder_lock
with folder_lock(sys.argv[1]):
    print("held", flush=True)
    sys.stdin.read()
"""


@contextmanager
def holding(path: Path, script: str = _HOLDER) -> Iterator[int]:
    """Another process holds the folder, or what another script holds, until the context ends or it is killed. Yields its process number."""
    command = [sys.executable, "-c", script, str(path)]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as child:
        assert child.stdout.readline() == "held\n"
        try:
            yield child.pid
        finally:
            child.kill()
