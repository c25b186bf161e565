"""Drawings of results in notebooks: plain SVG and tables, without any library.

A body at rest: its axis from the side and from above, undeformed and deformed, to one scale, with what counts in a table. A motion: the
path of its middle. viz draws the pictures of papers.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from magmpm.results.readable import lengths, quantity, stability_in_words
from magmpm.scene.notebook import panels, table


def of_result(result: Any) -> str:
    """A Result as HTML: its axis, m, and figures."""
    rows = [("tip", lengths(result.tip)), ("det F", f"{result.min_det_F:.4f} to {result.max_det_F:.4f}")]
    if not result.converged:
        rows.insert(0, ("NOT CONVERGED", result.failure or "the last good state"))
    if result.stability is not None:
        rows.append(("stability", stability_in_words(result.stability)))
    if result.error_estimate is not None:
        rows.append(("error of the grid", f"at most {quantity(result.error_estimate, 'm')}"))
    rows += [("unknowns, particles", f"{result.dof}, {result.particles}"), ("solve", quantity(result.seconds.get("solve", 0.0), "s"))]
    rows += [("warning", text) for text in result.warnings]
    axis = result.centreline
    if not len(axis):
        return table(result.name, rows)
    straight = np.column_stack([axis[:, 0] + axis[0, 1] - axis[0, 0], np.full((len(axis), 2), axis[0, 2:])])
    return panels([straight, axis[:, 1:]]) + table(result.name, rows)


def of_motion(motion: Any) -> str:
    """A Motion as HTML: how the middle of its particles moves, m, and its times."""
    some = np.unique(np.linspace(0, len(motion) - 1, 40).astype(int)).tolist() if len(motion) else []
    middles = np.array([np.asarray(motion[k].position).mean(axis=0) for k in some])
    last = quantity(float(motion.times[-1]), "s") if len(motion) else "none yet"
    rows = [("frames", str(len(motion))), ("last", last), ("particles", str(len(motion.reference))), ("folder", str(motion.folder))]
    return (panels([middles], width=2.0) if len(middles) > 1 else "") + table(motion.name, rows)
