"""Tables and words of a stepwise search."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd

from calib.missing.candidate_fit import CandidateFit
from calib.missing.explanation import Explanation
from calib.missing.partial import several_generic
from calib.missing.steps import Rejected, Stopped

STEPS, STEPS_ERRORS, REJECTED = "steps", "steps_errors", "steps_rejected"
"""Names of the tables: the models in turn; their errors; what was tried and rejected."""
STEP_COLUMNS = ("step", "effects", "added", "left_again", "misfit", "ln_bayes", "p_family", "p_fit", "dof")
ERROR_COLUMNS = ("step", "effects", "group", "rows", "rms", "expected", "p", "unpaired")
REJECTED_COLUMNS = ("beside", "effect", "title", "ln_bayes", "left_out", "why")
WHY: Mapping[Rejected, str] = {
    "weaker": "another effect has more evidence",
    "evidence": "too little evidence for the number of effects to choose from",
    "left_out": "data left out in turn are predicted worse",
    "dof": "fewer than two effective degrees of freedom are left",
    "no_longer_needed": "not needed once the others are in",
    "collinear": "collinear with an effect that was taken in: these data cannot tell which",
    "as_good": "explains about as well in the place of an effect that was taken in",
    "local_perturbation": "this place explains as well as an effect that was taken in",
    "fault": "this measurement error explains as well as an effect that was taken in",
}
"""Why an effect was rejected, in words."""
_STOPPED: Mapping[Stopped, str] = {
    "implausible": "one combination leaves nothing systematic, but takes an implausible value",
    "doubtful": "one combination leaves nothing systematic, but another effect, a place or a fault of the "
    "measurement explains as well as one of its effects, or it predicts data left out worse",
    "rejected": "no combination leaves nothing systematic",
    "most": "no combination leaves nothing systematic",
    "returned": "no combination leaves nothing systematic",
    "budget": "no combination leaves nothing systematic; the search ended with its budget of evaluations",
}


def steps_tables(found: Explanation, errors: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Tables of the stepwise search by name; none where there was no search.

    Parameters
    ----------
    found : Explanation
    errors : DataFrame
        Errors of the models of `step_fits`: ``stage, group, rows, rms, expected, p, unpaired``.
    """
    if found.steps is None:
        return {}
    rows, before = [], frozenset[str]()
    for k, step in enumerate(found.steps.steps):
        fit, names = step.candidate_fit, step.candidate_fit.names
        gone = sorted(before - set(names))
        new = [name for name in names if name not in before]
        rows.append((
            k, _together(names), ", ".join(new), ", ".join(gone), fit.fit.misfit, found.ln_bayes(fit),
            step.adequacy.p_family, step.adequacy.p_fit, step.adequacy.dof,
        ))  # fmt: skip
        before = frozenset(names)
    steps = pd.DataFrame(rows, columns=list(STEP_COLUMNS))
    by_step = errors.assign(step=errors["stage"].astype(int)).merge(steps[["step", "effects"]], on="step")
    rejected = [
        (_together(t.beside), t.what.name, t.what.title, t.ln_bayes, t.left_out, WHY[t.why]) for t in found.steps.trials
    ]
    return {
        STEPS: steps,
        STEPS_ERRORS: by_step[list(ERROR_COLUMNS)],
        REJECTED: pd.DataFrame(rejected, columns=list(REJECTED_COLUMNS)),
    }


def step_fits(found: Explanation) -> dict[str, CandidateFit]:
    """Fits of the models of a stepwise search, by the number of the step, from 0."""
    return {} if found.steps is None else {str(k): step.candidate_fit for k, step in enumerate(found.steps.steps)}


def steps_sentence(found: Explanation) -> str:
    """What the search for several effects found where none is named, in words; empty without a search."""
    if found.steps is None or found.names_something:
        return ""
    if found.steps.stopped == "adequate":
        last = found.steps.last.candidate_fit
        if found.minor or not several_generic(last):
            return ""
        together = " and ".join(effect.in_words for effect in last.effects)
        return (
            f"Together {together} would leave nothing; they are not named, since several causes that nobody listed can "
            "imitate another one."
        )
    return f"Effects were also taken in one after the other: {_STOPPED[found.steps.stopped]} ({REJECTED}.csv)."


def competing_sentence(found: Explanation) -> str:
    """Other effects that explain about as well in the place of one of several, in words; empty without any."""
    if found.steps is None or not found.names_something:
        return ""
    return " ".join(f"In the place of {name}, {other} explains about as well." for name, other in found.steps.competing)


def _together(names: tuple[str, ...]) -> str:
    return " + ".join(names) or "none"
