"""Converts robots of the magneticMPM format to scenes.

For each segment a robot file names an STL mesh (in millimeters, in the folder `meshes` beside it), a magnetization vector, density
(kg/m^3), shear modulus (Pa) and whether it is fixed, and one `remenance` (T, so spelled) for all. K = 20 G is implied. It says nothing of
field, ground or damping: the scene that is written has a zero field to fill in, weight, and what the robot needs to run at all.
Source: Davy, Lloyd, Chandler, Valdastri, A framework for simulation of magnetic soft robots ..., IEEE Rob. Autom. Lett. 8 (2023).
"""

from __future__ import annotations

import difflib
import math
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import yaml
from pydantic import Field, model_validator

from magmpm.bodies.assembly import MAX_PARTS, MAY_OVERLAP
from magmpm.bodies.surface_mesh import MeshError, overlaps, pack_mesh, read_stl, unpack_mesh
from magmpm.compiled.arrays import Plain
from magmpm.errors import InputError, report
from magmpm.inputs.settings import Settings, fault, validate
from magmpm.inputs.user_files import allow, read_regular
from magmpm.inputs.vectors import three
from magmpm.inputs.yaml_document import MOST_YAML_BYTES, read_yaml
from magmpm.scene import Scene, load_scene

_Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]


class RobotSegment(Settings):
    """One mesh of a robot."""

    mesh: str = Field(
        min_length=1, description="STL file in the folder `meshes`.", examples=["base.stl"]
    )
    magnetisation_vector: Annotated[tuple[_Number, _Number, _Number], three("[0, 0, 1]")] = Field(
        description="Direction of magnetization; zeros: unmagnetized.", examples=[[0, 0, 1]]
    )
    density: float = Field(strict=True, gt=0, le=30_000, description="kg/m^3", examples=[1882])
    shear_modulus: float = Field(strict=True, gt=0, le=5e11, description="Pa", examples=[120000])
    fixed: bool = Field(strict=True, description="Whether it is held.", examples=[False])


class Robot(Settings):
    """A robot of the magneticMPM format."""

    name: str = Field(min_length=1, max_length=100, description="Name.", examples=["Tentacle"])
    n_segments: int = Field(strict=True, ge=1, description="Number of segments.", examples=[9])
    remenance: float = Field(
        strict=True, ge=0, le=3, description="Remanent flux density, T.", examples=[0.138]
    )
    segments: tuple[RobotSegment, ...] = Field(
        min_length=1,
        max_length=MAX_PARTS,
        description="Segments.",
        examples=[[{"mesh": "base.stl"}]],
    )

    @model_validator(mode="before")
    @classmethod
    def _spelled_well(cls, data: Any) -> Any:
        """`remanence` is accepted for `remenance`, the format's spelling."""
        if isinstance(data, Mapping) and "remanence" in data and "remenance" not in data:
            return {
                ("remenance" if key == "remanence" else key): value for key, value in data.items()
            }
        return data

    @model_validator(mode="after")
    def _complete(self) -> Robot:
        if self.n_segments != len(self.segments):
            raise fault(
                f"n_segments must be the number of segments, and there are {len(self.segments)}",
                "correct it, or add what is missing",
                ("n_segments",),
            )
        return self


def import_robot(
    robot_file: Path | str, scene_file: Path | str, *, overwrite: bool = False
) -> tuple[Scene, list[str]]:
    """Make a scene file from a robot file. Returns the scene and warnings. overwrite: also replace a file with other content.

    Raises InputError with everything that is wrong; then no scene is written.
    """
    path = Path(robot_file)
    target = Path(scene_file)
    text, warnings = _scene_text(path, validate(Robot, read_yaml(path)), target)
    allow(
        path.parent / "meshes"
    )  # the user has named the robot: its scene may name its meshes, wherever it is kept
    if not overwrite:
        _spare(target, text)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        part = target.with_name(f".{target.name}.part")
        part.write_text(text, encoding="utf-8")
        scene = load_scene(part)
        part.replace(target)
    except OSError as error:
        raise InputError(
            f"-o: received {target}: can't be written ({error.strerror}); name another file"
        ) from None
    finally:
        with suppress(OSError):  # where nothing can be written there is no file to remove
            target.with_name(f".{target.name}.part").unlink(missing_ok=True)
    return scene, warnings


