"""`magmpm import`: a robot of the magneticMPM format becomes a scene."""

from __future__ import annotations

import argparse
import shlex

from magmpm.cli.answers import print_summary
from magmpm.scene.magnetic_mpm_import import import_robot


def command(options: argparse.Namespace) -> int:
    """Write the scene, and say what to do with it. Returns the exit status."""
    scene, warnings = import_robot(options.robot, options.output, overwrite=options.overwrite)
    regions = scene.regions()
    held = sum(region.held for region in regions)
    summary = {"scene": str(options.output), "name": scene.name, "parts": len(regions), "held": held, "warnings": warnings}
    text = [
        f"{scene.name}: {len(regions)} parts, {held} held",
        *(f"  warning  {warning}" for warning in warnings),
        f"saved {options.output}; set its field, then: magmpm run {shlex.quote(str(options.output))}",
    ]
    print_summary(options, summary, "\n".join(text))
    return 0
