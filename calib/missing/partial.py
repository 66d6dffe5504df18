"""Something like an effect, but not exactly: it explains nearly all of a misfit, and where the remainder sits."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from calib.inference.rules import WIDE
from calib.missing.candidate_fit import CandidateFit
from calib.missing.explanation import Explanation
from calib.missing.facts import Places
from calib.missing.rules import RULES
from calib.missing.score import Scores


def is_simpler_form(found: Explanation) -> bool:
    """Whether a partial explanation is that of an effect which the library lists in a simpler form than the real one.

    It is far ahead (`is_far_ahead`), and nothing further is predicted to lower the sum of squares by more than
    `DecisionRules.little` of what it did, or what does is minor beside it (`minor_beside`).
    """
    best, adequacy = found.chosen, found.chosen_adequacy
    if found.verdict != "partial" or best is None or adequacy is None or not is_far_ahead(found):
        return False
    if found.minor:
        return True
    decrease = found.base.fit.misfit - best.fit.misfit
    return (
        max(_decreases(adequacy.named, adequacy.perturbations, adequacy.faults), default=0.0) < RULES.little * decrease
    )


def minor_beside(found: Explanation, singles: Sequence[CandidateFit], together: CandidateFit) -> tuple[str, ...]:
    """Effects of a fit with several that are minor beside the first of them; empty unless all others are.

    A unit that is built otherwise than the library lists it leaves something, which a further effect of almost no size
    takes. Minor is an effect that has less than `DecisionRules.minor_size` of its plausible magnitude, and of what the
    first one has of its own, while all that are beside the first one gain less than `DecisionRules.minor_gain` of its
    log evidence.

    Parameters
    ----------
    found : Explanation
    singles : sequence of CandidateFit
        Fits of single effects.
    together : CandidateFit
    """
    own = [t for t in singles if t.names[0] in together.names]
    if not own:
        return ()
    first = max(own, key=lambda t: t.ln_evidence)
    if together.ln_evidence - first.ln_evidence >= RULES.minor_gain * found.ln_bayes(first):
        return ()
    shares = {e.name: abs(together.magnitude(e.name)[0]) / e.plausible for e in together.effects}
    most = RULES.minor_size * min(shares.pop(first.names[0]), 1.0)
    return tuple(shares) if all(share < most for share in shares.values()) else ()


def several_generic(together: CandidateFit) -> bool:
    """Whether more than one effect of a fit is generic: then none of them is named.

    Of hundreds that nobody listed, two imitate nearly any cause that is in no form of them, such as a thinner member a
    soft joint with a soft support. Such a cause is likelier than two independent ones that happen to have a form each.
    """
    return sum(effect.generic for effect in together.effects) > 1


def minor_of(found: Explanation, singles: Sequence[CandidateFit]) -> tuple[str, ...]:
    """The same of the end of a stepwise search that leaves nothing over; empty without one."""
    if found.steps is None or not found.steps.explains:
        return ()
    return minor_beside(found, singles, found.steps.last.candidate_fit)


def is_far_ahead(found: Explanation) -> bool:
    """Whether the best attempt explains far more than anything else.

    Every other effect, local perturbation or fault gains less than `DecisionRules.by_far` of the log evidence that it
    gains, or leaves more than `DecisionRules.leaves` times the sum of squares that it leaves.
    """
    best = found.chosen
    if best is None:
        return False
    gained = found.ln_bayes(best)
    same = {name for group in found.groups if group.effect.name in best.names for name in group.names}
    others = [t for t in found.candidate_fits if not same & set(t.names)]
    others += [t for t in (found.perturbation, *found.faults) if t is not None]
    near = [t for t in others if found.ln_bayes(t) > RULES.by_far * gained]
    return not any(t.fit.misfit < RULES.leaves * best.fit.misfit for t in near)


def _decreases(*families: Scores | None) -> Iterator[float]:
    """Predicted decrease of the sum of squares by each candidate of these families."""
    for scores in families:
        if scores is not None:
            yield from (scores.magnitude.clip(0.0) ** 2).tolist()


def magnitude_range(found: Explanation) -> tuple[float, float]:
    """Ends of all 95 % intervals of the best effect's magnitude, alone and beside what else was taken in with it.

    What the library does not list shifts the magnitude by an error that no interval of a single model holds.
    """
    assert found.chosen is not None
    (effect,) = found.chosen.effects
    fits: list[CandidateFit] = [found.chosen]
    if found.steps is not None:
        fits += [step.candidate_fit for step in found.steps.steps if effect.name in step.candidate_fit.names]
    p, ends = effect.magnitude, []
    for fit in fits:
        value, std = fit.magnitude(effect.name)
        ends += [max(value - WIDE * std, p.lower), min(value + WIDE * std, p.upper)]
    return min(ends), max(ends)


@dataclass(frozen=True)
class Remainder:
    """Where the remainder of a misfit sits.

    Attributes
    ----------
    distance : float
        Root mean square distance from the effect of the local perturbations that would lower what is left, weighted by
        the decrease of the sum of squares beyond noise, over that of all of them; NaN without places, or where none
        would. 1 is anywhere.
    modes : float
        Share of what is left beyond noise in the modes that the effect changes; NaN without modes, or where nothing is.
    expected : float
        The same share if what is left were the same for every row.
    """

    distance: float
    modes: float
    expected: float

    @property
    def near(self) -> bool | None:
        """Whether it sits near the effect, or without places in its modes; None where neither can be told."""
        if not math.isnan(self.distance):
            return self.distance < RULES.left_near
        return None if math.isnan(self.modes) else self.modes > max(RULES.left_most, self.expected)

    @property
    def sentence(self) -> str:
        """In words; empty where nothing can be told."""
        parts = []
        if not math.isnan(self.distance):
            parts.append(
                f"local stiffness or mass changes that would lower it lie at {self.distance:.2g} times the distance "
                "of all"
            )
        if not math.isnan(self.modes):
            parts.append(
                f"the modes that the effect changes most hold {100 * self.modes:.0f} % of it "
                f"({100 * self.expected:.0f} % if it were spread evenly)"
            )
        if self.near is None:
            return ""
        return f"What is left sits {'near it' if self.near else 'elsewhere'}: {'; '.join(parts)}."

    @property
    def entries(self) -> dict[str, object]:
        """As stored in ``explanation.json``."""
        numbers = {"distance": self.distance, "modes": self.modes, "modes_expected": self.expected}
        return {"near": self.near} | {name: None if math.isnan(x) else x for name, x in numbers.items()}


def remainder_of(
    found: Explanation,
    places: Places,
    acting: Sequence[tuple[float, float, float]],
    modes: Sequence[str],
) -> Remainder | None:
    """Where the rest of a misfit sits that something like an effect nearly explains; None for any other verdict.

    Parameters
    ----------
    found : Explanation
    places : mapping from str to (kind, (x, y, z), sensor)
        Of every local perturbation, by name; m.
    acting : sequence of (x, y, z)
        Where the effect acts, m; empty where that is unknown.
    modes : sequence of str
        Mode of every row of the data; empty for rows without one.
    """
    if not is_simpler_form(found):
        return None
    return Remainder(_distance(found, places, np.array(acting, dtype=float).reshape(-1, 3)), *_modes(found, modes))


def _distance(found: Explanation, places: Places, acting: np.ndarray) -> float:
    assert found.chosen_adequacy is not None
    scores = found.chosen_adequacy.perturbations
    points = np.array([places[name][1] if name in places else (np.nan,) * 3 for name in scores.owners], dtype=float)
    points = points.reshape(-1, 3)
    known = np.isfinite(points).all(axis=1)
    if not len(acting) or not known.any():
        return math.nan
    square = ((points[known][:, None] - acting[None]) ** 2).sum(axis=2).min(axis=1)
    weight = np.maximum(scores.magnitude[known].clip(0.0) ** 2 - RULES.left_noise**2, 0.0)
    if not weight.any() or not square.any():
        return math.nan
    return float(np.sqrt(weight @ square / weight.sum() / square.mean()))


def _modes(found: Explanation, modes: Sequence[str]) -> tuple[float, float]:
    assert found.chosen is not None
    (name,) = found.chosen.names
    base, rest = found.base.fit, found.chosen.fit.residual
    column = found.base_adequacy.named.unit[: len(rest), found.base_adequacy.named.best(name)]
    assert len(base.residual) == len(rest)
    table = pd.DataFrame({"mode": modes, "own": column**2, "left": rest**2, "rows": 1.0})
    table = table[table["mode"] != ""].groupby("mode", sort=False).sum()
    beyond = (table["left"] - table["rows"]).clip(lower=0.0)
    if len(table) < 2 or not beyond.sum() > 0 or not table["own"].sum() > 0:
        return math.nan, math.nan
    order = table["own"].sort_values(ascending=False, kind="stable")
    count = int(np.searchsorted(order.cumsum().to_numpy(), RULES.left_changed * order.sum())) + 1
    own = list(order.index[:count])
    return float(beyond[own].sum() / beyond.sum()), float(table.loc[own, "rows"].sum() / table["rows"].sum())
