"""The searches of a study as they run: its ledger is read as it grows, and nothing in it is locked or changed."""

from __future__ import annotations

import json
import math
import sqlite3
import threading
from bisect import bisect_right
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import quote

from calib.results.ledger.rows import unpacked
from calib.results.ledger.schema import VERSION

_PATIENCE = 0.05
"""Seconds that a reader waits for a lock."""
# By its index on generations SQLite would go through the whole history, for some hundred new rows.
_OF_GENERATIONS = (
    "FROM history NOT INDEXED JOIN run ON run.id = history.run WHERE history.id > ?"
    " GROUP BY history.run, generation ORDER BY history.run, generation"
)
# SQLite takes key and state from the row of the minimum, where it is the only one in the query.
_GENERATIONS = (
    "SELECT run.name, generation, MIN(misfit), AVG(misfit), COUNT(*), SUM(status = 'failed'),"
    f" SUM(status = 'infeasible'), history.key, history.state {_OF_GENERATIONS}"
)
_LASTS = f"SELECT MAX(history.id) {_OF_GENERATIONS}"
_POINT = (
    "SELECT p.names, evaluation.parameters, r.names, evaluation.responses FROM evaluation"
    " JOIN names AS p ON p.id = evaluation.parameter_names JOIN names AS r ON r.id = evaluation.response_names"
    " WHERE state = ? AND key = ? AND status = 'ok' ORDER BY attempt DESC LIMIT 1"
)


@dataclass
class SearchRun:
    """One search of the ledger.

    Attributes
    ----------
    name : str
        Its name in the ledger.
    generations : list of list
        ``generation, best, mean`` of each; ``best`` is the lowest misfit so far. None where there is none.
    individuals, failed, infeasible, last : int
        Counts, and the latest row of the history.
    lasts : list of int
        The latest row of each generation.
    best : (float, bytes, int)
        Lowest misfit, with the key and the state of its point.
    """

    name: str
    generations: list[list[Any]] = field(default_factory=list)
    individuals: int = 0
    failed: int = 0
    infeasible: int = 0
    last: int = 0
    lasts: list[int] = field(default_factory=list)
    best: tuple[float, bytes, int] = (math.inf, b"", 0)

    @property
    def case(self) -> str:
        """The case of the calibration."""
        return self.name.rsplit(":", 2)[0]

    def generations_since(self, row: int) -> list[list[Any]]:
        """The generations that hold later rows of the history than that."""
        return self.generations[bisect_right(self.lasts, row) :]


class LedgerReader:
    """Reads what was added to a ledger since the last time.

    Parameters
    ----------
    path : Path
    """

    def __init__(self, path: Path):
        self._path = path
        self._lock = threading.Lock()
        self._forget()

    def _forget(self) -> None:
        self._runs: dict[str, SearchRun] = {}
        self._last = self._evaluated = self._evaluations = 0
        self._file: tuple[int, int] = (0, 0)

    def read(self) -> list[SearchRun]:
        """The searches, those of the latest rows last; the last known ones while the ledger cannot be read."""
        with self._lock:
            try:
                known = self._path.stat()
                if (known.st_dev, known.st_ino) != self._file:
                    self._forget()
                    self._file = known.st_dev, known.st_ino
                with closing(self._connected()) as database:
                    (version,) = database.execute("PRAGMA user_version").fetchone()
                    if version == VERSION:
                        self._take(database)
            except (OSError, sqlite3.Error):
                pass
            return sorted(self._runs.values(), key=lambda run: run.last)

    @property
    def evaluations(self) -> int:
        """Rows of evaluations when it was last read."""
        return self._evaluations

    def point(self, run: SearchRun) -> tuple[dict[str, float], dict[str, float]]:
        """Parameters and responses of the best point of a search; empty where they cannot be read."""
        _, key, state = run.best
        try:
            with closing(self._connected()) as database:
                row = database.execute(_POINT, (state, key)).fetchone()
            if row is None:
                return {}, {}
            return unpacked(json.loads(row[0]), row[1]), unpacked(json.loads(row[2]), row[3])
        except (OSError, sqlite3.Error, ValueError):
            return {}, {}

    def _connected(self) -> sqlite3.Connection:
        # Without a log beside it nobody writes: then no file is made beside it either.
        writing = self._path.with_name(f"{self._path.name}-wal").exists()
        how = "mode=ro" if writing else "mode=ro&immutable=1"
        return sqlite3.connect(f"file:{quote(str(self._path))}?{how}", uri=True, timeout=_PATIENCE)

    def _take(self, database: sqlite3.Connection) -> None:
        database.execute("BEGIN")  # both queries see one state
        lasts = [last for (last,) in database.execute(_LASTS, (self._last,))]
        rows = database.execute(_GENERATIONS, (self._last,)).fetchall()
        for (name, generation, low, mean, count, failed, infeasible, key, state), last in zip(rows, lasts, strict=True):
            run = self._runs.setdefault(name, SearchRun(name))
            if run.generations and generation <= run.generations[-1][0]:
                # A search that was given again has replaced later generations, where they turned out otherwise.
                self._forget()
                database.execute("COMMIT")
                self._take(database)
                return
            before = run.generations[-1][1] if run.generations else None
            best = low if before is None else before if low is None else min(before, low)
            run.generations.append([generation, best, mean])
            run.lasts.append(last)
            run.individuals += count
            run.failed += failed
            run.infeasible += infeasible
            run.last = max(run.last, last)
            if low is not None and low < run.best[0]:
                run.best = low, key, state
        self._last = max([self._last, *(run.last for run in self._runs.values())])
        found, last = database.execute(
            "SELECT COUNT(*), MAX(id) FROM evaluation WHERE id > ?", (self._evaluated,)
        ).fetchone()
        self._evaluations += found
        self._evaluated = last or self._evaluated


def latest_of_cases(runs: list[SearchRun]) -> list[SearchRun]:
    """The latest search of each case, by case."""
    return sorted({run.case: run for run in runs}.values(), key=lambda run: run.case)
