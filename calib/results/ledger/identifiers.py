"""Integers that stand for fingerprints, lists of names and runs."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterable

from calib.results.ledger.database import Database


class Identifiers:
    """Those of one ledger. What is new is added, which must happen inside a transaction."""

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
