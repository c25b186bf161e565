"""`magmpm prepare`: kernels compiled ahead of their first use."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

from magmpm.cli.answers import print_summary
from magmpm.cli.progress import Progress
from magmpm.scene import Scene, load_scene
from magmpm.solving.precompile import PROOFS, SOLVE, describe, fill_cache

_SILICONE = {"shear_modulus": 120e3, "bulk_to_shear": 20.0, "density": 1882.0, "remanence": 0.138}
_CATHETER = {"length": 8e-3, "diameter": 4e-3, "material": "silicone", "clamp": "base", "segments": [{"magnetization": [1.0, 0.0, 0.0]}]}
_GROUND = {"point": [0.0, 0.0, -50e-3], "normal": [0.0, 0.0, 1.0]}
_TORQUE: dict[str, Any] = {"magnetic_torque": {}}
_USUAL: tuple[tuple[dict[str, Any], dict[str, Any] | None], ...] = (  # effects and motion
    (_TORQUE, None),
    ({**_TORQUE, "gravity": {}}, None),
    ({**_TORQUE, "damping": {"rate": 60.0}}, {}),
    ({**_TORQUE, "gravity": {}, "damping": {"rate": 60.0}}, {}),
    ({**_TORQUE, "gravity": {}, "damping": {"rate": 60.0}, "ground": _GROUND}, {}),
    ({**_TORQUE, "gravity": {}, "damping": {"rate": 60.0}, "ground": _GROUND, "self_contact": {}}, {}),
)


def usual() -> Iterator[Scene]:
    """A scene for each of the usual combinations of effects, in a uniform field."""
    for effects, motion in _USUAL:
        solver: dict[str, Any] = {"static": {}} if motion is None else {"dynamic": {"duration": 0.1}}
        yield Scene.from_si(
            {
                "name": "usual",
                "materials": {"silicone": _SILICONE},
                "body": {"catheter": _CATHETER},
                "field": {"uniform": [0.0, 6e-3, 8e-3]},
                "effects": effects,
                "solver": solver,
            }
        )


def command(options: argparse.Namespace) -> int:
    """Compile the kernels of scene files, or without any of the usual combinations. Returns the exit status."""
    scenes = [load_scene(path) for path in options.scenes] or list(usual())
    done = []
    with Progress("kernels") as progress:
        for k, scene in enumerate(scenes):
            progress.at(k, len(scenes), describe(scene))
            uses = (SOLVE, PROOFS) if scene.resolution.asked else (SOLVE,)
            done.append({"kernels": describe(scene), "compiled": fill_cache(scene, progress.note, uses)})
    lines = [f"{'compiled' if each['compiled'] else 'ready':<9} {each['kernels']}" for each in done]
    print_summary(options, {"kernels": done}, "\n".join(lines))
    return 0
