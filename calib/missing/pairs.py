"""Two effects at a time: which are tried together, and what they tell of one of them alone."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from calib.effect import Effect
from calib.missing.alike import grouped
from calib.missing.evidence import at_lower
from calib.missing.findings import Trial
from calib.missing.refits import LATE, Refits
from calib.missing.rules import RULES
from calib.missing.score import Scores
from calib.missing.state import ROUGH, State, neighbours

PAIRS_OF_BEST, PAIRS_OF_NEXT = 3, 2
"""Effects that are tried beside the best one and beside the runner-up."""


def fit_pairs(
    fits: Refits, best: Trial, found: Scores, singles: Sequence[Trial], candidates: Sequence[Effect]
) -> list[Trial]:
    """Two effects at a time, best first: the best one with what then stands out, and the runner-up likewise.

    ``found`` are the scores of the other candidates beside the best one. What was missing may have led whole
    numbers astray, where a second effect cannot be seen: their neighbours are asked too. What single effects have
    spent leaves pairs a part of the budget of their own.
    """
    fits.allowance.ensure(RULES.paired * fits.settings.budget)
    if fits.allowance.left <= 0:
        return []
    tests = [(best, found, PAIRS_OF_BEST)]
    for runner_up in [t for t in singles if t is not best][:1]:
        rest = [e for e in candidates if e.name not in runner_up.names]
        if rest:
            tests.append((runner_up, fits.scores(runner_up.state, rest), PAIRS_OF_NEXT))
    wanted: dict[frozenset[str], list[dict[str, float]]] = {}
    for first, beside, count in tests:
        places = [] if fits.spent(LATE) else neighbours(first.state)
        views = [(place, beside.at(place)) for place in (first.state, *places)]
        left = {n: _left(views, n) for n in dict.fromkeys(beside.owners)}
        for name in _first_of(fits, left, views, candidates, count):
            _, place, there = left[name]
            start = fits.starts(place, there, name)[0]
            wanted.setdefault(frozenset((first.names[0], name)), []).append(start)
    out: list[Trial] = []
    for key, starts in wanted.items():
        if fits.spent():
            break
        names = tuple(sorted(key))
        fits.progress("fitting " + " with ".join(fits.by_name[n].title for n in names))
        parent = min((t for t in (best, *singles) if t.names[0] in key), key=lambda t: t.state.misfit)
        pair = fits.best_of(names, starts[:1], parent)
        if len(starts) > 1 and (pair is None or pair.implausible):
            pair = fits.best_of(names, [*starts[1:], *([pair.state.values] if pair else [])], parent)
        if pair is not None:
            out.append(pair)
    # What one effect has led astray may hide the other: several pairs are allowed to move whole numbers back.
    order = sorted(range(len(out)), key=lambda k: -out[k].ln_evidence)
    for k in order[: RULES.polished]:
        if not fits.spent() or (k == order[0] and not out[k].implausible):
            out[k] = fits.followed(out[k], whole=1, settings=ROUGH)
    out.sort(key=lambda t: -t.ln_evidence)
    if out and not fits.spent():
        out[0] = fits.followed(out[0])
    return sorted(out, key=lambda t: -t.ln_evidence)


def _first_of(
    fits: Refits,
    left: Mapping[str, tuple[float, State, Scores]],
    views: Sequence[tuple[State, Scores]],
    candidates: Sequence[Effect],
    count: int,
) -> list[str]:
    """The effects that promise to leave least, each with all that look the same beside the first effect."""
    able = [e for e in candidates if e.name in left]
    groups = {g.effect.name: g.names for g in grouped(able, views[0][1], fits.settings.merge)}
    order = sorted(groups, key=lambda n: (min(left[m][0] for m in groups[n]), n))[:count]
    return [name for leader in order for name in groups[leader]]


def _left(views: Sequence[tuple[State, Scores]], name: str) -> tuple[float, State, Scores]:
    """Least sum of squares an effect promises to leave, and where; a place but the first one must be worth it."""
    left = [s.misfit - max(float(f.strength[f.best(name)]), 0.0) ** 2 for s, f in views]
    best = int(np.argmin(left))
    best = best if left[best] < left[0] - RULES.worth else 0
    return (left[best], *views[best])


def alone(fits: Refits, singles: list[Trial], pairs: Sequence[Trial]) -> list[Trial]:
    """The single effects once more where a pair in which the other one vanished has found a better fit."""
    better = {}
    for pair in pairs:
        if fits.spent():
            break
        left = [e for e in pair.effects if not at_lower(pair.state, e)]
        if len(left) != 1 or len(pair.effects) == 1:
            continue
        name = left[0].name
        known = next((t.state.misfit for t in singles if t.names == (name,)), math.inf)
        if pair.state.misfit < known - 1.0:
            gone = {n for e in pair.effects if e.name != name for n in e.names}
            start = {n: v for n, v in pair.state.values.items() if n not in gone}
            found = fits.trial((name,), start, whole=1)
            if found.state.misfit < known:
                better[name] = found
    if not better:
        return singles
    kept = [t for t in singles if t.names[0] not in better]
    return sorted([*kept, *better.values()], key=lambda t: -t.ln_evidence)
