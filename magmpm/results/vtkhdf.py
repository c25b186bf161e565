"""A file of frames, `motion.vtkhdf`, that ParaView opens, that can be read while it grows, and whose frames have checksums.

Format: https://docs.vtk.org/en/latest/vtk_file_formats/vtkhdf_file_format/index.html, PolyData of one vertex a particle, whose points
move: vertices and what is constant in time are stored once. Next to VTK's group, the group `magmpm` has a checksum (CRC-32) of each array
of each frame, in the order time and field, Points, quantities; and one of what is stored once.

The file is closed between frames. While it is open, HDF5 writes in an order in which it can be read at any moment (single writer, multiple
readers). A frame is counted only after all of it was flushed to the disk. Arrays and rows are extended for many frames at a time, and a
frame's arrays are written directly, past HDF5's cache: this saves a hundred calls a frame.
"""

from __future__ import annotations

import time as clock
import zlib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import h5py
import numpy as np
from h5py import h5d, h5l, h5o
from numpy.typing import NDArray

from magmpm.compiled.arrays import Array, Plain
from magmpm.errors import InputError
from magmpm.results.folder_lock import folder_lock
from magmpm.results.frame_arrays import QUANTITIES, Numbers
from magmpm.results.hdf5_mark import marked_in_order, state_of, unmark

T = TypeVar("T")

STATIC = ("part", "volume", "remanence", "reference")
_TOPOLOGIES = ("Vertices", "Lines", "Polygons", "Strips")
_AHEAD = 64  # frames by which arrays and rows are extended at a time: a chunk of the rows
_MOMENT = 0.02  # s between two looks at a file
_TIMES = "VTKHDF/Steps/Values"
_FIELD = "VTKHDF/FieldData/field"
_COUNT = "NSteps"
_SUMS = "magmpm/checksum"


class FrameFile:
    """A file of frames, open only while one is written. n: particles; frames: written so far; places: frames with room on the disk."""

    def __init__(self, path: Path, n: int, frames: int = 0, places: int = 0) -> None:
        self.path = path
        self.n = n
        self.frames = frames
        self.places = places
        self.last = -np.inf  # s, time of the last frame
        self._rows = frames  # rows that the file has

    @classmethod
    def create(cls, path: Path, static: Mapping[str, NDArray[Any]]) -> FrameFile:
        """A file without frames; static: the arrays of STATIC, (n, ...) each."""
        n = len(static["part"])
        unfinished = path.with_name(f".{path.name}")
        empty = h5py.h5f.create(
            bytes(unfinished), h5py.h5f.ACC_TRUNC, _untimed(h5py.h5p.FILE_CREATE), _access()
        )
        with h5py.File(empty) as file:
            _write_head(file, n, static)
        unfinished.replace(path)
        return cls(path, n)

    @classmethod
    def resume(cls, path: Path, n: int, until: float) -> FrameFile:
        """A file that was written before, without its frames after a time (s).

        New frames overwrite them. Raises InputError where the file is another motion's, or where a frame to keep is not whole.
        """
        mend(path)
        with opened(path) as file:
            stored = [name for name in file["VTKHDF/PointData"] if name not in STATIC]
            particles = int(file["VTKHDF/NumberOfPoints"][0])
            if particles != n or set(stored) != set(QUANTITIES):
                raise InputError(
                    f"{path}: holds another motion ({particles} particles, {', '.join(stored)}), "
                    f"not this one's ({n} particles, {', '.join(QUANTITIES)}); resume with the "
                    "original scene"
                )
            count = int(file["VTKHDF/Steps"].attrs[_COUNT])
            kept = int(np.count_nonzero(file[_TIMES][:count] <= until * (1 + 1e-12)))
            check(path, file, range(kept))
            last = float(file[_TIMES][kept - 1]) if kept else -np.inf
            rows = len(file[_SUMS])
        _count_only(path, kept)
        resumed = cls(path, n, kept, count)
        resumed.last = last
        resumed._rows = rows
        return resumed

    def append(self, time: float, arrays: Mapping[str, Numbers], field: Array) -> None:
        """Add a frame: time s, later than the last; Points (n, 3) m and every quantity; field (3,) T. Raises ValueError, OSError."""
        if time <= self.last:
            raise ValueError(f"frame at t = {time} s, but the last one is at {self.last} s")
        k = self.frames
        names = ("Points", *QUANTITIES)
        moment = np.array([time, *field], dtype=float)
        sums = [_sum(moment), *(_sum(arrays[name]) for name in names)]
        identifier = _open_for_growth(self.path)
        try:
            if (
                k >= self._rows
            ):  # but not of the times: VTK's reader reads all of them into room for the counted ones
                self._lengthen(identifier)
            for name in names:
                dataset = h5d.open(identifier, _place(name).encode())
                dataset.write_direct_chunk((k * self.n, 0)[: arrays[name].ndim], arrays[name])
            _write_row(identifier, _FIELD, k, moment[1:])
            _write_row(identifier, _SUMS, k, np.array(sums, dtype=np.uint32))
            h5py.h5f.flush(identifier)  # before the number of frames counts it
            _write_row(identifier, _TIMES, k, moment[0], grow=True)
            steps = h5py.h5g.open(identifier, b"VTKHDF/Steps")
            h5py.h5a.open(steps, _COUNT.encode()).write(np.array(k + 1, dtype=np.int64))
        finally:
            identifier.close()
        self.frames, self.last, self.places = k + 1, time, max(k + 1, self.places)

    def _lengthen(self, identifier: Any) -> None:
        """Extend the file for more frames, and write the rows that are known beforehand."""
        file = h5py.File(identifier)
        first = self._rows
        count = first + _AHEAD
        steps = np.arange(first, count)
        points = steps * self.n
        of_steps: Plain = {
            "NumberOfParts": 1,
            "PartOffsets": 0,
            "PointOffsets": points,
            "CellOffsets": 0,
            "ConnectivityIdOffsets": 0,
            "FieldDataOffsets/field": steps,
            "FieldDataSizes/field": (3, 1),
            **{f"PointDataOffsets/{name}": points for name in QUANTITIES},
            **dict.fromkeys([f"PointDataOffsets/{name}" for name in STATIC], 0),
        }
        of_file = {_FIELD: np.nan, _SUMS: 0}
        rows = {f"VTKHDF/Steps/{name}": values for name, values in of_steps.items()}
        for name, values in (rows | of_file).items():
            file[name].resize(count, axis=0)
            file[name][first:] = values
        for name in ("Points", *QUANTITIES):
            file[_place(name)].resize(count * self.n, axis=0)
        self._rows = count


