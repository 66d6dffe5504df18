"""Sensitivity of the verdict to the accuracy of the measurement."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from calib.missing.explanation import Explanation
from calib.missing.goodness import goodness, overall
from calib.missing.linearised_fit import LinearisedFit
from calib.missing.score import Scores, family_p, scored
from calib.problem.degrees_of_freedom import behind, beside_known, p_value
from calib.problem.labels import Labelled, RowLabels

GRID = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1)
"""Accuracies tried, ascending, relative to each value; for shapes, to the largest entry."""
COLUMNS = ("accuracy", "p_family", "p_fit", "misfit", "dof", "p_smaller", "missing")


def less_accurate(found: Explanation, labelled: Labelled, relative_std: np.ndarray, seed: int) -> pd.DataFrame:
    """Repeat the tests of the base model for accuracies of `GRID`, added in quadrature to every standard deviation.

    Nothing is solved again: the base fit is linearised, and its parameters and all scores are updated for the new
    weights. A lower accuracy only removes evidence, so that only a verdict that something is missing can change; the
    table ends at the first accuracy at which nothing is missing.

    Parameters
    ----------
    found : Explanation
    labelled : Labelled
        Labels of the rows of the residual.
    relative_std : ndarray (n_rows,)
        Standard deviation of every row relative to its value, without the factor that the explanation found
        (``noise_scale``).
    seed : int
        Of the samples behind the probabilities.

    Returns
    -------
    DataFrame
        `COLUMNS`; ``p_smaller`` is the probability of a sum of squares no larger than ``misfit`` if values were that
        inaccurate, ``missing`` whether the tests still reject the base model. Empty for the verdicts
        ``nothing_detectable`` and ``noise_underestimated``.
    """
    lines: list[tuple[float, float, float, float, float, float, bool]] = []
    std = np.asarray(relative_std, dtype=float) * found.noise_scale
    for accuracy in GRID if found.verdict not in ("nothing_detectable", "noise_underestimated") else ():
        weight = at_accuracy(std, accuracy)
        fit, weighted = reweighted(found.base.fit, weight), weighted_labels(labelled, weight)
        kinds, modes = goodness(fit, weighted)
        p_family, p_fit = family_p_at(found, fit, weight, weighted, seed), overall(kinds, modes)
        missing = not (p_family > found.alpha and p_fit > found.alpha)
        misfit, dof = float(fit.residual @ fit.residual), float(kinds["dof"].sum())
        behind_std = behind(dict(zip(kinds["kind"], kinds["dof"], strict=True)), weighted.std_dof)
        p_smaller = 1.0 - float(p_value(misfit, dof, behind_std))
        lines.append((accuracy, p_family, p_fit, misfit, dof, p_smaller, missing))
        if not missing:
            break
    return pd.DataFrame(lines, columns=list(COLUMNS))


def changing(table: pd.DataFrame) -> float:
    """First accuracy of the table at which nothing is missing; NaN if there is none."""
    gone = table.loc[~table["missing"].astype(bool), "accuracy"]
    return float(gone.iloc[0]) if len(gone) else float("nan")


def accuracy_sentence(table: pd.DataFrame, level: float) -> str:
    """Accuracy at which the verdict would change, in words; empty for an empty table.

    Where none of the table changes it, the largest accuracy that the data do not contradict is stated: with a larger
    one their errors would be larger than they are. They contradict an accuracy whose ``p_smaller`` is at most
    ``level``: the lower tail of chi-square, or of F where the standard deviations are estimates. What is missing adds
    to the sum of squares, so that without it an accuracy that is contradicted would be so all the more.
    """
    if table.empty:
        return ""
    at, basis = changing(table), "estimated on the linearised fit"
    if np.isnan(at):
        possible = table["p_smaller"] > level
        at = float(table.loc[possible, "accuracy"].max()) if possible.any() else float(table["accuracy"].min())
        return f"Even if every value were accurate to only {100 * at:g} %, something would be missing ({basis})."
    return f"If every value were accurate to only {100 * at:g} %, nothing would be detectable ({basis})."


def at_accuracy(std: np.ndarray, accuracy: float | np.ndarray) -> np.ndarray:
    """Weight of every row (n_rows,) once an accuracy is added in quadrature to its relative standard deviation."""
    with np.errstate(invalid="ignore"):
        return np.where(np.isfinite(std), std / np.hypot(std, accuracy), 1.0)


def weighted_labels(labelled: Labelled, weight: np.ndarray) -> RowLabels:
    """Labels of rows whose standard deviations are known in part: an added accuracy is no estimate from repeats."""
    rows = labelled.rows
    std_dof = {
        kind: beside_known(dof, weight[[row.kind == kind for row in rows]] ** 2)
        for kind, dof in labelled.std_dof.items()
    }
    return RowLabels(rows, labelled.fitted_factors, std_dof)


def family_p_at(found: Explanation, fit: LinearisedFit, weight: np.ndarray, weighted: Labelled, seed: int) -> float:
    """Family-wise p-value of the largest score of a fit with other weights, by the signatures of the base fit.

    ``weight`` (n_rows,) is over that of the base fit; ``weighted`` has the labels for the new weights.
    """
    p_values = [
        family_p(_rescored(fit, scores, weight), weighted, seed)
        for scores in (found.base_adequacy.named, found.base_adequacy.perturbations)
    ]
    return min(1.0, 2 * min(p_values))


def reweighted(fit: LinearisedFit, weight: np.ndarray) -> LinearisedFit:
    """First-order end point of a fit whose rows have other weights (n_rows,)."""
    weighted = replace(fit, residual=weight * fit.residual, slope=weight[:, None] * fit.slope)
    return weighted.relinearised({}, weighted.residual)


def _rescored(fit: LinearisedFit, scores: Scores, weight: np.ndarray) -> Scores:
    return scored(fit, scores.owners, scores.points, weight[:, None] * scores.raw, scores.signed, scores.onset)
