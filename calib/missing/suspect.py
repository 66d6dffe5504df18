"""Outlier test: each measured value, mode and sensor left out in turn."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
import pandas as pd

from calib.errors.errors import EvaluationError
from calib.missing.candidate_fit import CandidateFit, WrongDatum
from calib.missing.evidence import ln_evidence, ln_wrong
from calib.missing.goodness import FittedRows, Layout, overall_p
from calib.missing.hypotheses import Altered
from calib.missing.linearised_fit import FINE, least_squares_fit
from calib.missing.recommendation import as_ratio
from calib.missing.refits import Refits, near_to
from calib.missing.rules import RULES
from calib.problem import degrees_of_freedom
from calib.problem.degrees_of_freedom import hat_root, p_value
from calib.problem.labels import Label, Labelled, RowLabels

COLUMNS = ("what", "kind", "rows", "chi2", "dof", "p", "p_fit_without", "explains")
ESTIMATED = "by a linear estimate"
"""How the p-value of a fit without a datum is known, in words."""
_SINGULAR = 1e-9
"""Smallest part of the variance of a combination of values left by the parameters; below it, prediction is rounding."""
_AT_ONCE = 256
"""Data processed at a time, to limit memory: each needs a row as long as the data."""


class Datum(NamedTuple):
    """Rows that belong to one value, mode or sensor.

    Attributes
    ----------
    what : str
        Such as ``frequency of 2B``.
    kind : {"value", "shape", "mode", "sensor"}
    rows : ndarray of int
    """

    what: str
    kind: str
    rows: np.ndarray


class Optimum(FittedRows, Protocol):
    """A fit that knows whether it converged."""

    @property
    def converged(self) -> bool:
        """Whether the fit converged."""
        ...


class LeftOutDatum(NamedTuple):
    """A datum left out: ``I - H_bb``, its prediction error by all others, and the test of it."""

    datum: Datum
    inverse: np.ndarray
    predicted: np.ndarray
    chi2: float
    dof: float
    std: float


def data_of(rows: Sequence[Label]) -> tuple[Datum, ...]:
    """All data that may be wrong by themselves: values, shapes, modes, sensors, entries of shapes, scalar responses.

    Data of the same rows are listed once, by the smaller item.
    """
    found: dict[tuple[str, str], list[int]] = {}
    for k, row in enumerate(rows):
        if not row.mode:
            names = [("value", row.sensor)]
        elif row.kind == "shape":
            names = [
                ("value", f"shape of {row.mode} at {row.sensor}"), ("shape", f"shape of {row.mode}"),
                ("mode", f"mode {row.mode}"), ("sensor", f"sensor {row.sensor}"),
            ]  # fmt: skip
        else:
            names = [("value", f"{row.kind} of {row.mode}"), ("mode", f"mode {row.mode}")]
        for name in names:
            found.setdefault(name, []).append(k)
    out, seen = [], set()
    for (kind, what), index in found.items():
        if tuple(index) not in seen and len(index) < len(rows):
            seen.add(tuple(index))
            out.append(Datum(what, kind, np.array(index)))
    return tuple(out)


def suspects_table(
    fit: Optimum,
    labelled: Labelled,
    level: float = RULES.suspect,
) -> pd.DataFrame:
    """Leave out every datum in turn, where the fit as a whole fails, and test which of them alone explains the misfit.

    With e the residual and ``H = G V G^T`` the hat matrix of a fit (G its slope, V its posterior covariance), data b
    are predicted by all others with the error ``e_(-b) = (I - H_bb)^-1 e_b`` (see `calib.inference.leave_one_out`).
    Leaving them out lowers the sum of squares by ``chi2_b = e_b^T e_(-b)``; the other residuals become
    ``e + H_b e_(-b)``. This is exact for a linear model, and nothing is fitted again. ``p`` is the p-value of chi2_b
    times the number of data tried (Bonferroni, as in the test of studentised residuals; Cook and Weisberg 1982);
    ``p_fit_without`` is that of the goodness of fit without b, NaN where p is above the level. A datum explains the
    misfit when the first is below and the second above the level: it is improbable by itself, and without it everything
    fits. A single value that the parameters absorb almost entirely is not tested: its residual depends on how far the
    search converged.

    Parameters
    ----------
    fit : Optimum
        Without convergence the result is empty.
    labelled : Labelled
        Labels of the rows of the residual.
    level : float
        Significance level, also of the goodness of fit.

    Returns
    -------
    DataFrame
        `COLUMNS`; data that explain the misfit first, those of fewer rows and larger decrease before others. Empty when
        everything fits and without a converged fit.
    """
    if not fit.converged or overall_p(fit, labelled) > level:
        return pd.DataFrame(columns=list(COLUMNS))
    e, root, data = np.asarray(fit.residual, dtype=float), hat_root(fit.slope, fit.prior_sd), data_of(labelled.rows)
    layout = Layout.of(labelled)
    size, behind = np.bincount(layout.which), layout.std[layout.kind_of][layout.which]
    tried: list[LeftOutDatum] = []
    for datum in data:
        b = datum.rows
        here = root[b]
        inverse = np.eye(len(b)) - here @ here.T
        if len(b) == 1:  # most data are: without calls for a matrix of one entry
            left_over, least = inverse[0, 0], RULES.followed
        else:
            left_over, least = np.linalg.eigvalsh(inverse)[0], _SINGULAR
        if left_over < least:
            continue  # only these data determine a parameter
        predicted = e[b] / left_over if len(b) == 1 else np.linalg.solve(inverse, e[b])
        whole = np.bincount(layout.which[b], minlength=len(size)) == size  # their fitted factors are left out with them
        dof = max(len(b) - float(layout.factors[whole].sum()), 1.0)
        tried.append(LeftOutDatum(datum, inverse, predicted, float(e[b] @ predicted), dof, float(behind[b].min())))
    table = pd.DataFrame(
        [(o.datum.what, o.datum.kind, len(o.datum.rows), o.chi2, o.dof) for o in tried], columns=list(COLUMNS[:5])
    )
    tests = np.array([(o.chi2, o.dof, o.std) for o in tried]).reshape(-1, 3)
    table["p"] = np.minimum(1.0, len(data) * p_value(*tests.T))
    table["p_fit_without"], remaining_dof = np.nan, np.zeros(len(table))
    improbable = np.flatnonzero(table["p"] < level)
    for k in range(0, len(improbable), _AT_ONCE):
        some = improbable[k : k + _AT_ONCE]
        rest = _rest(e, root, [tried[j] for j in some])
        found = layout.sums(*rest)
        table.loc[some, "p_fit_without"], remaining_dof[some] = found.overall, found.kinds["dof"].sum(axis=1)
    enough = remaining_dof >= degrees_of_freedom.RULES.least
    table["explains"] = (table["p"] < level) & (table["p_fit_without"] > level) & enough
    # Of two that explain, the one with fewer rows is the more specific.
    order = np.lexsort((-table["chi2"], np.where(table["explains"], table["rows"], 0), ~table["explains"].astype(bool)))
    return table.iloc[order].reset_index(drop=True)


def suspect_in_short(table: pd.DataFrame, ln_odds: float = math.nan) -> str:
    """The datum without which everything fits, beside an effect that is named all the same, for the summary.

    Empty where no datum alone explains the misfit; the odds are those of `suspect_sentence`.
    """
    explaining = table[table["explains"].astype(bool)]
    if explaining.empty:
        return ""
    what = explaining["what"].iloc[0]
    return f"{_beside(what, ln_odds)} Check {_the(what)} to be sure."


def _beside(what: str, ln_odds: float, p: str = "") -> str:
    odds = as_ratio(ln_odds) if math.isfinite(ln_odds) else f"more than {as_ratio(RULES.credible)}"
    fits = f"If {_the(what)} were left out, the model would fit with nothing added{p}"
    return f"{fits}, but the odds are {odds} against that measurement being wrong."


def _the(what: str) -> str:
    return f"the {what}" if " of " in what else what


def suspect_sentence(table: pd.DataFrame, named: str = "", ln_odds: float = math.nan) -> str:
    """The datum without which everything fits, in words; empty where none alone explains the misfit.

    Parameters
    ----------
    table : DataFrame
        From `suspects_table`.
    named : str
        An effect that is named all the same: no wrong datum explains about as well as it does.
    ln_odds : float
        Log odds of that effect against a wrong datum; NaN where only the least that names it is known.
    """
    explaining = table[table["explains"].astype(bool)]
    if explaining.empty:
        return ""
    first, more = explaining.iloc[0], explaining["what"].tolist()[1:4]
    others = f"; so it does without {' or without '.join(more)}" if more else ""
    if named:
        p = f" (p = {first['p_fit_without']:.2g}, {ESTIMATED})"
        return _beside(first["what"], ln_odds, p)
    return (
        f"One measurement may be what does not fit: without {first['what']} everything does (p = "
        f"{first['p_fit_without']:.2g}, {ESTIMATED}; the chance of such a value in a correct model is "
        f"{first['p']:.1g}, over all that were left out in turn){others}. Check it before the model."
    )


def _rest(
    residual: np.ndarray, root: np.ndarray, gone: Sequence[LeftOutDatum]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Squares of the residual without each datum, the part of each row's variance left, and the rows kept.

    Each is (n_gone, n_rows). Without b the hat matrix H has the diagonal ``h_i + H_ib (I - H_bb)^-1 H_bi``.
    """
    moved = np.stack([root[one.datum.rows].T @ one.predicted for one in gone]) @ root.T
    kept = np.ones(moved.shape, dtype=bool)
    followed = np.tile(np.sum(root**2, axis=1), (len(gone), 1))
    for k, one in enumerate(gone):
        across = root @ root[one.datum.rows].T
        followed[k] += np.sum(across * np.linalg.solve(one.inverse, across.T).T, axis=1)
        kept[k, one.datum.rows] = False
    return (residual + moved) ** 2, np.maximum(1.0 - followed, 0.0), kept


