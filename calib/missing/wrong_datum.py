"""A single wrong datum as the rival of a missing effect: the model as it is, fitted to all other data."""

from __future__ import annotations

import numpy as np
import pandas as pd

from calib.errors import EvaluationError
from calib.missing.evidence import ln_evidence, ln_wrong
from calib.missing.findings import Trial, WrongDatum
from calib.missing.goodness import goodness, overall
from calib.missing.hypotheses import Altered
from calib.missing.refits import Refits, near_to
from calib.missing.state import FINE, fitted
from calib.missing.suspect import data_of
from calib.problem import Rows


def wrong_datum(fits: Refits, base: Trial, accused: pd.DataFrame, best: Trial) -> WrongDatum | None:
    """The first of the data that explain a misfit to first order, once the model is fitted without it.

    Its evidence is that of all other data times the density of the datum given them, with an error of any size
    (`calib.missing.evidence.ln_wrong`). It is None where no datum explains the misfit, where what one promises comes
    nowhere near the best effect, and where the others turn out not to fit. The verdict needs it, so that it is fitted
    whatever has been spent.

    Parameters
    ----------
    fits : Refits
    base : Trial
        The model without effects.
    accused : DataFrame
        From `calib.missing.suspect.suspects`, of the same fit.
    best : Trial
        The best effect.
    """
    guilty = accused[accused["explains"].astype(bool)]
    if guilty.empty:
        return None
    first, reached = guilty.iloc[0], best.ln_evidence - base.ln_evidence
    if reached - float(first["chi2"]) / 2 > near_to(reached):
        return None
    h = fits.hypotheses
    gone = next(d.rows for d in data_of(h.rows) if (d.what, d.kind) == (first["what"], first["kind"]))
    kept = np.setdiff1d(np.arange(len(h.rows)), gone)
    question = fits.question(())
    fits.progress(f"fitting without {first['what']}")
    try:
        rest = fitted(Altered(question, kept=kept), (), base.state.values, settings=fits.affordable(FINE))
        difference = question.residual(rest.values)[gone]
        slope = question.jacobian(rest.values, rest.names)[gone]
    except EvaluationError:
        return None
    p_fit = overall(*goodness(rest, Rows.of(h, kept)))
    if p_fit <= fits.settings.alpha:
        return None
    covariance = np.eye(len(gone)) + slope @ rest.covariance @ slope.T
    ln = ln_evidence(rest, ()) + ln_wrong(difference, covariance)
    return WrongDatum(str(first["what"]), str(first["kind"]), ln, p_fit)
