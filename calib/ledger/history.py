"""The individuals that every search requested, generation by generation."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import pandas as pd

from calib.ledger.blobs import key_of_blob
from calib.ledger.database import Database
from calib.ledger.identifiers import Identifiers
from calib.ledger.rows import add_individuals


@dataclass(frozen=True)
class Asked:
    """One individual of a generation.

    Attributes
    ----------
    key : str
        From `calib.outcome.key_of`.
    status : {"ok", "failed", "infeasible"}
    misfit : float
        NaN unless ``ok``.
    """

    key: str
    status: Literal["ok", "failed", "infeasible"]
    misfit: float = math.nan


class History:
    """The searches of one ledger."""

    def __init__(self, database: Database, identifiers: Identifiers):
        self._database = database
        self._identifiers = identifiers

    def record(self, run: str, fingerprint: str, generation: int, asked: Sequence[Asked]) -> None:
        """Record one generation; see `calib.ledger.Ledger.record`."""
        with self._database.transaction():
            number = self._identifiers.of_run(run)
            recorded = self._database.execute(
                "SELECT key, status, misfit FROM history JOIN point ON point.id = history.point"
                " WHERE run = ? AND generation = ? ORDER BY individual",
                (number, generation),
            ).fetchall()
            if recorded:
                stored = [(key_of_blob(k), s if s in ("infeasible", "failed") else "ok", m) for k, s, m in recorded]
                if stored == [(a.key, a.status, _nullable(a.misfit)) for a in asked]:
                    return
                self._database.execute("DELETE FROM history WHERE run = ? AND generation >= ?", (number, generation))
            points = self._identifiers.of_points(fingerprint, [a.key for a in asked])
            earlier = self._asked_earlier(number, points.values())
            rows = []
            for individual, one in enumerate(asked):
                status: str = one.status
                if status == "ok":
                    status = "reused" if points[one.key] in earlier else "solved"
                if status != "infeasible":
                    earlier.add(points[one.key])
                rows.append((number, generation, individual, points[one.key], status, _nullable(one.misfit)))
            add_individuals(self._database, rows)

    def _asked_earlier(self, run: int, points: Iterable[int]) -> set[int]:
        """Those of some points that this run requested, or another one before this one's first generation."""
        first = self._database.execute(
            "SELECT id FROM history WHERE run = ? ORDER BY generation, individual LIMIT 1", (run,)
        ).fetchone()
        start = first[0] if first else None
        query = (
            "SELECT DISTINCT point FROM history WHERE point IN ({}) AND status <> 'infeasible'"
            " AND (run = ? OR ? IS NULL OR id < ?)"
        )
        return {point for (point,) in self._database.among(query, points, run, start, start)}

    def of(self, run: str) -> pd.DataFrame:
        """Points requested by a run: ``generation, individual, key, status, misfit``, sorted by the first two."""
        columns = ["generation", "individual", "key", "status", "misfit"]
        with self._database.explaining():
            rows = self._database.execute(
                "SELECT generation, individual, key, status, misfit FROM history JOIN point ON point.id = history.point"
                " WHERE run = (SELECT id FROM run WHERE name = ?) ORDER BY generation, individual",
                (run,),
            )
            table = [(g, place, key_of_blob(key), status, misfit) for g, place, key, status, misfit in rows]
        return pd.DataFrame(table, columns=columns).astype({"misfit": float})


def _nullable(value: float) -> float | None:
    return None if math.isnan(value) else float(value)
