"""The tables of a ledger.

Fingerprints, lists of names and names of runs are stored once each; elsewhere an integer stands for them.
"""

from __future__ import annotations

from calib.errors.errors import InputError
from calib.results.ledger.database import Database
from calib.results.ledger.views import VIEWS

VERSION = 2
FORMER = (1,)
"""Versions that are converted."""

# Blobs stand last: SQLite reads a row from its front.
_TABLES = (
    "CREATE TABLE state (id INTEGER PRIMARY KEY, fingerprint TEXT NOT NULL UNIQUE)",
    "CREATE TABLE names (id INTEGER PRIMARY KEY, names TEXT NOT NULL UNIQUE)",
    """CREATE TABLE evaluation (
        id INTEGER PRIMARY KEY,
        state INTEGER NOT NULL REFERENCES state,
        key BLOB NOT NULL,
        attempt INTEGER NOT NULL,
        status TEXT NOT NULL CHECK (status IN ('ok', 'failed')),
        error TEXT NOT NULL,
        seconds REAL NOT NULL,
        created INTEGER NOT NULL,
        parameter_names INTEGER NOT NULL REFERENCES names,
        response_names INTEGER NOT NULL REFERENCES names,
        parameters BLOB NOT NULL,
        responses BLOB NOT NULL,
        UNIQUE (state, key, attempt))""",
    "CREATE TABLE run (id INTEGER PRIMARY KEY, name TEXT NOT NULL UNIQUE)",
    """CREATE TABLE history (
        id INTEGER PRIMARY KEY AUTOINCREMENT,
        run INTEGER NOT NULL REFERENCES run,
        generation INTEGER NOT NULL,
        individual INTEGER NOT NULL,
        state INTEGER NOT NULL REFERENCES state,
        key BLOB NOT NULL,
        status TEXT NOT NULL CHECK (status IN ('solved', 'reused', 'infeasible', 'failed')),
        misfit REAL,
        UNIQUE (run, generation, individual))""",
    "CREATE INDEX history_key ON history (state, key)",
    """CREATE TABLE vector (
        id INTEGER PRIMARY KEY,
        state INTEGER NOT NULL REFERENCES state,
        key BLOB NOT NULL,
        name TEXT NOT NULL,
        numbers BLOB NOT NULL,
        UNIQUE (state, key, name))""",
)
STATE = "(SELECT id FROM state WHERE fingerprint = ?)"
"""The integer of a fingerprint, in a query."""

_APPEND_ONLY = ("state", "names", "evaluation")


def create(database: Database) -> None:
    """Make tables, triggers and views, inside a transaction."""
    for statement in (*_TABLES, *VIEWS):
        database.execute(statement)
    for table in _APPEND_ONLY:
        for trigger, change in (("stays", "UPDATE"), ("remains", "DELETE")):
            database.execute(
                f"CREATE TRIGGER {table}_{trigger} BEFORE {change} ON {table}"
                " BEGIN SELECT RAISE(ABORT, 'append-only'); END"
            )
    database.execute(f"PRAGMA user_version = {VERSION}")


def version_of(database: Database) -> int:
    """Version of a ledger, 0 where there is nothing in the file yet; InputError for anything that is no ledger."""
    with database.explaining():
        # One statement sees one state, even while another process makes the ledger.
        version, tables, own = database.execute(
            "SELECT user_version, (SELECT COUNT(*) FROM sqlite_master), (SELECT COUNT(*) FROM sqlite_master"
            " WHERE type = 'table' AND name IN ('evaluation', 'history')) FROM pragma_user_version"
        ).fetchone()
    if (version or tables) and not (version in (*FORMER, VERSION) and own == 2):
        raise InputError(
            "it is a database, but not a ledger of this version of calib",
            place=database.path,
            remedy="move it away; a new one is made",
        )
    return int(version)
