"""Conversion of ledgers of versions 1 and 2.

Version 1 held numbers as JSON, and repeated fingerprint, key and names in every row. Rows of version 2 had no checksum.
"""

from __future__ import annotations

import json
import math
import sqlite3
from collections.abc import Sequence
from datetime import datetime

from calib.execution.outcome import Outcome, point_key
from calib.results.ledger.database import Database
from calib.results.ledger.rows import Identifiers, RowWriter, array, blob_of_key, checksum, unpacked
from calib.results.ledger.schema import VERSION, create, guard, unguard


def convert(database: Database, version: int) -> None:
    """Convert a ledger of an earlier version, inside a transaction: evaluations and individuals keep their order.

    A damaged row of version 1 raises ``sqlite3.DatabaseError``, as damaged pages do.
    """
    if version == 1:
        _replace_tables(database)
    else:
        _add_checksums(database)
        database.execute(f"PRAGMA user_version = {VERSION}")


def _add_checksums(database: Database) -> None:
    """Add a checksum to every row of version 2; one that visibly is damaged gets none, and counts as not there."""
    identifiers = Identifiers(database)
    for table in ("evaluation", "vector"):
        database.execute(f"ALTER TABLE {table} ADD COLUMN checksum BLOB NOT NULL DEFAULT x''")
    unguard(database, "evaluation")
    rows = database.execute(
        "SELECT evaluation.id, fingerprint, key, attempt, status, error, seconds, created, parameter_names,"
        " response_names, parameters, responses FROM evaluation JOIN state ON state.id = state"
    )
    for number, fingerprint, key, *told, known, responding, parameters, responses in rows:
        names = [identifiers.known_names(one) for one in (known, responding)]
        if _is_whole(key, names, (parameters, responses)):
            written = checksum(fingerprint, key, *told, *names, parameters, responses)
            database.execute("UPDATE evaluation SET checksum = ? WHERE id = ?", (written, number))
    guard(database, "evaluation")
    rows = database.execute(
        "SELECT vector.id, fingerprint, key, name, numbers FROM vector JOIN state ON state.id = state"
    )
    for number, *parts in rows:
        database.execute("UPDATE vector SET checksum = ? WHERE id = ?", (checksum(*parts), number))


def _is_whole(key: object, names: Sequence[tuple[str, ...] | None], numbers: Sequence[object]) -> bool:
    """Whether a row holds as many numbers as names, and its key is that of its parameters."""
    try:
        values, _ = (unpacked(one, content) for one, content in zip(names, numbers, strict=True) if one is not None)
        return blob_of_key(point_key(values)) == key
    except (sqlite3.DatabaseError, ValueError):
        return False


def _replace_tables(database: Database) -> None:
    """Replace the tables of version 1."""
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
