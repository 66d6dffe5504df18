"""More detailed forms of an effect, fitted after a decision that its simple form nearly explains the data.

They are no candidates of the first question and are not among the tests that it counts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import pandas as pd

from calib.execution.stage import Progress, silent
from calib.inference.rules import WIDE
from calib.missing.adequacy import UNSEEN, adequacy_of, beside, contradicting
from calib.missing.candidate_fit import AdequacyTests, CandidateFit
from calib.missing.explanation import Explanation
from calib.missing.goodness import p_words
from calib.missing.hypotheses import Hypotheses
from calib.missing.local import magnitude_words
from calib.missing.partial import is_far_ahead
from calib.missing.profile import profile_interval
from calib.missing.refits import Refits
from calib.missing.settings import Settings
from calib.problem.candidate import Candidate

RICHER, RICHER_ERRORS = "richer", "richer_errors"
"""Names of the tables."""
COLUMNS = (
    "simpler", "effect", "parameter", "unit", "value", "low", "high", "sum_of_squares", "sum_of_squares_simpler",
    "ln_bayes", "p_family", "p_fit", "adequate", "refused",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class DetailedFit:
    """One richer member, fitted.

    Attributes
    ----------
    simpler : CandidateFit
        The model with the next simpler member.
    candidate_fit : CandidateFit
    adequacy : AdequacyTests
    interval : (float, float)
        95 % interval of its magnitude, by profile likelihood.
    refused : str
        Why it is not adequate, as `Explanation.refused`, or ``held_out`` where held-out data contradict it; empty where
        it is adequate.
    errors : DataFrame
        Of its model, by group of data: ``group, rows, rms, expected, p``.
    """

    simpler: CandidateFit
    candidate_fit: CandidateFit
    adequacy: AdequacyTests
    interval: tuple[float, float]
    refused: str
    errors: pd.DataFrame

    @property
    def effect(self) -> Candidate:
        """The member."""
        (effect,) = self.candidate_fit.effects
        return effect

    @property
    def adequate(self) -> bool:
        """Whether nothing systematic is left, and nothing else speaks against it."""
        return not self.refused


def leading_fit(found: Explanation) -> CandidateFit | None:
    """The fit of the effect that is far ahead of anything else and yet not believed alone; None where there is none."""
    best = found.chosen
    if best is None or found.verdict not in ("partial", "none_explains") or len(best.effects) != 1:
        return None
    return best if is_far_ahead(found) else None


def fitted_in_detail(
    hypotheses: Hypotheses,
    found: Explanation,
    simpler: CandidateFit,
    name: str,
    settings: Settings,
    progress: Progress = silent,
) -> tuple[CandidateFit, AdequacyTests] | None:
    """The fit of a richer member with its tests; None where the model cannot be fitted with it.

    It starts from the fit of the simpler member, with the nuisance parameters that both have, at every point of its
    grid. The fit is not charged to the decision.

    Parameters
    ----------
    hypotheses : Hypotheses
        With the member in the place of the simpler one.
    found : Explanation
    simpler : CandidateFit
    name : str
        Of the member.
    settings : Settings
        Of the decision.
    """
    fits = Refits(hypotheses, replace(settings, budget=math.inf), found.noise_scale, progress)
    fits.announce(f"fitting {fits.by_name[name].title}")
    fit = fits.best_of((name,), _starts(fits.by_name[name], simpler), found.base)
    if fit is None:
        return None
    fit = fits.finished(fits.followed(fit))
    return fit, adequacy_of(fits, fit, beside(fits, fit, hypotheses.effects))


def _starts(effect: Candidate, simpler: CandidateFit) -> list[dict[str, float]]:
    (before,) = simpler.effects
    values = dict(simpler.fit.values)
    size = values.pop(before.name) if effect.magnitude.unit == before.magnitude.unit else None
    kept = {n: v for n, v in values.items() if n in effect.names or n not in before.names}
    out = []
    for point in effect.grid or ({effect.name: effect.plausible},):
        start = {**point, **kept}
        if size is not None:
            start[effect.name] = min(max(size, effect.magnitude.lower), effect.magnitude.upper)
        out += [start] if start not in out else []
    return out


def tested_in_detail(
    found: Explanation, simpler: CandidateFit, fitted: tuple[CandidateFit, AdequacyTests], errors: pd.DataFrame
) -> DetailedFit:
    """A fitted member with its interval, and why it is not adequate.

    Parameters
    ----------
    found : Explanation
    simpler : CandidateFit
    fitted : (CandidateFit, AdequacyTests)
        From `fitted_in_detail`.
    errors : DataFrame
        ``group, stage, rows, rms, expected, p`` of its model.
    """
    fit, adequacy = fitted
    refused = found.against(fit, adequacy)
    stage = str(errors["stage"].iloc[0]) if len(errors) else ""
    if not refused and contradicting(errors, stage):
        refused = "held_out"
    return DetailedFit(
        simpler, fit, adequacy, profile_interval(fit.fit, fit.names[0]), refused, errors.drop(columns="stage")
    )


# -- words and tables --------------------------------------------------------------------------------------------------


def best_in_detail(tried: Sequence[DetailedFit]) -> DetailedFit | None:
    """The member to tell: the first adequate one, or else that of the highest evidence; None where none was tried."""
    best = max(tried, key=lambda one: one.candidate_fit.ln_evidence, default=None)
    return next((one for one in tried if one.adequate), best)


def detailed_sentence(tried: Sequence[DetailedFit], before: pd.DataFrame) -> str:
    """What richer members tell, in words; empty where none was tried.

    Parameters
    ----------
    tried : sequence of DetailedFit
        From simple to rich.
    before : DataFrame
        Errors of the decision, ``group, stage, rms``.
    """
    one = best_in_detail(tried)
    if one is None:
        return ""
    e, listed = one.effect, tried[0].simpler.names[0]
    sized = f"{e.in_words}, {magnitude_words(e.magnitude, one.candidate_fit.fit.values[e.name], *one.interval)}"
    squares = f"the sum of squares falls from {tried[0].simpler.fit.misfit:.0f} to {one.candidate_fit.fit.misfit:.0f}"
    if one.adequate:
        start = f"In more detail {listed} explains the data: {sized}; {squares}, and nothing systematic is left"
        end = f"'calib extend' adds {e.name}."
    else:
        start = f"In more detail {listed} does not explain the data either: {sized}; {squares}, but {_why_not(one)}"
        end = f"It is {e.name} in the list of possible causes."
    least = p_words(min(one.adequacy.p_family, one.adequacy.p_fit))
    return (
        f"{start} ({least}){_held_out(one, before)}. It was fitted after the decision, which does not count it. {end}"
    )


def detailed_next(tried: Sequence[DetailedFit]) -> str:
    """What to do with an adequate member, in words; empty without one."""
    one = best_in_detail(tried)
    if one is None or not one.adequate:
        return ""
    return f"Or add {one.effect.name}, which is {tried[0].simpler.names[0]} in more detail and explains the data."


def _why_not(one: DetailedFit) -> str:
    return {
        "implausible": one.candidate_fit.implausible,
        "dof": "too few degrees of freedom are left to test it",
        "misfit": "something systematic is left",
        "local_perturbation": "a local stiffness or mass change fits better",
        "held_out": "validation data contradict it",
    }[one.refused]


def _held_out(one: DetailedFit, before: pd.DataFrame) -> str:
    """Errors of held-out data without the effect and with the member, in words."""
    own = before[before["stage"] == "before"]
    earlier = {str(group): float(rms) for group, rms in zip(own["group"], own["rms"], strict=True)}
    parts = [
        f"{UNSEEN[r['group']]} {earlier[r['group']]:.2f} -> {r['rms']:.2f} ({r['expected']:.2f} expected)"
        for r in one.errors.to_dict("records")
        if r["group"] in UNSEEN and r["group"] in earlier
    ]
    return f"; in standard deviations {', '.join(parts)}" if parts else ""


def detailed_tables(found: Explanation, tried: Sequence[DetailedFit]) -> dict[str, pd.DataFrame]:
    """``richer``: every parameter of every member tried, magnitude first; ``richer_errors``: their errors by group."""
    rows: list[tuple[object, ...]] = []
    for one in tried:
        fit, tests = one.candidate_fit.fit, one.adequacy
        std = dict(zip(fit.names, fit.std.tolist(), strict=True))
        for p in one.effect.parameters:
            value, reach = fit.values[p.name], WIDE * std.get(p.name, math.nan)
            ends = (max(value - reach, p.lower), min(value + reach, p.upper))
            low, high = one.interval if p.name == one.effect.name else ends
            rows.append((
                one.simpler.names[0], one.effect.name, p.name, p.unit, value, low, high, fit.misfit,
                one.simpler.fit.misfit, found.ln_bayes(one.candidate_fit), tests.p_family, tests.p_fit, one.adequate,
                one.refused,
            ))  # fmt: skip
    errors = pd.concat([one.errors.assign(effect=one.effect.name) for one in tried], ignore_index=True)
    order = ["effect", *(c for c in errors.columns if c != "effect")]
    return {RICHER: pd.DataFrame(rows, columns=list(COLUMNS)), RICHER_ERRORS: errors[order]}
