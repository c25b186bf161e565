"""The files of a motion: `motion.vtkhdf`, which ParaView opens, `energies.csv` and `contacts.csv`; of parts `positions.csv` as well.

All grow frame by frame while the run goes on, and can be read at any moment (vtkhdf, motion_tables).
"""

from __future__ import annotations

import errno
import json
import os
import shutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import NDArray

from magmpm.compiled.arrays import Array, Named, Plain
from magmpm.errors import PAIR, BudgetError, InputError, quantity, require
from magmpm.results import notices
from magmpm.results.file_names import ABOUT, CONTACTS, ENERGIES, JUMPS, MOTION, POSITIONS, STEPS
from magmpm.results.frame_arrays import QUANTITIES, FrameArrays, Numbers
from magmpm.results.motion_tables import (
    GrowingTable,
    contact_row,
    energy_row,
    must_have,
    position_rows,
    read_contacts,
    read_energies,
    read_jumps,
    read_positions,
    read_steps,
)
from magmpm.results.whole_file import write_json

if TYPE_CHECKING:
    import h5py

# bytes a frame takes besides its arrays, at most: index of the chunks, steps, rows of the tables
_OVERHEAD = 65_536


def frame_files() -> ModuleType:
    """magmpm.results.vtkhdf, which needs h5py. Raises MissingPackage without it."""
    require("h5py", "motion", key="solver", use="files of motions")
    from magmpm.results import vtkhdf

    return vtkhdf


@dataclass(frozen=True)
class Instant:
    """A motion at one time, as a solver passes it to its writer; n particles.

    Attributes
    ----------
    time : float, s
        When it is.
    x : array (n, 3), m
        Positions of the particles.
    v : array (n, 3), m/s
        Their velocities.
    F : array (n, 3, 3), no unit
        Their deformation gradients.
    P : array (n, 3, 3), Pa
        Their first Piola-Kirchhoff stress, with the effects' part.
    energies : Mapping[str, float], J
        Kinetic, elastic and each effect's potential.
    contacts : Mapping[str, Any]
        The contact of each effect (effects.base.Contact).
    field : array (3,), T, or None
        The external field at the body, for pictures.
    """

    time: float
    x: Array
    v: Array
    F: Array
    P: Array
    energies: Mapping[str, float]
    contacts: Named
    field: Array | None


