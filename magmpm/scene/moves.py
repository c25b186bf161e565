"""Motion of what holds a body: `move: {tip: {along: [-1, 0, 0], distance: 0.47 mm}}`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from pydantic import Field, model_validator

from magmpm.bodies.body_shape import BodyShape
from magmpm.compiled.arrays import Array
from magmpm.fields.over_time import OverTime
from magmpm.fields.schedule import ended, strength_of
from magmpm.inputs.settings import Length, Settings, fault
from magmpm.inputs.vectors import Axis


class Move(Settings):
    """A held part, or a held end, is moved along a line."""

    along: Axis = Field(description="Direction: [x, y, z] or angles.", examples=[[-1, 0, 0]])
    distance: Length = Field(description="How far.", examples=["0.47 mm"])
    over_time: OverTime | None = Field(
        default=None,
        description=(
            "The share of the distance over time, as the strength of a field: ramp, oscillation,"
            " keyframes or table. All of it, at all times, unless given."
        ),
        examples=[{"ramp": {"duration": "50 ms"}}],
    )

    @model_validator(mode="after")
    def _share_alone(self) -> Move:
        over = self.over_time
        if over is not None and over.rotation is not None:
            raise fault(
                "a motion along a line does not rotate",
                "remove rotation",
                ("over_time", "rotation"),
            )
        for k, frame in enumerate(over.frames if over is not None else ()):
            if frame.uniform is not None or frame.move is not None:
                at = (
                    ("over_time", "keyframes", k)
                    if over is not None and over.keyframes is not None
                    else ("over_time", "table")
                )
                raise fault(
                    "keyframes of `move` give only the share of its distance",
                    "write, say, `strength: 1`",
                    at,
                )
        return self

    @property
    def end(self) -> float:
        """Time when its schedule has ended, s; 0 where it has none or never ends."""
        return ended(self.over_time)

    def share(self, times: Array | float | None) -> Array:
        """Share (k,) of the distance at times (k,) s; (1,) at the end of its schedule for None."""
        at = np.atleast_1d(np.asarray(self.end if times is None else times, dtype=float))
        return np.ones(len(at)) if self.over_time is None else strength_of(self.over_time, at)

    @property
    def whole(self) -> Array:
        """Displacement (3,) m by all of its distance."""
        return self.distance * np.array(self.along)

    def displacement(self, times: Array | float | None) -> Array:
        """Displacement (k, 3) m at times (k,) s; (1, 3) at the end of its schedule for None."""
        return self.share(times)[:, None] * self.whole


Moves = Mapping[str, Move]


def holders(shape: BodyShape) -> tuple[str, ...]:
    """Names of what holds a body: base, tip, or its parts that are clamped."""
    ends = {"base": ("base",), "both": ("base", "tip"), "none": ()}
    return ends.get(
        shape.clamp, tuple(dict.fromkeys(region.name for region in shape.regions() if region.held))
    )


def farthest(moves: Moves) -> float:
    """Largest displacement by any of them, m."""
    return max(
        (
            float(np.linalg.norm(move.displacement(_moments([move])), axis=1).max())
            for move in moves.values()
        ),
        default=0.0,
    )


def check(scene: Any) -> None:
    """Raises PydanticCustomError (see `fault`) for the first rule of what a Scene moves that is broken."""
    torn = 10.0  # times the length: the softest silicones tear there, filled ones long before
    moves = scene.move or {}
    shape = scene.body.shape
    held = holders(shape)
    for name, move in moves.items():
        at = ("move", name)
        over = move.over_time
        if name not in held:
            raise fault(
                f"only held ends and parts can be moved; held here: {', '.join(held) or 'nothing'}",
                "move one of them, or hold this one: `clamp: both` in body.strip, or `clamp: true`"
                " in a part",
                at,
            )
        if scene.effects.feed is not None:
            raise fault("feed moves the base already", "do not name feed, or remove move", at)
        if shape.in_plane_strain and move.along[1]:
            raise fault(
                "nothing moves along y in plane strain", "write, say, [-1, 0, 0]", (*at, "along")
            )
        if (
            over is not None
            and over.endless is not None
            and scene.static
            and scene.solver.quasi_static is None
        ):
            rule = "an equilibrium takes the motion at the end of its schedule, and this has no end"
            raise fault(
                rule, "add `cycles` to say when it stops", (*at, "over_time", "oscillation")
            )
        if not scene.static and move.share(0.0)[0] != 0.0:
            rule = "a motion begins with the undeformed body: at 0 s nothing has been moved"
            say = "`over_time: {ramp: {duration: 50 ms}}`"
            raise fault(rule, f"write, say, {say}", (*at, "over_time") if over is not None else at)
    if moves and shape.line is not None and shape.clamp == "both":
        times = _moments(list(moves.values()))
        base, tip = (
            moves[name].displacement(times) if name in moves else np.zeros(3)
            for name in ("base", "tip")
        )
        between = np.array([shape.length, 0.0, 0.0]) + (tip - base)
        left = float(between[..., 0].min())
        apart = float(np.linalg.norm(between, axis=-1).max())
        last = next(name for name in ("tip", "base") if name in moves)
        if apart > torn * shape.length:
            raise fault(
                f"silicone tears before it is {torn:g} times as long, and the ends would be "
                f"{1e3 * apart:.4g} mm apart, from {1e3 * shape.length:.4g} mm",
                "check the unit of the distance, or write a smaller one",
                ("move", last, "distance"),
            )
        if not left > 0.0:
            raise fault(
                f"the ends would pass through each other: they would come within {1e3 * left:.4g}"
                f" mm of {1e3 * shape.length:.4g} mm",
                "check the unit of the distance, and the sign of `along`",
                ("move", last, "distance"),
            )


def _moments(moves: list[Move]) -> Array:
    """Times (k,) s that sample what is moved."""
    frames = [
        frame.time
        for move in moves
        if move.over_time is not None
        for frame in move.over_time.frames
    ]
    swings = [
        move.over_time.oscillation
        for move in moves
        if move.over_time is not None and move.over_time.oscillation is not None
    ]
    periods = [swing.start + 1.0 / swing.frequency for swing in swings]
    return np.unique(
        np.concatenate(
            [frames, np.linspace(0.0, max([*periods, *(move.end for move in moves)]), 1000)]
        )
    )
