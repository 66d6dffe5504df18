"""Rows added to a ledger, inside a transaction, and the integers that stand for fingerprints, names and runs."""

from __future__ import annotations

import hashlib
import json
import sqlite3
import struct
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from calib.execution.outcome import Outcome
from calib.results.ledger.database import Database


def packed(numbers: Iterable[float]) -> bytes:
    """Eight bytes a number, NaN included."""
    given = [float(number) for number in numbers]
    return struct.pack(f"<{len(given)}d", *given)


def unpacked(names: Sequence[str], content: object) -> dict[str, float]:
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


def checksum(*parts: object) -> bytes:
    """Eight bytes by which a row knows its own content: a disk, a copy or a hand may have changed it.

    Of what its integers stand for, not of these: they may have been changed too.
    """
    digest = hashlib.blake2b(digest_size=8)
    for part in parts:
        content = part if isinstance(part, bytes) else repr(part).encode("utf-8", "surrogatepass")
        digest.update(b"%d " % len(content) + content)
    return digest.digest()


def blob_of_key(key: str) -> bytes:
    """The key of a point, which is hexadecimal."""
    return bytes.fromhex(key)


def key_of_blob(content: object) -> str:
    """The key of a point again."""
    if not isinstance(content, bytes):
        raise sqlite3.DatabaseError("malformed key")
    return content.hex()


class Identifiers:
    """Integers of one ledger that stand for texts. What is new is added, which must happen inside a transaction."""

    def __init__(self, database: Database):
        self._database = database
        self._names: dict[int, tuple[str, ...]] = {}
        self._numbers: dict[tuple[str, ...], int] = {}
        self._rollbacks = 0

    def of_state(self, fingerprint: str) -> int:
        """Of a state of model and measurement."""
        return self._of("state", "fingerprint", fingerprint)

    def of_run(self, name: str) -> int:
        """Of a search."""
        return self._of("run", "name", name)

    def of_names(self, names: Iterable[str]) -> int:
        """Of names in this order."""
        self._forget()
        listed = tuple(names)
        if listed not in self._numbers:
            self._numbers[listed] = self._of("names", "names", json.dumps(listed, separators=(",", ":")))
        return self._numbers[listed]

    def names(self, number: int) -> tuple[str, ...]:
        """The names of an integer."""
        self._forget()
        if number not in self._names:
            row = self._database.execute("SELECT names FROM names WHERE id = ?", (number,)).fetchone()
            try:
                self._names[number] = tuple(str(name) for name in json.loads(row[0]))
            except (TypeError, ValueError):
                raise sqlite3.DatabaseError("malformed names") from None
        return self._names[number]

    def known_names(self, number: object) -> tuple[str, ...] | None:
        """The names of an integer; None where it stands for none, or they are damaged."""
        try:
            return self.names(number) if isinstance(number, int) else None
        except sqlite3.DatabaseError:
            return None

    def _forget(self) -> None:
        """After a rollback an integer may come to stand for other names."""
        if self._rollbacks != self._database.rollbacks:
            self._rollbacks = self._database.rollbacks
            self._names.clear()
            self._numbers.clear()

    def _of(self, table: str, column: str, text: str) -> int:
        row = self._database.execute(f"SELECT id FROM {table} WHERE {column} = ?", (text,)).fetchone()
        if row:
            return int(row[0])
        added = self._database.execute(f"INSERT INTO {table} ({column}) VALUES (?)", (text,)).lastrowid
        assert added is not None
        return added


class RowWriter:
    """Adds the rows of one ledger.

    Parameters
    ----------
    database : Database
    identifiers : Identifiers
    """

    def __init__(self, database: Database, identifiers: Identifiers):
        self._database = database
        self._identifiers = identifiers

    def add_evaluation(self, fingerprint: str, key: str, attempt: int, outcome: Outcome, created: int) -> None:
        """Add one evaluation, made at ``created`` (milliseconds since 1970, UTC)."""
        told = (attempt, outcome.status, outcome.error, float(outcome.seconds), created)
        names = tuple(outcome.values), tuple(outcome.responses)
        numbers = packed(outcome.values.values()), packed(outcome.responses.values())
        self._database.execute(
            "INSERT INTO evaluation (state, key, attempt, status, error, seconds, created, parameter_names,"
            " response_names, parameters, responses, checksum) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
            (
                self._identifiers.of_state(fingerprint), blob_of_key(key), *told,
                *map(self._identifiers.of_names, names), *numbers,
                checksum(fingerprint, blob_of_key(key), *told, *names, *numbers),
            ),
        )  # fmt: skip

    def add_individuals(
        self, run: str, fingerprint: str, rows: Iterable[tuple[int, int, str, str, float | None]]
    ) -> None:
        """Add individuals of a run: generation, place in it, key, status and misfit."""
        number, state = self._identifiers.of_run(run), self._identifiers.of_state(fingerprint)
        self._database.executemany(
            "INSERT INTO history (run, state, generation, individual, key, status, misfit)"
            " VALUES (?, ?, ?, ?, ?, ?, ?)",
            [(number, state, generation, k, blob_of_key(key), *rest) for generation, k, key, *rest in rows],
        )

    def add_vectors(self, fingerprint: str, key: str, vectors: Mapping[str, np.ndarray]) -> None:
        """Add vectors of a point by name; one that is already stored stays."""
        state, point = self._identifiers.of_state(fingerprint), blob_of_key(key)
        self._database.executemany(
            "INSERT OR IGNORE INTO vector (state, key, name, numbers, checksum) VALUES (?, ?, ?, ?, ?)",
            [
                (state, point, name, content, checksum(fingerprint, point, name, content))
                for name, content in ((name, packed_array(numbers)) for name, numbers in vectors.items())
            ],
        )
