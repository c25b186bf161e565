"""True error over promised error, for scenes drawn at random: is `resolution: {error: ...}` true?

    python tests/benchmarks/promised_error.py [--jointed] [--cells N] [--first SEED] [--scenes N] [--out FILE]

Each scene (drawn_scenes.py; seeds from 1000, none of which set any constant; with --jointed of soft and stiff segments, those from 3000
alike) is asked for an error of 0.02 to 2 % of the length, on the centreline or at the tip, and solved again with twice the cells of the
grid that proved the error (or as many as MOST_OPERATIONS allow, but 1.2 times as many at least), from its rod, as if nothing had been
asked. With --cells no error is asked for: the bound is that of a grid with so many, as magmpm.error tells it. Printed: the ratio of the
difference to the error_estimate, where the answer is not within the error asked for, failures, seconds.
"""

import math
from collections.abc import Callable
from time import perf_counter
from typing import Any

import numpy as np
from drawn_scenes import drawn, jointed, options_of, rows_of, shares

from magmpm import error, run
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
    options = options_of(__doc__, FIRST, SCENES, "promised_error.json", jointed=True, cells=True)
    draw_scene = jointed if options.jointed else drawn

    def row(seed: int) -> dict[str, Any]:
        return judged(asked(seed, draw_scene), seed, options.cells)

    print(summary(rows_of(options, row, told)))


def asked(seed: int, draw_scene: Callable[[int], Scene] = drawn) -> Scene:
    """The scene of a seed, with the error it is asked for."""
    draw = np.random.default_rng([7, seed])
    share = float(np.exp(draw.uniform(np.log(2e-4), np.log(2e-2))))
    of = ("centreline", "tip")[int(draw.random() < 0.25)]
    return Scene.from_si({**draw_scene(seed).to_si(), "resolution": {"error": share, "of": of}})


def judged(scene: Scene, seed: int, given: int | None = None) -> dict[str, Any]:
    """One scene: asked, promised and true error (m), or why there is none; given: cells across, in place of an error asked for."""
    row: dict[str, Any] = {
        "seed": seed,
        "name": scene.name,
        "slenderness": scene.length / scene.thickness,
        "requested": scene.resolution.error if given is None else math.inf,
    }
    begun = perf_counter()
    try:
        known = error(scene if given is None else scene.with_cells(given))
        took = perf_counter() - begun
        cells = known.report["cells_across"]
        result = run(scene.with_cells(cells))
    except MagmpmError as trouble:
        return {**row, "failed": str(trouble)}
    of = "centreline" if given is not None else scene.resolution.of
    row |= {"cells": cells, "promised": known.error, "length": scene.length, "of": of}
    row |= {"seconds": took, "proof": known.report["seconds_of_proof"]}
    row |= {"answer": known.report["seconds_of_answer"]}
    proof = known.report["finer"]["cells_across"]
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
    except MagmpmError as trouble:
        return {**row, "failed": f"no reference: {trouble}"}
    tip = float(np.linalg.norm(np.subtract(result.tip, truth.tip)))
    row["true"] = tip if of == "tip" else largest_distance(truth, result.centreline)
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