def _write_head(file: h5py.File, n: int, static: Mapping[str, NDArray[Any]]) -> None:
    integer = np.dtype(np.int64)
    number = np.dtype(float)
    root = _group(file, "VTKHDF")
    root.attrs["Version"] = np.array([2, 1])
    root.attrs.create("Type", np.bytes_("PolyData"))
    root["NumberOfPoints"] = np.array([n])
    _growing(file, "Points", n, 3)
    for name in _TOPOLOGIES:
        topology = _group(root, name)
        cells = n if name == "Vertices" else 0
        topology["NumberOfCells"] = topology["NumberOfConnectivityIds"] = np.array([cells])
        topology["Offsets"] = np.arange(cells + 1)
        topology["Connectivity"] = np.arange(cells)
    steps = _group(root, "Steps")
    steps.attrs[_COUNT] = np.int64(0)
    _row_of(steps, "Values", (), number)
    for name in ("NumberOfParts", "PartOffsets", "PointOffsets"):
        _row_of(steps, name, (), integer)
    for name in ("CellOffsets", "ConnectivityIdOffsets"):
        _row_of(steps, name, (len(_TOPOLOGIES),), integer)
    data = _group(root, "PointData")
    offsets = _group(steps, "PointDataOffsets")
    for name, components in QUANTITIES.items():
        _growing(file, name, n, components)
    for name in STATIC:
        data[name] = static[name]
    for name in (*QUANTITIES, *STATIC):
        _row_of(offsets, name, (), integer)
    _row_of(_group(root, "FieldData"), "field", (3,), number)
    _row_of(_group(steps, "FieldDataOffsets"), "field", (), integer)
    _row_of(_group(steps, "FieldDataSizes"), "field", (2,), integer)
    own = _group(file, "magmpm")
    _row_of(own, "checksum", (2 + len(QUANTITIES),), np.dtype(np.uint32))
    own.attrs["quantities"] = list(QUANTITIES)
    own.attrs["static"] = np.uint32(_sum_of_static(static))