class MotionWriter:
    """Writer of a motion into a folder, frame by frame.

    Parameters
    ----------
    folder : Path or str
        Is made if missing; what it held of a motion is replaced, unless `resume_at` is given.
    model : object
        Anything with particles.position (n, 3) m, particles.volume (n,) m^3, particles.segment
        (n,), remanence (n, 3 or more) T, and optionally scene, which is stored for the
        pictures.
    max_disk : float, bytes, optional
        What the motion's files may take; all there is unless given.
    resume_at : float, s, optional
        Time of a checkpoint: frames after it are dropped and the motion goes on, so that its
        files hold what those of an unbroken run do.
    resume_frames : int, optional
        How many frames there must be up to then, each with its energies.
    resume_contacts : iterable of str, default ()
        Effects whose contacts these frames must have.

    Raises
    ------
    InputError
        If the frames of the motion that is to go on are missing.
    """

    def __init__(
        self,
        folder: Path | str,
        model: Any,
        *,
        max_disk: float | None = None,
        resume_at: float | None = None,
        resume_frames: int | None = None,
        resume_contacts: Iterable[str] = (),
    ) -> None:
        vtkhdf = frame_files()
        self.folder = Path(folder)
        self.folder.mkdir(parents=True, exist_ok=True)
        self.path = self.folder / MOTION
        self.max_disk = max_disk
        particles = model.particles
        reference = np.array(particles.position, dtype=float)
        remanence = np.array(model.remanence[:, :3], dtype=float)
        self._arrays = FrameArrays(reference, remanence, getattr(model, "rotating", None))
        self._energies = GrowingTable(self.folder / ENERGIES)
        self._contacts = GrowingTable(self.folder / CONTACTS)
        self._positions = GrowingTable(self.folder / POSITIONS)
        self._parts = _shares_of_parts(model)
        if resume_at is not None:
            if not self.path.exists():
                place = (
                    f"{self.path}: is missing, while the folder holds a checkpoint of this motion"
                )
                raise InputError(
                    place,
                    rule="a motion resumes from the frames on disk",
                    remedy="run again without --resume",
                )
            if resume_frames is not None:
                self._must_hold(resume_frames, resume_at, resume_contacts)
            self._file = vtkhdf.FrameFile.resume(self.path, len(reference), resume_at)
            self._energies.cut(self._file.last)
            self._contacts.cut(self._file.last)
            self._positions.cut(self._file.last)
            self._tell_about(model)
            return
        for name in (MOTION, ENERGIES, CONTACTS, POSITIONS):
            (self.folder / name).unlink(missing_ok=True)
        static = {
            "part": np.asarray(particles.segment, dtype=np.int32),
            "volume": np.asarray(particles.volume, dtype=np.float32),
            "remanence": remanence.astype(np.float32),
            "reference": reference.astype(np.float32),
        }
        self._tell_about(model)
        self._file = vtkhdf.FrameFile.create(self.path, static)

    @property
    def frames(self) -> int:
        """Frames written so far."""
        return self._file.frames

    @property
    def size(self) -> int:
        """Bytes the motion's files take now."""
        files = (self.folder / name for name in (MOTION, ENERGIES, CONTACTS, POSITIONS, ABOUT))
        return sum(path.stat().st_size for path in files if path.exists())

    @property
    def frame_size(self) -> int:
        """Bytes a frame adds, at most."""
        return 4 * len(self._arrays.reference) * (3 + sum(QUANTITIES.values())) + _OVERHEAD

    def frame(self, now: Instant) -> None:
        """Add a frame.

        Parameters
        ----------
        now : Instant
            What is to be written, later than the last frame.

        Raises
        ------
        BudgetError
            Before anything is written, if the frame would not fit into max_disk or on the disk.
        """
        self._afford(now.time)
        arrays = self._arrays.of(now.x, now.v, now.F, now.P)
        self._reserve()
        unknown = np.full(3, np.nan)
        external = unknown if now.field is None else np.asarray(now.field, dtype=float)
        self._file.append(now.time, arrays, external)
        self._energies.add(energy_row(now.time, now.energies))
        for effect, contact in now.contacts.items():
            self._contacts.add(contact_row(now.time, effect, contact))
        places = {name: share @ now.x[of] for name, (of, share) in self._parts.items()}
        for row in position_rows(now.time, places):
            self._positions.add(row)

    def _afford(self, time: float) -> None:
        keep_free = 16_000_000  # bytes of the disk left to others
        needed = _OVERHEAD if self.frames < self._file.places else self.frame_size
        at = f"after {self.frames} frames, before the one at t = {time:g} s"
        remedy = (
            "remedy: a larger output_every writes fewer frames, fewer resolution.cells_across "
            f"make them smaller; the frames written so far are intact: {self.path}"
        )
        if self.max_disk is not None and self.size + needed > self.max_disk:
            raise BudgetError(
                f"solver.dynamic.max_disk: received {_bytes(self.max_disk)}; the motion takes"
                f" {_bytes(self.size)} {at}, which would add {_bytes(needed)}\n  rule: the motion's"
                f" files must stay within max_disk\n  {remedy}; or raise max_disk"
            )
        free = shutil.disk_usage(self.folder).free
        if free < needed + keep_free:
            raise BudgetError(
                f"{self.folder}: the disk is full: {_bytes(free)} are free {at}, which would add "
                f"{_bytes(needed)}\n  rule: {_bytes(keep_free)} of the disk are kept free\n  "
                f"{remedy}"
            )

    def _reserve(self) -> None:
        """Reserve the room of a frame on the disk: HDF5 does not recover from a write that fails. Raises BudgetError.

        A quota, or a limit on a file's size, shows only here. HDF5 gives unused room back when it closes the file.
        """
        if not hasattr(os, "posix_fallocate"):
            return
        with self.path.open("r+b") as file:
            size = os.fstat(file.fileno()).st_size
            try:
                os.posix_fallocate(file.fileno(), size, self.frame_size)
            except OSError as error:
                file.truncate(size)
                if error.errno in (errno.EOPNOTSUPP, errno.EINVAL):
                    return  # a file system that can't
                raise BudgetError(
                    f"{self.path}: {error.strerror} after {self.frames} frames, before one more "
                    f"of up to {_bytes(self.frame_size)}\n  rule: the motion must fit on the "
                    "disk, and within the system's limits for this user\n  remedy: a larger "
                    "output_every writes fewer frames; the frames written so far are intact: "
                    f"{self.path}"
                ) from error

    def _tell_about(self, model: Any) -> None:
        scene: Any = getattr(model, "scene", None)
        about = {
            "scene": scene.to_si() if hasattr(scene, "to_si") else scene,
            "name": getattr(scene, "name", ""),
        }
        write_json(self.folder / ABOUT, about)

    def _must_hold(self, frames: int, until: float, contacts: Iterable[str]) -> None:
        """Raises InputError unless the files hold what a motion has written until a time (s)."""
        vtkhdf = frame_files()
        vtkhdf.mend(self.path)
        with vtkhdf.opened(self.path) as file:
            times = vtkhdf.read_moments(file)[0]
        times = times[times <= until * (1 + 1e-12)]
        if len(times) != frames:
            raise InputError(
                str(self.path),
                received=f"{len(times)} frames up to the checkpoint",
                rule=f"a motion resumes from all {frames} frames it had then",
                remedy=(
                    "put back the file that belongs to the checkpoint, or run again without"
                    " --resume"
                ),
            )
        must_have(self._energies.path, read_energies(self._energies.path), times)
        found = read_contacts(self._contacts.path)
        for effect in contacts:
            if PAIR not in effect:
                must_have(self._contacts.path, found.get(effect, {}), times)


