"""Rows added to a ledger, inside a transaction."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from calib.execution.outcome import Outcome
from calib.results.ledger.blobs import blob_of_key, packed, packed_array
from calib.results.ledger.database import Database
from calib.results.ledger.identifiers import Identifiers


class Rows:
    """Writer of the rows of one ledger.

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
        self._database.execute(
            "INSERT INTO evaluation (state, key, attempt, status, error, seconds, created,"
            " parameter_names, response_names, parameters, responses) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
            (
                self._identifiers.of_state(fingerprint),
                blob_of_key(key),
                attempt,
                outcome.status,
                outcome.error,
                outcome.seconds,
                created,
                self._identifiers.of_names(outcome.values),
                self._identifiers.of_names(outcome.responses),
                packed(outcome.values.values()),
                packed(outcome.responses.values()),
            ),
        )

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
            "INSERT OR IGNORE INTO vector (state, key, name, numbers) VALUES (?, ?, ?, ?)",
            [(state, point, name, packed_array(numbers)) for name, numbers in vectors.items()],
        )
