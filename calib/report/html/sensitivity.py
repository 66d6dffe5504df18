"""What the page tells of the sensitivity: the matrices, and where they differ."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from calib.report.correlation import correlated_pairs
from calib.report.html.study_results import StudyResults
from calib.report.numbers import fixed
from calib.report.sensitivity import RESPONSE_KINDS

_MATRICES = {
    "partial": "partial rank correlation",
    "sensitivity": "Spearman's rank correlation",
    "variance_share": "variance share (square root)",
}

MOST_NUMBERS = 20_000
"""Numbers of samples that the page holds; of more samples evenly chosen ones are shown."""


@dataclass(frozen=True)
class Matrix:
    """A measure of every parameter with every response.

    Attributes
    ----------
    name, label : str
        Of its table, and of the measure.
    words : str
        Its largest values.
    difference : str
        How far it differs from the first matrix; empty for that one, which alone is shown unfolded.
    """

    name: str
    label: str
    words: str
    difference: str


def matrices(results: StudyResults) -> list[Matrix]:
    """The matrices of the folder."""
    found: list[Matrix] = []
    first = pd.DataFrame()
    for name, label in _MATRICES.items():
        table = results.table(name)
        if table is None:
            continue
        values = table.set_index("parameter")
        difference = f"{label.capitalize()}: {_difference(values, found[0].label, first)}" if found else ""
        first = first if found else values
        found.append(Matrix(name, label, _strongest(values, label), difference))
    return found


def designs_section(results: StudyResults) -> dict[str, Any] | None:
    """Samples over parallel axes, for ``parallel.js``; None without them.

    Returns
    -------
    dict
        ``axes``: of each ``name``, ``low``, ``high``, ``log`` and ``measured`` (None where it was not); ``rows``, the
        samples with four significant digits; ``left_out``, how many are not among them.
    """
    samples, space = results.table("sensitivity_samples"), results.table("parameter_space")
    if samples is None or space is None:
        return None
    looks, measured = space.set_index("parameter"), _measured(results)
    known = samples.loc[:, samples.notna().any()].dropna()
    shown = known.loc[:, known.nunique() > 1]
    most = max(1, MOST_NUMBERS // max(1, shown.shape[1]))
    if len(shown) > most:
        shown = shown.iloc[np.linspace(0, len(shown) - 1, most).astype(int)]
    if shown.shape[1] < 2:
        return None
    shown, axes = shown.map(lambda value: float(f"{value:.4g}")), []
    for name in map(str, shown):
        unit = str(looks["unit"].get(name, "")) if name in looks.index else ""
        log = name in looks.index and looks["scale"].get(name) == "log"
        axes.append({
            "name": name if unit in ("", "-", "nan") else f"{name} ({unit})", "low": float(shown[name].min()),
            "high": float(shown[name].max()), "log": bool(log), "measured": measured.get(name),
        })  # fmt: skip
    return {"axes": axes, "rows": shown.to_numpy(dtype=float).tolist(), "left_out": len(samples) - len(shown)}


def _measured(results: StudyResults) -> dict[str, float]:
    """Measured values by the name of the response."""
    table = results.table("measured")
    if table is None or results.kind == "frf":
        return {}
    if results.kind == "responses":
        return dict(zip(table["response"], table["value"].astype(float), strict=True))
    return {
        f"natural_freq_{mode}": float(freq) for mode, freq in zip(table["mode"], table["natural_freq"], strict=True)
    }


def _difference(values: pd.DataFrame, label: str, of_first: pd.DataFrame) -> str:
    """Where the absolute values of two measures differ most."""
    one, other = values.reindex_like(of_first).abs().to_numpy(dtype=float), of_first.abs().to_numpy(dtype=float)
    apart = np.abs(one - other)
    if np.isnan(apart).all():
        return f"nothing in common with the {label}"
    at = divmod(int(np.nanargmax(apart)), apart.shape[1])
    which = f"{of_first.index[at[0]]} on {_response(str(of_first.columns[at[1]]))}"
    return f"differs most from the {label} for {which}, {fixed(one[at], 2)} instead of {fixed(other[at], 2)}"


def _strongest(values: pd.DataFrame, label: str) -> str:
    known = values.abs().dropna(how="all")
    found = [
        f"{name} on {_response(str(row.idxmax()))} ({fixed(float(row.max()), 2)})" for name, row in known.iterrows()
    ]
    return f"Largest absolute {label} of each parameter: {'; '.join(found)}."


def _response(name: str) -> str:
    for beginning, kind in RESPONSE_KINDS.items():
        if name.startswith(beginning):
            return f"{kind} {name.removeprefix(beginning)}"
    return name


def largest_pair(table: pd.DataFrame) -> str:
    """The two parameters of the largest correlation, in words."""
    a, b, value = correlated_pairs(table).iloc[0]
    return f"{fixed(value, 2)}, of {a} and {b}"


def least_predicted(table: pd.DataFrame) -> str:
    """The responses that metamodels predict worst, in words."""
    known = table.dropna(subset=["cop"]).sort_values("cop", kind="stable").head(3)
    worst = [f"{_response(str(r['response']))} ({fixed(float(r['cop']), 2)})" for r in known.to_dict("records")]
    return f"Least predicted: {'; '.join(worst)}." if worst else "No response has a metamodel."
