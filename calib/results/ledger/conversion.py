"""Conversion of a ledger of version 1.

It held numbers as JSON, and repeated fingerprint, key and names in every row.
"""

from __future__ import annotations

import json
import math
import sqlite3
from datetime import datetime

from calib.execution.outcome import Outcome
from calib.results.ledger.database import Database
from calib.results.ledger.rows import Identifiers, RowWriter, array
from calib.results.ledger.schema import create


def convert(database: Database) -> None:
    """Replace the tables of version 1, inside a transaction: evaluations and individuals keep their order.

    A damaged row raises ``sqlite3.DatabaseError``, as damaged pages do.
    """
    present = {name for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    for trigger in ("evaluation_stays", "evaluation_remains"):
        database.execute(f"DROP TRIGGER IF EXISTS {trigger}")
    database.execute("DROP INDEX IF EXISTS history_key")
    former = [table for table in ("evaluation", "history", "vector") if table in present]
    for table in former:
        database.execute(f"ALTER TABLE {table} RENAME TO former_{table}")
    create(database)
    rows = RowWriter(database, Identifiers(database))
    try:
        _copy_evaluations(database, rows)
        _copy_history(database, rows)
        if "vector" in former:  # it was made on first use
            _copy_vectors(database, rows)
    except (ValueError, TypeError, AttributeError):
        raise sqlite3.DatabaseError("malformed row") from None
    for table in former:
        database.execute(f"DROP TABLE former_{table}")


def _copy_evaluations(database: Database, rows: RowWriter) -> None:
    for fingerprint, key, attempt, parameters, responses, status, error, seconds, created in database.execute(
        "SELECT fingerprint, key, attempt, parameters, responses, status, error, seconds, created"
        " FROM former_evaluation ORDER BY id"
    ):
        milliseconds = round(1000 * datetime.fromisoformat(created).timestamp())
        outcome = Outcome(_read(parameters), status, _read(responses), error, seconds)
        rows.add_evaluation(fingerprint, key, attempt, outcome, milliseconds)


def _copy_history(database: Database, rows: RowWriter) -> None:
    for run, fingerprint, *individual in database.execute(
        "SELECT run, fingerprint, generation, individual, key, status, misfit FROM former_history ORDER BY id"
    ):
        rows.add_individuals(run, fingerprint, [individual])


def _copy_vectors(database: Database, rows: RowWriter) -> None:
    for fingerprint, key, name, numbers in database.execute(
        "SELECT fingerprint, key, name, numbers FROM former_vector"
    ):
        rows.add_vectors(fingerprint, key, {name: array(numbers)})


def _read(text: str) -> dict[str, float]:
    return {name: math.nan if value is None else float(value) for name, value in json.loads(text).items()}
