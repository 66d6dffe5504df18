"""Parameters that are not selected, taken as uncertain by a stated share: the discrepancy of an explained model."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from calib.hypotheses.rules import RULES
from calib.measurement.accuracy import Claim
from calib.problem.space import Parameter, ParameterSpace
from calib.study.study import LoadedStudy


def with_uncertain(study: LoadedStudy) -> LoadedStudy:
    """The study with its unselected parameters free about their nominal values; unchanged without ``fixed_sd``.

    Their prior standard deviation is a share of the nominal value. Fitted along and projected out of every score, they
    count like a covariance ``J S^2 J^T`` added to that of the data, J the derivative of the predictions and S these
    standard deviations (Kennedy and O'Hagan 2001, to first order).
    """
    given = study.settings.explain.fixed_sd
    if given is None:
        return study
    return replace(study, search_space=freed(study.search_space, uncertain(study), given))


def freed(space: ParameterSpace, parameters: Iterable[Parameter], given: str) -> ParameterSpace:
    """The space with some parameters free about their nominal values, which are uncertain by a share of themselves."""
    share = Claim.of(given).share
    for p in parameters:
        sd = share * abs(p.value)
        reach = min(RULES.freed_reach * sd, (1 - RULES.freed_least) * abs(p.value))
        space = space.replace(
            p.name, lower=p.value - reach, upper=p.value + reach, prior_sd=sd, distribution="uniform"
        )  # fmt: skip
    return space


def uncertain(study: LoadedStudy) -> tuple[Parameter, ...]:
    """Unselected parameters to which a share of their value applies: no integers, none of value 0, none held."""
    own = (study.sensitivity_space[name] for name in study.unselected)
    return tuple(p for p in own if not p.integer and p.value != 0)


def uncertain_note(study: LoadedStudy) -> tuple[str, ...]:
    """Which parameters are uncertain and by how much, in words; empty without ``fixed_sd``."""
    given = study.settings.explain.fixed_sd
    if given is None:
        return ()
    names = [p.name for p in uncertain(study)]
    exact = [name for name in study.unselected if name not in names]
    return (uncertain_words(given, names, exact),)


def uncertain_words(given: str, names: Sequence[str], exact: Sequence[str]) -> str:
    """Which parameters that are not fitted are uncertain, and which are exact, in words."""
    told = f"uncertain by {given}: {', '.join(names)}" if names else "all selected, so that none is uncertain"
    rest = f"; exact, as integers or of value 0: {', '.join(exact)}" if exact else ""
    return f"Parameters that are not selected are {told}{rest}."
