"""What a motion leaves behind: `motion.vtkhdf`, which ParaView opens, `energies.csv` and `contacts.csv`.

All three grow frame by frame while the run goes on. A run that is killed leaves frames that can be read: the file is closed between
frames, and while it is open HDF5 writes in an order in which it can be read at any moment (single writer, multiple readers).
Format of the file: https://docs.vtk.org/en/latest/vtk_file_formats/vtkhdf_file_format/index.html, PolyData of one vertex a particle,
whose points move: vertices and what does not change in time are stored once.
"""

from __future__ import annotations

import csv
import errno
import json
import os
import shutil
import time as clock
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from magmpm.basis import Array
from magmpm.errors import BudgetError, InputError
from magmpm.motion_files import ABOUT, CONTACTS, ENERGIES, MOTION

QUANTITIES = {  # name of each array of the file: its components
    "displacement": 3,  # m
    "velocity": 3,  # m/s
    "cauchy_stress": 9,  # Pa, row by row; not symmetric: its skew part is the magnetic torque per volume
    "von_mises": 1,  # Pa, of the symmetric part
    "magnetisation": 3,  # T, F Br: remanence carried along with the material
    "det_F": 1,
}
STATIC = ("part", "volume", "remanence", "reference")
# Readable by HDF5 1.10 and later, and so by ParaView 5.6 and later, whatever is installed here.
_FORMAT = ("v110", "v110")
_TOPOLOGIES = ("Vertices", "Lines", "Polygons", "Strips")
_KEEP_FREE = 16_000_000  # bytes of the disk left to others
_OVERHEAD = (
    65_536  # bytes a frame takes besides its arrays, at most: index of the chunks, steps, rows of the tables
)
_STEPS_CHUNK = 64  # frames
_PATIENCE = 2.0  # s after which a file still marked as being written was left by a killed run
Numbers = NDArray[np.float32]


