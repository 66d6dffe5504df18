"""Whether a model still answers as it did: one point of the ledger is asked anew before others are taken from it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager

from calib.correlation.problem import ModalProblem
from calib.errors import InputError
from calib.ledger import Ledger
from calib.outcome import Outcome
from calib.questions.recorded import asked_anew, numbers_anew, recorded
from calib.questions.user_function import function_of, kept_under, told_by
from calib.several import AnyStudy
from calib.space import ParameterSpace
from calib.study import Study

SAME = 1e-6
"""Relative difference up to which two answers are the same."""
PART_OF_STD = 1e-3
"""The same as a part of the measured standard deviation, where one is known."""
CHEAP = 1.0
"""Seconds up to which a model without stored points is asked twice; a dearer one is asked anew at its best point."""
SHOWN = 6
"""Parameters of a point that are told."""


def confirmed(study: Study, ledger: Ledger) -> float | None:
    """Ask one stored point anew, or the adopted values where none is stored, and compare.

    Returns
    -------
    float or None
        Seconds of the evaluation; None where nothing was evaluated, since a model with matrices is told by these and is
        asked anew only where that is cheap.

    Raises
    ------
    InputError
        When the model answers differently than it did.
    """
    problem = study.problem
    kept = kept_under(problem)
    stored = ledger.stored(kept)
    plain = function_of(problem) is not None
    if stored is None:
        if not plain:
            return None
        first = numbers_anew(problem, problem.space.values)
        ledger.append(kept, [first])
        if first.seconds <= CHEAP:
            confirm(study, ledger, first)
        return first.seconds
    if not plain and stored.seconds > CHEAP:
        return None
    return confirm(study, ledger, stored)


def confirm(study: Study, ledger: Ledger, known: Outcome) -> float:
    """Ask one point anew and compare it with the numbers that are known of it; returns the seconds that took."""
    problem = study.problem
    known, fresh = told_by(problem, known), asked_anew(problem, known.values)
    different = _difference(study, known, fresh)
    if different is None:
        return fresh.seconds
    again = asked_anew(problem, known.values)
    point = point_words(study.sensitivity_space, known.values)
    unsteady = _difference(study, fresh, again)
    if unsteady is not None:
        raise InputError(
            f"the model is not deterministic: asked twice at {point}, it answers {unsteady}",
            place=study.file,
            remedy="seed its random numbers, and let every evaluation start from the same state",
        )
    since = ledger.stored_at(kept_under(problem), known.values)
    raise InputError(
        f"the model answers differently than when a point was stored on {since}: {different}, at {point}; "
        "what is stored is stale, or the model depends on what it was asked before",
        place=ledger.path,
        remedy="name the files that it reads in depends_on (study.toml), and use another --results or move the ledger "
        "away",
    )


@contextmanager
def modes_kept(study: AnyStudy, opened: Callable[[], AbstractContextManager[Ledger]]) -> Iterator[AnyStudy]:
    """A study with functions of modes behind its ledger, one stored point of each asked anew; others stay as they are.

    Every test of a study is asked so.
    """
    if not any(_tells_modes(one) for one in study.studies):
        yield study
        return
    with opened() as ledger:

        def kept(one: Study) -> Study:
            if not _tells_modes(one):
                return one
            confirmed(one, ledger)
            return recorded(one, ledger)

        yield study.each(kept)


def _tells_modes(study: Study) -> bool:
    return isinstance(study.problem, ModalProblem) and function_of(study.problem) is not None


def point_words(space: ParameterSpace, values: Mapping[str, float]) -> str:
    """A point by its free parameters, as many as can be read."""
    names = [n for n in space.free_names if n in values] or list(values)
    told = ", ".join(f"{name} = {values[name]:.6g}" for name in names[:SHOWN])
    return told + (", ..." if len(names) > SHOWN else "")


def _difference(study: Study, one: Outcome, other: Outcome) -> str | None:
    """What differs most between two answers at the same point, in words; None where they are the same."""
    if one.transient or other.transient:  # the machine's doing
        return None
    if one.status != other.status:
        said = [outcome.error or "an answer" for outcome in (one, other)]
        return f"{said[0]!r} and then {said[1]!r}"
    worst, words = 1.0, None
    for name in study.targets or one.responses:
        a, b = one.responses.get(name, math.nan), other.responses.get(name, math.nan)
        if math.isnan(a) and math.isnan(b):
            continue
        _, std = study.targets.get(name, (0.0, None))
        allowed = max(SAME * max(abs(a), abs(b)), PART_OF_STD * (std or 0.0), 1e-300)
        size = math.inf if math.isnan(a) or math.isnan(b) else abs(a - b) / allowed
        if size > worst:
            worst, words = size, f"{name!r} was {a:.6g} and is {b:.6g}"
    return words
