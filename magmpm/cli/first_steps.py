"""Commands that make something ready: `magmpm examples`, `import` and `prepare`."""

from __future__ import annotations

import argparse
import filecmp
import shlex
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from magmpm.cli.answers import print_summary
from magmpm.errors import InputError, MagmpmError

if TYPE_CHECKING:
    from magmpm.scene import Scene

INSTALLED = "share/magmpm/data/"  # where a wheel puts the examples, below the environment's root


def examples(options: argparse.Namespace) -> int:
    """Copy what comes with magmpm to where it can be changed. Returns the exit status. Raises InputError where another file is there."""
    source = examples_folder()
    target = options.folder / "data"
    files = sorted(
        path.relative_to(source)
        for path in source.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    )
    if target.exists() and target.resolve() == source.resolve():
        raise InputError(
            f"{target}: this is where the installed examples are",
            rule="examples are copied to another folder",
            remedy="name another",
        )
    changed = [
        name
        for name in files
        if (target / name).exists() and not filecmp.cmp(source / name, target / name, shallow=False)
    ]
    if changed and not options.overwrite:
        raise InputError(
            (
                f"{target}: {len(changed)} of the files there differ from the examples, such as "
                f"{changed[0]}"
            ),
            rule="files that were changed are kept",
            remedy="name another folder, or give --overwrite, which restores the original examples",
        )
    for name in files:
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source / name, target / name)
    first = target / "scenes/five_segments.yaml"
    text = f"{len(files)} files in {target}; try: magmpm run {first} --render"
    print_summary(options, {"folder": str(target), "files": len(files)}, text)
    return 0


def examples_folder() -> Path:
    """Folder of the examples: in the checkout, or where pip put them. Raises MagmpmError where they are gone."""
    checkout = Path(__file__).resolve().parents[2] / "data"
    if (checkout / "scenes").is_dir():
        return checkout
    from importlib.metadata import PackageNotFoundError, files

    try:
        known = files("magmpm") or []
    except PackageNotFoundError:
        known = []
    for name in known:
        if INSTALLED in name.as_posix():
            place = Path(str(name.locate())).resolve()
            return next(folder for folder in place.parents if folder.name == "data")
    raise MagmpmError(
        "the examples are not installed; reinstall magmpm: pip install --force-reinstall "
        "magmpm-*.whl"
    )


def import_robot(options: argparse.Namespace) -> int:
    """Make a scene of a robot of the magneticMPM format, and say what to do with it. Returns the exit status."""
    from magmpm.scene import magnetic_mpm_import

    scene, warnings = magnetic_mpm_import.import_robot(
        options.robot, options.output, overwrite=options.overwrite
    )
    regions = scene.regions()
    held = sum(region.held for region in regions)
    summary = {
        "scene": str(options.output),
        "name": scene.name,
        "parts": len(regions),
        "held": held,
        "warnings": warnings,
    }
    text = [
        f"{scene.name}: {len(regions)} parts, {held} held",
        *(f"  warning  {warning}" for warning in warnings),
        (
            f"saved {options.output}; set its field, then: magmpm run"
            f" {shlex.quote(str(options.output))}"
        ),
    ]
    print_summary(options, summary, "\n".join(text))
    return 0


def prepare(options: argparse.Namespace) -> int:
    """Compile the kernels of scene files, or without any of the usual combinations. Returns the exit status."""
    from magmpm.cli.answers import Progress
    from magmpm.scene import load_scene
    from magmpm.solving.precompile import PROOFS, SOLVE, describe, fill_cache

    scenes = [load_scene(path) for path in options.scenes] or list(usual())
    done = []
    with Progress("kernels") as progress:
        for k, scene in enumerate(scenes):
            progress.at(k, len(scenes), describe(scene))
            uses = (SOLVE, PROOFS) if scene.resolution.requested else (SOLVE,)
            done.append(
                {"kernels": describe(scene), "compiled": fill_cache(scene, progress.note, uses)}
            )
    lines = [f"{'compiled' if each['compiled'] else 'ready':<9} {each['kernels']}" for each in done]
    print_summary(options, {"kernels": done}, "\n".join(lines))
    return 0


def usual() -> Iterator[Scene]:
    """A scene for each of the usual combinations of effects, in a uniform field: two at rest, four in motion."""
    from magmpm.scene import Scene

    weight: dict[str, Any] = {"gravity": {}}
    damping: dict[str, Any] = {"damping": {"rate": 60.0}}
    ground = {"ground": {"point": [0.0, 0.0, -50e-3], "normal": [0.0, 0.0, 1.0]}}
    motion = {"dynamic": {"duration": 0.1}}
    combinations: tuple[tuple[dict[str, Any], dict[str, Any]], ...] = (
        ({}, {}),
        (weight, {}),
        (damping, motion),
        (weight | damping, motion),
        (weight | damping | ground, motion),
        (weight | damping | ground | {"self_contact": {}}, motion),
    )
    segments = [{"magnetization": [1.0, 0.0, 0.0]}]
    for effects, solver in combinations:
        yield Scene.from_si(
            {
                "name": "usual",
                "materials": {
                    "silicone": {
                        "shear_modulus": 120e3,
                        "bulk_to_shear": 20.0,
                        "density": 1882.0,
                        "remanence": 0.138,
                    }
                },
                "body": {
                    "catheter": {
                        "length": 8e-3,
                        "diameter": 4e-3,
                        "material": "silicone",
                        "clamp": "base",
                        "segments": segments,
                    }
                },
                "field": {"uniform": [0.0, 6e-3, 8e-3]},
                "effects": {"magnetic_torque": {}, **effects},
                "solver": solver or {"static": {}},
            }
        )
