"""Growth of a process during a motion: the memory that a machine needs, not the sum of the arrays.

    python tests/benchmarks/resident.py      prints {"now": bytes a particle, "peak": ..., "counted": ..., "particles": n}

Measured in a separate process, because freed memory may stay with the process that had it.
"""

import gc
import json
import resource
import subprocess
import sys
from pathlib import Path

# across the five-segment catheter: 290 000 particles, so that one megabyte is 4 bytes per particle
CELLS = 16


def grown() -> dict[str, float]:
    """Output of the command, measured in a new process."""
    done = subprocess.run([sys.executable, __file__], check=True, capture_output=True, text=True)
    found: dict[str, float] = json.loads(done.stdout)
    return found


def _resident() -> int:
    """Current memory of this process, bytes."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize()


def _highest() -> int:
    """Peak memory of this process, bytes. Not ru_maxrss of getrusage, which starts at the memory of the parent."""
    status = Path("/proc/self/status").read_text()
    return int(status.split("VmHWM:")[1].split()[0]) * 1024


def _moved(cells: int) -> tuple[object, int, int]:
    """A motion after some steps, one check and its measures, as in `magmpm run`; also its particles, and the bytes of its arrays."""
    from motion_rates import advance, scene

    from magmpm.dynamics.time_loop import begin, memory
    from magmpm.model import build

    moved = begin(build(scene(cells=cells)))
    advance(moved.motion, 3, moved.dt, moved.motion.model.effects)
    return (moved, moved.motion.kinematics()), len(moved.motion.model.density), memory(moved.motion)


def main() -> int:
    """Measure, and print one JSON object."""
    from motion_rates import scene

    from magmpm.solving.precompile import prepare_kernels

    prepare_kernels(
        scene(cells=4)
    )  # in other processes: otherwise the memory of the compiler would be the peak
    kept, few, _ = _moved(4)  # kernels, libraries
    del kept
    gc.collect()
    before = _resident()
    kept, many, counted = _moved(CELLS)
    gc.collect()
    now = _resident() - before
    peak = _highest() - before
    print(
        json.dumps(
            {"now": now / many, "peak": peak / many, "counted": counted / many, "particles": many}
        )
    )
    assert few < many
    assert kept is not None
    return 0


if __name__ == "__main__":
    sys.exit(main())
