"""What the page tells of the candidate effects and of local perturbations: magnitudes, remarks, places."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from calib.report.alike import alike_words
from calib.report.explanation import COLLINEAR, only_predicted, ranked
from calib.report.html.cells import flagged
from calib.report.html.study_results import StudyResults
from calib.report.numbers import fixed, flag, magnitude_in_words, place, places, significant, with_unit
from calib.report.scene import PLACE
from calib.report.why import BY_TEST, PRIOR, explained_words, further_parameters

_CORNERS = 4
"""Places of an effect that are told: one at each corner of a structure."""


def ranked_effects(results: StudyResults) -> pd.DataFrame | None:
    """Read ``effects.csv``, sorted by decreasing evidence."""
    table = results.table("effects")
    return None if table is None else ranked(table)


def unseen(table: pd.DataFrame) -> list[bool]:
    """Whether each effect is not visible with these data."""
    return [not flag(visible) for visible in table["visible"]]


def not_visible(table: pd.DataFrame) -> list[str]:
    """Names of the effects that are not visible with these data at a plausible magnitude."""
    return [str(name) for name, hidden in zip(table["name"], unseen(table), strict=True) if hidden]


def magnitude_cells(table: pd.DataFrame) -> list[str]:
    """Magnitude of every effect with its interval."""
    return [magnitude_in_words(r) if flag(r["refitted"]) else "not refitted" for r in table.to_dict("records")]


def smallest_visible_magnitudes(table: pd.DataFrame) -> list[str]:
    """The smallest visible magnitude of every effect."""
    return [
        "never" if np.isinf(least) else with_unit(least, str(unit), 2)
        for least, unit in zip(table["magnitude_min"], table["unit"], strict=True)
    ]


def remarks(table: pd.DataFrame) -> list[str]:
    """What is remarkable in every effect."""
    credible = flagged(table, "credible").to_dict("records")
    best = credible[0] if credible else None
    return [
        "; ".join(filter(None, _remarks(r, predicted, best)))
        for r, predicted in zip(table.to_dict("records"), only_predicted(table), strict=True)
    ]


def _remarks(r: Mapping[Hashable, Any], predicted: bool, best: Mapping[Hashable, Any] | None) -> list[str]:
    plausible = with_unit(r["plausible"], str(r["unit"]), 2)
    return [
        "candidate left" if flag(r["credible"]) else "",
        _behind(best, float(r["ln_bayes"])) if predicted else "",
        "" if flag(r["visible"]) else f"not visible at a plausible magnitude of {plausible}",
        str(r["implausible"]),
        f"confounded with {r['confounded_with']}" if r["confounded_with"] else "",
        f"represents {r['stands_for']} too" if r["stands_for"] else "",
    ]


def _behind(best: Mapping[Hashable, Any] | None, ln_bayes: float) -> str:
    """Why an effect with evidence was not refitted: that of the best credible one is larger."""
    lead = 0.0 if best is None else float(best["ln_bayes"]) - ln_bayes
    less = f"evidence less than {best['name']} by {fixed(lead, 1)}; " if best is not None and lead > 0 else ""
    return f"{less}linear prediction only"


def places_of_effects(results: StudyResults, table: pd.DataFrame) -> list[str]:
    """Where every effect acts; empty where the model has no places."""
    acts = results.table("effect_places")
    if acts is None:
        return []
    at = {name: own[[*PLACE]].to_numpy().tolist() for name, own in acts.groupby("effect")}
    return [places(at.get(str(name), []), _CORNERS, ", ") for name in table["name"]]


@dataclass(frozen=True)
class Why:
    """The figures of change patterns in words: how far they are the residual, and what is alike on the structure."""

    words: list[str]
    near: list[str]


def why(results: StudyResults) -> Why:
    """What each fitted effect explains of the residual, and what is alike."""
    table = results.table("why")
    assert table is not None
    fits = results.table("candidate_fits")
    misfit = {} if fits is None else dict(zip(fits["effects"], fits["misfit"], strict=True))
    by_test = results.table(BY_TEST)
    found = []
    for together in dict.fromkeys(table["effects"]):
        rows = table[table["effects"] == together]
        own = rows[rows["effect"] == rows["effect"].iloc[0]]  # each effect of a fit has all rows
        words = explained_words(own, by_test)
        if {"none", together} <= misfit.keys() and (own["kind"] == PRIOR).any():  # the fits are of all rows
            words += f"; fitted, it falls from {significant(misfit['none'], 3)} to {significant(misfit[together], 3)}"
        found.append(words)
    fitted = results.table("why_parameters")
    names = list(dict.fromkeys(table["effect"]))
    found += [words for name in names for words in further_parameters(fitted, name)]
    alike = results.table("why_places")
    near = [] if alike is None else [f"{name}: {words}" for name in names if (words := alike_words(alike, name))]
    return Why(found, near)


def collinear_effects(results: StudyResults) -> list[str]:
    """Pairs of effects whose signatures are nearly the same."""
    table = results.table("confounding")
    assert table is not None
    names = table["effect"].astype(str).tolist()
    values = table.set_index("effect").reindex(columns=names).to_numpy(dtype=float)
    close = np.argwhere(np.abs(np.tril(values, -1)) > COLLINEAR)
    return [f"{names[i]} and {names[j]} {fixed(values[i, j], 2)}" for i, j in close]


def ranked_perturbations(results: StudyResults) -> pd.DataFrame | None:
    """``perturbations.csv``, the largest scores first."""
    table = results.table("perturbations")
    if table is None:
        return None
    order = table["score"].abs().sort_values(ascending=False, kind="stable").index
    return table.loc[order].reset_index(drop=True)


def places_of_perturbations(table: pd.DataFrame) -> list[str]:
    """Where every local perturbation acts."""
    return [place(at) for at in table[PLACE].to_numpy(dtype=float).tolist()]
