"""Names of the files that a folder of results holds. Apart from what reads and writes them, which imports HDF5."""

from pathlib import Path

NUMBERS = "result.json"
ARRAYS = "state.npz"
MOTION = "motion.vtkhdf"
ENERGIES = "energies.csv"
CONTACTS = "contacts.csv"
ABOUT = "motion.json"
# of equilibria along time
STEPS = "steps.csv"
JUMPS = "jumps.csv"
POSITIONS = "positions.csv"  # of parts
CHECKPOINT = "checkpoint.npz"
PICTURE = "picture.png"
MOVIE = "movie.mp4"
MOMENTS = "moments.png"
ENERGIES_PLOT = "energies.png"
FRAMES = "frames"
OWNER = "scene-file.json"
EARLIER = "earlier"
FAILED = "failed"

SUBFOLDERS = (
    FRAMES,
    EARLIER,
    FAILED,
    "best",
    "improvements",
    "pictures",
    "artifacts",
    "schedule",
)  # a run's and a study's

OF_EQUILIBRIUM = (NUMBERS, ARRAYS)
OF_MOTION = (CHECKPOINT, MOTION, ENERGIES, CONTACTS, POSITIONS, STEPS, JUMPS, ABOUT)

FORMATS = ("png", "svg", "pdf")  # of pictures


def forms(name: str) -> tuple[str, ...]:
    """A picture's names in every form that `--format` offers."""
    return tuple(str(Path(name).with_suffix(f".{kind}")) for kind in FORMATS)


PICTURES = (MOVIE, "movie.gif", *forms(PICTURE), *forms(MOMENTS), *forms(ENERGIES_PLOT))
OF_ACCURACY = ("accuracy.csv", "accuracy.json", *forms("accuracy.png"))  # of `magmpm accuracy`


def forget_motion(folder: Path | str) -> None:
    """Remove an earlier motion from a folder that takes another result: it would seem to belong to it, and be resumed."""
    for name in OF_MOTION:
        (Path(folder) / name).unlink(missing_ok=True)
