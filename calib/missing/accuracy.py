"""Whether something would still be missing if the measurement were less accurate than it repeats."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from calib.freedom import beside_known
from calib.missing.findings import Findings
from calib.missing.goodness import goodness, overall
from calib.missing.score import Scores, family_p, scored
from calib.missing.state import State
from calib.problem import Labelled, Rows

GRID = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1)
"""Accuracies that are asked, as shares of a value; of shapes, of the largest entry."""
COLUMNS = ("accuracy", "p_family", "p_fit", "misfit", "freedom", "missing")


def less_accurate(
    found: Findings,
    labelled: Labelled,
    relative_std: np.ndarray,
    seed: int,
    grid: Sequence[float] = GRID,
) -> pd.DataFrame:
    """The tests of the base model with a standard deviation added in squares to every value, accuracy by accuracy.

    Nothing is solved again: the base fit is taken as linear, its parameters follow the new weights, and the scores of
    effects and local changes with them. An accuracy that is claimed takes away evidence, so that only a verdict that
    something is missing can change; the table ends at the first accuracy where nothing is left.

    Parameters
    ----------
    found : Findings
    labelled : Labelled
        Whose residual it is.
    relative_std : ndarray (n_rows,)
        Standard deviation of every row over its value, before any factor that the explanation found on the scatter.
    seed : int
        Of the draws behind probabilities.
    grid : sequence of float
        Ascending.

    Returns
    -------
    DataFrame
        `COLUMNS`; ``missing`` tells whether the tests still say so. Empty for a verdict that
        nothing is detectable, with the scatter as stated or as it was found.
    """
    lines: list[tuple[float, float, float, float, float, bool]] = []
    rows, own = labelled.rows, np.asarray(relative_std, dtype=float) * found.noise_scale
    for accuracy in grid if found.verdict not in ("nothing_detectable", "noise_underestimated") else ():
        with np.errstate(invalid="ignore"):
            weight = np.where(np.isfinite(own), own / np.hypot(own, accuracy), 1.0)
        state = _weighted(found.base.state, weight)
        behind = {
            kind: beside_known(freedom, weight[[row.kind == kind for row in rows]] ** 2)
            for kind, freedom in labelled.scatter_freedom.items()
        }
        told = Rows(rows, labelled.fitted_factors, behind)
        kinds, modes = goodness(state, told)
        each = [
            family_p(_again(state, scores, weight), told, seed)
            for scores in (found.base_check.named, found.base_check.atoms)
        ]
        p_family, p_fit = min(1.0, 2 * min(each)), overall(kinds, modes)
        missing = not (p_family > found.alpha and p_fit > found.alpha)
        freedom = float(kinds["freedom"].sum())
        lines.append((accuracy, p_family, p_fit, float(state.residual @ state.residual), freedom, missing))
        if not missing:
            break
    return pd.DataFrame(lines, columns=list(COLUMNS))


def changing(table: pd.DataFrame) -> float:
    """The first accuracy of the table at which nothing is missing; NaN for none."""
    gone = table.loc[~table["missing"].astype(bool), "accuracy"]
    return float(gone.iloc[0]) if len(gone) else float("nan")


def sentence(table: pd.DataFrame) -> str:
    """At which accuracy the verdict would change; empty for an empty table."""
    if table.empty:
        return ""
    at, basis = changing(table), "estimated on the linearised fit"
    if np.isnan(at):
        at = float(table["accuracy"].max())
        return f"Even were every value accurate to {100 * at:g} % only, something would be missing ({basis})."
    return f"Were every value accurate to {100 * at:g} % only, nothing would be detectable ({basis})."


def _weighted(state: State, weight: np.ndarray) -> State:
    there = replace(state, residual=weight * state.residual, slope=weight[:, None] * state.slope)
    return there.elsewhere({}, there.residual)


def _again(state: State, scores: Scores, weight: np.ndarray) -> Scores:
    return scored(state, scores.owners, scores.points, weight[:, None] * scores.raw, scores.signed, scores.onset)
