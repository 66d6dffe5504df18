"""The evaluations of a study, and what its searches requested.

Evaluations are append-only. A search needs no checkpoint: started again with the same seed it requests the same points,
and the ledger returns those that were evaluated before.
"""

from __future__ import annotations

import itertools
import random
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

import numpy as np

from calib.execution.evaluate import BatchEvaluator
from calib.execution.outcome import Individual, Outcome, point_key
from calib.results.ledger.database import Database, connected, marks
from calib.results.ledger.history import History
from calib.results.ledger.rows import (
    Identifiers,
    RowWriter,
    array,
    blob_of_key,
    checksum,
    key_of_blob,
    unpacked,
)
from calib.results.ledger.schema import STATE, VERSION, create, version_of

if TYPE_CHECKING:
    import pandas as pd

_BUSY_SECONDS = 30.0


class Ledger:
    """The evaluations of one study, made with `Ledger.open` or `Ledger.in_memory`.

    Attributes
    ----------
    path : Path
    retried : int
        Points evaluated again since it was opened, because a process had died there or run out of memory or time.
    damaged : int
        Rows found since it was opened whose content has changed since they were written; they count as not there.
    """

    def __init__(self, database: Database):
        self.path = database.path
        self.retried = 0
        self._database = database
        self._identifiers = Identifiers(database)
        self._rows = RowWriter(database, self._identifiers)
        self._history = History(database, self._rows)
        self._tried: set[tuple[str, str]] = set()
        self._damaged: set[tuple[str, int]] = set()
        self._again = False
        self._ahead: dict[tuple[str, str], Outcome] = {}

    @property
    def damaged(self) -> int:
        """See `Ledger`."""
        return len(self._damaged)

    @staticmethod
    def open(path: Path, busy_seconds: float = _BUSY_SECONDS) -> Ledger:
        """Open a ledger, making file and folder where there is none, and converting one of an earlier version.

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
        database = connected(path, busy_seconds)
        try:
            version_of(database)  # what is no ledger stays as it is, its journal mode too
            database.use_write_ahead_log(busy_seconds)
            _prepare(database)
            database.shrink()
        except BaseException:
            database.close()
            raise
        return Ledger(database)

    @staticmethod
    def in_memory() -> Ledger:
        """A ledger without a file, lost when it is closed."""
        database = connected(Path(":memory:"), _BUSY_SECONDS)
        _prepare(database)
        return Ledger(database)

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
        """Stored outcomes by key; of several attempts the last one. Damaged rows count as not there."""
        query = (
            "SELECT id, checksum, key, attempt, status, error, seconds, created, parameter_names, response_names,"
            f" parameters, responses FROM evaluation WHERE key IN ({{}}) AND state = {STATE} ORDER BY key, attempt"
        )
        found: dict[str, Outcome] = {}
        damaged: dict[int, object] = {}
        with self._database.explaining():
            for row in self._database.among(query, map(blob_of_key, keys), fingerprint):
                number, written, key, attempt, status, error, seconds, created, *numbers, parameters, responses = row
                names, responding = (self._identifiers.known_names(one) for one in numbers)
                told = (attempt, status, error, seconds, created, names, responding, parameters, responses)
                if names is None or responding is None or written != checksum(fingerprint, key, *told):
                    damaged[number] = key
                    continue
                values, answer = unpacked(names, parameters), unpacked(responding, responses)
                found[key_of_blob(key)] = Outcome(values, status, answer, error, seconds)
            self._damaged |= {("evaluation", n) for n, key in damaged.items() if key_of_blob(key) not in found}
        return {key: self._ahead.get((fingerprint, key), one) for key, one in found.items()}

    def append(self, fingerprint: str, outcomes: Sequence[Outcome]) -> None:
        """Add evaluations in one transaction.

        A stored point is left as it is, unless its last attempt failed transiently (see `Outcome.transient`), or failed
        at all within `failed_again`: then the new outcome becomes its next attempt.
        """
        keys = [point_key(outcome.values) for outcome in outcomes]
        self._tried.update((fingerprint, key) for key in keys)
        created = time.time_ns() // 1_000_000
        with self._database.transaction():
            known = self.lookup(fingerprint, keys)
            for key, outcome in zip(keys, outcomes, strict=True):
                if key not in known or known[key].transient or (self._again and known[key].status == "failed"):
                    self._rows.add_evaluation(fingerprint, key, self._attempts(fingerprint, key) + 1, outcome, created)
                    known[key] = outcome

    def evaluate(
        self,
        fingerprint: str,
        points: Sequence[Mapping[str, float]],
        evaluator: BatchEvaluator,
        told: Callable[[int], None] = lambda done: None,
    ) -> list[Outcome]:
        """Outcomes of a batch in the order of the points; those not stored are evaluated as one batch.

        Each outcome is stored as soon as it is available: even a killed process loses only the points in progress.

        A failed point is not tried again, with one exception: where a worker process died, or memory or time ran out,
        the point is tried once each time the ledger is opened, provided that worker processes are used (in this
        process such a point could end the command). Within `failed_again` every failed point is tried once. ``told``
        receives the number of points that are known so far.
        """
        keys = [point_key(values) for values in points]
        known = self.lookup(fingerprint, keys)
        repeated = {
            k for k, o in known.items()
            if (o.transient and evaluator.isolated) or (o.status == "failed" and self._again)
            if (fingerprint, k) not in self._tried
        }  # fmt: skip
        self.retried += len(repeated)
        known = {k: o for k, o in known.items() if k not in repeated}
        new = {key: values for key, values in zip(keys, points, strict=True) if key not in known}
        if new:
            done = itertools.count(len(points) - len(new) + 1)

            def arrived(outcome: Outcome) -> None:
                self.append(fingerprint, [outcome])
                told(next(done))

            outcomes = evaluator.evaluate(list(new.values()), arrived)
            known |= dict(zip(new, outcomes, strict=True))
        return [known[key] for key in keys]

    def evaluate_ahead(
        self, fingerprint: str, points: Sequence[Mapping[str, float]], evaluator: BatchEvaluator
    ) -> None:
        """Evaluate and store points that are about to be asked for; `first_use` tells them from others.

        Until then an outcome keeps what is not stored: where the user's code failed, and its traceback.
        """
        keys = [point_key(values) for values in points]
        known = self.lookup(fingerprint, keys)
        outcomes = self.evaluate(fingerprint, points, evaluator)
        self._ahead |= {(fingerprint, k): one for k, one in zip(keys, outcomes, strict=True) if k not in known}

    def first_use(self, fingerprint: str, key: str) -> bool:
        """Whether a point was evaluated ahead of this request; false from then on."""
        return self._ahead.pop((fingerprint, key), None) is not None

    @contextmanager
    def failed_again(self) -> Iterator[None]:
        """While this lasts, a failed point that is requested is evaluated once more."""
        self._again = True
        try:
            yield
        finally:
            self._again = False

    def stored(self, fingerprint: str) -> Outcome | None:
        """One successfully evaluated point; None without any.

        It is drawn with the number of such points as the seed, so that the choice depends on the content alone.
        """
        keys = self._keys(fingerprint, "status = 'ok' ORDER BY key")
        draw = random.Random(len(keys))
        while keys:
            key = draw.choice(keys)
            if found := self.lookup(fingerprint, [key]):
                return found[key]
            keys.remove(key)  # it is damaged
        return None

    def stored_at(self, fingerprint: str, values: Mapping[str, float]) -> str:
        """Day and time (UTC) at which a point was last evaluated; empty when it never was."""
        created = self._number(
            f"SELECT MAX(created) FROM evaluation WHERE state = {STATE} AND key = ?",
            fingerprint,
            blob_of_key(point_key(values)),
        )
        return f"{datetime.fromtimestamp(created / 1000, UTC):%Y-%m-%d %H:%M} UTC" if created else ""

    def failed(self, fingerprint: str) -> list[Outcome]:
        """All points whose last attempt failed, in the order of their keys."""
        keys = self._keys(fingerprint, "status = 'failed' ORDER BY key")
        found = self.lookup(fingerprint, keys)
        return [found[key] for key in keys if key in found and found[key].status == "failed"]

    def count(self, fingerprint: str) -> int:
        """Number of points evaluated in this state of model and measurement."""
        return self._number(f"SELECT COUNT(*) FROM evaluation WHERE state = {STATE} AND attempt = 1", fingerprint)

    def keys(self, fingerprint: str) -> list[str]:
        """Keys of the points evaluated in this state of model and measurement, the earliest first."""
        return self._keys(fingerprint, "attempt = 1 ORDER BY id")

    def numbers(self, fingerprint: str, keys: Iterable[str]) -> dict[str, int]:
        """The number of each evaluated point, by key; it stays what it is."""
        query = f"SELECT key, MIN(id) FROM evaluation WHERE key IN ({{}}) AND state = {STATE} GROUP BY key"
        with self._database.explaining():
            return {key_of_blob(k): n for k, n in self._database.among(query, map(blob_of_key, keys), fingerprint)}

    def design(self, number: int) -> Outcome | None:
        """The evaluated point of that number; None where there is none, or its row is damaged."""
        query = "SELECT fingerprint, key FROM evaluation JOIN state ON state.id = state WHERE evaluation.id = ?"
        with self._database.explaining():
            row = self._database.execute(query, (number,)).fetchone()
        if row is None:
            return None
        fingerprint, key = str(row[0]), key_of_blob(row[1])
        return self.lookup(fingerprint, [key]).get(key)

    def other_fingerprints(self, *current: str) -> int:
        """Number of rows that belong to other states of model and measurement than the current ones."""
        return self._number(
            "SELECT COUNT(*) FROM evaluation WHERE state IN"
            f" (SELECT id FROM state WHERE fingerprint NOT IN ({marks(current)}))",
            *current,
        )

    def _keys(self, fingerprint: str, which: str) -> list[str]:
        """Keys of the points with such an attempt, in that order."""
        with self._database.explaining():
            query = f"SELECT DISTINCT key FROM evaluation WHERE state = {STATE} AND {which}"
            return [key_of_blob(key) for (key,) in self._database.execute(query, (fingerprint,))]

    def _attempts(self, fingerprint: str, key: str) -> int:
        return self._number(
            f"SELECT MAX(attempt) FROM evaluation WHERE state = {STATE} AND key = ?", fingerprint, blob_of_key(key)
        )

    def _number(self, query: str, *given: object) -> int:
        """The one number that a query finds; 0 for NULL."""
        with self._database.explaining():
            (number,) = self._database.execute(query, given).fetchone()
        return int(number or 0)

    # -- vectors -------------------------------------------------------------------------------------------------------

    def vectors(self, fingerprint: str, key: str, names: Sequence[str]) -> dict[str, np.ndarray]:
        """Stored vectors of one point by name, such as its residual and the columns of its Jacobian."""
        query = f"SELECT id, name, numbers, checksum FROM vector WHERE name IN ({{}}) AND state = {STATE} AND key = ?"
        found: dict[str, np.ndarray] = {}
        with self._database.explaining():
            for number, name, numbers, written in self._database.among(query, names, fingerprint, blob_of_key(key)):
                if written == checksum(fingerprint, blob_of_key(key), name, numbers):
                    found[name] = array(numbers)
                else:
                    self._damaged.add(("vector", number))
        return found

    def keep_vectors(self, fingerprint: str, key: str, vectors: Mapping[str, np.ndarray]) -> None:
        """Add vectors of one point, each (n,), in one transaction; one that is already stored whole stays."""
        with self._database.transaction():
            for _, number in {one for one in self._damaged if one[0] == "vector"}:
                self._database.execute("DELETE FROM vector WHERE id = ?", (number,))
            self._rows.add_vectors(fingerprint, key, vectors)

    # -- history -------------------------------------------------------------------------------------------------------

    def record(self, run: str, fingerprint: str, generation: int, individuals: Sequence[Individual]) -> None:
        """Record one generation of a search.

        An evaluated point is ``reused`` if this run requested it earlier, or another run did before this run's first
        generation was recorded; else it is ``solved``. That depends on the requests alone, not on the content of the
        ledger, so a run that was killed and started again records the same history as one that was not.

        The history of a run is always that of one search. A recorded generation stays if the new one is equal; if not
        (after a transient failure, say), it and all later ones are replaced.
        """
        self._history.record(run, fingerprint, generation, individuals)

    def searched(self, run: str) -> str:
        """State of model and measurement in which a run evaluates; empty for one without history."""
        query = (
            "SELECT fingerprint FROM history JOIN state ON state.id = history.state JOIN run ON run.id = history.run"
            " WHERE run.name = ? LIMIT 1"
        )
        with self._database.explaining():
            (found,) = self._database.execute(query, (run,)).fetchone() or ("",)
        return str(found)

    def history(self, run: str) -> pd.DataFrame:
        """Points requested by a run: ``generation, individual, key, status, misfit``, sorted by the first two."""
        return self._history.of(run)


def _prepare(database: Database) -> None:
    """Make the tables of a new ledger, or convert those of an earlier version."""
    with database.transaction():
        version = version_of(database)
        if not version:
            create(database)
        elif version != VERSION:
            from calib.results.ledger.conversion import convert

            convert(database, version)
