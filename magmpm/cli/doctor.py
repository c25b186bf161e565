"""`magmpm doctor`: what is here, what is missing, whether the numbers come out right, and what to install.

Only the standard library is imported here, so that it can say which other library is missing. What may crash or hang (libraries, OpenGL,
the self-test) is tried in processes of their own.
"""

import argparse
import json
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from magmpm.cli.answers import print_summary
from magmpm.compiled.environment import cache_folder
from magmpm.errors import install, installed

OK = "ok"
WARN = "warning"
FAIL = "failure"
IMPORTS = {"PyYAML": "yaml"}  # where names differ
PATIENCE = {
    "import": 120.0,
    "opengl": 150.0,
    "self-test": 600.0,
}  # s: a cold self-test compiles kernels
EXTRAS_FOR = {
    "design": "design studies, with plots",
    "motion": "saved motions, and progress bars",
    "parts": "STL parts and walls",
    "magnets": "fields of magnets and coils of any shape",
    "units": "units other than m, Pa, T, deg, s ...",
    "render": "pictures and movies",
    "dashboard": "magmpm dashboard",
    "report": "magmpm report as PDF",
    "dataframe": "tables as pandas.DataFrame",
    "gp": "the sampler gp by Optuna",
    "postgresql": "studies in PostgreSQL",
    "grpc": "studies through Optuna's gRPC proxy",
    "s3": "pictures in an S3 store",
    "fem": "finite-element references",
    "browser": "make test-browser",
    "test": "the tests and linters",
    "docs": "make docs",
    "notebook": "make test-docs",
    "completion": "Tab in the shell",
}


@dataclass(frozen=True)
class Check:
    """One thing looked at: its name, how it is, what was found, and what to do."""

    name: str
    status: str
    found: str
    remedy: str = ""


def command(options: argparse.Namespace) -> int:
    """Look at everything, and print it. Returns the exit status: 0, or 1 where something fails."""
    checks: list[Check] = []
    for check in looked_at(quick=options.quick):
        checks.append(check)
        if not options.json:
            print(_line(check), flush=True)
    failed, warned = (sum(check.status == status for check in checks) for status in (FAIL, WARN))
    last = (
        f"{len(checks)} checks: {failed} failed, {warned} warnings"
        if failed or warned
        else f"{len(checks)} checks: no problems"
    )
    print_summary(
        options,
        {"checks": [asdict(check) for check in checks], "failed": failed, "warnings": warned},
        last,
    )
    return 1 if failed else 0


def looked_at(*, quick: bool = False) -> Iterator[Check]:
    """All checks, one after the other. quick: without the self-test."""
    yield _python()
    libraries = list(_libraries())
    yield from libraries
    yield from _extras()
    yield from _threads()
    yield from _room()
    if any(check.status == FAIL for check in libraries):
        yield Check("self-test", WARN, "left out: a library is missing")
        return
    yield _opengl()
    if quick:
        return
    yield from _self_test()


def _line(check: Check) -> str:
    mark = {OK: "ok     ", WARN: "warning", FAIL: "FAILURE"}[check.status]
    return f"{mark}  {check.name:<24} {check.found}" + (
        f"\n{'':34}remedy: {check.remedy}" if check.remedy else ""
    )


def _python() -> Check:
    found = (
        f"{platform.python_version()} at {sys.executable}, {platform.system()} {platform.machine()}"
    )
    if sys.prefix == sys.base_prefix:
        remedy = f"{sys.executable} -m venv .venv keeps the libraries of other projects separate"
        return Check("Python", OK, f"{found}, no virtual environment", remedy)
    return Check("Python", OK, found)


@dataclass(frozen=True)
class _Needed:
    """A library that magmpm needs: name, least version, and the extra that it belongs to, "" for all."""

    name: str
    least: str
    extra: str


def _needed() -> list[_Needed]:
    """Packages that magmpm needs, as its installed metadata or its setup.cfg lists them."""
    try:
        lines = metadata.requires("magmpm") or []
    except metadata.PackageNotFoundError:
        lines = list(_of_setup_cfg())
    found = []
    for line in lines:
        match = re.match(r"([A-Za-z0-9_.-]+)\s*(?:>=\s*([\d.]+))?", line)
        extra = re.search(r"extra\s*==\s*['\"]([^'\"]+)", line)
        if match:
            found.append(
                _Needed(match.group(1), match.group(2) or "0", extra.group(1) if extra else "")
            )
    return found


