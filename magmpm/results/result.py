"""Result of a run; saved as `result.json` and `state.npz`, and read back."""

from __future__ import annotations

import dataclasses
import json
import math
import platform
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from functools import cache
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magmpm.bodies.assembly import different_names
from magmpm.compiled.arrays import Array
from magmpm.errors import InputError, count, length, lengths, quantity, report, require
from magmpm.inputs.user_files import MOST_JSON_BYTES, read_regular
from magmpm.results import notices
from magmpm.results.file_names import ARRAYS, NUMBERS
from magmpm.results.whole_file import whole_file, write_json


@cache
def versions() -> dict[str, str]:
    """Find the versions of Python, magmpm and the packages that compute for it.

    Returns
    -------
    dict[str, str]
        Versions by name.
    """
    found = {"python": platform.python_version()}
    for name in ("magmpm", "numpy", "scipy", "numba"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found


# How to cite, in words: as CITATION.cff says it.
CITATION = (
    "The magmpm developers (2026). magmpm: simulation and computational design of magnetic soft"
    " robots with the material point method, version 0.1.0, MIT license."
)
SOURCES = (
    (
        "T. Akiba, S. Sano, T. Yanase, T. Ohta, M. Koyama: Optuna: a next-generation hyperparameter"
        " optimization framework. KDD 2019. doi:10.1145/3292500.3330701 (the search)"
    ),
    (
        "S. K. Lam, A. Pitrou, S. Seibert: Numba: a LLVM-based Python JIT compiler. LLVM-HPC 2015."
        " doi:10.1145/2833157.2833162 (the kernels)"
    ),
    (
        "R. Zhao, Y. Kim, S. A. Chester, P. Sharma, X. Zhao: Mechanics of hard-magnetic soft"
        " materials. J. Mech. Phys. Solids 124 (2019) 244. doi:10.1016/j.jmps.2018.10.008 (the"
        " magnetic stress)"
    ),
)  # what a study stands on
_LATER: dict[str, Any] = {  # what results saved by earlier versions lack
    "load_share": 1.0,
    "failure": "",
    "largest_stretch": 1.0,
    "tightest_radius": None,
    "steps": [],
    "jumps": [],
    "stability": None,
    "error_estimate": None,
    "resolution": None,
    "effects_chosen": None,
    "contacts": {},
    "start": "",
}


def readable(folder: Path) -> bool:
    """Check whether both files of a saved result are complete.

    Parameters
    ----------
    folder : Path
        Where they are.

    Returns
    -------
    bool
        True if they can be read.
    """
    try:
        with np.load(folder / ARRAYS) as stored:
            whole = all(
                stored[name] is not None for name in stored.files
            )  # each array has a checksum
        return whole and isinstance(
            json.loads(read_regular(folder / NUMBERS, MOST_JSON_BYTES)), dict
        )
    except (
        Exception
    ):  # a damaged archive raises a dozen kinds: BadZipFile, EOFError, zlib.error, ...
        return False


def _checked(name: str, kind: str, value: Any) -> Any:
    """A field's value, if it has the type that the field's annotation names. Raises ValueError."""
    kinds: dict[str, type | tuple[type, ...]] = {
        "str": str,
        "bool": bool,
        "int": int,
        "float": (int, float),
        "Array": np.ndarray,
        "NDArray": np.ndarray,
        "dict": dict,
        "list": list,
    }
    if value is None and kind.endswith(" | None"):
        return value
    if not isinstance(value, kinds[kind.removesuffix(" | None").split("[")[0]]):
        raise ValueError(f"`{name}` is {json.dumps(value, default=repr)[:40]}, which is no {kind}")
    return value


def _unreadable(folder: Path, error: Exception) -> str:
    """The message for a result that can't be read: which of its files is damaged, and what to do."""
    damaged = NUMBERS
    try:
        if isinstance(
            numbers := json.loads(read_regular(folder / NUMBERS, MOST_JSON_BYTES)), dict
        ) and not readable(folder):
            damaged = ARRAYS
        what = str(error) if isinstance(numbers, dict) else f"it holds {json.dumps(numbers)[:40]}"
    except (OSError, ValueError) as failure:
        what = str(failure)
    return report(
        f"{folder / damaged}: the saved result can't be read ({what})",
        rule="must be whole, as `magmpm run` or `magmpm design` wrote it",
        remedy=("run the scene again; for a design of a study, `magmpm design` writes it again"),
    )


@dataclass(frozen=True)
class Result:
    """One simulation: the answer, how it was found, and what a user should know of it.

    Everything is in SI. The body has n particles and k regions (segments or parts). Of what runs
    along time the shape is that of its last moment.

    Attributes
    ----------
    name : str
        Of the scene.
    scene : dict[str, Any]
        The scene as plain SI data (Scene.to_si).
    scene_hash : str
        Scene.hash of the scene that was run.
    particle_reference : array (n, 3), m
        Positions of the particles in the undeformed body.
    particle_position : array (n, 3), m
        Their positions in the deformed body.
    particle_volume : array (n,), m^3
        Their volumes in the undeformed body.
    particle_segment : array (n,) of int
        The region that each is in.
    particle_det_F : array (n,), no unit
        Determinant of each deformation gradient: volume over undeformed volume.
    segment_center : array (k, 3), m
        Centers of the regions in the deformed body, by volume.
    segment_remanence : array (k, 3), T
        Mean remanence of each region, carried along by the body: F Br, or R Br where a
        material's magnetization rotates.
    grid_correction : array (planes, m), m
        Spline coefficients of what the solve added to the rod's shape: where another run can
        start.
    centreline : array (2 cells + 1, 4), m
        The axis: rows [s, x, y, z] at the cells' faces and middles, with s along the undeformed
        axis. No rows for a body of parts.
    tip : array (3,), m, or None
        Mean of the end face. Of parts what body.parts.tip names; None if it names nothing.
    field : array (3,), T
        The external field at the body's center.
    converged : bool
        Whether this is the answer; otherwise it is the last good state.
    iterations : int
        Newton steps; of a motion its time steps.
    particles : int
        Number of particles.
    dof : int
        Number of unknowns of the grid.
    min_det_F : float, no unit
        Least of `particle_det_F`.
    max_det_F : float, no unit
        Largest of it.
    energy : float, J
        Energy, counted from the undeformed body in the same field.
    section : dict[str, float]
        Relative errors of the particles' area and second moments, no unit.
    seconds : dict[str, float]
        Wall time (s) of setup, compile and solve.
    warnings : list of str
        What a user should know, a sentence each.
    versions : dict[str, str]
        Versions of Python, magmpm and the packages that compute for it.
    time : float, s
        How long a motion or a path has lasted; 0 of an equilibrium.
    time_step : float, s
        Of a motion.
    stable_steps : dict[str, float]
        Bounds on a motion's time step at its start, s, by what sets them.
    formulation : {'static', 'quasi_static', 'total'}
        How the scene was solved; 'total', a motion. Old files also have 'updated'.
    kinetic_energy : float, J
        Of a motion at its end.
    load_share : float, no unit
        Part of the load (field, weight) that an equilibrium carries: less than 1 if the solve
        failed on the way.
    start : str
        Of an equilibrium, what its solve began from (statics.equilibrium.WAYS): rod, neighbor,
        given rod, coarser grid, whole load, growing load, growing branch.
    failure : str
        Why the run stopped early; empty if it did not.
    largest_stretch : float, no unit
        Of any particle; of a motion in any frame.
    steps : list of dict[str, Any]
        Of equilibria along time, one each: see docs/motion.md.
    jumps : list of dict[str, Any]
        Where a branch of equilibria ended: see docs/motion.md.
    tightest_radius : float, m, or None
        Of the bent axis; of a motion in any frame. None: straight, or a body without an axis.
    stability : float, no unit, or None
        Smallest eigenvalue of the tangent over that of the unloaded body: 1 at rest, 0 at a
        critical load. None: not known, as of a motion.
    error_estimate : float, m, or None
        Bound of the error that the grid leaves, where the scene requests an error or a time.
    resolution : dict[str, Any] or None
        What was chosen for that, and how: see docs/accuracy.md.
    contacts : dict[str, dict[str, Any]]
        Of each obstacle at the end ("ground"), of each part or segment that touches it
        ("ground: foot"), and of each two parts ("self_contact: a, b"): `force` (3,) N on the body,
        the part, or the first of two; `count` of the points that touch; `depth` (m) of the deepest;
        of two parts the mean `point` (3,) m. Of a motion also `largest` (N), the largest force in
        any frame, and its time `largest_at` (s).
    effects_chosen : list of dict[str, Any] or None
        Of `effects: auto`, for each effect whether it was named, and why (docs/effects.md).

    Examples
    --------
    >>> import magmpm
    >>> scene = magmpm.load_scene("data/scenes/axial_transverse.yaml").with_cells(2)
    >>> result = magmpm.run(scene)
    >>> folder = result.save("hook")
    >>> magmpm.Result.load(folder).tip.tolist() == result.tip.tolist()
    True
    """

    name: str
    scene: dict[str, Any]  # Scene.to_si()
    scene_hash: str
    particle_reference: Array  # (n, 3) m
    particle_position: Array  # (n, 3) m
    particle_volume: Array  # (n,) m^3, undeformed
    particle_segment: NDArray[np.int32]  # (n,)
    particle_det_F: Array  # (n,), no unit
    segment_center: Array  # (k, 3) m, deformed
    segment_remanence: Array  # (k, 3) T, mean of F Br, or R Br
    # (planes, m) m, spline coefficients of what the solve added to the rod's shape: another run's
    # start
    grid_correction: Array
    centreline: Array  # (2 cells + 1, 4) m
    tip: Array | None  # (3,) m
    field: Array  # (3,) T
    converged: bool
    iterations: int
    particles: int
    dof: int
    min_det_F: float  # no unit
    max_det_F: float  # no unit
    energy: float  # J, counted from the undeformed body in the same field
    section: dict[str, float]
    seconds: dict[str, float]
    warnings: list[str] = dataclasses.field(default_factory=list)
    versions: dict[str, str] = dataclasses.field(default_factory=dict)
    time: float = 0.0  # s that a motion has lasted; iterations are its steps
    time_step: float = 0.0  # s
    stable_steps: dict[str, float] = dataclasses.field(
        default_factory=dict
    )  # s, the bounds on the time step at the start
    formulation: str = "static"  # or quasi_static, total; of old files, updated
    kinetic_energy: float = 0.0  # J
    # no unit: part of the load (field, weight) that an equilibrium carries: less if the solve
    # failed on the way
    load_share: float = 1.0
    # of an equilibrium, what its solve began from (statics.equilibrium.WAYS): rod, neighbor, given rod,
    # coarser grid, whole load, growing load, growing branch
    start: str = ""
    failure: str = (
        ""  # why the run stopped early; then this is not the answer but the last good state
    )
    largest_stretch: float = 1.0  # no unit: of any particle; of a motion in any frame
    steps: list[dict[str, Any]] = dataclasses.field(
        default_factory=list
    )  # of equilibria along time, one each: see docs/motion.md
    jumps: list[dict[str, Any]] = dataclasses.field(
        default_factory=list
    )  # where a branch of equilibria ended: see docs/motion.md
    tightest_radius: float | None = (
        # m, of the bent axis, of a motion in any frame; None: straight, or a body without an axis
        None
    )
    # No unit: smallest eigenvalue of the tangent over that of the unloaded body: 1 at rest, 0 at a critical load; None: not known (motion).
    stability: float | None = None
    error_estimate: float | None = (
        # m: bound of the error that the grid leaves, where the scene requests an error or a time
        None
    )
    resolution: dict[str, Any] | None = (
        None  # what was chosen for it, and how: see docs/accuracy.md
    )
    # Of each obstacle at the end: force on the body (3,) N, count of points (or particles) that touch, depth of the deepest (m).
    contacts: dict[str, dict[str, Any]] = dataclasses.field(default_factory=dict)
    effects_chosen: list[dict[str, Any]] | None = (
        None  # of `effects: auto`: of each effect whether it was named, and why (docs/effects.md)
    )

    def __repr__(self) -> str:
        """One line: how the run ended, the tip or how far parts have moved, det F, what it cost, and how many warnings it has."""
        how = {
            "static": "equilibrium in {} Newton steps",
            "quasi_static": (
                f"{len(self.steps)} equilibria until {quantity(self.time, 's')}, the last in {{}}"
                " Newton steps"
            ),
        }.get(self.formulation, f"motion of {quantity(self.time, 's')} in {{}} steps")
        ended = how.format(self.iterations) + ("" if self.converged else ", NOT CONVERGED")
        warned = f", {count(len(self.warnings), 'warning')}" if self.warnings else ""
        return (
            f"Result({self.name!r}: {ended}, {self._where()}, det F {self.min_det_F:.4f} to"
            f" {self.max_det_F:.4f}, {self.dof} unknowns,"
            f" {quantity(self.seconds.get('solve', 0.0), 's')}{warned})"
        )

    def _where(self) -> str:
        """The tip; without one, how far anything has moved."""
        if self.tip is not None:
            return f"tip {lengths(self.tip)}"
        moved = float(
            np.linalg.norm(self.particle_position - self.particle_reference, axis=1).max()
        )
        return f"{count(len(self.positions), 'part')}, moved by at most {length(moved)}"

    @property
    def positions(self) -> dict[str, Array]:
        """Centers (3,) m of a body's parts by their names, each the mean by volume; none of a body that is not made of parts."""
        parts = _parts_of(self.scene)
        if parts is None:
            return {}
        names = different_names([str(part["name"]) for part in parts["meshes"]])
        return dict(zip(names, self.segment_center, strict=True))

    def _repr_html_(self) -> str:
        """Its axis and figures, as notebooks show it."""
        from magmpm.scene.notebook import of_result

        return of_result(self)

    def summary(self) -> dict[str, Any]:
        """Return what `magmpm run --json` prints: everything but the particle and grid arrays.

        Returns
        -------
        dict[str, Any]
            Plain data in SI.
        """
        shown = {
            key: value.tolist() if isinstance(value, np.ndarray) else value
            for key, value in asdict(self).items()
            if not key.startswith(("particle_", "grid_"))
        }
        return {
            **shown,
            "positions": {name: place.tolist() for name, place in self.positions.items()},
        }

    def to_dataframe(self) -> Any:
        """Make a pandas DataFrame of the axis, or of the centers of parts.

        Returns
        -------
        pandas.DataFrame
            The columns s_m, x_m, y_m and z_m (m), a row for each of `centreline`; of parts the
            columns part, x_m, y_m and z_m.

        Raises
        ------
        InputError
            Where pandas is not installed.
        """
        require("pandas", "dataframe", key="to_dataframe", use="tables")
        frame = import_module("pandas").DataFrame
        if self.positions:
            rows = [(name, *place.tolist()) for name, place in self.positions.items()]
            return frame(rows, columns=["part", "x_m", "y_m", "z_m"])
        return frame(self.centreline, columns=["s_m", "x_m", "y_m", "z_m"])

    def mesh(self) -> Any:
        """Make a PyVista mesh of the deformed surface.

        Returns
        -------
        pyvista.PolyData
            The surface, in m, with each face's region in `region`.

        Raises
        ------
        InputError
            Where PyVista is not installed.
        """
        require("pyvista", "render", key="mesh", use="meshes of PyVista")
        return import_module("magmpm.viz.from_result").polydata(
            self
        )  # by name: the physics draws nothing

    def render(self, path: Path | str, *, target: Array | None = None) -> Path:
        """Draw the deformed body, and what stands around it, into a file.

        Parameters
        ----------
        path : Path or str
            A PNG, SVG or PDF file, whose folder is made.
        target : array (q, 3) or (q, 4), m, optional
            Points, or rows [s, x, y, z], of a curve to compare the axis with; then it is drawn
            from the top and the side as well.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        RenderError
            Where nothing can be drawn.
        """
        require("matplotlib", "render", key="render", use="pictures")
        draw = import_module("magmpm.viz.figure_panels").draw_result
        notices.warn(filter(None, [draw(self, Path(path), target)]), "pictures")
        return Path(path)

    def not_finite(self) -> list[str]:
        """Find the fields that hold a NaN or an infinity, which no valid result has and JSON can't hold.

        Returns
        -------
        list of str
            Their names.
        """
        return [f.name for f in fields(self) if not _finite(getattr(self, f.name))]

    def save(self, folder: Path | str) -> Path:
        """Write the result into a folder, which is made if missing. Both of its files appear whole or not at all.

        Parameters
        ----------
        folder : Path or str
            Where it is written.

        Returns
        -------
        Path
            The folder.

        Raises
        ------
        ValueError
            Where a number is not finite, before anything is written.
        """
        if wrong := self.not_finite():
            raise ValueError(f"numbers that are not finite in {', '.join(wrong)}")
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        arrays = {
            f.name: getattr(self, f.name)
            for f in fields(self)
            if isinstance(getattr(self, f.name), np.ndarray)
        }
        with whole_file(folder / ARRAYS) as part, part.open("wb") as stream:
            np.savez_compressed(stream, **arrays)
        numbers = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in arrays}
        write_json(folder / NUMBERS, {**numbers, **self.summary()}, indent=1, allow_nan=False)
        return folder

    @classmethod
    def load(cls, folder: Path | str) -> Result:
        """Read the result that a folder holds.

        Parameters
        ----------
        folder : Path or str
            Where Result.save, or a run, has written it.

        Returns
        -------
        Result
            The result.

        Raises
        ------
        InputError
            If the folder holds none, or one that can't be read.
        """
        folder = Path(folder)
        try:
            numbers = json.loads(read_regular(folder / NUMBERS, MOST_JSON_BYTES))
            with np.load(folder / ARRAYS) as stored:
                arrays = dict(stored)
            found = {**_LATER, **numbers, **arrays}
            parts = _parts_of(found["scene"])
            if parts is not None and parts.get("tip") is None:
                found["tip"] = None  # earlier versions called the center of the last part so
            return cls(
                **{f.name: _checked(f.name, str(f.type), found[f.name]) for f in fields(cls)}
            )
        except FileNotFoundError as error:
            raise InputError(
                f"{folder}: holds no saved result ({Path(error.filename).name} is missing); "
                "give the folder that `magmpm run` named, such as runs/NAME"
            ) from None
        except (
            Exception
        ) as error:  # a damaged archive raises a dozen kinds: BadZipFile, EOFError, zlib.error, ...
            raise InputError(_unreadable(folder, error)) from None


def _parts_of(scene: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """The key body.parts of a scene's plain data; None for another body."""
    body: Mapping[str, Any] = scene.get("body") or {}
    return body.get("parts")


def _finite(value: Any) -> bool:
    """True if all numbers in an array, a number or plain data are finite; text and the like count as finite."""
    if isinstance(value, np.ndarray):
        return value.dtype.kind != "f" or bool(np.isfinite(value).all())
    if isinstance(value, Mapping):
        return all(_finite(item) for item in value.values())
    if isinstance(value, (list, tuple)):
        return all(_finite(item) for item in value)
    return not isinstance(value, float) or math.isfinite(value)
