"""What a study file says: the scene, what is varied, what it must match, and how it is searched.

`load_study(path)` reads a file and all it names. A study's *definition* is everything that decides which trials are
made and how they are judged; the length of the study (`trials`, `stop`) is not part of it, so a study can be
extended, but is never silently continued as a different one.
"""

from __future__ import annotations

import dataclasses
import difflib
import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, WithJsonSchema, model_validator

from magmpm.errors import InputError, NotThereYet, report
from magmpm.inputs.csv_tables import read_centreline
from magmpm.inputs.folder_names import folder_fault
from magmpm.inputs.settings import Quantity, Settings, fault, validate
from magmpm.inputs.yaml_document import Document, read_yaml
from magmpm.scene import Scene, load_scene

SAMPLERS = ("tpe", "gp", "cmaes", "random")
LATER_SAMPLERS = {"gauss-newton": "search along the sensitivities of the shape"}
MOST_TRIALS = 1_000_000
STRETCH = 1.1  # a target may be this much longer than the part of the catheter it belongs to
SHOWN_DIFFERENCES = 12


class VaryMagnetization(Settings):
    """The direction of each magnetized segment: two angles. No settings."""


class VaryField(Settings):
    """The uniform outside field: its strength and two angles."""

    max: Annotated[float, Quantity("flux density", above="0 mT", at_most="20 T")] = Field(
        description="Greatest strength of the field.", examples=["10 mT"]
    )


class Vary(Settings):
    """What the study may change."""

    magnetization: VaryMagnetization | None = Field(
        default=None, description="The direction of each magnetized segment: {}.", examples=["{}"]
    )
    field: VaryField | None = Field(
        default=None, description="The outside field, up to a greatest strength.", examples=["{max: 10 mT}"]
    )

    @model_validator(mode="after")
    def _something(self) -> Vary:
        if self.magnetization is None and self.field is None:
            raise fault("a study must vary something", "add `magnetization: {}`")
        return self


class Match(Settings):
    """What the catheter's shape is compared with."""

    centreline: str = Field(
        min_length=1,
        description="Path, relative to this file, of a CSV table with columns s_mm,x_mm,y_mm,z_mm.",
        examples=["../targets/s_shape.csv"],
    )


def _known_sampler(value: Any) -> Any:
    if not isinstance(value, str) or value not in (*SAMPLERS, *LATER_SAMPLERS):
        near = difflib.get_close_matches(str(value).lower(), SAMPLERS, n=1, cutoff=0.5)
        remedy = f'did you mean "{near[0]}"?' if near else "write, say, `sampler: tpe`"
        raise fault(f"must be {', '.join(SAMPLERS[:-1])} or {SAMPLERS[-1]}", remedy)
    return value


class Stop(Settings):
    """When a study is done before its last trial."""

    rms: Annotated[float, Quantity("length", above="0 mm", at_most="10 m")] = Field(
        description="Root mean square distance to the target that is good enough.", examples=["2 mm"]
    )


class StudyFile(Settings):
    """A study: the scene, what is varied, what it must match, and how it is searched."""

    scene: str = Field(
        min_length=1,
        description="Path of the scene, relative to this file.",
        examples=["../scenes/five_segments.yaml"],
    )
    vary: Vary = Field(description="What the study may change.", examples=["{magnetization: {}}"])
    match: Match = Field(description="The target shape.", examples=["{centreline: ../targets/s_shape.csv}"])
    trials: int = Field(
        default=35,
        strict=True,
        ge=1,
        le=MOST_TRIALS,
        description="Trials in all; 35 unless given.",
        examples=[35],
    )
    sampler: Annotated[
        str, BeforeValidator(_known_sampler), WithJsonSchema({"type": "string", "enum": list(SAMPLERS)})
    ] = Field(default="tpe", description="How trials are chosen; tpe unless given.", examples=["tpe"])
    seed: int = Field(
        default=1,
        strict=True,
        ge=0,
        le=2**32 - 1,
        description="The same seed gives the same trials; 1 unless given.",
        examples=[1],
    )
    stop: Stop | None = Field(
        default=None, description="Ends the study early, when it is good enough.", examples=["{rms: 2 mm}"]
    )