class MotionWriter:
    """Writes a motion frame by frame into a folder; a context manager, though every frame is whole on disk by itself.

    model: anything with particles.position (n, 3) m, particles.volume (n,) m^3, particles.segment (n,), magnet (n, 3) T, and
    optionally scene, which is stored for the pictures. quantities: names from QUANTITIES [all]. max_disk: bytes that the motion's
    files may take. resume_at: s, time of a checkpoint: frames after it are dropped and the motion goes on, so that its files hold
    what an unbroken run's do.
    """

    def __init__(
        self,
        folder: Path | str,
        model: Any,
        quantities: Sequence[str] | None = None,
        *,
        max_disk: float | None = None,
        resume_at: float | None = None,
    ) -> None:
        self.folder = Path(folder)
        self.folder.mkdir(parents=True, exist_ok=True)
        self.path = self.folder / MOTION
        self.max_disk = max_disk
        self.quantities = tuple(QUANTITIES if quantities is None else quantities)
        unknown = [name for name in self.quantities if name not in QUANTITIES]
        if unknown:
            raise InputError(f"quantities: received {unknown[0]!r}; must be among {', '.join(QUANTITIES)}")
        self.reference = np.array(model.particles.position, dtype=float)
        self.magnet = np.array(model.magnet[:, :3], dtype=float)
        self._places = 0  # frames the file has room for: after a resume the dropped ones' is used again
        if resume_at is not None and self.path.exists():
            self.frames = self._resume(resume_at)
        else:
            for name in (MOTION, ENERGIES, CONTACTS):
                (self.folder / name).unlink(missing_ok=True)
            self._create(model)
            self.frames = 0

    def __enter__(self) -> MotionWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        return None

    @property
    def size(self) -> int:
        """Bytes the motion's files take now."""
        files = (self.folder / name for name in (MOTION, ENERGIES, CONTACTS, ABOUT))
        return sum(path.stat().st_size for path in files if path.exists())

    @property
    def frame_size(self) -> int:
        """Bytes a frame adds, at most."""
        return 4 * len(self.reference) * (3 + sum(QUANTITIES[name] for name in self.quantities)) + _OVERHEAD

    def frame(
        self,
        time: float,
        x: Array,
        v: Array,
        F: Array,
        stress: Array,
        energies: Mapping[str, float],
        contacts: Mapping[str, Any] | None = None,
        field: Array | None = None,
    ) -> None:
        """Add a frame.

        time: s, later than the last frame's; x (n, 3) m; v (n, 3) m/s; F (n, 3, 3); stress (n, 3, 3) Pa: first Piola-Kirchhoff stress,
        the effects' part included; energies: J, kinetic, elastic and each effect's potential; `total` is their sum unless given,
        `dissipated` is not part of it. contacts: effect -> {force: (3,) N on the body, count: particles touching, depth: m, deepest
        penetration}, or an object with these attributes, or the force alone. field: (3,) T, the outside field at the body, for pictures.
        Raises BudgetError, before anything is written, if the frame would not fit into max_disk or on the disk.
        """
        self._afford(time)
        arrays = _arrays(x, v, F, stress, self.reference, self.magnet, self.quantities)
        self._append(time, arrays, np.full(3, np.nan) if field is None else np.asarray(field, dtype=float))
        self._rows(time, energies, contacts or {})
        self.frames += 1

    def _afford(self, time: float) -> None:
        needed = _OVERHEAD if self.frames < self._places else self.frame_size
        at = f"after {self.frames} frames, before the one at t = {time:g} s"
        remedy = (
            "remedy: a larger output_every writes fewer frames, fewer resolution.cells_across make them smaller; "
            f"what was written so far is whole: {self.path}"
        )
        if self.max_disk is not None and self.size + needed > self.max_disk:
            raise BudgetError(
                f"solver.dynamic.max_disk: received {_bytes(self.max_disk)}; the motion takes {_bytes(self.size)} {at}, "
                f"which would add {_bytes(needed)}\n  rule: the motion's files must stay within max_disk\n"
                f"  {remedy}; or raise max_disk"
            )
        free = shutil.disk_usage(self.folder).free
        if free < needed + _KEEP_FREE:
            raise BudgetError(
                f"{self.folder}: the disk is full: {_bytes(free)} are free {at}, which would add {_bytes(needed)}\n"
                f"  rule: {_bytes(_KEEP_FREE)} of the disk are left to others\n  {remedy}"
            )

    def _reserve(self) -> None:
        """Have the disk keep the room a frame takes: HDF5 does not get over a write that fails. Raises BudgetError.

        A quota, or a limit on a file's size, shows only now. What of the room is not used HDF5 gives back as it closes the file.
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
                    f"{self.path}: {error.strerror} after {self.frames} frames, before one more of up to {_bytes(self.frame_size)}\n"
                    "  rule: the motion must fit on the disk, and within the system's limits for this user\n"
                    f"  remedy: a larger output_every writes fewer frames; what was written so far is whole: {self.path}"
                ) from error

    def _create(self, model: Any) -> None:
        """The file without frames."""
        n, integer = len(self.reference), np.dtype(np.int64)
        unfinished = self.path.with_name(f".{MOTION}")
        with h5py.File(unfinished, "w", libver=_FORMAT, locking=False) as file:
            root = file.create_group("VTKHDF")
            root.attrs["Version"] = np.array([2, 1])
            root.attrs.create("Type", np.bytes_("PolyData"))
            root["NumberOfPoints"] = np.array([n])
            self._growing(root, "Points", 3)
            for name in _TOPOLOGIES:
                topology = root.create_group(name)
                cells = n if name == "Vertices" else 0
                topology["NumberOfCells"] = topology["NumberOfConnectivityIds"] = np.array([cells])
                topology["Offsets"] = np.arange(cells + 1)
                topology["Connectivity"] = np.arange(cells)
            steps = root.create_group("Steps")
            steps.attrs["NSteps"] = 0
            _steps(steps, "Values", (), np.dtype(float))
            for name in ("NumberOfParts", "PartOffsets", "PointOffsets"):
                _steps(steps, name, (), integer)
            for name in ("CellOffsets", "ConnectivityIdOffsets"):
                _steps(steps, name, (len(_TOPOLOGIES),), integer)
            data, offsets = root.create_group("PointData"), steps.create_group("PointDataOffsets")
            for name in self.quantities:
                self._growing(data, name, QUANTITIES[name])
            values = (
                np.asarray(model.particles.segment, dtype=np.int32),
                np.asarray(model.particles.volume, dtype=np.float32),
                self.magnet.astype(np.float32),
                self.reference.astype(np.float32),
            )
            for name, array in zip(STATIC, values):
                data[name] = array
            for name in (*self.quantities, *STATIC):
                _steps(offsets, name, (), integer)
            _steps(root.create_group("FieldData"), "field", (3,), np.dtype(float))
            _steps(steps.create_group("FieldDataOffsets"), "field", (), integer)
            _steps(steps.create_group("FieldDataSizes"), "field", (2,), integer)
        scene: Any = getattr(model, "scene", None)
        about = {
            "scene": scene.to_si() if hasattr(scene, "to_si") else scene,
            "name": getattr(scene, "name", ""),
        }
        (self.folder / ABOUT).write_text(json.dumps(about) + "\n", encoding="utf-8")
        unfinished.replace(self.path)

    def _growing(self, group: Any, name: str, components: int) -> None:
        """An array with one chunk a frame."""
        n, tail = len(self.reference), (components,) if components > 1 else ()
        group.create_dataset(
            name, (0, *tail), np.float32, chunks=(n, *tail), maxshape=(None, *tail), fillvalue=np.nan
        )

    def _append(self, time: float, arrays: Mapping[str, Numbers], field: Array) -> None:
        n, k = len(self.reference), self.frames
        self._reserve()
        with _opened_for_growth(self.path) as file:
            root = file["VTKHDF"]
            steps = root["Steps"]
            if k and time <= steps["Values"][k - 1]:
                raise ValueError(f"frame at t = {time} s, but the last one is at {steps['Values'][k - 1]} s")
            for name, array in arrays.items():
                stored = root["Points"] if name == "Points" else root["PointData"][name]
                stored.resize(max((k + 1) * n, len(stored)), axis=0)
                stored[k * n : (k + 1) * n] = array
            rows: list[tuple[Any, Any]] = [
                (steps["Values"], time),
                (steps["NumberOfParts"], 1),
                (steps["PartOffsets"], 0),
                (steps["PointOffsets"], k * n),
                (steps["CellOffsets"], 0),
                (steps["ConnectivityIdOffsets"], 0),
                (root["FieldData"]["field"], field),
                (steps["FieldDataOffsets"]["field"], k),
                (steps["FieldDataSizes"]["field"], (3, 1)),
                *((steps["PointDataOffsets"][name], k * n) for name in self.quantities),
                *((steps["PointDataOffsets"][name], 0) for name in STATIC),
            ]
            for stored, row in rows:
                stored.resize(max(k + 1, len(stored)), axis=0)
                stored[k] = row
            file.flush()  # the frame is on its way to the disk before the number of frames counts it
            steps.attrs.modify("NSteps", k + 1)

    def _rows(self, time: float, energies: Mapping[str, float], contacts: Mapping[str, Any]) -> None:
        """One row of energies.csv, and one of contacts.csv for each effect in contact."""
        if {"t", "kinetic", "elastic"} - {"t", *energies}:
            raise ValueError(f"energies need `kinetic` and `elastic`, got {sorted(energies)}")
        path = self.folder / ENERGIES
        ends = ("dissipated", "total")
        parts = [name for name in energies if name not in ends]
        total = energies.get("total", sum(energies[name] for name in parts))
        row = {name: energies[name] for name in parts}
        if "dissipated" in energies:
            row["dissipated"] = energies["dissipated"]
        _add_row(path, {"t": time, **row, "total": total})
        for effect, contact in contacts.items():
            known = contact if isinstance(contact, Mapping) else _of_object(contact)
            force = np.asarray(known["force"], dtype=float)
            _add_row(
                self.folder / CONTACTS,
                {
                    "t": time,
                    "effect": effect,
                    **{f"F{axis}": force[i] for i, axis in enumerate("xyz")},
                    **{name: known.get(name, "") for name in ("count", "depth")},
                },
            )

    def _resume(self, time: float) -> int:
        """Drop the frames after a time; how many are left. They are no longer counted, and what follows is written over them."""
        mend(self.path)
        with _opened_for_growth(self.path) as file:
            root = file["VTKHDF"]
            steps = root["Steps"]
            n = len(self.reference)
            stored = tuple(name for name in root["PointData"] if name not in STATIC)
            if int(root["NumberOfPoints"][0]) != n or set(stored) != set(self.quantities):
                raise InputError(
                    f"{self.path}: holds another motion ({int(root['NumberOfPoints'][0])} particles, {', '.join(stored)}), not "
                    f"this one's ({n} particles, {', '.join(self.quantities)}); resume with the scene it began with"
                )
            kept = int(np.count_nonzero(steps["Values"][: steps.attrs["NSteps"]] <= time * (1 + 1e-12)))
            steps.attrs.modify("NSteps", kept)
            self._places = len(steps["Values"])
            last = float(steps["Values"][kept - 1]) if kept else -np.inf
        for name in (ENERGIES, CONTACTS):
            _cut_rows(self.folder / name, last)
        return kept


def _opened_for_growth(path: Path) -> h5py.File:
    """The file, in the mode in which what HDF5 writes can be read at every moment.

    It enters that mode as it is opened: between `h5py.File(path, "r+")` and `swmr_mode = True` the file would be marked as written in
    no readable order, and a run killed there would leave a file that nothing opens any more.
    """
    access = h5py.h5p.create(h5py.h5p.FILE_ACCESS)
    access.set_libver_bounds(h5py.h5f.LIBVER_V110, h5py.h5f.LIBVER_V110)
    access.set_fclose_degree(h5py.h5f.CLOSE_STRONG)
    access.set_file_locking(False, False)
    flags = h5py.h5f.ACC_RDWR | h5py.h5f.ACC_SWMR_WRITE
    return h5py.File(h5py.h5f.open(bytes(path), flags, access))


def _steps(group: Any, name: str, tail: tuple[int, ...], dtype: np.dtype[Any]) -> None:
    group.create_dataset(name, (0, *tail), dtype, chunks=(_STEPS_CHUNK, *tail), maxshape=(None, *tail))


def _arrays(
    x: Array, v: Array, F: Array, P: Array, reference: Array, magnet: Array, wanted: Sequence[str]
) -> dict[str, Numbers]:
    """What is stored of a frame, in single precision."""
    make = {
        "displacement": lambda: x - reference,
        "velocity": lambda: v,
        "magnetisation": lambda: np.einsum("nij,nj->ni", F, magnet),
        "det_F": lambda: _det(F),
    }
    arrays = {name: make[name]() for name in wanted if name in make}
    if "cauchy_stress" in wanted or "von_mises" in wanted:
        cauchy = np.einsum("nik,njk->nij", P, F) / _det(F)[:, None, None]
        if "cauchy_stress" in wanted:
            arrays["cauchy_stress"] = cauchy.reshape(-1, 9)
        if "von_mises" in wanted:
            arrays["von_mises"] = von_mises(cauchy)
    with np.errstate(over="ignore"):  # of a run that blows up
        return {"Points": x.astype(np.float32), **{k: arrays[k].astype(np.float32) for k in wanted}}


def _det(F: Array) -> Array:
    """det F (n,); by hand, as numpy's determinants of many small matrices are slow."""
    a, b, c = F[:, 0], F[:, 1], F[:, 2]
    return np.asarray(np.einsum("ni,ni->n", a, np.cross(b, c)))