def _shares_of_parts(model: Any) -> dict[str, tuple[NDArray[Any], Array]]:
    """Particles of each part by its name, and their shares of its volume; none of a body that is not made of parts."""
    scene: Any = getattr(model, "scene", None)
    names = scene.body.shape.part_names() if hasattr(scene, "body") else ()
    shares = {}
    for number, name in enumerate(names):
        of = np.flatnonzero(model.particles.segment == number)
        volume = model.particles.volume[of]
        shares[name] = of, volume / volume.sum()
    return shares


def _bytes(size: float) -> str:
    for unit, name in ((1e9, "GB"), (1e6, "MB"), (1e3, "kB")):
        if size >= unit:
            return f"{size / unit:.4g} {name}"
    return f"{size:.0f} bytes"


@dataclass(frozen=True)
class Frame:
    """One moment of a motion, of n particles.

    Attributes
    ----------
    number : int
        Of the frame, from 0.
    time : float, s
        When it is.
    position : array (n, 3), m
        Of the particles.
    field : array (3,), T, or None
        The external field at the body; None where it was not given.
    quantities : dict[str, Numbers]
        What else is stored, by name: arrays of n rows (docs/motion.md).
    """

    number: int
    time: float
    position: Numbers
    field: Array | None
    quantities: dict[str, Numbers]

    def __repr__(self) -> str:
        """One line: its number, time, particles, and the names of its quantities."""
        named = ", ".join(self.quantities) or "no quantities"
        return (
            f"Frame({self.number} at {quantity(self.time, 's')}: {len(self.position)} particles;"
            f" {named})"
        )


def _read_about(path: Path) -> tuple[str, Plain | None]:
    """Name and scene of a motion. Raises InputError."""
    try:
        about = json.loads(path.read_text(encoding="utf-8"))
        name = about["name"]
        scene = about["scene"]
        if not isinstance(name, str) or not isinstance(scene, dict | None):
            raise ValueError("it holds no name and scene")
        return name, scene
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{path}: can't be read ({error})",
            rule="must be as the motion's run wrote it",
            remedy="run the scene again with --resume, which rewrites it, or without",
        ) from None


