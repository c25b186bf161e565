"""Which systems magmpm imports on: modules that only Unix has are used nowhere without asking, as seen by making them unimportable."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
UNIX = ("fcntl", "grp", "pty", "pwd", "resource", "syslog", "termios", "tty")
OF_UNIX = ("getuid", "geteuid", "statvfs", "sched_getaffinity", "register_at_fork", "getloadavg")
# Libraries come first: theirs are the libraries' own affair, which pip installs for each system.
SCRIPT = """
import importlib, multiprocessing.connection, os, pathlib, subprocess, sys
import filelock, h5py, llvmlite.binding, matplotlib.figure, numba, optuna, PIL.Image, pydantic
import pyvista, scipy.linalg, yaml
sys.modules.update(dict.fromkeys({unix}))
for name in {of_unix}:
    delattr(os, name)
delattr(os, "O_NONBLOCK")
sys.platform = {platform!r}
sys.path.insert(0, {root!r})
names = []
for top in ("magmpm", "studies", "viz"):
    for path in sorted(pathlib.Path({root!r}, top).rglob("*.py")):
        parts = path.relative_to({root!r}).with_suffix("").parts
        inside = parts if top == "magmpm" else ("magmpm", *parts)
        names.append(".".join(inside).removesuffix(".__init__"))
for name in names:
    if not name.endswith("__main__") and "grpc" not in name:
        importlib.import_module(name)
import magmpm
scene = magmpm.load_scene({scene!r})
print(len(names), scene.name, scene.length)
try:
    magmpm.compiled.process.Process(print)
    print("started")
except magmpm.InputError as error:
    print(error)
"""


@pytest.mark.parametrize("platform", ["win32", "darwin"])
def test_every_module_imports_and_a_scene_is_read(platform: str) -> None:
    """Without what only Unix has. Where processes can't be made as magmpm makes them, a run says so at once, and names the remedy."""
    script = SCRIPT.format(
        unix=UNIX,
        of_unix=OF_UNIX,
        platform=platform,
        root=str(ROOT),
        scene=str(ROOT / "data/scenes/five_segments.yaml"),
    )
    done = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    count, *said = done.stdout.split("\n")
    assert int(count.split()[0]) > 300
    assert count.endswith("five-segment catheter 0.04")
    if platform == "win32":
        assert said[0] == "this system: received Windows"
        assert "remedy: install magmpm in WSL 2" in done.stdout
    else:
        assert said[0] == "started"
