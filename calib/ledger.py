"""Every evaluation and the history of every search, in one SQLite file.

Evaluations are append-only. A search needs no checkpoint: started again with the same seed it requests the same points,
and the ledger returns those that were evaluated before.
"""

from __future__ import annotations

import json
import math
import os
import random
import shutil
import sqlite3
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Literal

import numpy as np
import pandas as pd

from calib.errors import InputError
from calib.evaluate import BatchEvaluator
from calib.outcome import Outcome, key_of

_VERSION = 1
_BUSY_SECONDS = 30.0
_COMPANIONS = 2**17
"""Bytes below which a disk counts as full."""
_AT_ONCE = 500
"""Keys per query; SQLite limits the number of variables in a statement."""

_SCHEMA = (
    """CREATE TABLE evaluation (
        id INTEGER PRIMARY KEY,
        fingerprint TEXT NOT NULL,
        key TEXT NOT NULL,
        attempt INTEGER NOT NULL,
        parameters TEXT NOT NULL,
        responses TEXT NOT NULL,
        status TEXT NOT NULL CHECK (status IN ('ok', 'failed')),
        error TEXT NOT NULL,
        seconds REAL NOT NULL,
        created TEXT NOT NULL,
        UNIQUE (fingerprint, key, attempt))""",
    """CREATE TABLE history (
        id INTEGER PRIMARY KEY AUTOINCREMENT,
        run TEXT NOT NULL,
        generation INTEGER NOT NULL,
        individual INTEGER NOT NULL,
        fingerprint TEXT NOT NULL,
        key TEXT NOT NULL,
        status TEXT NOT NULL CHECK (status IN ('solved', 'reused', 'infeasible', 'failed')),
        misfit REAL,
        UNIQUE (run, generation, individual))""",
    "CREATE INDEX history_key ON history (fingerprint, key)",
    "CREATE TRIGGER evaluation_stays BEFORE UPDATE ON evaluation BEGIN SELECT RAISE(ABORT, 'append-only'); END",
    "CREATE TRIGGER evaluation_remains BEFORE DELETE ON evaluation BEGIN SELECT RAISE(ABORT, 'append-only'); END",
    f"PRAGMA user_version = {_VERSION}",
)

# Not part of the schema: a ledger without this table gets it when it is opened.
_VECTORS = """CREATE TABLE IF NOT EXISTS vector (
    fingerprint TEXT NOT NULL,
    key TEXT NOT NULL,
    name TEXT NOT NULL,
    numbers BLOB NOT NULL,
    PRIMARY KEY (fingerprint, key, name)) WITHOUT ROWID"""


@dataclass(frozen=True)
class Asked:
    """One individual of a generation.

    Attributes
    ----------
    key : str
        From `key_of`.
    status : {"ok", "failed", "infeasible"}
    misfit : float
        NaN unless ``ok``.
    """

    key: str
    status: Literal["ok", "failed", "infeasible"]
    misfit: float = math.nan


