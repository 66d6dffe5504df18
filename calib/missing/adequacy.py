"""Tests of a fitted model: whether a systematic misfit is left, and how well the model predicts data left out."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
from scipy.special import chdtr

from calib.missing.candidate_fit import AdequacyTests, CandidateFit
from calib.missing.goodness import by_sensor, common_scale, goodness, overall
from calib.missing.refits import Refits
from calib.missing.rules import RULES
from calib.missing.score import Scores, family_p
from calib.missing.screened import Screened, screened_p
from calib.problem.candidate import Candidate
from calib.problem.labels import Labelled


def beside(fits: Refits, candidate_fit: CandidateFit, candidates: Sequence[Candidate]) -> Scores:
    """Scores of the candidates that a fitted model lacks, with no prior on the magnitudes of its own effects."""
    fit = candidate_fit.fit.granting(candidate_fit.names)
    return fits.scores(fit, [e for e in candidates if e.name not in candidate_fit.names])


def suspects(fits: Refits, candidate_fit: CandidateFit, also: Collection[str] = ()) -> Scores:
    """Scores of the faults of the measurement that a fitted model lacks, of pairs the largest and those named."""
    single, pairs = beside(fits, candidate_fit, fits.family.single), screened_pairs(fits, candidate_fit, also)
    return single if pairs is None else single.joined(pairs.scores)


def screened_pairs(fits: Refits, candidate_fit: CandidateFit, also: Collection[str] = ()) -> Screened | None:
    """The largest scores of the faults of pairs that a fitted model lacks; None where there are none."""
    own = [*candidate_fit.names, *(fault.name for fault in fits.granted)]
    return fits.family.screened(candidate_fit.fit.granting(own), candidate_fit.names, also)


def adequacy_of(fits: Refits, candidate_fit: CandidateFit, named: Scores) -> AdequacyTests:
    """Tests of a fitted model, given the scores of the named effects that it lacks."""
    hypotheses, seed = fits.hypotheses, fits.settings.seed
    local = beside(fits, candidate_fit, hypotheses.perturbations)
    faults = beside(fits, candidate_fit, fits.family.single) if fits.family.single else None
    pairs = None if faults is None else screened_pairs(fits, candidate_fit)
    kinds, modes = goodness(candidate_fit.fit, hypotheses)
    return AdequacyTests(
        named=named,
        perturbations=local,
        p_named=family_p(named, hypotheses, seed),
        p_perturbations=family_p(local, hypotheses, seed),
        kinds=kinds,
        modes=modes,
        p_fit=overall(kinds, modes),
        sensors=by_sensor(candidate_fit.fit, hypotheses),
        faults=faults,
        p_faults=1.0 if faults is None else _p_faults(family_p(faults, hypotheses, seed), pairs, hypotheses, seed),
        pairs=pairs,
        # Beside a fault that is granted, another one may stand out all the same: two wrong gains.
        overstated=not fits.granted and overstated(kinds, hypotheses),
    )


def _p_faults(single: float, pairs: Screened | None, labelled: Labelled, seed: int) -> float:
    """Of all faults together, from that of single ones; see `AdequacyTests`."""
    if pairs is None:
        return single
    return min(1.0, single / (1 - RULES.pairs_share), screened_p(pairs, labelled, seed) / RULES.pairs_share)


def overstated(kinds: pd.DataFrame, labelled: Labelled) -> bool:
    """Whether data without modes fit better than independent errors of their standard deviations would.

    ``kinds`` is from `calib.missing.goodness.goodness`; its sum of squares is a chi-square variate if the errors are
    independent and as large as stated.
    """
    if any(row.mode for row in labelled.rows):
        return False
    return float(chdtr(max(float(kinds["dof"].sum()), 1.0), float(kinds["chi2"].sum()))) < RULES.overstated


def adequate(fits: Refits, adequacy: AdequacyTests) -> bool:
    """Whether no systematic misfit is left and enough degrees of freedom remain to show one."""
    return adequacy.adequate(fits.settings.alpha) and adequacy.can_tell


def left_out_error(fits: Refits, candidate_fit: CandidateFit) -> float:
    """Rms of the leave-one-out error, by mode or by response, in standard deviations."""
    groups = [row.mode or row.sensor for row in fits.hypotheses.rows]
    return float(np.sqrt(np.mean(candidate_fit.fit.left_out(groups).residual ** 2)))


def predicts(fits: Refits, candidate_fit: CandidateFit, base: CandidateFit) -> bool:
    """Whether the leave-one-out error is no larger than that of a model with fewer effects."""
    return left_out_error(fits, candidate_fit) <= left_out_error(fits, base)


def measured_scale(fits: Refits, *candidate_fits: CandidateFit | None) -> float:
    """Factor on the standard deviation that the shapes call for at the best of some fits, see `common_scale`."""
    best = max((t for t in candidate_fits if t is not None), key=lambda t: t.ln_evidence)
    return common_scale(best.fit, fits.hypotheses, fits.settings.alpha)


def predicted_scale(fits: Refits, candidate_fit: CandidateFit, others: Scores) -> float:
    """The same if the effect that stands out beside a fit removed all the misfit that its score predicts."""
    if not others.owners:
        return measured_scale(fits, candidate_fit)
    k = int(np.argmax(others.magnitude))
    remainder = candidate_fit.fit.residual - others.unit[: len(candidate_fit.fit.residual), k] * others.z[k]
    return measured_scale(fits, replace(candidate_fit, fit=replace(candidate_fit.fit, residual=remainder)))


UNSEEN: Mapping[str, str] = {
    "held_out_sensors": "validation sensors",
    "held_out_modes": "validation modes",
    "held_out_responses": "validation responses",
    "held_out_references": "validation references",
    "held_out_bands": "validation bands",
}
"""Groups of held-out data, in words."""


def contradicting(errors: pd.DataFrame, stage: str) -> tuple[str, ...]:
    """Groups of held-out data that contradict a model: a correctly specified one would rarely predict them as badly.

    Parameters
    ----------
    errors : DataFrame
        ``group, stage, p``.
    stage : str
        Of the model, such as ``after``.
    """
    own = errors[(errors["stage"] == stage) & errors["group"].isin(list(UNSEEN))]
    return tuple(own.loc[own["p"] < RULES.contradicted, "group"].astype(str))
