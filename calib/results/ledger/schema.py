"""The tables of a ledger, and views by which any SQLite from 3.38 on reads it without calib.

Fingerprints, lists of names and names of runs are stored once each; elsewhere an integer stands for them. The views
decode numbers in SQL, exact to the last bit; NaN is NULL.
"""

from __future__ import annotations

from calib.errors.errors import InputError
from calib.results.ledger.database import Database

VERSION = 3
FORMER = (1, 2)
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
        checksum BLOB NOT NULL,
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
        checksum BLOB NOT NULL,
        UNIQUE (state, key, name))""",
)
STATE = "(SELECT id FROM state WHERE fingerprint = ?)"
"""The integer of a fingerprint, in a query."""

_APPEND_ONLY = ("state", "names", "evaluation")

# Where a byte stands among all bytes is its value.
_BYTES = f"x'{bytes(range(256)).hex()}'"
_MANTISSA = 2**52

# Powers of two, up and down; doubling and halving are exact, which reading a decimal text need not be.
_POWERS = """
    powers (size, large, small) AS (
        SELECT 0, 1.0, 1.0 UNION ALL SELECT size + 1, large * 2.0, small / 2.0 FROM powers WHERE size < 1074)"""


def _byte(place: int) -> str:
    return f"(instr({_BYTES}, substr(packed, {place + 1}, 1)) - 1)"


def _decoded(columns: str, source: str) -> str:
    """A query that adds the column ``value`` to one with a column ``packed`` of eight bytes each; NaN is NULL.

    IEEE 754: sign, eleven bits of exponent, 52 bits of fraction, which is part of an integer below 2^53.
    """
    low = " | ".join(f"({_byte(place)} << {8 * place})" for place in range(6))
    return f"""
    SELECT {columns}, (1 - 2 * (top >> 7)) * CASE biased
        WHEN 2047 THEN CASE fraction WHEN 0 THEN 9e999 END
        ELSE (fraction + (biased > 0) * {_MANTISSA}) * iif(exponent < 0, small, large) END AS value
    FROM (SELECT *, min(max(biased, 1), 2046) - 1075 AS exponent FROM (
        SELECT *, ((top & 127) << 4) | (high >> 4) AS biased, low | ((high & 15) << 48) AS fraction
        FROM (SELECT *, {low} AS low, {_byte(6)} AS high, {_byte(7)} AS top FROM ({source}))))
    CROSS JOIN powers ON powers.size = abs(exponent)"""


def _point(table: str) -> str:
    return f"state.fingerprint, lower(hex({table}.key)) AS key"


def _of(kind: str) -> str:
    """One row a value of the parameters or the responses."""
    source = f"""
        SELECT {_point("evaluation")}, attempt, each.value AS name,
            substr(evaluation.{kind}s, 8 * each.key + 1, 8) AS packed
        FROM evaluation JOIN state ON state.id = evaluation.state
        JOIN names ON names.id = evaluation.{kind}_names JOIN json_each(names.names) AS each"""
    return f"""CREATE VIEW {kind}s (fingerprint, key, attempt, name, value) AS WITH RECURSIVE {_POWERS}
    {_decoded("fingerprint, key, attempt, name", source)}"""


_VECTORS = f"""
        SELECT {_point("vector")}, vector.name, place, substr(vector.numbers, 8 * place + 1, 8) AS packed
        FROM vector JOIN state ON state.id = vector.state JOIN places ON 8 * place < length(vector.numbers)"""

_VIEWS = (
    f"""CREATE VIEW evaluations (fingerprint, key, attempt, status, error, seconds, created) AS
    SELECT {_point("evaluation")}, attempt, status, error, seconds,
        strftime('%Y-%m-%dT%H:%M:%f+00:00', evaluation.created / 1000.0, 'unixepoch')
    FROM evaluation JOIN state ON state.id = evaluation.state""",
    _of("parameter"),
    _of("response"),
    f"""CREATE VIEW individuals (run, generation, individual, fingerprint, key, status, misfit) AS
    SELECT run.name, generation, individual, {_point("history")}, status, misfit
    FROM history JOIN run ON run.id = history.run JOIN state ON state.id = history.state""",
    f"""CREATE VIEW vectors (fingerprint, key, name, place, value) AS WITH RECURSIVE {_POWERS},
    places (place) AS (
        SELECT 0 UNION ALL SELECT place + 1 FROM places WHERE place + 1 < (SELECT MAX(length(numbers)) / 8 FROM vector))
    {_decoded("fingerprint, key, name, place", _VECTORS)}""",
)
"""``evaluations`` and ``individuals`` of searches, one row each.

The ``parameters`` and ``responses`` of evaluations, and ``vectors``, have one row a number.
"""


def create(database: Database) -> None:
    """Make tables, triggers and views, inside a transaction."""
    for statement in (*_TABLES, *_VIEWS):
        database.execute(statement)
    for table in _APPEND_ONLY:
        guard(database, table)
    database.execute(f"PRAGMA user_version = {VERSION}")


def guard(database: Database, table: str) -> None:
    """Make a table append-only, inside a transaction."""
    for trigger, change in (("stays", "UPDATE"), ("remains", "DELETE")):
        database.execute(
            f"CREATE TRIGGER {table}_{trigger} BEFORE {change} ON {table} BEGIN SELECT RAISE(ABORT, 'append-only'); END"
        )


def unguard(database: Database, table: str) -> None:
    """Undo `guard`."""
    for trigger in ("stays", "remains"):
        database.execute(f"DROP TRIGGER IF EXISTS {table}_{trigger}")


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
