"""Conversion of a ledger of version 1.

It held numbers as JSON, and repeated fingerprint, key and names in every row.
"""

from __future__ import annotations

import json
import math
import sqlite3
from datetime import datetime

from calib.ledger.blobs import array
from calib.ledger.database import Database
from calib.ledger.identifiers import Identifiers
from calib.ledger.rows import add_evaluation, add_individuals, add_vectors
from calib.ledger.schema import create
from calib.outcome import Outcome

_FORMER = ("evaluation", "history", "vector")


def convert(database: Database) -> None:
    """Replace the tables of version 1, inside a transaction: evaluations and individuals keep their order.

    InputError where a row is damaged.
    """
    present = {name for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    for trigger in ("evaluation_stays", "evaluation_remains"):
        database.execute(f"DROP TRIGGER IF EXISTS {trigger}")
    for table in _FORMER:
        if table in present or table != "vector":  # made on first use
            database.execute(f"ALTER TABLE {table} RENAME TO former_{table}")
    create(database)
    try:
        _copy_evaluations(database)
        _copy_history(database)
        if "vector" in present:
            _copy_vectors(database)
    except (ValueError, TypeError, AttributeError):
        raise sqlite3.DatabaseError("malformed row") from None
    for table in _FORMER:
        database.execute(f"DROP TABLE IF EXISTS former_{table}")


def _copy_evaluations(database: Database) -> None:
    identifiers = Identifiers(database)
    for fingerprint, key, attempt, parameters, responses, status, error, seconds, created in database.execute(
        "SELECT fingerprint, key, attempt, parameters, responses, status, error, seconds, created"
        " FROM former_evaluation ORDER BY id"
    ):
        point = identifiers.of_points(fingerprint, [key])[key]
        milliseconds = round(1000 * datetime.fromisoformat(created).timestamp())
        outcome = Outcome(_read(parameters), status, _read(responses), error, seconds)
        add_evaluation(database, identifiers, point, attempt, outcome, milliseconds)


def _copy_history(database: Database) -> None:
    identifiers = Identifiers(database)
    add_individuals(
        database,
        (
            (identifiers.of_run(run), generation, k, identifiers.of_points(fingerprint, [key])[key], status, misfit)
            for run, generation, k, fingerprint, key, status, misfit in database.execute(
                "SELECT run, generation, individual, fingerprint, key, status, misfit FROM former_history ORDER BY id"
            )
        ),
    )


def _copy_vectors(database: Database) -> None:
    identifiers = Identifiers(database)
    for fingerprint, key, name, numbers in database.execute(
        "SELECT fingerprint, key, name, numbers FROM former_vector"
    ):
        add_vectors(database, identifiers.of_points(fingerprint, [key])[key], {name: array(numbers)})


def _read(text: str) -> dict[str, float]:
    return {name: math.nan if value is None else float(value) for name, value in json.loads(text).items()}
