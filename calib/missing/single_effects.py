"""Fits of single effects."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from calib.errors.errors import EvaluationError
from calib.missing.candidate_fit import CandidateFit
from calib.missing.collinear import Group
from calib.missing.evidence import ln_bayes_linear
from calib.missing.linearised_fit import FINE
from calib.missing.refits import Refits, near_to
from calib.missing.rules import RULES
from calib.missing.score import Scores

Starts = Mapping[tuple[str, ...], dict[str, float]]
"""Values of earlier fits by their effects."""


def fit_singles(
    fits: Refits, base: CandidateFit, groups: Sequence[Group], named: Scores, starts: Starts
) -> list[CandidateFit]:
    """Fits of the most promising effects, and of those collinear with the ones that fit well; best first.

    Those that are likely to be asked for are made by all processes first; see `Refits.ahead`.
    """
    plausible = np.array([fits.by_name[n].plausible for n in named.owners])
    predicted = ln_bayes_linear(named.magnitude, named.size, plausible)
    by_effect = {g.effect.name: max(predicted[k] for k, n in enumerate(named.owners) if n in g.names) for g in groups}
    order = sorted(by_effect, key=lambda n: (-by_effect[n], n))[: fits.settings.refits]

    def negligible(name: str, reached: float) -> bool:
        """Whether the predicted gain of an effect is negligible beside that of another effect."""
        return reached > RULES.far and by_effect[name] < reached / 4 and (name,) not in starts

    likely = [name for name in order if not negligible(name, by_effect[order[0]])]
    fits.ahead(((name,), start) for name in likely for start in _starts(fits, base, named, name, starts))
    out: list[CandidateFit] = []
    for name in order:
        if len(out) > 1 and fits.spent(RULES.early):
            break
        if negligible(name, max((t.ln_evidence - base.ln_evidence for t in out), default=0.0)):
            continue
        found = _single(fits, base, named, name, starts)
        if found is not None:
            out.append(found)
    if not out:
        raise EvaluationError("no effect could be fitted")
    out.sort(key=lambda t: -t.ln_evidence)
    near = near_to(out[0].ln_evidence - base.ln_evidence)
    others = {g.effect.name: g.others for g in groups}
    like = {t.names: others[t.names[0]] for t in out if out[0].ln_evidence - t.ln_evidence < near}
    alike = [one.name for each in like.values() for one in each]
    fits.ahead(((name,), start) for name in alike for start in _starts(fits, base, named, name, starts))
    for competitors in like.values():
        for competitor in () if fits.spent() else competitors:
            found = _single(fits, base, named, competitor.name, starts)
            out += [] if found is None else [found]
    out.sort(key=lambda t: -t.ln_evidence)
    # Integer parameters may have absorbed what was missing: the best fits may move them back.
    reached = out[0].ln_evidence - base.ln_evidence
    near = near_to(reached) if reached > RULES.credible else -math.inf

    def is_close(k: int) -> bool:
        return out[0].ln_evidence - out[k].ln_evidence < near and not fits.spent(RULES.early if k else 1.0)

    first = range(min(len(out), RULES.refined))
    fits.ahead(((out[k].names, out[k].fit.values) for k in first if is_close(k)), FINE, 1)
    for k in first:
        if is_close(k):
            out[k] = fits.followed(out[k], whole=1)
    return sorted(out, key=lambda t: -t.ln_evidence)


def _single(fits: Refits, base: CandidateFit, named: Scores, name: str, starts: Starts) -> CandidateFit | None:
    """Fit of one effect, from its earlier fit or from one step off the base model."""
    fits.announce(f"fitting {fits.by_name[name].title}")
    columns = {} if (name,) in starts else fits.columns(base.fit, named, name)
    return fits.best_of((name,), _starts(fits, base, named, name, starts), base, columns)


def _starts(fits: Refits, base: CandidateFit, named: Scores, name: str, starts: Starts) -> list[dict[str, float]]:
    return [starts[(name,)]] if (name,) in starts else fits.starts(base.fit, named, name)