def _of_setup_cfg() -> Iterator[str]:
    """Requirements of a checkout that is run without being installed."""
    import configparser

    path = Path(__file__).resolve().parents[2] / "setup.cfg"
    parser = configparser.ConfigParser(interpolation=None)
    parser.read(path, encoding="utf-8")
    if parser.has_section("options"):
        yield from parser.get("options", "install_requires", fallback="").split("\n")[1:]
    if parser.has_section("options.extras_require"):
        for extra, names in parser.items("options.extras_require"):
            yield from (f"{name}; extra == '{extra}'" for name in names.split("\n") if name)


def _installed(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _numbers(version: str) -> tuple[int, ...]:
    """The leading numbers of a version: 3.10.1rc2 as (3, 10, 1)."""
    found = re.match(r"\d+(?:\.\d+)*", version)
    parts = [int(part) for part in found.group().split(".")] if found else []
    while parts and parts[-1] == 0:
        parts.pop()
    return tuple(parts)


def _older(version: str, needed: _Needed) -> bool:
    return _numbers(version) < _numbers(needed.least)


def _install(extra: str) -> str:
    """The command for this Python that installs an extra, or what magmpm itself needs ("")."""
    return f"{Path(sys.executable).name} -m {install(extra)}"


def _libraries() -> Iterator[Check]:
    """The libraries that everything needs: there, new enough, and that they can be imported."""
    for needed in (one for one in _needed() if not one.extra):
        version = _installed(needed.name)
        name = f"library {needed.name}"
        if version is None:
            yield Check(name, FAIL, f"missing; {needed.least} or newer is needed", _install(""))
        elif _older(version, needed):
            yield Check(
                name,
                FAIL,
                f"{version}; {needed.least} or newer is needed",
                _install("") + " --upgrade",
            )
        else:
            failure = _tried(
                [sys.executable, "-c", f"import {IMPORTS.get(needed.name, needed.name)}"],
                PATIENCE["import"],
            )[1]
            remedy = f"{Path(sys.executable).name} -m pip install --force-reinstall {needed.name}"
            yield (
                Check(name, FAIL, f"{version} can't be imported: {failure}", remedy)
                if failure
                else Check(name, OK, version)
            )


def _extras() -> Iterator[Check]:
    """The optional parts in one list, and a warning for a library that is there but too old."""
    extras: dict[str, list[_Needed]] = {}
    for needed in _needed():
        if needed.extra and needed.name != "magmpm":  # an extra that takes in another one
            extras.setdefault(needed.extra, []).append(needed)
    absent = []
    for extra, all_needed in extras.items():
        versions = {needed: _installed(needed.name) for needed in all_needed}
        if old := [
            f"{one.name} {have} (older than {one.least})"
            for one, have in versions.items()
            if have and _older(have, one)
        ]:
            yield Check(
                f"extra {extra}",
                WARN,
                f"{'; '.join(old)}: {EXTRAS_FOR[extra]}",
                _install(extra),
            )
        elif None in versions.values():
            absent.append(extra)
    there = ", ".join(extra for extra in extras if extra not in absent)
    lacking = ", ".join(f"{extra} ({EXTRAS_FOR[extra]})" for extra in absent)
    found = f"there: {there or 'none'}" + (
        f"; not installed: {lacking}; to add one: {_install('NAME')}" if absent else ""
    )
    yield Check("optional parts", OK, found)


def _tried(arguments: list[str], patience: float) -> tuple[str, str]:
    """Run a process; return its output and the reason why it failed, "" if it did not."""
    try:
        done = subprocess.run(
            arguments,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=patience,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return "", f"no answer within {patience:g} s"
    except OSError as error:
        return "", str(error)
    if done.returncode == 0:
        return done.stdout, ""
    last = (done.stderr.strip().splitlines() or ["without a word"])[-1][:200]
    ended = (
        f"killed by signal {-done.returncode}"
        if done.returncode < 0
        else f"exit status {done.returncode}"
    )
    return done.stdout, f"{ended}: {last}"


def _threads() -> Iterator[Check]:
    """Cores that this process may use, and what the environment says about threads."""
    cores = (
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    )
    requested = os.environ.get("NUMBA_NUM_THREADS")
    found = f"{cores} of {os.cpu_count()} processors may be used" + (
        f"; NUMBA_NUM_THREADS={requested}" if requested else ""
    )
    allowed = _allowed_by_cgroup()
    if allowed is not None and allowed < cores:
        found += f"; the container's limit is {allowed:.3g}"
    if requested and requested.strip().isdigit() and int(requested) > cores:
        yield Check(
            "threads",
            WARN,
            found,
            "more threads than processors slow runs down: unset NUMBA_NUM_THREADS",
        )
    elif allowed is not None and allowed < cores and not requested:
        yield Check(
            "threads",
            WARN,
            found,
            f"set NUMBA_NUM_THREADS={max(1, int(allowed))}: threads beyond the limit slow runs "
            "down",
        )
    else:
        yield Check("threads", OK, found)
    if hasattr(os, "getloadavg") and os.getloadavg()[0] > 1.5 * cores:
        busy = f"{os.getloadavg()[0]:.1f} processes want {cores} processors"
        yield Check("load", OK, busy, "runs take longer while other programs compute")


def _allowed_by_cgroup() -> float | None:
    """Processors that a container may use at once, by cgroup v2; None without a limit."""
    try:
        quota, period = Path("/sys/fs/cgroup/cpu.max").read_text(encoding="ascii").split()
        return None if quota == "max" else int(quota) / int(period)
    except (OSError, ValueError):
        return None


def _room() -> Iterator[Check]:
    """The folder of compiled kernels: whether it takes files, how large it is, whether it is warm; and room for results."""
    folder = cache_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=folder):
            pass
    except OSError as error:
        remedy = "fix its permissions, or set NUMBA_CACHE_DIR to a writable folder"
        yield Check(
            "cache of kernels",
            FAIL,
            (
                f"{folder} is not writable ({error.strerror}): every run would compile its "
                "kernels again"
            ),
            remedy,
        )
    else:
        size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
        kernels = sum(1 for path in folder.rglob("*.nbc"))
        found = f"{folder}: {kernels} kernels, {size / 1e6:.0f} MB"
        if not kernels:
            yield Check(
                "cache of kernels",
                OK,
                f"{found}: the first run compiles them, and reports how long that took",
                "magmpm prepare",
            )
        elif size > 2_000_000_000:
            yield Check(
                "cache of kernels",
                OK,
                found,
                (f"remove {folder}; kernels are compiled again when needed"),
            )
        else:
            yield Check("cache of kernels", OK, found)
    free = shutil.disk_usage(Path.cwd()).free
    written = f"{free / 1e9:.1f} GB free in {Path.cwd()}"
    if not os.access(Path.cwd(), os.W_OK):
        yield Check(
            "folder of results",
            WARN,
            f"{Path.cwd()} can't be written",
            "work in another folder, or give --out",
        )
    elif free < 1_000_000_000:
        yield Check(
            "folder of results",
            WARN,
            written,
            "motions take about 100 MB: free disk space, or give --out on another disk",
        )
    else:
        yield Check("folder of results", OK, written)


_OPENGL = """
import json
from magmpm.viz.worker import Renderer
with Renderer() as renderer:
    renderer.wait_ready()
    print(json.dumps([renderer.backend, renderer.note]))
"""


def _opengl() -> Check:
    """Find out which renderer draws: tried in a process, since a missing OpenGL library is a segmentation fault."""
    if not installed("matplotlib"):
        return Check("OpenGL", OK, "not tried: pictures need the extra render", _install("render"))
    printed, failure = _tried([sys.executable, "-c", _OPENGL], PATIENCE["opengl"])
    if failure:
        remedy = "apt-get install libegl1 libgl1-mesa-dri; or set MAGMPM_RENDER=matplotlib"
        return Check("OpenGL", FAIL, f"no picture can be drawn: {failure}", remedy)
    backend, note = json.loads(printed.strip().splitlines()[-1])
    if backend == "pyvista":
        return Check("OpenGL", OK, "PyVista draws")
    if not note:
        return Check("OpenGL", OK, f"{backend} draws, as MAGMPM_RENDER says")
    says, _, remedy = note.partition(": ")
    return Check(
        "OpenGL",
        WARN if _installed("pyvista") else OK,
        says,
        remedy or "apt-get install libegl1 libgl1-mesa-dri",
    )


def _self_test() -> Iterator[Check]:
    """Numbers against stored answers, in a process of their own."""
    printed, failure = _tried([sys.executable, "-m", "magmpm.cli.self_test"], PATIENCE["self-test"])
    try:
        rows: list[dict[str, Any]] = json.loads(printed.strip().splitlines()[-1])
    except (ValueError, IndexError):
        rows = []
    for row in rows:
        found = f"{row['found']} ({row['rule']})"
        remedy = (
            ""
            if row["passed"]
            else (
                "report it, with the output of magmpm doctor --json; do not trust results "
                "on this machine until it is resolved"
            )
        )
        yield Check(f"self-test: {row['name']}", OK if row["passed"] else FAIL, found, remedy)
    if failure or not rows:
        yield Check(
            "self-test",
            FAIL,
            failure or "it said nothing",
            "reinstall numba and llvmlite; then: magmpm doctor",
        )
