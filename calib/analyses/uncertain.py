"""Parameters that are not selected: in an explanation they are fitted along under their priors."""

from __future__ import annotations

from dataclasses import replace

from calib.problem.space import Parameter
from calib.study.study import LoadedStudy


def with_uncertain(study: LoadedStudy) -> LoadedStudy:
    """The study with its unselected parameters free within their limits; unchanged where all are selected or exact.

    Fitted along and projected out of every score, they count like a covariance ``J S^2 J^T`` added to that of the data,
    J the derivative of the predictions and S their prior standard deviations (Kennedy and O'Hagan 2001, to first
    order), as in a calibration; see `calib.inference.considered`.
    """
    space = study.search_space
    for p in uncertain(study):
        own = {"lower": p.lower, "upper": p.upper, "prior_sd": p.prior_width}
        space = space.replace(p.name, distribution="uniform", **own)
    return study if space is study.search_space else replace(study, search_space=space)


def uncertain(study: LoadedStudy) -> tuple[Parameter, ...]:
    """Unselected parameters whose values are uncertain by their priors; no integers, none that is held."""
    return tuple(study.model.space[name] for name in study.unselected if name in study.held_sd)


def uncertain_note(study: LoadedStudy) -> tuple[str, ...]:
    """Which parameters that are not selected are uncertain, and which are exact, in words; empty without any."""
    names = [p.name for p in uncertain(study)]
    exact = [name for name in study.unselected if name not in names]
    if not names:
        return ()
    rest = f"; exact, as integers: {', '.join(exact)}" if exact else ""
    return (f"Parameters that are not selected are uncertain by their priors: {', '.join(names)}{rest}.",)
