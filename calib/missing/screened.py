"""Scores of many candidates of which only the largest are kept: faults of pairs, of which a test has thousands.

Each is scored as any candidate is (`calib.missing.score`), many columns at a time. What all of them look like
together, which a family-wise p-value by samples needs, is not known then: theirs is a bound.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, ndtri

from calib.missing.linearised_fit import LinearisedFit
from calib.missing.rules import RULES
from calib.missing.score import Scores, scores
from calib.problem.candidate import Candidate
from calib.problem.labels import Labelled

_ENTRIES = 4_000_000
"""Entries of the columns at a time, to limit memory."""


@dataclass(frozen=True, eq=False)
class Screened:
    """The largest of many scores.

    Attributes
    ----------
    scores : Scores
        Of the `DecisionRules.screened` largest, largest first.
    number : int
        Of candidates.
    tests : float
        Number of scores that the data know of, counted twice where both signs are.
    """

    scores: Scores
    number: int
    tests: float

    @property
    def limit(self) -> float:
        """Absolute score that noise alone exceeds anywhere with a probability of `DecisionRules.noise_level`."""
        return float(-ndtri(min(RULES.noise_level / max(self.tests, 1.0), 0.5)))


def screened_candidates(fit: LinearisedFit, candidates: Sequence[Candidate], also: Collection[str] = ()) -> Screened:
    """Score candidates without a grid at a fitted model, and keep the largest; beside them those named in ``also``.

    With ``P`` a projector, the score ``z = g^T P r/|P g|`` needs no projected column: ``|P g|^2 = |g|^2 - |Q^T g|^2``
    with the orthonormal directions Q that the parameters absorb.
    """
    largest: list[tuple[float, str]] = []
    tests = 0.0
    at_once = max(_ENTRIES // max(len(fit.residual), 1), 1)
    for start in range(0, len(candidates), at_once):
        some = candidates[start : start + at_once]
        columns = -fit.fit_problem.jacobian(fit.values, [e.name for e in some])
        whole, size, along = fit.unabsorbed(columns)
        plausible, signed = (np.array([value(e) for e in some]) for value in (_plausible, _signed))
        seen = (whole * plausible > RULES.unseen) & (size > RULES.absorbed * whole)
        z = np.divide(along, size, out=np.zeros(len(some)), where=seen)
        magnitude = np.where(signed, np.abs(z), z)
        tests += float(np.sum(np.where(signed, 2.0, 1.0)[seen]))
        largest += [(-float(magnitude[k]), e.name) for k, e in enumerate(some) if seen[k]]
    kept = [name for k, (_, name) in enumerate(sorted(largest)) if k < RULES.screened or name in also]
    by_name = {e.name: e for e in candidates}
    return Screened(scores(fit, [by_name[name] for name in kept], {}), len(candidates), tests)


def _plausible(e: Candidate) -> float:
    return e.plausible


def _signed(e: Candidate) -> bool:
    return e.signed


def screened_p(found: Screened, labelled: Labelled, seed: int) -> float:
    """Upper bound of the family-wise p-value of the largest of many scores (Bonferroni).

    Given the factors of the estimated standard deviations of all kinds of data, of which samples are drawn as by
    `calib.missing.score.family_p`, scores are normal; kinds count as they do in the largest score.
    """
    if not found.tests or not len(found.scores.owners):
        return 1.0
    k = int(np.argmax(found.scores.magnitude))
    kinds = np.array([row.kind for row in labelled.rows])
    share = found.scores.unit[:, k] ** 2
    variance, rng = np.full(RULES.samples, float(share[len(kinds) :].sum())), np.random.default_rng(seed)
    for kind in dict.fromkeys(kinds.tolist()):
        dof, own = labelled.std_dof.get(kind, np.inf), float(share[: len(kinds)][kinds == kind].sum())
        variance += own * (dof / rng.chisquare(dof, RULES.samples) if np.isfinite(dof) else 1.0)
    chance = found.tests * ndtr(-float(found.scores.magnitude[k]) / np.sqrt(np.maximum(variance, 1e-300)))
    return float((np.minimum(chance, 1.0).sum() + 1) / (RULES.samples + 1))