class Ledger:
    """The evaluations of one study, made with `Ledger.open` or `Ledger.in_memory`.

    Attributes
    ----------
    path : Path
    retried : int
        Points evaluated again since it was opened, because a process had died there or run out of memory or time.
    """

    def __init__(self, path: Path, database: sqlite3.Connection):
        self.path = path
        self.retried = 0
        self._database = database
        self._tried: set[tuple[str, str]] = set()

    @staticmethod
    def open(path: Path, busy_seconds: float = _BUSY_SECONDS) -> Ledger:
        """Open a ledger, making file and folder where there is none.

        Parameters
        ----------
        path : Path
        busy_seconds : float
            How long to wait for another process that is writing.

        Raises
        ------
        InputError
            When it cannot be written, is no ledger, or is locked for longer than that.
        """
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as fault:
            raise InputError(
                f"the folder cannot be made ({fault.strerror})",
                place=path.parent,
                remedy="choose another --results",
            ) from None
        # SQLite would leave companion files behind that cannot be written either, even once the ledger can.
        if path.is_file() and not os.access(path, os.W_OK):
            raise _explained(sqlite3.OperationalError("readonly"), path)
        try:
            database = sqlite3.connect(path, timeout=busy_seconds, isolation_level=None)
        except sqlite3.Error as fault:
            raise _explained(fault, path) from None
        ledger = Ledger(path, database)
        try:
            ledger._is_new()  # what is no ledger stays as it is, its journal mode too
            with _explaining(path):
                _use_write_ahead_log(database, busy_seconds)
            ledger._prepare()
        except BaseException:
            database.close()
            raise
        return ledger

    @staticmethod
    def in_memory() -> Ledger:
        """A ledger without a file, lost when it is closed."""
        ledger = Ledger(Path(":memory:"), sqlite3.connect(":memory:", isolation_level=None))
        ledger._prepare()
        return ledger

    def _prepare(self) -> None:
        with self._transaction():
            if self._is_new():
                for statement in _SCHEMA:
                    self._database.execute(statement)
            self._database.execute(_VECTORS)

    def _is_new(self) -> bool:
        """Whether there is nothing in the file yet; InputError for anything else than a ledger of this version."""
        with _explaining(self.path):
            # One statement sees one state, even while another process makes the ledger.
            version, tables = self._database.execute(
                "SELECT user_version, (SELECT COUNT(*) FROM sqlite_master) FROM pragma_user_version"
            ).fetchone()
        if (version or tables) and not (version == _VERSION and tables):
            raise InputError(
                "it is a database, but not a ledger of this version of calib",
                place=self.path,
                remedy="move it away; a new one is made",
            )
        return not tables

    def __enter__(self) -> Ledger:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    # -- evaluations ---------------------------------------------------------------------------------------------------

    def lookup(self, fingerprint: str, keys: Iterable[str]) -> dict[str, Outcome]:
        """Stored outcomes by key; of several attempts the last one."""
        wanted = list(dict.fromkeys(keys))
        found: dict[str, Outcome] = {}
        with _explaining(self.path):
            for part in _parts(wanted):
                rows = self._database.execute(
                    "SELECT key, parameters, responses, status, error, seconds FROM evaluation"
                    f" WHERE fingerprint = ? AND key IN ({_marks(part)}) ORDER BY attempt",
                    (fingerprint, *part),
                )
                for key, parameters, responses, status, error, seconds in rows:
                    try:
                        found[key] = Outcome(_read(parameters), status, _read(responses), error, seconds)
                    except (ValueError, TypeError, AttributeError):  # no JSON object of numbers
                        raise _explained(sqlite3.DatabaseError("malformed"), self.path) from None
        return found

    def append(self, fingerprint: str, outcomes: Sequence[Outcome]) -> None:
        """Add evaluations in one transaction.

        A stored point is left as it is, unless its last attempt failed transiently (see `Outcome.transient`): then the
        new outcome becomes its next attempt.
        """
        created = datetime.now(UTC).isoformat(timespec="milliseconds")
        with self._transaction():
            for outcome in outcomes:
                key = key_of(outcome.values)
                self._tried.add((fingerprint, key))
                last = self.lookup(fingerprint, [key]).get(key)
                if last is not None and not last.transient:
                    continue
                (attempts,) = self._database.execute(
                    "SELECT COUNT(*) FROM evaluation WHERE fingerprint = ? AND key = ?", (fingerprint, key)
                ).fetchone()
                self._database.execute(
                    "INSERT INTO evaluation"
                    " (fingerprint, key, attempt, parameters, responses, status, error, seconds, created)"
                    " VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)",
                    (
                        fingerprint,
                        key,
                        attempts + 1,
                        _written(outcome.values),
                        _written(outcome.responses),
                        outcome.status,
                        outcome.error,
                        outcome.seconds,
                        created,
                    ),
                )

    def evaluate(
        self, fingerprint: str, points: Sequence[Mapping[str, float]], evaluator: BatchEvaluator
    ) -> list[Outcome]:
        """Outcomes of a batch in the order of the points; those not stored are evaluated as one batch.

        Each outcome is stored as soon as it is available: even a killed process loses only the points in progress.

        A failed point is not tried again, with one exception: where a worker process died, or memory or time ran out,
        the point is tried once each time the ledger is opened, provided that worker processes are used (in this
        process such a point could end the command).
        """
        keys = [key_of(values) for values in points]
        known = self.lookup(fingerprint, keys)
        if evaluator.isolated:
            again = [k for k, o in known.items() if o.transient and (fingerprint, k) not in self._tried]
            self.retried += len(again)
            known = {k: o for k, o in known.items() if k not in again}
        new = {key: values for key, values in zip(keys, points, strict=True) if key not in known}
        if new:
            outcomes = evaluator.evaluate(list(new.values()), lambda outcome: self.append(fingerprint, [outcome]))
            known |= dict(zip(new, outcomes, strict=True))
        return [known[key] for key in keys]

    def stored(self, fingerprint: str) -> Outcome | None:
        """One successfully evaluated point; None without any.

        It is drawn with the number of such points as the seed, so that the choice depends on the content alone.
        """
        with _explaining(self.path):
            rows = self._database.execute(
                "SELECT DISTINCT key FROM evaluation WHERE fingerprint = ? AND status = 'ok' ORDER BY key",
                (fingerprint,),
            ).fetchall()
        if not rows:
            return None
        (key,) = random.Random(len(rows)).choice(rows)
        return self.lookup(fingerprint, [key])[key]

    def stored_at(self, fingerprint: str, values: Mapping[str, float]) -> str:
        """Day and time (UTC) at which a point was last evaluated; empty when it never was."""
        with _explaining(self.path):
            (created,) = self._database.execute(
                "SELECT MAX(created) FROM evaluation WHERE fingerprint = ? AND key = ?", (fingerprint, key_of(values))
            ).fetchone()
        return "" if created is None else f"{datetime.fromisoformat(created):%Y-%m-%d %H:%M} UTC"

    def failed(self, fingerprint: str) -> list[Outcome]:
        """All points whose last attempt failed, in the order of their keys."""
        with _explaining(self.path):
            rows = self._database.execute(
                "SELECT DISTINCT key FROM evaluation WHERE fingerprint = ? AND status = 'failed' ORDER BY key",
                (fingerprint,),
            ).fetchall()
        found = self.lookup(fingerprint, [key for (key,) in rows])
        return [found[key] for (key,) in rows if found[key].status == "failed"]

    def count(self, fingerprint: str) -> int:
        """Number of points evaluated in this state of model and measurement."""
        return self._number("SELECT COUNT(DISTINCT key) FROM evaluation WHERE fingerprint = ?", fingerprint)

    def other_fingerprints(self, *current: str) -> int:
        """Number of rows that belong to other states of model and measurement than the current ones."""
        return self._number(f"SELECT COUNT(*) FROM evaluation WHERE fingerprint NOT IN ({_marks(current)})", *current)

    # -- vectors -------------------------------------------------------------------------------------------------------

    def vectors(self, fingerprint: str, key: str, names: Sequence[str]) -> dict[str, np.ndarray]:
        """Stored vectors of one point by name, such as its residual and the columns of its Jacobian."""
        found: dict[str, np.ndarray] = {}
        with _explaining(self.path):
            for part in _parts(list(names)):
                rows = self._database.execute(
                    f"SELECT name, numbers FROM vector WHERE fingerprint = ? AND key = ? AND name IN ({_marks(part)})",
                    (fingerprint, key, *part),
                )
                for name, numbers in rows:
                    try:
                        found[name] = np.frombuffer(numbers, dtype="<f8").astype(float)
                    except (ValueError, TypeError):
                        raise _explained(sqlite3.DatabaseError("malformed"), self.path) from None
        return found

    def keep_vectors(self, fingerprint: str, key: str, vectors: Mapping[str, np.ndarray]) -> None:
        """Add vectors of one point, each (n,), in one transaction; one that is already stored stays."""
        with self._transaction():
            self._database.executemany(
                "INSERT OR IGNORE INTO vector (fingerprint, key, name, numbers) VALUES (?, ?, ?, ?)",
                [(fingerprint, key, n, np.asarray(v, dtype="<f8").tobytes()) for n, v in vectors.items()],
            )

    # -- history -------------------------------------------------------------------------------------------------------

    def record(self, run: str, fingerprint: str, generation: int, asked: Sequence[Asked]) -> None:
        """Record one generation of a search.

        An evaluated point is ``reused`` if this run requested it earlier, or another run did before this run's first
        generation was recorded; else it is ``solved``. That depends on the requests alone, not on the content of the
        ledger, so a run that was killed and started again records the same history as one that was not.

        The history of a run is always that of one search. A recorded generation stays if the new one is equal; if not
        (after a transient failure, say), it and all later ones are replaced.
        """
        with self._transaction():
            recorded = self._database.execute(
                "SELECT key, status, misfit FROM history WHERE run = ? AND generation = ? ORDER BY individual",
                (run, generation),
            ).fetchall()
            if recorded:
                stored = [(k, s if s in ("infeasible", "failed") else "ok", m) for k, s, m in recorded]
                if stored == [(a.key, a.status, _nullable(a.misfit)) for a in asked]:
                    return
                self._database.execute("DELETE FROM history WHERE run = ? AND generation >= ?", (run, generation))
            earlier = self._asked_earlier(run, fingerprint, [a.key for a in asked])
            for individual, one in enumerate(asked):
                status: str = one.status
                if status == "ok":
                    status = "reused" if one.key in earlier else "solved"
                if status != "infeasible":
                    earlier.add(one.key)
                self._database.execute(
                    "INSERT INTO history (run, generation, individual, fingerprint, key, status, misfit)"
                    " VALUES (?, ?, ?, ?, ?, ?, ?)",
                    (run, generation, individual, fingerprint, one.key, status, _nullable(one.misfit)),
                )

    def _asked_earlier(self, run: str, fingerprint: str, keys: Sequence[str]) -> set[str]:
        (start,) = self._database.execute("SELECT MIN(id) FROM history WHERE run = ?", (run,)).fetchone()
        found: set[str] = set()
        for part in _parts(list(dict.fromkeys(keys))):
            rows = self._database.execute(
                f"SELECT DISTINCT key FROM history WHERE fingerprint = ? AND key IN ({_marks(part)})"
                " AND status <> 'infeasible' AND (run = ? OR ? IS NULL OR id < ?)",
                (fingerprint, *part, run, start, start),
            )
            found.update(key for (key,) in rows)
        return found

    def history(self, run: str) -> pd.DataFrame:
        """Points requested by a run: ``generation, individual, key, status, misfit``, sorted by the first two."""
        columns = ["generation", "individual", "key", "status", "misfit"]
        with _explaining(self.path):
            rows = self._database.execute(
                f"SELECT {', '.join(columns)} FROM history WHERE run = ? ORDER BY generation, individual", (run,)
            ).fetchall()
        return pd.DataFrame(rows, columns=columns).astype({"misfit": float})

    # -- transactions and faults ---------------------------------------------------------------------------------------

    def _number(self, query: str, *given: str) -> int:
        with _explaining(self.path):
            (number,) = self._database.execute(query, given).fetchone()
        return int(number)

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        """All or nothing, whatever happens inside."""
        with _explaining(self.path):
            self._database.execute("BEGIN IMMEDIATE")
            try:
                yield
                self._database.execute("COMMIT")
            except BaseException:
                if self._database.in_transaction:  # SQLite may have rolled back by itself, on a full disk for one
                    self._database.execute("ROLLBACK")
                raise


