"""What the page tells of the searches: curves of all cases, counts, and the best design against the measurement."""

from __future__ import annotations

import math
from typing import Any

from calib.report.html.study_results import StudyResults
from calib.report.numbers import fixed, percent, significant
from calib.workbench.search import LedgerReader, SearchRun, latest_of_cases


def search_view(reader: LedgerReader, results: StudyResults, since: int) -> dict[str, Any]:
    """The latest search of every case.

    Parameters
    ----------
    reader : LedgerReader
    results : StudyResults
        Of the study, for what was measured.
    since : int
        Row of the history up to which the page knows the curves; 0 for all.

    Returns
    -------
    dict
        ``cases``: of each search ``case, name, generations`` (``generation, best, mean``; those from ``since`` on, of
        which the first replaces what the page has from there), and counts. ``last``: the row to name next.
        ``best``: the best design's errors, its ``values``, and its ``worst`` mode (of the lowest MAC).
        ``earlier``: searches of other states. ``evaluations``.
    """
    runs = reader.read()
    latest = latest_of_cases(runs)
    best = min(latest, key=lambda run: run.best[0], default=None)
    return {
        "cases": [_case(run, since) for run in latest],
        "last": max((run.last for run in runs), default=0),
        "earlier": len(runs) - len(latest),
        "evaluations": reader.evaluations,
        "best": None if best is None or not math.isfinite(best.best[0]) else _best(reader, best, results),
        "calibrated": bool(results.summary),
    }


def _case(run: SearchRun, since: int) -> dict[str, Any]:
    rows = run.generations_since(since)
    return {
        "case": run.case, "name": run.name, "generations": rows, "individuals": run.individuals, "failed": run.failed,
        "infeasible": run.infeasible, "generation": run.generations[-1][0] if run.generations else 0,
        "best": significant(run.best[0], 4) if math.isfinite(run.best[0]) else "–",
    }  # fmt: skip


def _best(reader: LedgerReader, run: SearchRun, results: StudyResults) -> dict[str, Any]:
    """The best design of all cases beside the nominal model, mode by mode; without modes its misfit alone."""
    before = results.compared("before")
    values, responses = reader.point(run)
    rows = [] if before is None else _modes(responses, before)
    known = {row["mode"]: responses.get(f"mac_{row['mode']}", math.nan) for row in rows}
    known = {mode: mac for mode, mac in known.items() if math.isfinite(mac)}
    worst = min(known, key=lambda mode: known[mode], default="")
    return {"case": run.case, "misfit": significant(run.best[0], 4), "rows": rows, "values": values, "worst": worst}


def _modes(responses: dict[str, float], before: Any) -> list[dict[str, str]]:
    """Frequencies and MAC of each measured mode: measured, nominal, and at the best design."""
    found = []
    for r in before.to_dict("records"):
        mode, measured = str(r["mode"]), float(r["natural_freq_measured"])
        freq, mac = responses.get(f"natural_freq_{mode}", math.nan), responses.get(f"mac_{mode}", math.nan)
        found.append(
            {
                "mode": mode, "measured": fixed(measured, 2), "model": fixed(freq, 2),
                "error": percent((freq - measured) / measured, 2, sign=True),
                "error_before": percent(float(r["freq_error"]), 2, sign=True),
                "mac": fixed(mac, 3), "mac_before": fixed(float(r["mac"]), 3),
            }
        )  # fmt: skip
    return found
