"""Richer members of the effect that a decision finds nearly right: fitted, tested and held against held-out data."""

from __future__ import annotations

from calib.errors.errors import EvaluationError, ToleranceError
from calib.execution.stage import Progress, unheard
from calib.missing.detailed import Richer, fitted_richer, nearly_explaining, told_richer
from calib.missing.explanation import Explanation
from calib.missing.settings import Settings
from calib.missing.test import Adapter

STAGE = "richer"
"""Stage of the errors of a richer member."""


def richer_members(adapter: Adapter, found: Explanation, progress: Progress = unheard) -> tuple[Richer, ...]:
    """The family of the effect that nearly explains the data, from simple to rich, up to the first adequate member.

    Empty where no effect does, or where it has no richer member.
    """
    settings, tried = Settings(alpha=found.alpha, seed=adapter.facts.seed), list[Richer]()
    simpler = nearly_explaining(found)
    while simpler is not None:
        try:
            richer = adapter.richer(simpler.names[0], progress)
            if richer is None:
                break
            (name,) = {e.name for e in richer.hypotheses.effects} - {e.name for e in adapter.hypotheses.effects}
            fitted = fitted_richer(richer.hypotheses, found, simpler, name, settings, progress)
        except (EvaluationError, ToleranceError):
            break
        if fitted is None:
            break
        errors = richer.errors({STAGE: fitted[0]}, found.noise_scale)[0]
        errors = errors[["group", "stage", "rows", "rms", "expected", "p"]]
        tried.append(told_richer(found, simpler, fitted, errors))
        adapter, simpler = richer, None if tried[-1].adequate else fitted[0]
    return tuple(tried)
