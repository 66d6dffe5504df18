"""A single wrong datum as a competing explanation: the base model fitted to all other data."""

from __future__ import annotations

import numpy as np
import pandas as pd

from calib.errors.errors import EvaluationError
from calib.missing.candidate_fit import CandidateFit, WrongDatum
from calib.missing.evidence import ln_evidence, ln_wrong
from calib.missing.goodness import overall_p
from calib.missing.hypotheses import Altered
from calib.missing.linearised_fit import FINE, least_squares_fit
from calib.missing.refits import Refits, near_to
from calib.missing.suspect import data_of
from calib.problem.problem import RowLabels


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