@dataclass(frozen=True)
class Study:
    """A study with the scene and target it names. SI.

    path: the file; name: the file's name without its ending, which names the folder of results; target (m, 4) m: rows
    [s, x, y, z]; field_max T or None (fixed field); stop_rms m or None; scene_file: the file of the scene, None for
    a study made in Python.
    """

    path: Path
    name: str
    scene: Scene
    target: NDArray[np.float64]
    vary_magnetization: bool
    field_max: float | None
    trials: int
    sampler: str
    seed: int
    stop_rms: float | None
    scene_file: Path | None = None

    def changed(self, *, trials: int | None = None, sampler: str | None = None) -> Study:
        """The study with what a command line overrides. Raises InputError (NotThereYet for later samplers)."""
        if trials is not None and not 1 <= trials <= MOST_TRIALS:
            rule = "must be at least 1" if trials < 1 else f"must be at most {MOST_TRIALS}"
            raise InputError(report("--trials", received=str(trials), rule=rule, remedy="--trials 35"))
        if sampler is not None:
            check_sampler_name(sampler, "--sampler")
        return dataclasses.replace(
            self,
            trials=self.trials if trials is None else trials,
            sampler=self.sampler if sampler is None else sampler,
        )

    def definition(self) -> dict[str, Any]:
        """All that decides which trials are made and how they are judged, as plain data; numbers in SI, the target in mm.

        Of the scene it leaves out names, and what the study varies anyway: starting values do not count.
        """
        scene = self.scene
        if self.vary_magnetization:
            magnetized = np.isin(np.arange(len(scene.regions())), scene.magnetized_regions())
            scene = scene.with_magnetizations(np.outer(magnetized, [1.0, 0.0, 0.0]))
        content = scene.model_dump(mode="json", exclude={"name", "reference"}, exclude_none=True)
        if self.field_max is not None:
            content["field"] = "varied"
        vary: dict[str, Any] = {"magnetization": {}} if self.vary_magnetization else {}
        if self.field_max is not None:
            vary["field"] = {"max": self.field_max}
        rows = [" ".join(f"{x:.6g}" for x in row) for row in (1e3 * self.target + 0.0).tolist()]
        return {
            "scene": content,
            "vary": vary,
            "match": {"centreline": rows},
            "sampler": self.sampler,
            "seed": self.seed,
        }


def load_study(path: Path | str) -> Study:
    """The study a file describes, with the scene and the target it names.

    Raises InputError (NotThereYet for what a later version brings) with file, line, key, value, rule and remedy.
    """
    document = read_yaml(path)
    _check_name(document.path)
    file = validate(StudyFile, document)
    if file.sampler in LATER_SAMPLERS:
        check_sampler_name(file.sampler, _place(document, "sampler"))
    folder = document.path.parent
    try:
        scene = load_scene(folder / file.scene)
    except InputError as error:
        raise _named_in(error, _place(document, "scene")) from None
    try:
        target = read_centreline(folder / file.match.centreline)
    except InputError as error:
        raise _named_in(error, _place(document, "match", "centreline")) from None
    _check_scene(scene, file, document)
    _check_target(target, scene.length, folder / file.match.centreline, document)
    return Study(
        path=document.path,
        name=document.path.stem,
        scene=scene,
        target=target,
        vary_magnetization=file.vary.magnetization is not None,
        field_max=None if file.vary.field is None else file.vary.field.max,
        trials=file.trials,
        sampler=file.sampler,
        seed=file.seed,
        stop_rms=None if file.stop is None else file.stop.rms,
        scene_file=folder / file.scene,
    )


def _check_name(path: Path) -> None:
    """The file's name names the folder of results: `..yaml` would name the folder of all of them."""
    found = folder_fault(path.stem)
    if found is not None:
        place, received = f"{path}: its name without the ending names the folder of results", f'"{path.stem}"'
        raise InputError(report(place, received=received, rule=found[0], remedy=f"rename the file; {found[1]}"))


def check_sampler_name(name: str, place: str) -> None:
    """Raises NotThereYet for samplers of a later version, InputError for unknown names."""
    known = f"samplers: {', '.join(SAMPLERS)}"
    if name in LATER_SAMPLERS:
        rule = f"`{name}` ({LATER_SAMPLERS[name]}) is not there yet in this version; {known}"
        raise NotThereYet(report(place, received=f'"{name}"', rule=rule, remedy="sampler: tpe"))
    if name not in SAMPLERS:
        raise InputError(report(place, received=f'"{name}"', rule=known, remedy="sampler: tpe"))


def _named_in(error: InputError, place: str) -> InputError:
    """An error in a file that the study names, with the place that names it."""
    kind = NotThereYet if isinstance(error, NotThereYet) else InputError
    return kind(f"{error}\n  named in: {place}")


def _place(document: Document, *key: str) -> str:
    line = next((document.lines[key[:n]] for n in range(len(key), 0, -1) if key[:n] in document.lines), 1)
    return f"{document.path}:{line}: {'.'.join(key)}"


