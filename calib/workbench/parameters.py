"""What the page tells of the parameters: limits, prior and fitted values, whether each is identified, where it acts."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping
from typing import Any

import pandas as pd

from calib.report.correlation import STRONG
from calib.report.html import space
from calib.report.html.calibrated import best_case
from calib.report.html.study_results import StudyResults
from calib.report.numbers import fixed, flag, significant, with_unit

_FIGURES = ("parameters", "profiles", "posterior_correlation", "selection", "sensitivity")


def parameters(results: StudyResults) -> dict[str, Any] | None:
    """Every parameter of the model; None before any analysis has listed them.

    Returns
    -------
    dict
        ``rows``: of each parameter what it is, in words as the report has them, and for its scale the numbers ``lower``
        and ``upper`` (search limits), ``nominal``, ``prior_sd``, and once it was fitted ``value`` and the
        ends ``low`` and ``high`` of its 95 % interval. ``case`` whose values are reported. ``scene`` and ``layers`` of
        the viewer. ``figures`` that there are.
    """
    listed = results.table("parameter_space")
    if listed is None:
        return None
    verdicts, pulls = _by_parameter(results.table("verdicts")), _pulls(results)
    fitted, chosen = results.table("parameters"), _by_parameter(results.table("selection"))
    scene = space.scene(results)
    return {
        "rows": [
            _row(str(r["parameter"]), r, verdicts, pulls, chosen, _partners(results, str(r["parameter"])))
            for r in listed.to_dict("records")
        ],
        "case": "" if fitted is None else best_case(results),
        "scene": scene, "layers": [] if scene is None else space.parameter_layers(results),
        "figures": [name for name in _FIGURES if name in results.figures.plan],
    }  # fmt: skip


def _row(
    name: str,
    r: Mapping[Hashable, Any],
    verdicts: Mapping[str, Mapping[Hashable, Any]],
    pulls: Mapping[str, Mapping[Hashable, Any]],
    chosen: Mapping[str, Mapping[Hashable, Any]],
    partners: list[str],
) -> dict[str, Any]:
    unit, own, pull, selected = str(r["unit"]), verdicts.get(name), pulls.get(name), chosen.get(name)
    lower, upper = (_first(r.get(f"search_{end}"), r[end]) for end in ("lower", "upper"))
    value, std, low, high = (math.nan if own is None else _first(own.get(k)) for k in ("value", "std", "low", "high"))
    return {
        "name": name, "description": str(r["description"]), "source": str(r["source"]), "lower": lower, "upper": upper,
        "nominal": float(r["value"]), "prior_sd": float(r["prior_sd"]), "value": value,
        "low": low, "high": high,
        "limits": f"{significant(lower)} to {significant(upper)}", "nominal_words": with_unit(r["value"], unit),
        "prior_words": with_unit(r["prior_sd"], unit, 3), "value_words": with_unit(value, unit), "unit": unit,
        "std_words": with_unit(std, unit, 3),
        "identified": None if own is None else _known(own["identified"]),
        "sentence": "" if own is None else str(own["sentence"]),
        "pull": "" if pull is None else fixed(pull["standardised"], 1, sign=True),
        "pulled": pull is not None and flag(pull["pulled"]),
        "why": "" if selected is None else str(selected["why"]),
        "selected": None if selected is None else _known(selected["selected"]), "partners": partners,
    }  # fmt: skip


def _first(*values: Any) -> float:
    """The first that is known; NaN where none is."""
    return next((float(value) for value in values if value is not None and value == value), math.nan)


def _known(value: Any) -> bool | None:
    """A flag; None where it is unknown."""
    return None if value is None or value != value else flag(value)


def _by_parameter(table: pd.DataFrame | None) -> dict[str, Mapping[Hashable, Any]]:
    return {} if table is None else {str(r["parameter"]): r for r in table.to_dict("records")}


def _pulls(results: StudyResults) -> dict[str, Mapping[Hashable, Any]]:
    """Shifts from the priors of the base model."""
    table = results.table("pulls")
    return {} if table is None else _by_parameter(table[table["model"] == "base"])


def _partners(results: StudyResults, name: str) -> list[str]:
    """Parameters whose posterior correlation with one is strong, the strongest first."""
    table = results.table("posterior_correlation")
    if table is None or name not in table:
        return []
    own = table.set_index("parameter")[name].drop(name).dropna()
    own = own[own.abs() > STRONG].sort_values(key=lambda values: -values.abs(), kind="stable")
    return [f"{other} {fixed(value, 2, sign=True)}" for other, value in own.items()]