def wrong_datum(fits: Refits, base: CandidateFit, accused: pd.DataFrame, best: CandidateFit) -> WrongDatum | None:
    """The first of the data that explain the misfit to first order, after a fit without it.

    Its evidence is that of all other data times the density of the datum given them, with an error of any size
    (`calib.missing.evidence.ln_wrong`). None where no datum explains the misfit, where its predicted evidence comes
    nowhere near that of the best effect, and where the other data do not fit. The verdict needs it, so that it is
    fitted whatever has been spent.

    Parameters
    ----------
    fits : Refits
    base : CandidateFit
        The model that would fit without the datum.
    accused : DataFrame
        From `calib.missing.suspect.suspects_table`, of the base fit.
    best : CandidateFit
        The best effect.
    """
    explaining = accused[accused["explains"].astype(bool)]
    if explaining.empty:
        return None
    first, reached = explaining.iloc[0], best.ln_evidence - base.ln_evidence
    if reached - float(first["chi2"]) / 2 > near_to(reached):
        return None
    h = fits.hypotheses
    gone = next(d.rows for d in data_of(h.rows) if (d.what, d.kind) == (first["what"], first["kind"]))
    kept = np.setdiff1d(np.arange(len(h.rows)), gone)
    fit_problem = fits.fit_problem(base.names)
    fits.announce(f"fitting without {first['what']}")
    try:
        rest = least_squares_fit(
            Altered(fit_problem, kept=kept), base.names, base.fit.values, settings=fits.affordable(FINE)
        )
        difference = fit_problem.residual(rest.values)[gone]
        slope = fit_problem.jacobian(rest.values, rest.names)[gone]
    except EvaluationError:
        return None
    p_fit = overall_p(rest, RowLabels.of(h, kept))
    if p_fit <= fits.settings.alpha:
        return None
    covariance = np.eye(len(gone)) + slope @ rest.covariance @ slope.T
    ln = ln_evidence(rest, base.effects) + ln_wrong(difference, covariance)
    return WrongDatum(str(first["what"]), str(first["kind"]), ln, p_fit)