def _check_scene(scene: Scene, file: StudyFile, document: Document) -> None:
    """A study turns magnets in a field, so the scene must have magnets, and a field unless that is varied."""
    if scene.body.shape.line is None:
        rule = "a study compares centrelines, and a body of STL parts has none"
        remedy = "name a scene of a catheter or a strip"
    elif file.vary.magnetization is not None and not scene.body.shape.magnetized_by_region:
        rule = "a study varies segments, and this strip has a magnetization_profile in their place"
        remedy = "give the strip `segments`"
    elif scene.effects.magnetic_torque is None:
        rule = "the scene of a study must name the effect magnetic_torque: without it, magnets do nothing"
        remedy = "add `effects: {magnetic_torque: {}}` to the scene"
    elif not scene.magnetized_regions():
        rule = "the scene of a study must have a magnetized segment"
        remedy = "give the segments that may be magnetized a direction, say, `magnetization: [1, 0, 0]`"
    elif file.vary.field is None and not scene.field.acts:
        rule = "the field of the scene must not be zero while the study does not vary it"
        remedy = "give the scene a field, or add `field: {max: 10 mT}` to `vary`"
    else:
        return
    raise InputError(report(_place(document, "scene"), received=f'"{file.scene}"', rule=rule, remedy=remedy))


def _check_target(target: NDArray[np.float64], length: float, csv: Path, document: Document) -> None:
    """The target must belong to a catheter of this length that starts at the origin.

    A silicone catheter bends but hardly stretches. Points farther apart than the length of catheter between them show a mistake in
    the table (units, columns, another catheter), which a search would never reveal.
    """
    place = f"{csv} (named in {_place(document, 'match', 'centreline')})"
    if target[-1, 0] > length * (1 + 1e-6):
        received = f"s_mm up to {1e3 * target[-1, 0]:g}"
        rule = f"s_mm of the target must not exceed the catheter's length, {1e3 * length:g} mm"
        remedy = "check that the target belongs to this catheter"
        raise InputError(report(place, received=received, rule=rule, remedy=remedy))
    rows = target if target[0, 0] == 0 else np.vstack([np.zeros(4), target])
    if np.linalg.norm(rows[0, 1:]) > 0.01 * length:
        received = f"{1e3 * rows[0, 1:]} mm at s = 0"
        rule = "the target must start at the catheter's base, the origin"
        raise InputError(report(place, received=received, rule=rule, remedy="move the target"))
    apart = np.linalg.norm(np.diff(rows[:, 1:], axis=0), axis=1)
    along = np.diff(rows[:, 0])
    worst = int(np.argmax(apart - STRETCH * along))
    if apart[worst] > STRETCH * along[worst] + 0.001 * length:
        a, b = 1e3 * rows[worst, 0], 1e3 * rows[worst + 1, 0]
        received = f"points {1e3 * apart[worst]:.4g} mm apart at s_mm = {a:g} and {b:g}"
        rule = "points must not be further apart than the catheter between them is long (it bends, but hardly stretches)"
        remedy = "check units, columns, and that the catheter leaves the base along +x"
        raise InputError(report(place, received=received, rule=rule, remedy=remedy))
    if apart.sum() < 0.2 * along.sum():
        received = f"points that span {1e3 * apart.sum():.4g} mm along {1e3 * along.sum():.4g} mm of catheter"
        rule = "the target's points must follow the catheter"
        raise InputError(report(place, received=received, rule=rule, remedy="check units: columns are in mm"))


def definition_hash(definition: Mapping[str, Any]) -> str:
    """SHA-256, in hex, of a definition; numbers count to 12 digits, the order of keys does not."""
    return hashlib.sha256(json.dumps(dict(_flat(definition)), sort_keys=True).encode()).hexdigest()


def differences(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    """What changed between two definitions, one line a key: `sampler: tpe -> random`."""
    was, now = dict(_flat(old)), dict(_flat(new))
    keys = [*was, *(key for key in now if key not in was)]
    lines = [
        f"{key}: {was.get(key, 'nothing')} -> {now.get(key, 'nothing')}"
        for key in keys
        if was.get(key) != now.get(key)
    ]
    if len(lines) > SHOWN_DIFFERENCES:
        lines[SHOWN_DIFFERENCES:] = [f"and {len(lines) - SHOWN_DIFFERENCES} more"]
    return lines


def _flat(content: Any, key: str = "") -> Iterator[tuple[str, str]]:
    """("body.catheter.length", "0.04") for every leaf of nested data."""
    if isinstance(content, Mapping) and content:
        for name, value in content.items():
            yield from _flat(value, f"{key}.{name}" if key else str(name))
    elif isinstance(content, (list, tuple)) and content:
        for i, value in enumerate(content):
            yield from _flat(value, f"{key}[{i}]")
    elif isinstance(content, (int, float)) and not isinstance(content, bool):
        yield key, f"{content + 0.0:.12g}"
    else:
        yield key, content if isinstance(content, str) else json.dumps(content)