def _group(parent: h5py.Group, name: str) -> h5py.Group:
    return h5py.Group(
        h5py.h5g.create(parent.id, name.encode(), gcpl=_untimed(h5py.h5p.GROUP_CREATE))
    )


def _untimed(kind: Any) -> Any:
    """Settings of an object to be made: without the time of day (HDF5 before 2.0), so that a motion's file has the same bits again."""
    made = h5py.h5p.create(kind)
    made.set_obj_track_times(False)
    return made


def _place(name: str) -> str:
    return "VTKHDF/Points" if name == "Points" else f"VTKHDF/PointData/{name}"


def _growing(file: h5py.File, name: str, n: int, components: int) -> None:
    """An array with one chunk a frame."""
    tail = (components,) if components > 1 else ()
    file.create_dataset(
        _place(name),
        (0, *tail),
        np.float32,
        chunks=(n, *tail),
        maxshape=(None, *tail),
        fillvalue=np.nan,
    )


def _row_of(group: Any, name: str, tail: tuple[int, ...], dtype: np.dtype[Any]) -> None:
    """A table with a row a frame."""
    group.create_dataset(name, (0, *tail), dtype, chunks=(_AHEAD, *tail), maxshape=(None, *tail))


def _write_row(identifier: Any, name: str, k: int, values: Any, *, grow: bool = False) -> None:
    dataset = h5d.open(identifier, name.encode())
    row = np.atleast_1d(values)[None]
    if grow:
        dataset.set_extent((k + 1,))
    space = dataset.get_space()
    shape = (1, *space.shape[1:])
    space.select_hyperslab((k, *(0 for _ in shape[1:])), shape)
    dataset.write(h5py.h5s.create_simple(shape), space, np.ascontiguousarray(row.reshape(shape)))


def _sum(array: NDArray[Any], before: int = 0) -> int:
    """CRC-32 of an array's bytes, or of those and what was summed before."""
    return zlib.crc32(array.data, before)


def _sum_of_static(static: Mapping[str, NDArray[Any]]) -> int:
    total = 0
    for name in STATIC:
        total = _sum(np.ascontiguousarray(static[name]), total)
    return total


def _open_for_growth(path: Path) -> Any:
    """The file, opened so that what HDF5 writes can be read at every moment (single writer, multiple readers).

    Between `h5py.File(path, "r+")` and `swmr_mode = True` the file would be marked as open in another mode, and a run killed there would
    leave a file that nothing can open.
    """
    return h5py.h5f.open(bytes(path), h5py.h5f.ACC_RDWR | h5py.h5f.ACC_SWMR_WRITE, _access())


def _access() -> Any:
    """Settings to open a file with. HDF5 1.10 and later can read it, and so ParaView 5.6 and later, whatever is installed here."""
    access = h5py.h5p.create(h5py.h5p.FILE_ACCESS)
    access.set_libver_bounds(h5py.h5f.LIBVER_V110, h5py.h5f.LIBVER_V110)
    access.set_fclose_degree(h5py.h5f.CLOSE_STRONG)
    access.set_file_locking(False, False)
    return access


def _count_only(path: Path, frames: int) -> None:
    """Drop the frames after these."""
    with h5py.File(_open_for_growth(path)) as file:
        steps = file["VTKHDF/Steps"]
        steps.attrs.modify(_COUNT, frames)
        steps["Values"].resize(frames, axis=0)


def read_static(file: h5py.File) -> Plain:
    """Read the arrays that are stored once: those of STATIC."""
    return {name: file["VTKHDF/PointData"][name][()] for name in STATIC}


def read_moments(file: h5py.File) -> tuple[Array, Array]:
    """Times (frames,) s and fields (frames, 3) T of all frames."""
    count = int(file["VTKHDF/Steps"].attrs[_COUNT])
    return file[_TIMES][:count], file[_FIELD][:count]


def read_arrays(
    path: Path, file: h5py.File, k: int, names: Iterable[str] | None = None
) -> dict[str, Numbers]:
    """Points and quantities of frame k by name, or those named. Raises InputError where they are not as they were written."""
    n = int(file["VTKHDF/NumberOfPoints"][0])
    stored = [str(name) for name in file["magmpm"].attrs["quantities"]]
    sums = file[_SUMS][k]
    found = {}
    for name in ("Points", *stored) if names is None else names:
        found[name] = file[_place(name)][k * n : (k + 1) * n]
        if _sum(found[name]) != sums[1 + ("Points", *stored).index(name)]:
            raise damaged(path, file, k, name)
    return found