def _use_write_ahead_log(database: sqlite3.Connection, busy_seconds: float) -> None:
    """Let readers and one writer work at once; SQLite does not wait for another process that sets the same mode."""
    until = time.monotonic() + busy_seconds
    while True:
        try:
            database.execute("PRAGMA journal_mode = WAL")
            break
        except sqlite3.OperationalError as fault:
            if "locked" not in str(fault) or time.monotonic() > until:
                raise
            time.sleep(0.02)
    # A killed process loses nothing by this, a power cut at most the last transactions, and never the order.
    database.execute("PRAGMA synchronous = NORMAL")


@contextmanager
def _explaining(path: Path) -> Iterator[None]:
    try:
        yield
    except sqlite3.Error as fault:
        raise _explained(fault, path) from None
    except UnicodeDecodeError:  # a text in it, or in SQLite's complaint about it, is no text any more
        raise _explained(sqlite3.DatabaseError("malformed"), path) from None


_REMEDIES = (
    ("locked", "another process is writing to it", "wait until that one has ended, or give this one its own --results"),
    ("full", "the disk is full", "free some space and start again; nothing recorded is lost"),
    ("readonly", "it cannot be written", "make file and folder writable, or choose another --results"),
    ("unable to open", "it cannot be opened or made", "make its folder writable, or choose another --results"),
    ("not a database", "it is not a ledger", "move it away; a new one is made"),
    ("malformed", "it is damaged", "move it away; a new one is made"),
    ("disk i/o", "the disk reports an error", "check disk and connection, or choose another --results"),
)


def _explained(fault: sqlite3.Error, path: Path) -> InputError:
    text = str(fault)
    with suppress(OSError):
        # Without room for its companion files SQLite reports an error of the disk.
        if "disk i/o" in text.lower() and shutil.disk_usage(path.parent).free < _COMPANIONS:
            text = "full"
    for sign, problem, remedy in _REMEDIES:
        if sign in text.lower():
            return InputError(problem, place=path, remedy=remedy)
    return InputError(f"the ledger cannot be used ({text})", place=path, remedy="move it away; a new one is made")


def _written(numbers: Mapping[str, float]) -> str:
    """JSON whose numbers read back exactly; NaN is null."""
    return json.dumps({name: _nullable(value) for name, value in numbers.items()}, allow_nan=False)


def _read(text: str) -> dict[str, float]:
    return {name: math.nan if value is None else float(value) for name, value in json.loads(text).items()}


def _nullable(value: float) -> float | None:
    return None if math.isnan(value) else float(value)


def _parts(keys: list[str]) -> Iterator[list[str]]:
    for start in range(0, len(keys), _AT_ONCE):
        yield keys[start : start + _AT_ONCE]


def _marks(keys: Sequence[str]) -> str:
    return ", ".join("?" * len(keys))
