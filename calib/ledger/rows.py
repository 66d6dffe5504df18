"""Rows added to a ledger, inside a transaction."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from calib.ledger.blobs import packed, packed_array
from calib.ledger.database import Database
from calib.ledger.identifiers import Identifiers
from calib.outcome import Outcome


def add_evaluation(
    database: Database, identifiers: Identifiers, point: int, attempt: int, outcome: Outcome, created: int
) -> None:
    """Add one evaluation of a point, made at ``created`` (milliseconds since 1970, UTC)."""
    database.execute(
        "INSERT INTO evaluation (point, attempt, status, error, seconds, created,"
        " parameter_names, response_names, parameters, responses) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
        (
            point,
            attempt,
            outcome.status,
            outcome.error,
            outcome.seconds,
            created,
            identifiers.of_names(outcome.values),
            identifiers.of_names(outcome.responses),
            packed(outcome.values.values()),
            packed(outcome.responses.values()),
        ),
    )


def add_individuals(database: Database, rows: Iterable[tuple[int, int, int, int, str, float | None]]) -> None:
    """Add individuals: run, generation, place in it, point, status, misfit."""
    database.executemany(
        "INSERT INTO history (run, generation, individual, point, status, misfit) VALUES (?, ?, ?, ?, ?, ?)", rows
    )


def add_vectors(database: Database, point: int, vectors: Mapping[str, np.ndarray]) -> None:
    """Add vectors of a point by name; one that is already stored stays."""
    database.executemany(
        "INSERT OR IGNORE INTO vector (point, name, numbers) VALUES (?, ?, ?)",
        [(point, name, packed_array(numbers)) for name, numbers in vectors.items()],
    )
