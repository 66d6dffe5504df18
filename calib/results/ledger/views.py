"""Views by which any SQLite from 3.38 on reads a ledger, without calib.

Its numbers are decoded in SQL, exact to the last bit; NaN is NULL.
"""

from __future__ import annotations

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

VIEWS = (
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