def von_mises(cauchy: Array) -> Array:
    """Von Mises stress (n,) Pa of the symmetric part of stresses (n, 3, 3) Pa: sqrt(3/2 s:s), s its deviator."""
    s = 0.5 * (cauchy + cauchy.transpose(0, 2, 1))
    s = s - np.trace(s, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)
    return np.asarray(np.sqrt(1.5 * np.einsum("nij,nij->n", s, s)))


def _add_row(path: Path, row: Mapping[str, Any]) -> None:
    """One row at the end of a table, which gets its header with the first; numbers with all their digits."""
    new = not path.exists()
    text = [value if isinstance(value, str) else repr(value) for value in map(_plain, row.values())]
    if not new:
        with path.open(encoding="utf-8", newline="") as stream:
            header = next(csv.reader(stream))
        if header != list(row):
            raise ValueError(
                f"{path.name} has the columns {', '.join(header)}; this frame gives {', '.join(row)}"
            )
    with path.open("a", encoding="utf-8", newline="") as stream:
        stream.write(("" if not new else ",".join(row) + "\n") + ",".join(text) + "\n")


def _of_object(contact: Any) -> dict[str, Any]:
    """An effect's report as a mapping; an array is the force alone."""
    if not hasattr(contact, "force"):
        return {"force": contact}
    return {name: getattr(contact, name) for name in ("force", "count", "depth") if hasattr(contact, name)}


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value


