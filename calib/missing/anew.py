"""Single effects fitted once more from the adopted values, where the base fit may be no place to begin from."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from calib.effect import Effect
from calib.errors import EvaluationError
from calib.missing.findings import Check, Trial
from calib.missing.refits import Refits
from calib.missing.rules import RULES
from calib.missing.state import State, linearised

_Start = tuple[float, str, dict[str, float]]


def led_astray(base: Trial, check: Check) -> bool:
    """Whether the base fit may be far from where its parameters are.

    A parameter is pulled beyond what a right model needs (2.4 standard deviations and more, see `plausible.strain`), or
    the base model is strongly rejected.
    """
    strongest = float(max(check.named.strength, default=0.0))
    return bool(base.implausible) or strongest > RULES.rejected or check.p_fit < RULES.rejected_fit


def anew(fits: Refits, base: Trial, singles: Sequence[Trial], effects: Sequence[Effect]) -> list[Trial]:
    """Single effects fitted from the adopted values with every magnitude of their grid, best first.

    Every start is judged by the sum of squares that is left once the parameters have followed to first order; the most
    promising ones are fitted, and the best fit chooses whole numbers again. A fit replaces an earlier one of the same
    effect only where it ended lower.
    """
    fits.progress("fitting from the adopted values too")
    own = replace(fits, settings=replace(fits.settings, budget=RULES.anew * fits.settings.budget))
    best = {t.names[0]: t for t in singles}
    try:
        starts = _starts(own, effects)
    except EvaluationError:
        return list(singles)
    tried: Counter[str] = Counter()
    for _, name, start in starts:
        if own.spent():
            break
        if tried[name] < RULES.starts_anew:
            tried[name] += 1
            found = own.best_of((name,), [start], base)
            if found is not None and (name not in best or found.state.misfit < best[name].state.misfit):
                best[name] = found
    first = max(best.values(), key=lambda t: t.ln_evidence)
    if not any(first is t for t in singles):
        first = own.followed(first, whole=2)
        best[first.names[0]] = own.moved(first) or first
    return sorted(best.values(), key=lambda t: (-t.ln_evidence, t.names))


def _starts(fits: Refits, effects: Sequence[Effect]) -> list[_Start]:
    """Promised sum of squares, effect and start, of the most promising effects at the adopted values; best first."""
    question = fits.question(())
    adopted = linearised(question, (), question.space.values)
    found = fits.scores(adopted, effects)
    by_name = {e.name: e for e in effects}
    out: list[_Start] = []
    for k, name in enumerate(found.owners):
        effect, point, size = by_name[name], dict(found.points[k]), float(found.size[k])
        if not point:
            p, step = effect.strength, float(found.z[k]) / size if size > 0 else 0.0
            point = {name: min(max(step, p.lower), p.upper)}
        out.append(_start(adopted, effect, point, adopted.residual - found.raw[:, k] * point[name]))
    order = list(dict.fromkeys(name for _, name, _ in sorted(out, key=lambda s: s[:2])))[: fits.settings.refits]
    out = [start for start in out if start[1] in order]
    for name in order:
        if not by_name[name].grid and not fits.spent():
            sign = -1.0 if by_name[name].signed and found.z[found.best(name)] < 0 else 1.0
            out += _at_magnitudes(fits, adopted, by_name[name], sign)
    return sorted(out, key=lambda s: s[:2])


def _at_magnitudes(fits: Refits, adopted: State, effect: Effect, sign: float) -> Iterator[_Start]:
    """Starts of an effect without a grid, asked of the model itself."""
    question, p = fits.question((effect.name,)), effect.strength
    for part in RULES.magnitudes:
        point = {effect.name: sign * part * effect.plausible}
        if p.lower <= point[effect.name] <= p.upper:
            try:
                residual = question.residual({**adopted.values, **point})
            except EvaluationError:
                continue
            yield _start(adopted, effect, point, residual)


def _start(adopted: State, effect: Effect, point: Mapping[str, float], residual: np.ndarray) -> _Start:
    """A start with the sum of squares it promises."""
    there = adopted.elsewhere(point, residual)
    promised = there.misfit + (point[effect.name] / effect.plausible) ** 2
    return promised if math.isfinite(promised) else math.inf, effect.name, {**adopted.values, **point}
