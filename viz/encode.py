"""Pictures in a row into a file that plays: mp4 where imageio-ffmpeg is installed, else GIF."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from viz.process import RenderError

NO_FFMPEG = "imageio-ffmpeg is not installed, so the movie is a GIF; for mp4: pip install -e '.[render]' in the checkout of magmpm."

_LEAN = ("-x264-params", "rc-lookahead=2:sync-lookahead=0:ref=1:bframes=0")


@dataclass(frozen=True)
class Movie:
    """path: the file written, .mp4 or .gif. note: empty, or one line that says why it is not an mp4."""

    path: Path
    note: str = ""


def write_mp4(frames: Iterable[np.ndarray], path: Path, fps: int, size: tuple[int, int]) -> None:
    """Encode with H.264 as browsers play it.

    One thread that looks two frames ahead takes 57 MB where the defaults take 103; the file is no larger.
    """
    from imageio_ffmpeg import write_frames

    unfinished = path.with_name(f"{path.stem}.part.mp4")
    writer = write_frames(
        str(unfinished),
        size,
        fps=fps,
        codec="libx264",
        pix_fmt_out="yuv420p",
        macro_block_size=2,
        quality=None,
        output_params=[
            "-crf",
            "20",
            "-preset",
            "veryfast",
            "-threads",
            "1",
            "-movflags",
            "+faststart",
            *_LEAN,
        ],
    )
    try:
        writer.send(None)
        for frame in frames:
            writer.send(np.ascontiguousarray(frame))
    except OSError as error:
        raise RenderError(f"{path.name} could not be encoded: {error}") from None
    finally:
        writer.close()
    unfinished.replace(path)


def write_gif(stills: Iterable[np.ndarray], path: Path, seconds: Sequence[float]) -> None:
    """Pictures (h, w, 3) uint8 shown for so many seconds each, at half the size: a GIF stores every changed pixel."""
    from PIL import Image

    images = [Image.fromarray(still).reduce(2).quantize(128) for still in stills]
    times = [round(1000 * t) for t in seconds]
    images[0].save(path, save_all=True, append_images=images[1:], duration=times, loop=0)
