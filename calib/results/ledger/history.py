"""The individuals that every search requested, generation by generation."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from calib.execution.outcome import Individual
from calib.results.ledger.database import Database
from calib.results.ledger.rows import RowWriter, blob_of_key, key_of_blob
from calib.results.ledger.schema import STATE

if TYPE_CHECKING:
    import pandas as pd

_RUN = "(SELECT id FROM run WHERE name = ?)"


class History:
    """The searches of one ledger."""

    def __init__(self, database: Database, rows: RowWriter):
        self._database = database
        self._rows = rows

    def record(self, run: str, fingerprint: str, generation: int, individuals: Sequence[Individual]) -> None:
        """Record one generation; see `calib.results.ledger.Ledger.record`."""
        with self._database.transaction():
            recorded = self._database.execute(
                f"SELECT key, status, misfit FROM history WHERE run = {_RUN} AND generation = ? ORDER BY individual",
                (run, generation),
            ).fetchall()
            if recorded:
                stored = [(key_of_blob(k), s if s in ("infeasible", "failed") else "ok", m) for k, s, m in recorded]
                if stored == [(a.key, a.status, _nullable(a.misfit)) for a in individuals]:
                    return
                self._database.execute(f"DELETE FROM history WHERE run = {_RUN} AND generation >= ?", (run, generation))
            earlier = self._requested_earlier(run, fingerprint, [a.key for a in individuals])
            rows = []
            for individual, one in enumerate(individuals):
                status: str = one.status
                if status == "ok":
                    status = "reused" if one.key in earlier else "solved"
                if status != "infeasible":
                    earlier.add(one.key)
                rows.append((generation, individual, one.key, status, _nullable(one.misfit)))
            self._rows.add_individuals(run, fingerprint, rows)

    def _requested_earlier(self, run: str, fingerprint: str, keys: Iterable[str]) -> set[str]:
        """Those of some points that this run requested, or another one before this one's first generation."""
        first = self._database.execute(
            f"SELECT run, id FROM history WHERE run = {_RUN} ORDER BY generation, individual LIMIT 1", (run,)
        ).fetchone()
        number, start = first or (None, None)
        query = (
            f"SELECT DISTINCT key FROM history WHERE key IN ({{}}) AND state = {STATE} AND status <> 'infeasible'"
            " AND (run = ? OR ? IS NULL OR id < ?)"
        )
        rows = self._database.among(query, map(blob_of_key, keys), fingerprint, number, start, start)
        return {key_of_blob(key) for (key,) in rows}

    def of(self, run: str) -> pd.DataFrame:
        """Points requested by a run: ``generation, individual, key, status, misfit``, sorted by the first two."""
        import pandas as pd

        columns = ["generation", "individual", "key", "status", "misfit"]
        with self._database.explaining():
            rows = self._database.execute(
                f"SELECT {', '.join(columns)} FROM history WHERE run = {_RUN} ORDER BY generation, individual",
                (run,),
            )
            table = [(g, place, key_of_blob(key), status, misfit) for g, place, key, status, misfit in rows]
        return pd.DataFrame(table, columns=columns).astype({"misfit": float})


def _nullable(value: float) -> float | None:
    return None if math.isnan(value) else float(value)
