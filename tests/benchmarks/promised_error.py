"""True error over promised error, for scenes drawn at random: is `resolution: {error: ...}` true?

    python tests/benchmarks/promised_error.py [--jointed] [--first SEED] [--scenes N] [--out FILE]

Each scene (drawn_scenes.py; seeds from 1000, none of which set any constant; with --jointed of soft and stiff segments, those from 3000
alike) is asked for an error of 0.02 to 2 % of the length, on the centreline or at the tip, and solved again with twice the cells of the
grid that proved the error (or as many as MOST_OPERATIONS allow, but 1.2 times as many at least), from its rod, as if nothing had been
asked. Printed: the ratio of the difference to the error_estimate, where the answer is not within the error asked for, failures, seconds.
"""

from collections.abc import Callable
from time import perf_counter
from typing import Any

import numpy as np
from drawn_scenes import drawn, jointed, options_of, rows_of, shares

from magmpm import run
from magmpm.errors import MagmpmError
from magmpm.results.measures import largest_distance
from magmpm.scene import Scene
from magmpm.statics.grids import operations

FIRST = 1000
SCENES = 100
MOST_OPERATIONS = 4e10  # of a factorization of the reference: some ten seconds a scene
# the reference's cells over those of the proof, at least, so that it is not the grid which told the
# error
FINER = 1.2


def main() -> None:
    options = options_of(__doc__, FIRST, SCENES, "promised_error.json", jointed=True)
    draw_scene = jointed if options.jointed else drawn
    print(summary(rows_of(options, lambda seed: judged(asked(seed, draw_scene), seed), told)))


def asked(seed: int, draw_scene: Callable[[int], Scene] = drawn) -> Scene:
    """The scene of a seed, with the error it is asked for."""
    draw = np.random.default_rng([7, seed])
    share = float(np.exp(draw.uniform(np.log(2e-4), np.log(2e-2))))
    of = ("centreline", "tip")[int(draw.random() < 0.25)]
    return Scene.from_si({**draw_scene(seed).to_si(), "resolution": {"error": share, "of": of}})


def judged(scene: Scene, seed: int) -> dict[str, Any]:
    """One scene: asked, promised and true error (m), or why there is none."""
    row: dict[str, Any] = {
        "seed": seed,
        "name": scene.name,
        "slenderness": scene.length / scene.thickness,
        "requested": scene.resolution.error,
    }
    begun = perf_counter()
    try:
        result = run(scene)
    except MagmpmError as error:
        return {**row, "failed": str(error)}
    assert result.resolution is not None
    cells = result.resolution["cells_across"]
    row |= {
        "cells": cells,
        "promised": result.error_estimate,
        "length": scene.length,
        "of": scene.resolution.of,
    }
    row |= {
        "seconds": perf_counter() - begun - result.seconds["compile"],
        "proof": result.resolution["seconds_of_proof"],
    }
    row |= {"answer": result.resolution["seconds_of_answer"]}
    proof = result.resolution["finer"]["cells_across"]
    reference = next(
        (
            n
            for n in range(min(2 * proof, 16), proof, -1)
            if operations(scene.with_cells(n))[0] <= MOST_OPERATIONS
        ),
        proof,
    )
    if reference < FINER * proof:
        return {**row, "failed": "no reference: a grid finer than the proof takes too long"}
    row["reference"] = reference
    try:
        truth = run(scene.with_cells(reference))
    except MagmpmError as error:
        return {**row, "failed": f"no reference: {error}"}
    tip = float(np.linalg.norm(np.subtract(result.tip, truth.tip)))
    row["true"] = (
        tip if scene.resolution.of == "tip" else largest_distance(truth, result.centreline)
    )
    return {**row, "ratio": row["true"] / row["promised"]}


def told(row: dict[str, Any]) -> str:
    """A scene in a line."""
    begin = f"{row['name']:26s} L/D {row['slenderness']:4.1f}, asked {100 * row['requested']:.3f} %"
    if "failed" in row:
        return f"{begin}: {row['failed'][:300]}"
    promised = 100 * row["promised"] / row["length"]
    return (
        f"{begin}: {row['cells']} cells, promised {promised:.4f} %, true/promised"
        f" {row['ratio']:.2f}, {row['seconds']:.2f} s"
    )


def summary(rows: list[dict[str, Any]]) -> str:
    """Summary of all scenes."""
    known = [row for row in rows if "ratio" in row]
    kept = sum(row["true"] <= row["requested"] * row["length"] for row in known)
    spread = shares(np.array([row["ratio"] for row in known]))
    return (
        f"{len(rows)} scenes, {len(known)} judged: {spread}; within the error asked for: {kept} of"
        f" {len(known)}"
    )


if __name__ == "__main__":
    main()
