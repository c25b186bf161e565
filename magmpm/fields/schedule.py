"""A field's schedule: strength, uniform part and place of its sources at any time.

The strengths of ramp, oscillation and keyframes are multiplied. Sources are first moved as the keyframes say; then the whole field, uniform
part and sources, turns about the axis of the rotation. Before it begins, each part has its initial value; after its end, its final value.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from magmpm.compiled.arrays import Array
from magmpm.fields.kernels import PLACE
from magmpm.fields.over_time import Keyframe, OverTime
from magmpm.fields.sources import FieldSource

DTYPE = np.dtype(PLACE)


def places(
    field: FieldSource, times: Array | None = None, strength: float = 1.0
) -> NDArray[np.void]:
    """Find where the sources are, and how strong.

    Parameters
    ----------
    field : FieldSource
        The sources.
    times : array (k,), s, optional
        When; the end of the schedule unless given.
    strength : float, no unit
        Scales all.

    Returns
    -------
    array
        Records (k,) of fields.kernels.PLACE; one at the end of the schedule.
    """
    times = (
        np.array([end_time(field)])
        if times is None
        else np.atleast_1d(np.asarray(times, dtype=float))
    )
    over = field.over_time
    if over is None:
        times = times[:1]
    out = np.zeros(len(times), DTYPE)
    factor = np.full(len(times), strength)
    uniform: Array = np.tile(np.array(field.uniform, dtype=float), (len(times), 1))
    move = np.zeros((len(times), 3))
    turn = np.tile(np.eye(3), (len(times), 1, 1))
    center = np.zeros(3)
    if over is not None:
        factor = factor * strength_of(over, times)
        uniform = _framed(over.frames, "uniform", times, uniform)
        move = _framed(over.frames, "move", times, move)
        if over.rotation is not None:
            turn = _turn(over, times)
            center = np.array(over.rotation.center)
    out["strength"] = factor
    out["uniform"] = factor[:, None] * np.einsum("kij,kj->ki", turn, uniform)
    out["frame"] = turn.reshape(-1, 9)
    out["origin"] = center + np.einsum("kij,kj->ki", turn, move - center)
    return out


def records(
    field: FieldSource, dtype: np.dtype[Any], times: Array | None, strength: float
) -> NDArray[np.void]:
    """Find where the sources are, and how strong, as records of an effect.

    Parameters
    ----------
    field : FieldSource
        The sources.
    dtype : np.dtype[Any]
        Has the entries of PLACE.
    times : array (k,), s, or None
        When; None: the end of the schedule.
    strength : float, no unit
        Scales all.

    Returns
    -------
    array
        Records (k,) of this dtype.
    """
    found = places(field, times, strength)
    out = np.zeros(len(found), dtype)
    for entry in PLACE:
        out[entry[0]] = found[entry[0]]
    return out


def end_time(field: FieldSource) -> float:
    """Find when everything of a field that ends has ended.

    Parameters
    ----------
    field : FieldSource
        The sources.

    Returns
    -------
    float, s
        The time; 0 where nothing changes or nothing ends.
    """
    return ended(field.over_time)


def ended(over: OverTime | None) -> float:
    """Find when everything of a schedule that ends has ended.

    Parameters
    ----------
    over : OverTime or None
        The schedule, or None.

    Returns
    -------
    float, s
        The time; 0 where nothing changes or nothing ends.
    """
    if over is None:
        return 0.0
    ends = [0.0]
    if over.ramp is not None:
        ends.append(over.ramp.start + over.ramp.duration)
    if over.rotation is not None and over.rotation.turns is not None:
        ends.append(over.rotation.start + over.rotation.turns / abs(over.rotation.frequency))
    if over.oscillation is not None and over.oscillation.cycles is not None:
        ends.append(over.oscillation.start + over.oscillation.cycles / over.oscillation.frequency)
    ends += [frame.time for frame in over.frames[-1:]]
    return max(ends)


def sample_times(field: FieldSource) -> Array:
    """Find times that sample the whole path of the sources: which part of their frame the body may reach.

    Parameters
    ----------
    field : FieldSource
        The sources.

    Returns
    -------
    array (k,), s
        The times.
    """
    over = field.over_time
    if over is None:
        return np.zeros(1)
    times = [np.array([0.0, end_time(field)]), np.array([frame.time for frame in over.frames])]
    if over.rotation is not None:
        turns = min(over.rotation.turns or 1.0, 1.0)
        times.append(
            over.rotation.start + np.linspace(0.0, turns / abs(over.rotation.frequency), 73)
        )
        if over.frames and over.frames[-1].time < 1e4 / abs(over.rotation.frequency):
            times.append(
                np.linspace(0.0, over.frames[-1].time + 1.0 / abs(over.rotation.frequency), 2000)
            )
    return np.unique(np.concatenate(times))


def moments(field: FieldSource, end: float, most: int = 1_000_000) -> Array:
    """Find times that sample how a field changes: the ends of its parts, and sixteen in each cycle, its crests among them.

    Parameters
    ----------
    field : FieldSource
        The sources.
    end : float, s
        Until when.
    most : int
        Times of one part at most: the first of them.

    Returns
    -------
    array (k,), s
        The times, rising from 0 to the end; 0 alone where nothing passes.
    """
    if end == 0.0:
        return np.zeros(1)
    times = [np.linspace(0.0, end, 1000)]
    over = field.over_time
    if over is not None:
        times.append(np.array([frame.time for frame in over.frames]))
        if over.ramp is not None:
            times.append(over.ramp.start + np.array([0.0, over.ramp.duration]))
        for swing in (over.rotation, over.oscillation):
            if swing is None:
                continue
            step = 1.0 / (16.0 * abs(swing.frequency))
            ahead = -getattr(swing, "phase", 0.0) / (2.0 * np.pi) % (1.0 / 16.0) * 16.0
            count = min(max(end - swing.start, 0.0) / step + 1.0, most)
            times.append(swing.start + step * (ahead + np.arange(-1.0, count)))
        times.append(np.array([end_time(field)]))
    every = np.unique(np.concatenate(times))
    return every[(every >= 0.0) & (every <= end)]


def strength_of(over: OverTime, times: Array) -> Array:
    """Find the factor of the whole field over time.

    Parameters
    ----------
    over : OverTime
        The schedule.
    times : array (k,), s
        When.

    Returns
    -------
    array (k,), no unit
        The factors.
    """
    factor = np.ones(len(times))
    if over.ramp is not None:
        share = np.clip((times - over.ramp.start) / over.ramp.duration, 0.0, 1.0)
        factor *= over.ramp.begin + (over.ramp.end - over.ramp.begin) * share
    if over.oscillation is not None:
        swing = over.oscillation
        passed = np.maximum(times - swing.start, 0.0)
        if swing.cycles is not None:
            passed = np.minimum(passed, swing.cycles / swing.frequency)
        factor *= swing.mean + swing.amplitude * np.sin(
            2 * np.pi * swing.frequency * passed + swing.phase
        )
    return factor * _framed(over.frames, "strength", times, np.ones(len(times)))


def _framed(frames: tuple[Keyframe, ...], key: str, times: Array, otherwise: Array) -> Array:
    """A keyframed quantity at times (k,): linear between the keyframes that give it, constant outside of them."""
    given = [
        (frame.time, getattr(frame, key)) for frame in frames if getattr(frame, key) is not None
    ]
    if not given:
        return otherwise
    at = np.array([time for time, _ in given])
    values = np.array([value for _, value in given])
    if values.ndim == 1:
        return np.interp(times, at, values)
    return np.stack([np.interp(times, at, values[:, i]) for i in range(3)], axis=1)


def _turn(over: OverTime, times: Array) -> Array:
    """Rotation matrices (k, 3, 3)."""
    from scipy.spatial.transform import (
        Rotation,
    )  # only where sources rotate: its import takes 0.2 s

    turning = over.rotation
    assert turning is not None
    turns = np.maximum(times - turning.start, 0.0) * turning.frequency
    if turning.turns is not None:
        turns = np.clip(turns, -turning.turns, turning.turns)
    angle = (
        2 * np.pi * (turns - np.rint(turns))
    )  # whole turns are removed first: the angle is accurate even after a hundred hours
    return Rotation.from_rotvec(angle[:, None] * turning.axis).as_matrix()
