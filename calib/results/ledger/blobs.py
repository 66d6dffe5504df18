"""What stands in a ledger as bytes: numbers as little-endian 64-bit floats, whose names are stored elsewhere, and keys.

Contents that no ledger writes raise ``sqlite3.DatabaseError``, as do damaged pages.
"""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Iterable, Sequence

import numpy as np


def packed(numbers: Iterable[float]) -> bytes:
    """Eight bytes a number, NaN included."""
    given = [float(number) for number in numbers]
    return struct.pack(f"<{len(given)}d", *given)


def named(names: Sequence[str], content: object) -> dict[str, float]:
    """Packed numbers by name."""
    if not isinstance(content, bytes) or len(content) != 8 * len(names):
        raise sqlite3.DatabaseError("malformed numbers")
    return dict(zip(names, struct.unpack(f"<{len(names)}d", content), strict=True))


def packed_array(numbers: np.ndarray) -> bytes:
    """An array (n,) likewise."""
    return np.asarray(numbers, dtype="<f8").tobytes()


def array(content: object) -> np.ndarray:
    """Packed numbers, (n,)."""
    if not isinstance(content, bytes) or len(content) % 8:
        raise sqlite3.DatabaseError("malformed numbers")
    return np.frombuffer(content, dtype="<f8").astype(float)


def blob_of_key(key: str) -> bytes:
    """The key of a point, which is hexadecimal."""
    return bytes.fromhex(key)


def key_of_blob(content: object) -> str:
    """The key of a point again."""
    if not isinstance(content, bytes):
        raise sqlite3.DatabaseError("malformed key")
    return content.hex()
