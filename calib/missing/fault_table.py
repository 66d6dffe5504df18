"""Table of the faults that a measurement may have: their scores, magnitudes and evidence."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pandas as pd

from calib.missing.explanation import Explanation
from calib.missing.local import fault_words, local_perturbation
from calib.missing.rules import RULES
from calib.missing.score import noise_limit
from calib.problem.candidate import Candidate

FAULT_COLUMNS = (
    "fault", "kind", "sensor", "x", "y", "z", "unit", "score", "unabsorbed", "magnitude", "low", "high",
    "magnitude_min", "ln_bayes", "fitted", "blamed", "told", "limit",
)  # fmt: skip


def faults_table(
    found: Explanation,
    places: Mapping[str, tuple[str, tuple[float, float, float], str]],
    candidates: Mapping[str, Candidate],
) -> pd.DataFrame:
    """One row per fault of the measurement, largest score first; `docs/tables.toml` lists the columns.

    Parameters
    ----------
    found : Explanation
    places : mapping from str to (kind, (x, y, z), sensor)
        Of every fault, by name; m.
    candidates : mapping from str to Candidate
        The faults themselves, for units and limits.
    """
    scores = found.base_adequacy.faults
    if scores is None:
        return pd.DataFrame(columns=list(FAULT_COLUMNS))
    fits, blamed = {t.names[0]: t for t in found.faults}, {t.names[0] for t in found.blamed}
    rows: list[dict[str, object]] = []
    for k, name in enumerate(scores.owners):
        kind, (x, y, z), sensor = places[name]
        size, p = float(scores.size[k]), candidates[name].magnitude
        stepped = float(scores.z[k]) / size if size > 0 else math.nan
        row: dict[str, object] = {
            "fault": name, "kind": kind, "sensor": sensor, "x": x, "y": y, "z": z, "unit": p.unit,
            "score": scores.z[k] if scores.signed[k] else max(scores.z[k], 0.0), "unabsorbed": scores.unabsorbed[k],
            "magnitude": stepped if p.lower <= stepped <= p.upper else math.nan, "low": math.nan, "high": math.nan,
            "magnitude_min": RULES.detectable / size if size > 0 else math.inf,
            "ln_bayes": math.nan, "fitted": name in fits, "blamed": name in blamed, "told": "",
        }  # fmt: skip
        if name in fits:
            fitted = local_perturbation(fits[name])
            row |= {"magnitude": fitted.value, "low": fitted.low, "high": fitted.high}
            row |= {"ln_bayes": found.ln_bayes(fits[name])}
            row["told"] = fault_words(fits[name])
        rows.append(row)
    table = pd.DataFrame(rows).assign(limit=noise_limit(scores.magnitude))
    order = np.argsort(-table["score"].abs().to_numpy(dtype=float), kind="stable")
    return table.iloc[order][list(FAULT_COLUMNS)].reset_index(drop=True)