def _spare(target: Path, text: str) -> None:
    """Raises InputError where an import would change an existing file: somebody may have worked on it."""
    try:
        same = not target.exists() or read_regular(target, MOST_YAML_BYTES) == text.encode()
    except OSError as error:
        raise InputError(
            f"-o: received {target}: can't be written ({error.strerror}); name another file"
        ) from None
    if not same:
        raise InputError(
            "-o",
            received=str(target),
            rule="an existing file whose contents differ from this import is not changed",
            remedy="name another file, or add --overwrite to replace its contents",
        )


def _scene_text(path: Path, robot: Robot, target: Path) -> tuple[str, list[str]]:
    """The text of the scene, and warnings of what the robot's author may not have meant."""
    found, texts = _meshes(path, robot)
    warnings = [*_odd_vectors(robot), *_unused(path, found), *_apart(robot, texts)]
    _refuse_overlaps(path, robot, texts)
    if all(segment.fixed for segment in robot.segments):
        raise InputError(
            f"{path}: segments",
            received="fixed: true in all",
            rule="at least one segment must be free to move",
            remedy="set `fixed: False` on those that are",
        )
    if not any(any(s.magnetisation_vector) for s in robot.segments) or robot.remenance == 0.0:
        warnings.append(
            "no segment is magnetized: a field will do nothing, and the scene does not name"
            " magnetic_torque"
        )
    folder = target.resolve().parent
    relative = [Path(os.path.relpath(mesh.resolve(), folder)).as_posix() for mesh in found]
    low = min(float(unpack_mesh(text).vertices[:, 2].min()) for text in texts)
    content = _scene(robot, relative, low)
    head = (
        f"# {robot.name}, made by `magmpm import` from {path.name}, a robot of the magneticMPM"
        " format, which says nothing of field,\n# surroundings or time: set `field` (zero here),"
        " and look through `effects`, `solver` and `resolution`.\n"
    )
    return (
        head
        + yaml.safe_dump(
            content, sort_keys=False, default_flow_style=None, width=200, allow_unicode=True
        ),
        warnings,
    )


def _scene(robot: Robot, meshes: list[str], low: float) -> Plain:
    """The scene's content; low: z of the robot's lowest point, mm."""
    materials: Plain = {}
    parts = []
    for segment, mesh in zip(robot.segments, meshes, strict=True):
        magnetized = any(segment.magnetisation_vector) and robot.remenance > 0
        name = (
            f"{'magnetic' if magnetized else 'plain'} {segment.shear_modulus:.9g} Pa,"
            f" {segment.density:.9g} kg per m^3"
        )
        materials[name] = {
            "shear_modulus": f"{segment.shear_modulus:.12g} Pa",
            "bulk_to_shear": 20.0,  # implied by the format
            "density": f"{segment.density:.12g} kg/m^3",
            **({"remanence": f"{robot.remenance:.12g} T"} if magnetized else {}),
        }
        part: Plain = {"mesh": mesh, "material": name}
        if magnetized:
            part["magnetization"] = [float(x) for x in segment.magnetisation_vector]
        parts.append({**part, "clamp": True} if segment.fixed else part)
    held = any(segment.fixed for segment in robot.segments)
    effects: Plain = {"gravity": {}}
    if any("magnetization" in part for part in parts):
        effects["magnetic_torque"] = {}
    solver: Plain = {"static": {}}
    if not held:
        effects["ground"] = {"point": ["0 mm", "0 mm", f"{low:.9g} mm"], "friction": 0.5}
        solver = {"dynamic": {"duration": "10 ms", "output_every": "1 ms"}}
    return {
        "name": _folder_name(robot.name),
        "materials": materials,
        "body": {"parts": {"unit": "mm", "meshes": parts}},
        "field": {"uniform": ["0 mT", "0 mT", "0 mT"]},
        "effects": effects,
        "solver": solver,
        "resolution": {"cells_across": 4 if held else 2},
    }


def _folder_name(name: str) -> str:
    """The robot's name without characters that a scene's name may not have."""
    kept = (
        "".join("-" if c in '/\\<>:"|?*' or not c.isprintable() else c for c in name)
        .strip()
        .lstrip(".")
    )
    return kept or "robot"