def _cut_rows(path: Path, last: float) -> None:
    """Keep the rows of a table until a time; without any left the table goes, as before its first row."""
    if not path.exists():
        return
    header, *rows = path.read_text(encoding="utf-8").splitlines(keepends=True)
    kept = [row for row in rows if row.endswith("\n") and float(row.split(",", 1)[0]) <= last]
    if not kept:
        path.unlink()
        return
    unfinished = path.with_name(f".{path.name}")
    unfinished.write_text("".join([header, *kept]), encoding="utf-8")
    unfinished.replace(path)


def _bytes(size: float) -> str:
    for unit, name in ((1e9, "GB"), (1e6, "MB"), (1e3, "kB")):
        if size >= unit:
            return f"{size / unit:.4g} {name}"
    return f"{size:.0f} bytes"


def opened(path: Path) -> h5py.File:
    """The file to read, waiting for a frame that is being written. Raises OSError if it can't be opened."""
    patience = clock.monotonic() + _PATIENCE
    while True:
        try:
            return h5py.File(path, "r", locking=False)
        except OSError:
            if clock.monotonic() > patience:
                raise
            clock.sleep(0.05)


def mend(path: Path) -> None:
    """Make a file usable that a killed run left marked as being written: whole frames are copied, nothing is lost but the mark.

    While a run is writing a frame its file is marked as well, so the mark must stay for a while to count.
    """
    try:
        opened(path).close()
        return
    except OSError:
        pass
    unfinished = path.with_name(f".{path.name}")
    try:
        with (
            h5py.File(path, "r", libver="latest", swmr=True, locking=False) as marked,
            h5py.File(unfinished, "w", libver=_FORMAT, locking=False) as whole,
        ):
            marked.copy("VTKHDF", whole)
    except (OSError, KeyError, RuntimeError) as error:
        unfinished.unlink(missing_ok=True)
        raise InputError(
            f"{path}: can't be read, nor can its whole frames be saved: {error}\n  rule: must be the motion that a run here wrote\n"
            "  remedy: run again without --resume, or put back a copy of the file"
        ) from error
    unfinished.replace(path)


