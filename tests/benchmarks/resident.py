"""Memory that a process grows by while it moves a body, for one formulation: what a machine must have, not what arrays add up to.

    python tests/benchmarks/resident.py total|updated      prints {"now": bytes a particle, "peak": ..., "counted": ..., "particles": n}

In a process of its own, because memory that was freed may stay with the process that had it.
"""

from __future__ import annotations

import gc
import json
import resource
import subprocess
import sys
from pathlib import Path

CELLS = 16  # across the five-segment catheter: 290 000 particles, so that a megabyte more or less is 4 bytes a particle


def grown(formulation: str) -> dict[str, float]:
    """The same as the command prints, measured in a new process."""
    done = subprocess.run([sys.executable, __file__, formulation], check=True, capture_output=True, text=True)
    found: dict[str, float] = json.loads(done.stdout)
    return found


def _resident() -> int:
    """Memory of this process now, bytes."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize()


def _highest() -> int:
    """The most memory this process has had, bytes. Not getrusage's ru_maxrss, which begins at what the parent had."""
    status = Path("/proc/self/status").read_text()
    return int(status.split("VmHWM:")[1].split()[0]) * 1024


def _moved(formulation: str, cells: int) -> tuple[object, int, int]:
    """A motion after some steps, a look and its measures, as `magmpm run` has it; its particles, and the bytes of its arrays."""
    from motion_rates import advance, scene

    from magmpm.dynamics.time_loop import begin, memory
    from magmpm.model import build

    moved = begin(build(scene(formulation, cells=cells)))
    advance(moved.motion, 3, moved.dt, moved.motion.model.effects)
    return (moved, moved.motion.look()), len(moved.motion.model.density), memory(moved.motion)


def main(formulation: str) -> int:
    """Measure, and print one JSON object."""
    from motion_rates import scene

    from magmpm.precompile import prepare_kernels

    prepare_kernels(scene(formulation, cells=4))  # in other processes: a compiler's memory would be the peak of this one
    kept, few, _ = _moved(formulation, 4)  # kernels, libraries
    del kept
    gc.collect()
    before = _resident()
    kept, many, counted = _moved(formulation, CELLS)
    gc.collect()
    now = _resident() - before
    peak = _highest() - before
    print(json.dumps({"now": now / many, "peak": peak / many, "counted": counted / many, "particles": many}))
    assert few < many
    assert kept is not None
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