def check(path: Path, file: h5py.File, frames: Iterable[int]) -> None:
    """Raises InputError where a frame, or what is stored once, is not as it was written."""
    if "magmpm" not in file:
        raise _unreadable(
            path, "a motion without checksums, as an earlier version of magmpm wrote it"
        )
    if _sum_of_static(read_static(file)) != file["magmpm"].attrs["static"]:
        raise _unreadable(
            path, "particles (part, volume, remanence, reference) that are not as they were written"
        )
    for k in frames:
        moment = np.array([file[_TIMES][k], *file[_FIELD][k]])
        if _sum(moment) != file[_SUMS][k][0]:
            raise damaged(path, file, k, "time and field")
        read_arrays(path, file, k)


def damaged(path: Path, file: h5py.File, k: int, name: str) -> InputError:
    count = int(file["VTKHDF/Steps"].attrs[_COUNT])
    return _unreadable(
        path, f"frame {k} of {count} with {name} not as it was written (its checksum is another)"
    )


def _unreadable(path: Path, received: str) -> InputError:
    return InputError(
        str(path),
        received=received,
        rule="must be the whole motion that a run here wrote",
        remedy="run the scene again, without --resume, or put back a copy of the file",
    )


def opened(path: Path) -> h5py.File:
    """The file to read, waiting for a frame that is being written. Raises OSError if it can't be opened.

    A run that goes on changes the mark and the length between two looks, so a failure counts only where the file has stayed as it was.
    """
    begun = since = clock.monotonic()
    seen = None
    while True:
        now = clock.monotonic()
        state = state_of(path)
        if state != seen:
            seen = state
            since = now
        try:
            return self_contained(path, h5py.File(path, "r", locking=False))
        except OSError:
            patience = (
                2.0 if marked_in_order(path) else _MOMENT
            )  # what is marked and does not change was left by a killed run
            if now - since > patience or now - begun > 30.0:
                raise
            clock.sleep(_MOMENT)


def self_contained(path: Path, file: h5py.File) -> h5py.File:
    """The file, if all that it holds is in it. Raises InputError where HDF5 would read, or on `--resume` write, another file."""
    foreign: list[str] = []

    def look(name: bytes, link: Any) -> None:
        away = link.type == h5l.TYPE_EXTERNAL
        item = h5o.open(file.id, name) if link.type == h5l.TYPE_HARD else None
        if isinstance(item, h5d.DatasetID):
            layout = item.get_create_plist()
            away = layout.get_external_count() > 0 or layout.get_layout() == h5d.VIRTUAL
        if away:
            foreign.append(name.decode())

    file.id.links.visit(look, info=True)  # without h5py's objects, at a fifth of their time
    if foreign:
        file.close()
        raise InputError(
            f"{path}: {foreign[0]}",
            received="data of another file",
            rule="a motion's file holds all of its data itself",
            remedy="run the scene again",
        )
    return file


def steady(path: Path, read: Callable[[h5py.File], T]) -> T:
    """Read from the file; again where that fails while a run changes the file. Raises what `read` raises, OSError."""
    for _ in range(5):  # attempts
        before = state_of(path)
        try:
            with opened(path) as file:
                return read(file)
        except (OSError, RuntimeError, KeyError, ValueError, InputError):
            if state_of(path) == before:
                raise
            clock.sleep(_MOMENT)
    with opened(path) as file:
        return read(file)


def mend(path: Path) -> None:
    """Make a file usable that a killed run left marked as being written; only the mark is removed. Raises InputError.

    A run that writes a frame marks its file as well: the mark must stay for a while, with nothing written, and nobody may hold the folder.
    """
    try:
        opened(path).close()
        return
    except OSError as error:
        reason: Exception = error
    if marked_in_order(path):
        with folder_lock(
            path.parent
        ):  # Raises FolderInUse: a run that was suspended in the middle of a frame
            if unmark(path):
                try:
                    with opened(path) as file:
                        times, _ = read_moments(file)
                    _count_only(path, len(times))
                    return
                except (OSError, KeyError) as error:
                    reason = error
    text = str(reason)  # with addresses and names of functions around HDF5's message
    message = text[text.find("(") + 1 : text.rfind(")")] if "(" in text else text
    cause = f"{path.stat().st_size} bytes that can't be opened as HDF5 ({message})"
    raise _unreadable(path, cause) from reason