@dataclass(frozen=True)
class Frame:
    """One moment: number k, time s, position (n, 3) m, field (3,) T or None, and the stored quantities by name."""

    number: int
    time: float
    position: Numbers
    field: Array | None
    quantities: dict[str, Numbers]


@dataclass(frozen=True)
class Motion:
    """A motion that was written; `motion[k]` reads a frame, `motion.position(k)` its positions alone.

    times (frames,) s. fields (frames, 3) T, NaN where it was not given. part (n,), volume (n,) m^3, remanence (n, 3) T, reference
    (n, 3) m: of the undeformed body. energies: table of energies.csv, column -> (frames,); contacts: effect -> {t, Fx, Fy, Fz, count,
    depth} -> (rows,). scene: Scene.to_si() or None.
    """

    folder: Path
    name: str
    scene: dict[str, Any] | None
    times: Array
    fields: Array
    part: NDArray[np.int32]
    volume: Numbers
    remanence: Numbers
    reference: Numbers
    energies: dict[str, Array]
    contacts: dict[str, dict[str, Array]]

    @classmethod
    def load(cls, folder: Path | str) -> Motion:
        """The motion in a folder, also an unfinished one. Raises InputError if it holds none, or one that can't be read."""
        folder = Path(folder)
        path = folder / MOTION
        if not path.exists():
            raise InputError(
                f"{folder}: holds no motion ({MOTION} is missing); give the folder that `magmpm run` named for a dynamic scene"
            )
        try:
            mend(path)
            with opened(path) as file:
                root = file["VTKHDF"]
                steps = int(root["Steps"].attrs["NSteps"])
                static = {name: root["PointData"][name][()] for name in STATIC}
                times = root["Steps"]["Values"][:steps]
                fields = root["FieldData"]["field"][:steps]
            about = json.loads((folder / ABOUT).read_text(encoding="utf-8"))
            energies, contacts = _read_energies(folder / ENERGIES), _read_contacts(folder / CONTACTS)
        except (OSError, KeyError, ValueError) as error:
            raise InputError(f"{folder}: the motion can't be read ({error}); run the scene again") from None
        return cls(
            folder=folder,
            name=about["name"],
            scene=about["scene"],
            times=times,
            fields=fields,
            energies=energies,
            contacts=contacts,
            **static,
        )

    def __len__(self) -> int:
        return len(self.times)

    def __getitem__(self, number: int) -> Frame:
        """Frame k; negative numbers count from the end. Raises IndexError."""
        k = range(len(self))[number]
        n = len(self.part)
        with opened(self.folder / MOTION) as file:
            root = file["VTKHDF"]
            field = root["FieldData"]["field"][k]
            return Frame(
                number=k,
                time=float(self.times[k]),
                position=root["Points"][k * n : (k + 1) * n],
                field=None if np.isnan(field).any() else field,
                quantities={
                    name: root["PointData"][name][k * n : (k + 1) * n]
                    for name in root["PointData"]
                    if name not in STATIC
                },
            )

    def position(self, number: int) -> Numbers:
        """Positions (n, 3) m of frame k alone."""
        k, n = range(len(self))[number], len(self.part)
        with opened(self.folder / MOTION) as file:
            return np.asarray(file["VTKHDF"]["Points"][k * n : (k + 1) * n])

    def nearest(self, time: float) -> int:
        """Number of the frame nearest to a time in s."""
        return int(np.argmin(np.abs(self.times - time)))


def _whole_rows(path: Path) -> list[dict[str, str]]:
    """Rows of a table; the last may be cut off by a kill, and is then left out."""
    if not path.exists():
        return []
    text = path.read_text(encoding="utf-8")
    return list(csv.DictReader(text[: text.rfind("\n") + 1].splitlines()))


def _read_energies(path: Path) -> dict[str, Array]:
    rows = _whole_rows(path)
    return {name: np.array([float(row[name]) for row in rows]) for name in (rows[0] if rows else {})}


def _read_contacts(path: Path) -> dict[str, dict[str, Array]]:
    rows = _whole_rows(path)
    found: dict[str, dict[str, Array]] = {}
    for effect in dict.fromkeys(row["effect"] for row in rows):
        of = [row for row in rows if row["effect"] == effect]
        found[effect] = {
            name: np.array([float(row[name] or "nan") for row in of]) for name in of[0] if name != "effect"
        }
    return found
