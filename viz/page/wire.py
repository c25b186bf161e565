"""How numbers travel to the page: a JSON header, then arrays of single precision or whole numbers, one after the other.

4 bytes: length of the header (little-endian); the header, filled up with spaces to a multiple of 4; the arrays. The header's `arrays` says
of each its name, kind (f: 32-bit float, u: 32-bit whole number) and count.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np


def packed(header: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> bytes:
    """The message. Numbers of the header that are not finite become null."""
    flat = {
        name: np.ascontiguousarray(array, dtype="<u4" if np.issubdtype(array.dtype, np.integer) else "<f4").ravel()
        for name, array in arrays.items()
    }
    about = [{"name": name, "kind": "u" if array.dtype.kind == "u" else "f", "count": len(array)} for name, array in flat.items()]
    head = json.dumps(finite({**header, "arrays": about})).encode()
    head += b" " * (-len(head) % 4)
    return b"".join([struct.pack("<I", len(head)), head, *(array.tobytes() for array in flat.values())])


def finite(value: Any) -> Any:
    """Plain data without numbers that JSON does not know."""
    if isinstance(value, Mapping):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(item) for item in value]
    if isinstance(value, np.ndarray):
        return finite(value.tolist())
    if isinstance(value, (float, np.floating)):
        return float(value) if np.isfinite(value) else None
    return int(value) if isinstance(value, np.integer) else value
