"""The mark of an HDF5 file that is open for writing, and how to remove it where the writer was killed.

HDF5 marks a file while it is open (File Consistency Flags of the superblock, version 3: bit 0 open for writing, bit 2 single writer and
many readers), and refuses to open it until the mark is removed. A file written in the single-writer mode is consistent at every moment:
without the mark, and with the end of file set to its size, it can be opened as any other. HDF5's own tool (h5clear) does the same.
Format: https://docs.hdfgroup.org/documentation/hdf5/latest/_f_m_t3.html, "Superblock (Versions 2 and 3)".
Checksum: Bob Jenkins, lookup3.c, hashlittle (public domain), https://burtleburtle.net/bob/c/lookup3.c
"""

import struct
from pathlib import Path

_SUPERBLOCK = struct.Struct(
    "<8s4B4Q"
)  # signature; version, sizes of offsets and lengths, flags; base, extension, end, root
_IN_ORDER = 5  # open for writing, in the single-writer mode
_WORD = 0xFFFFFFFF


def marked_in_order(path: Path) -> bool:
    """True if the file is marked as open by a single writer that keeps it consistent at every moment."""
    fields = _read(path)
    return fields is not None and fields[4] == _IN_ORDER


def state_of(path: Path) -> tuple[int, int, int]:
    """State of a file that changes as it is written: time of the last change in ns, length in bytes, mark (-1 without a superblock)."""
    fields = _read(path)
    now = path.stat()
    return now.st_mtime_ns, now.st_size, -1 if fields is None else fields[4]


def unmark(path: Path) -> bool:
    """Remove the mark of such a file; returns whether there was one.

    Only for a file whose writer has died: a running one would go on writing. A truncated file is left as it is.
    """
    fields = _read(path)
    size = path.stat().st_size
    if fields is None or fields[4] != _IN_ORDER or size < fields[7]:
        return False
    block = _SUPERBLOCK.pack(*fields[:4], 0, *fields[5:7], size, fields[8])
    with path.open("r+b", buffering=0) as file:
        file.write(block + struct.pack("<I", lookup3(block)))
    return True


def _read(path: Path) -> tuple[bytes, int, int, int, int, int, int, int, int] | None:
    """Fields of a superblock that is whole and of version 3, else None."""
    signature = b"\x89HDF\r\n\x1a\n"
    with path.open("rb") as file:
        block = file.read(_SUPERBLOCK.size + 4)
    if len(block) < _SUPERBLOCK.size + 4 or block[-4:] != struct.pack("<I", lookup3(block[:-4])):
        return None
    fields = _SUPERBLOCK.unpack(block[:-4])
    return fields if fields[:4] == (signature, 3, 8, 8) else None


def lookup3(data: bytes) -> int:
    """Jenkins's 32-bit hash of some bytes, from 0, as HDF5 uses it for its metadata."""
    a = b = c = (0xDEADBEEF + len(data)) & _WORD
    padded = data + bytes(-len(data) % 12)
    words = struct.unpack(f"<{len(padded) // 4}I", padded)
    for first in range(0, len(words), 3):
        a, b, c = ((one + word) & _WORD for one, word in zip((a, b, c), words[first : first + 3]))
        if first + 3 < len(words):
            a, b, c = _mixed(a, b, c)
    return _last(a, b, c) if words else c


def _turned(word: int, bits: int) -> int:
    return ((word << bits) | (word >> (32 - bits))) & _WORD


def _mixed(a: int, b: int, c: int) -> tuple[int, int, int]:
    for bits in (4, 6, 8, 16, 19, 4):  # each round with the three words in rotation
        a = ((a - c) & _WORD) ^ _turned(c, bits)
        c = (c + b) & _WORD
        a, b, c = b, c, a
    return a, b, c


def _last(a: int, b: int, c: int) -> int:
    for bits in (14, 11, 25, 16, 4, 14, 24):
        c = ((c ^ b) - _turned(b, bits)) & _WORD
        a, b, c = b, c, a
    return b