def _meshes(path: Path, robot: Robot) -> tuple[list[Path], list[str]]:
    """Each segment's file and its mesh as a scene keeps it. Raises InputError with all that is wrong with any of them."""
    folder = path.parent / "meshes"
    there = sorted(p.name for p in folder.iterdir()) if folder.is_dir() else []
    found = []
    texts = []
    wrong = []
    for i, segment in enumerate(robot.segments):
        file = folder / segment.mesh
        place = f"{path}: segments[{i}].mesh"
        if (
            not file.is_file()
            or Path(segment.mesh).is_absolute()
            or ".." in Path(segment.mesh).parts
        ):
            near = difflib.get_close_matches(segment.mesh, there, n=1, cutoff=0.8)
            remedy = f'did you mean "{near[0]}"?' if near else "add the file, or correct the name"
            rule = (
                f"the file must be in {folder}"
                if folder.is_dir()
                else f"the folder {folder} must be there"
            )
            wrong.append(report(place, received=segment.mesh, rule=rule, remedy=remedy))
            continue
        try:
            texts.append(pack_mesh(read_stl(file)))
            found.append(file)
        except MeshError as error:
            wrong.append(report(place, received=segment.mesh, rule=error.rule, remedy=error.remedy))
    _refuse_all(path, wrong)
    return found, texts


def _refuse_all(path: Path, wrong: list[str]) -> None:
    """Raises InputError with all that is wrong, if anything is."""
    if wrong:
        raise InputError(
            (f"{len(wrong)} problems in {path}\n" if len(wrong) > 1 else "") + "\n".join(wrong)
        )


def _odd_vectors(robot: Robot) -> list[str]:
    """A warning for each vector that is neither of length one nor zero."""
    found = []
    for i, segment in enumerate(robot.segments):
        length = math.hypot(*segment.magnetisation_vector)
        if length > 0 and abs(length - 1) > 1e-3:  # what three decimals leave
            vector = ", ".join(f"{x:g}" for x in segment.magnetisation_vector)
            found.append(
                f"segments[{i}].magnetisation_vector: [{vector}] has length {length:.4g}; it is"
                f" made one, so the remanence is {robot.remenance:g} T, not"
                f" {length * robot.remenance:.4g} T"
            )
    return found


def _unused(path: Path, found: list[Path]) -> list[str]:
    """A warning for the meshes that no segment names."""
    used = {file.name for file in found}
    others = [
        p.name
        for p in sorted((path.parent / "meshes").iterdir())
        if p.suffix.lower() == ".stl" and p.name not in used
    ]
    return (
        [f"meshes: {', '.join(others)}: no segment uses {'it' if len(others) == 1 else 'them'}"]
        if others
        else []
    )


def _refuse_overlaps(path: Path, robot: Robot, texts: list[str]) -> None:
    """Raises InputError where segments overlap: which of two materials would fill the shared volume? They may touch."""
    wrong = []
    for i, j, shared, smaller in overlaps(texts):
        if shared > MAY_OVERLAP * smaller:
            wrong.append(
                report(
                    f"{path}: segments[{j}].mesh",
                    received=robot.segments[j].mesh,
                    rule=(
                        f"segments must not overlap, and this one shares {shared:.3g} mm^3 with"
                        f" segments[{i}], {robot.segments[i].mesh}: {100 * shared / smaller:.3g} %"
                        " of the smaller"
                    ),
                    remedy="trim one of the meshes; faces may touch",
                )
            )
    _refuse_all(path, wrong)


def _apart(robot: Robot, texts: list[str]) -> list[str]:
    """A warning for each segment that touches no other, judged by the boxes around them."""
    boxes = np.array([[v.min(0), v.max(0)] for v in (unpack_mesh(text).vertices for text in texts)])
    size = float((boxes[:, 1].max(0) - boxes[:, 0].min(0)).max())
    found = []
    for i in range(len(boxes) if len(boxes) > 1 else 0):
        gap = np.maximum(boxes[:, 0] - boxes[i, 1], boxes[i, 0] - boxes[:, 1]).max(axis=1)
        gap[i] = np.inf
        if gap.min() > 0.01 * size:
            found.append(
                f"segments[{i}].mesh: {robot.segments[i].mesh} touches no other segment: the"
                f" nearest is {gap.min():.3g} mm away"
            )
    return found
