"""Fits of pairs of effects."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from calib.missing.candidate_fit import CandidateFit
from calib.missing.collinear import grouped
from calib.missing.evidence import at_lower
from calib.missing.linearised_fit import ROUGH, LinearisedFit, neighbouring_integers
from calib.missing.refits import Refits
from calib.missing.rules import RULES
from calib.missing.score import Scores
from calib.problem.candidate import Candidate


def fit_pairs(
    fits: Refits, best: CandidateFit, found: Scores, singles: Sequence[CandidateFit], candidates: Sequence[Candidate]
) -> list[CandidateFit]:
    """Fit pairs of effects, best first: the best effect with those that then stand out, and the runner-up likewise.

    ``found`` are the scores of the other candidates beside the best one. Missing effects may have shifted integer
    parameters to values at which a second effect does not show, so that neighbouring integers are tried too. Pairs have
    their own part of the budget, whatever single effects have spent.
    """
    fits.allowance.ensure(RULES.paired * fits.settings.budget)
    if fits.allowance.remaining <= 0:
        return []
    tests = [(best, found, RULES.pairs_of_best)]
    for runner_up in [t for t in singles if t is not best][:1]:
        rest = [e for e in candidates if e.name not in runner_up.names]
        if rest:
            tests.append((runner_up, fits.scores(runner_up.fit, rest), RULES.pairs_of_next))
    wanted: dict[frozenset[str], list[dict[str, float]]] = {}
    for first, beside, count in tests:
        places = [] if fits.spent(RULES.late) else neighbouring_integers(first.fit)
        linearisations = [(place, beside.at(place)) for place in (first.fit, *places)]
        remainder = {n: _left(linearisations, n) for n in dict.fromkeys(beside.owners)}
        for name in _first_of(fits, remainder, linearisations, candidates, count):
            _, place, there = remainder[name]
            start = fits.starts(place, there, name)[0]
            wanted.setdefault(frozenset((first.names[0], name)), []).append(start)
    out: list[CandidateFit] = []
    fits.ahead((tuple(sorted(key)), starts[0]) for key, starts in wanted.items())
    for key, starts in wanted.items():
        if fits.spent():
            break
        names = tuple(sorted(key))
        fits.announce("fitting " + " with ".join(fits.by_name[n].title for n in names))
        parent = min((t for t in (best, *singles) if t.names[0] in key), key=lambda t: t.fit.misfit)
        pair = fits.best_of(names, starts[:1], parent)
        if len(starts) > 1 and (pair is None or pair.implausible):
            pair = fits.best_of(names, [*starts[1:], *([pair.fit.values] if pair else [])], parent)
        if pair is not None:
            out.append(pair)
    # Integers shifted by one effect may hide the other: several pairs are refitted with free integers.
    order = sorted(range(len(out)), key=lambda k: -out[k].ln_evidence)
    fits.ahead(((out[k].names, out[k].fit.values) for k in order[: RULES.refined] if not fits.spent()), ROUGH, 1)
    for k in order[: RULES.refined]:
        if not fits.spent() or (k == order[0] and not out[k].implausible):
            out[k] = fits.followed(out[k], whole=1, settings=ROUGH)
    out.sort(key=lambda t: -t.ln_evidence)
    if out and not fits.spent():
        out[0] = fits.followed(out[0])
    return sorted(out, key=lambda t: -t.ln_evidence)


def _first_of(
    fits: Refits,
    remainder: Mapping[str, tuple[float, LinearisedFit, Scores]],
    linearisations: Sequence[tuple[LinearisedFit, Scores]],
    candidates: Sequence[Candidate],
    count: int,
) -> list[str]:
    """The effects predicted to leave the least misfit, each with all that are collinear with it."""
    able = [e for e in candidates if e.name in remainder]
    groups = {g.effect.name: g.names for g in grouped(able, linearisations[0][1], fits.settings.merge)}
    order = sorted(groups, key=lambda n: (min(remainder[m][0] for m in groups[n]), n))[:count]
    return [name for leader in order for name in groups[leader]]


def _left(linearisations: Sequence[tuple[LinearisedFit, Scores]], name: str) -> tuple[float, LinearisedFit, Scores]:
    """Least predicted sum of squares with an effect, and where; any but the first place must be clearly better."""
    remainder = [s.misfit - max(float(f.magnitude[f.best(name)]), 0.0) ** 2 for s, f in linearisations]
    best = int(np.argmin(remainder))
    best = best if remainder[best] < remainder[0] - RULES.worth else 0
    return (remainder[best], *linearisations[best])


def singles_from_pairs(
    fits: Refits, base: CandidateFit, singles: list[CandidateFit], pairs: Sequence[CandidateFit]
) -> list[CandidateFit]:
    """Refit single effects from pairs that fit better: each effect of the best pairs, and one whose partner vanished.

    An effect may have ended far from its optimum alone, such as at zero, so that only a pair shows how well it explains
    the data; its partner then adds nothing. The best pairs are those that may be named, and those about as good.
    """
    able = [t.ln_evidence for t in pairs if t.is_possible and t.ln_evidence > singles[0].ln_evidence + RULES.credible]
    least = max(able, default=math.inf) - RULES.credible
    misfit = {t.names[0]: t.fit.misfit for t in singles}
    better: dict[str, CandidateFit] = {}
    for pair in pairs:
        remainder = [e for e in pair.effects if not at_lower(pair.fit, e)]
        best = pair.is_possible and pair.ln_evidence >= least
        if not best and (len(remainder) != 1 or fits.spent()):
            continue
        for effect in remainder:
            known = misfit.get(effect.name, math.inf)
            found = _alone(fits, base, pair, effect) if pair.fit.misfit < known - 1.0 else None
            if found is not None and found.fit.misfit < known:
                better[effect.name], misfit[effect.name] = found, found.fit.misfit
    if not better:
        return singles
    kept = [t for t in singles if t.names[0] not in better]
    return sorted([*kept, *better.values()], key=lambda t: -t.ln_evidence)


def _alone(fits: Refits, base: CandidateFit, pair: CandidateFit, effect: Candidate) -> CandidateFit | None:
    """An effect of a pair fitted alone, from the pair's values; None where the model cannot be solved there.

    The verdict rests on one that comes near the pair: its integers are chosen again, beyond the budget if need be.
    """
    (partner,) = (e for e in pair.effects if e is not effect)
    found = fits.without(pair, partner, base)
    if found is None or pair.ln_evidence - found.ln_evidence >= RULES.close:
        return found
    return fits.beside_whole(fits.finished(found))


def no_worse(fits: Refits, pairs: Sequence[CandidateFit], singles: Sequence[CandidateFit]) -> list[CandidateFit]:
    """The pairs, best first; one that fits worse than its effect alone becomes that fit with the other at zero."""
    out = []
    for pair in pairs:
        parent = min((t for t in singles if t.names[0] in pair.names), key=lambda t: t.fit.misfit, default=pair)
        out.append(fits.grown(pair.names, parent) if parent.fit.misfit < pair.fit.misfit else pair)
    return sorted(out, key=lambda t: -t.ln_evidence)
