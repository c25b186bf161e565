"""The command in a process of its own, and scene files for it."""

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).parents[2]


def environment(**more: str) -> dict[str, str]:
    """Variables of a process that finds this checkout."""
    return {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),
        **more,
    }


def started(*words: object, output: int = subprocess.DEVNULL, **env: str) -> subprocess.Popen[str]:
    """The command, begun; output: what becomes of what it prints."""
    command = [sys.executable, "-m", "magmpm.cli", *map(str, words)]
    return subprocess.Popen(
        command, env=environment(**env), stdout=output, stderr=output, text=True
    )


def wait_for(
    condition: Callable[[], object], child: subprocess.Popen[str], seconds: float = 120.0
) -> None:
    """Until the condition holds, the process ends, or so long."""
    until = time.monotonic() + seconds
    while not condition() and child.poll() is None and time.monotonic() < until:
        time.sleep(0.005)


def scene_text(
    name: str = "small",
    *,
    length: str = "20 mm",
    segments: str = "{magnetization: [1, 0, 0]}",
    material: str = "magnetic",
    **more: str,
) -> str:
    """A scene file of a catheter, 4 mm thick, on two cells, a key a line; more: keys in place of the usual ones, or besides."""
    keys = {
        "name": name,
        "materials": (
            f"{{{material}: {{shear_modulus: 120 kPa, bulk_to_shear: 20, density: 1882 kg/m^3,"
            " remanence: 100 mT}}"
        ),
        "body": (
            f"{{catheter: {{length: {length}, diameter: 4 mm, material: {material}, segments:"
            f" [{segments}]}}}}"
        ),
        "field": "{uniform: [0 mT, 0 mT, 5 mT]}",
        "effects": "{magnetic_torque: {}}",
        "resolution": "{cells_across: 2}",
        **more,
    }
    return "".join(f"{key}: {value}\n" for key, value in keys.items())
