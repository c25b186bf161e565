"""A study in memory: what its file says, with the scene and the target that it names."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from magmpm.compiled.arrays import Array, Plain
from magmpm.errors import InputError
from magmpm.scene import Scene
from magmpm.scene.options import Resolution
from magmpm.studies.problem.sampler_names import check_sampler_name
from magmpm.studies.problem.study_file import MOST_TRIALS, Limits, Robust
from magmpm.studies.problem.variables import Vary


@dataclass(frozen=True)
class ShapeKeyframe:
    """A shape of a schedule.

    Attributes
    ----------
    time : float, s
        When the body must have it.
    target : array (m, 4), m
        Rows [s, x, y, z].
    """

    time: float
    target: Array


@dataclass(frozen=True)
class Study:
    """A study with the scene and the target that it names. SI.

    Attributes
    ----------
    path : Path
        The study's file.
    name : str
        The file's name without its ending, which names the folder of results.
    scene : Scene
        With the coarsest grid where its file requests an error: trials are compared on it.
    target : array (m, 4), m
        Rows [s, x, y, z]; of an insertion its path, of a schedule the last shape.
    vary : Vary
        What each trial may change.
    trials : int
        Number of trials that are wanted.
    sampler : str
        Its name.
    seed : int
        Of all that is drawn at random.
    stop_rms : float, m, or None
        The distance at which the study stops.
    scene_file : Path or None
        The scene's file; None for a study made in Python.
    depths : tuple of float, m
        Inserted lengths, increasing; none without an insertion.
    keyframes : tuple of ShapeKeyframe
        The shapes of a schedule; none without one.
    hold : float, s
        How long a schedule's field stays at the end.
    minimize : tuple of str
        What a trial's values are.
    robust : Robust or None
        Errors of manufacture that a design must bear.
    margin : float, no unit, or None
        The least stability that a design may have.
    limits : Limits or None
        Limits of manufacture on directions.
    start : str or None
        "rod" to begin with the rod's designs, or None.
    requested : Resolution or None
        The error that the scene's file requests, or None.
    why_sampler : str or None
        Reason for the sampler where the file names none.
    """

    path: Path
    name: str
    scene: Scene
    target: Array
    vary: Vary
    trials: int
    sampler: str
    seed: int
    stop_rms: float | None
    scene_file: Path | None = None
    depths: tuple[float, ...] = ()
    keyframes: tuple[ShapeKeyframe, ...] = ()
    hold: float = 0.0
    minimize: tuple[str, ...] = ("rms",)
    robust: Robust | None = None
    margin: float | None = None
    limits: Limits | None = None
    start: str | None = None
    requested: Resolution | None = None
    why_sampler: str | None = None

    @property
    def turned(self) -> list[int]:
        """Indices of the regions whose directions are varied."""
        directions = self.vary.magnetization
        return [] if directions is None else directions.regions(self.scene)

    @property
    def field_max(self) -> float | None:
        """Greatest strength of a varied field, T; None for a fixed field."""
        return None if self.vary.field is None else self.vary.field.max

    @property
    def fields(self) -> int:
        """Number of fields that are varied, if any is: one, or one at each depth or time."""
        at = "once" if self.vary.field is None else self.vary.field.at
        return {"once": 1, "each depth": len(self.depths), "each time": len(self.keyframes)}[at]

    def changed(self, *, trials: int | None = None, sampler: str | None = None) -> Study:
        """Make the study with what a command line overrides.

        Parameters
        ----------
        trials : int, optional
            Number of trials.
        sampler : str, optional
            Name of the sampler.

        Returns
        -------
        Study
            The changed study.

        Raises
        ------
        InputError
            For a number or a name that can't be.
        """
        check_trials(trials)
        if sampler is not None:
            check_sampler_name(sampler, "--sampler")
        return dataclasses.replace(
            self,
            trials=self.trials if trials is None else trials,
            sampler=self.sampler if sampler is None else sampler,
            why_sampler=self.why_sampler if sampler is None else None,
        )

    def definition(self) -> Plain:
        """Collect all that decides which trials are made and how they are evaluated.

        Of the scene it leaves out names, and what the study varies anyway: starting values do not
        count.

        Returns
        -------
        dict[str, Any]
            Plain data; numbers in SI, the target in mm.
        """
        vary = self.vary.model_dump(mode="json", exclude_none=True)
        if self.vary.field is not None and self.vary.field.at == "once":
            del vary["field"]["at"]  # as in studies before there was a choice
        match: Any = {"path" if self.depths else "centreline": _rows(self.target)}
        if self.keyframes:
            match = [
                {"time": frame.time, "centreline": _rows(frame.target)} for frame in self.keyframes
            ]
        return {
            "scene": self._fixed_scene(),
            "vary": vary,
            "match": match,
            "sampler": self.sampler,
            "seed": self.seed,
            **self._more(),
        }

    def _fixed_scene(self) -> Plain:
        """The scene's data without what varies."""
        scene = self.scene
        if self.turned:
            directions = np.array([region.magnetization for region in scene.regions()])
            directions[self.turned] = [1.0, 0.0, 0.0]
            scene = scene.with_magnetizations(directions)
        content: Plain = scene.model_dump(
            mode="json", exclude={"name", "reference"}, exclude_none=True
        )
        if self.requested is not None:
            content["resolution"] = self.requested.model_dump(mode="json")
        if self.vary.field is not None:
            content["field"] = "varied"
        body = content["body"][scene.body.kind]
        if self.vary.diameter is not None:
            body["diameter"] = "varied"
        if self.vary.length is not None:
            for segment in body["segments"]:
                segment["length"] = "varied"
            if self.vary.length.total == "free":
                body["length"] = "varied"
        return content

    def _more(self) -> Plain:
        """The keys that most studies do not have: they count only where they are given, so that older studies stay what they are."""
        given = {
            "insertion": {"depths": list(self.depths)} if self.depths else None,
            "schedule": {"hold": self.hold} if self.keyframes else None,
            "minimize": list(self.minimize) if self.minimize != ("rms",) else None,
            "robust": None
            if self.robust is None
            else self.robust.model_dump(mode="json", exclude_none=True),
            "stability": None if self.margin is None else {"margin": self.margin},
            "limits": (
                None
                if self.limits is None
                else self.limits.model_dump(mode="json", exclude_none=True)
            ),
            "start": self.start,
        }
        return {key: value for key, value in given.items() if value is not None}


def check_trials(trials: int | None) -> None:
    """Refuse a number of trials that can't be.

    Parameters
    ----------
    trials : int or None
        Their number, or None.

    Raises
    ------
    InputError
        For one that can't be.
    """
    if trials is not None and not 1 <= trials <= MOST_TRIALS:
        rule = "must be at least 1" if trials < 1 else f"must be at most {MOST_TRIALS}"
        raise InputError("--trials", received=str(trials), rule=rule, remedy="--trials 35")


def _rows(target: Array) -> list[str]:
    """A target in mm, a text a row."""
    return [" ".join(f"{x:.6g}" for x in row) for row in (1e3 * target + 0.0).tolist()]
