"""Names of the files that a motion leaves in its folder; apart from what reads and writes them, which takes HDF5."""

from __future__ import annotations

from pathlib import Path

MOTION, ENERGIES, CONTACTS, ABOUT = "motion.vtkhdf", "energies.csv", "contacts.csv", "motion.json"
CHECKPOINT = "checkpoint.npz"


def forget(folder: Path | str) -> None:
    """Remove an earlier motion from a folder that takes another result: it would seem to belong to it, and be resumed."""
    for name in (CHECKPOINT, MOTION, ENERGIES, CONTACTS, ABOUT):
        (Path(folder) / name).unlink(missing_ok=True)