def _whole(path: Path, file: h5py.File) -> tuple[Array, Array, Plain]:
    """Times, fields and what is stored once, after all frames were checked. Raises InputError."""
    vtkhdf = frame_files()
    times, fields = vtkhdf.read_moments(file)
    vtkhdf.check(path, file, range(len(times)))
    return times, fields, vtkhdf.read_static(file)


@dataclass(frozen=True)
class Motion:
    """A motion that was written: its times, tables and frames, which are read when asked for.

    `motion[k]` reads a frame, `motion[i:j]` a list of them, `motion.position(k)` the positions of
    one. Everything is in SI; the body has n particles.

    Attributes
    ----------
    folder : Path
        Where it is.
    name : str
        Of the scene.
    scene : dict[str, Any] or None
        The scene as plain SI data (Scene.to_si), or None.
    times : array (frames,), s
        Of the frames.
    fields : array (frames, 3), T
        The external field at the body; NaN where it was not given.
    part : array (n,) of int
        The region that each particle is in.
    volume : array (n,), m^3
        Volumes of the particles in the undeformed body.
    remanence : array (n, 3), T
        Their remanence in the undeformed body.
    reference : array (n, 3), m
        Their positions in the undeformed body.
    energies : dict[str, array]
        Columns (frames,) of energies.csv: t in s, the others in J.
    contacts : dict[str, dict[str, array]]
        By effect the columns (rows,) of contacts.csv: t (s), Fx, Fy, Fz (N), count, depth (m).
    steps : dict[str, array]
        Of equilibria along time the columns (frames,) of steps.csv, in s, m, T and J; stability
        and iterations have no unit.
    jumps : list of dict[str, Any]
        Of equilibria along time, as in a Result.
    positions : dict[str, array]
        By the name of a part its centers (frames, 3) m; none of other bodies.

    Examples
    --------
    >>> import magmpm
    >>> scene = magmpm.load_scene("data/scenes/gallery/catheter_swing.yaml").with_cells(2)
    >>> data = {**scene.to_si(), "solver": {"dynamic": {"duration": 1e-3, "output_every": 5e-4}}}
    >>> result = magmpm.run(magmpm.Scene.from_si(data), folder="swing", progress=False)
    >>> motion = magmpm.Motion.load("swing")
    >>> motion.times.tolist()  # s
    [0.0, 0.0005, 0.001]
    >>> motion[-1].position.shape == motion.reference.shape
    True
    """

    folder: Path
    name: str
    scene: Plain | None
    times: Array
    fields: Array
    part: NDArray[np.int32]
    volume: Numbers
    remanence: Numbers
    reference: Numbers
    energies: dict[str, Array]
    contacts: dict[str, dict[str, Array]]
    steps: dict[str, Array] = field(default_factory=dict)
    jumps: list[Plain] = field(default_factory=list)
    positions: dict[str, Array] = field(default_factory=dict)

    @classmethod
    def load(cls, folder: Path | str) -> Motion:
        """Read the motion in a folder, also an unfinished one.

        Parameters
        ----------
        folder : Path or str
            Where a run has written it.

        Returns
        -------
        Motion
            The motion.

        Raises
        ------
        InputError
            If the folder holds none, or one that can't be read.
        """
        folder = Path(folder)
        path = folder / MOTION
        if not path.exists():
            raise InputError(
                f"{folder}: holds no motion ({MOTION} is missing); give the folder that `magmpm"
                " run` named for a dynamic scene"
            )
        vtkhdf = frame_files()
        try:
            vtkhdf.mend(path)
            times, fields, static = vtkhdf.steady(path, lambda file: _whole(path, file))
            name, scene = _read_about(folder / ABOUT)
            energies = read_energies(folder / ENERGIES)
            contacts = read_contacts(folder / CONTACTS)
            steps = read_steps(folder / STEPS)
            jumps = read_jumps(folder / JUMPS)
            positions = read_positions(folder / POSITIONS)
            must_have(folder / ENERGIES, energies, times, lacking=1)
            for found in positions.values():
                must_have(folder / POSITIONS, found, times, lacking=1)
            if steps:
                must_have(folder / STEPS, steps, times, lacking=1)
            for effect, found in contacts.items() if scene is not None else ():
                if PAIR not in effect:
                    must_have(folder / CONTACTS, found, times, lacking=1)
        except (OSError, KeyError, TypeError, ValueError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(
                f"{folder}: the motion can't be read ({error}); run the scene again"
            ) from None
        tables: Plain = {
            "energies": energies,
            "contacts": contacts,
            "steps": steps,
            "jumps": jumps,
        }
        tables["positions"] = {
            name: np.column_stack([found[axis] for axis in "xyz"])[: len(times)]
            for name, found in positions.items()
        }
        return cls(
            folder=folder, name=name, scene=scene, times=times, fields=fields, **tables, **static
        )

    def __repr__(self) -> str:
        """One line: how many frames of how many particles, the times, and where they are."""
        last = quantity(float(self.times[-1]), "s") if len(self) else "none yet"
        return (
            f"Motion({self.name!r}: {len(self)} frames of {len(self.reference)} particles, the last"
            f" at {last}, in {self.folder})"
        )

    def _repr_html_(self) -> str:
        """Drawing of the path of the body's middle, and its times, as notebooks show it."""
        from magmpm.scene.notebook import of_motion

        return of_motion(self)

    def __len__(self) -> int:
        """Count the frames.

        Returns
        -------
        int
            Their number.
        """
        return len(self.times)

    @overload
    def __getitem__(self, number: int) -> Frame: ...

    @overload
    def __getitem__(self, number: slice) -> list[Frame]: ...

    def __getitem__(self, number: int | slice) -> Frame | list[Frame]:
        """Read a frame, or those of a slice.

        Parameters
        ----------
        number : int or slice
            Of the frame; negative numbers count from the end.

        Returns
        -------
        Frame or list of Frame
            The frame; of a slice a list of frames. SI.

        Raises
        ------
        IndexError
            Where the motion has no such frame.
        """
        if isinstance(number, slice):
            return [self[k] for k in range(len(self))[number]]
        k = self._counted(number)
        path = self.folder / MOTION
        vtkhdf = frame_files()
        quantities = vtkhdf.steady(path, lambda file: vtkhdf.read_arrays(path, file, k))
        field = self.fields[k]
        return Frame(
            number=k,
            time=float(self.times[k]),
            position=quantities.pop("Points"),
            field=None if np.isnan(field).any() else field,
            quantities=quantities,
        )

    def position(self, number: int) -> Numbers:
        """Read the positions of a frame alone.

        Parameters
        ----------
        number : int
            Of the frame; negative numbers count from the end.

        Returns
        -------
        array (n, 3), m
            Positions of the particles.

        Raises
        ------
        IndexError
            Where the motion has no such frame.
        """
        k = self._counted(number)
        path = self.folder / MOTION
        vtkhdf = frame_files()
        found: dict[str, Numbers] = vtkhdf.steady(
            path, lambda file: vtkhdf.read_arrays(path, file, k, ["Points"])
        )
        return found["Points"]

    def render(self, path: Path | str, *, frames: Sequence[int] | None = None) -> Path:
        """Draw moments side by side into a picture, or the whole motion as a movie.

        Parameters
        ----------
        path : Path or str
            A PNG, SVG or PDF file; a movie where it is .mp4 or .gif.
        frames : sequence of int, optional
            Numbers of the moments; unless given the first, the last, and the one between that
            is most unlike both.

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
        draw = import_module("magmpm.viz.figure_panels").draw_motion
        notices.warn(filter(None, [draw(self, Path(path), frames)]), "pictures")
        return Path(path)

    def _counted(self, number: int) -> int:
        """The number of a frame counted from the start. Raises IndexError."""
        try:
            return range(len(self))[number]
        except IndexError:
            has = f"frames 0 to {len(self) - 1}" if len(self) else "no frames yet"
            raise IndexError(f"frame: received {number}; motion has {has}") from None

    def nearest(self, time: float) -> int:
        """Find the frame nearest to a time.

        Parameters
        ----------
        time : float, s
            Any time.

        Returns
        -------
        int
            Number of the frame.
        """
        return int(np.argmin(np.abs(self.times - time)))
