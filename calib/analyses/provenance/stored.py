"""Reproducibility check: one stored point is evaluated again before the ledger is used."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import replace
from typing import Any

from calib.analyses.provenance.isolation import Workers
from calib.analyses.provenance.recorded import outcome_of, recorded, reevaluated, reevaluated_numbers
from calib.errors.errors import InputError
from calib.execution.outcome import Outcome
from calib.problem.space import ParameterSpace
from calib.results.ledger import Ledger
from calib.study.several import AnyStudy
from calib.study.study import LoadedStudy

SAME = 1e-6
"""Relative difference up to which two results are equal."""
PART_OF_STD = 1e-3
"""Tolerance in measured standard deviations, where known."""
CHEAP = 1.0
"""Seconds up to which a new model is evaluated twice; a slower one is checked at its best point."""
SHOWN = 6
"""Parameters of a point that are listed."""


def confirmed(study: LoadedStudy, ledger: Ledger) -> float | None:
    """Evaluate one stored point again, or the nominal values where none is stored, and compare.

    Returns
    -------
    float or None
        Duration of the evaluation (s); None where nothing was evaluated: a model of matrices is identified by these,
        and is checked only where that is cheap; a study in memory is not checked.

    Raises
    ------
    InputError
        When the model returns other results than before.
    """
    if study.in_memory:
        return None
    problem = study.problem
    kept = problem.ledger_key
    stored = ledger.stored(kept)
    is_function = problem.user_function is not None
    if stored is None:
        if not is_function:
            return None
        first = reevaluated_numbers(problem, problem.space.values)
        ledger.append(kept, [first])
        if first.seconds <= CHEAP:
            confirm(study, ledger, first)
        return first.seconds
    if not is_function and stored.seconds > CHEAP:
        return None
    return confirm(study, ledger, stored)


def confirm(study: LoadedStudy, ledger: Ledger, known: Outcome) -> float:
    """Evaluate one point again and compare it with its stored numbers; returns the duration (s)."""
    problem = study.problem
    known, fresh = outcome_of(problem, known), reevaluated(problem, known.values)
    different = _difference(study, known, fresh)
    if different is None:
        return fresh.seconds
    point = point_label(study.sensitivity_space, known.values)
    if (known.status == "failed") != (fresh.status == "failed"):
        failed = f"failed ({(known.error or fresh.error)})"
        order = (failed, "gives a result") if known.error else ("gave a result", failed)
        raise InputError(
            f"evaluated twice at {point}, the model first {order[0]} and then {order[1]}", place=study.file,
            remedy="where a failure passes, such as a licence that is taken, let calib wait for it, retry = "
            '{ pattern = "LICENSE" }, and evaluate failed points once more by calib again; otherwise the model '
            "depends on more than its values",
        )  # fmt: skip
    again = reevaluated(problem, known.values)
    unsteady = _difference(study, fresh, again)
    if unsteady is not None:
        raise InputError(
            f"the model is not deterministic: evaluated twice at {point}, {unsteady}",
            place=study.file,
            remedy="seed its random numbers, and let every evaluation start from the same state",
        )
    since = ledger.stored_at(problem.ledger_key, known.values)
    raise InputError(
        f"the model returns other results than when a point was stored on {since}: {different}, at {point}; "
        "the stored points are stale, or the results depend on earlier evaluations",
        place=ledger.path,
        remedy="name the files that it reads in depends_on (study.toml), and use another --results or move the ledger "
        "away",
    )


@contextmanager
def with_stored_modes(
    study: AnyStudy, opened: Callable[[], AbstractContextManager[Ledger]], workers: Workers = 1
) -> Iterator[AnyStudy]:
    """A study with its functions of modes and its solvers behind the ledger, one stored point of each checked.

    Other functions are put behind a ledger that is not kept, where ``workers`` may share their points. This holds for
    every test of the study.
    """
    modes = any(_is_stored(one) for one in study.studies)
    with opened() if modes else nullcontext() as ledger, Ledger.in_memory() as passing:

        def kept(one: LoadedStudy) -> LoadedStudy:
            if ledger is not None and _is_stored(one):
                confirmed(one, ledger)
                return recorded(one, ledger, workers)
            return with_passing(one, passing, workers)

        yield study.each(kept)


def with_passing(study: LoadedStudy, ledger: Ledger, workers: Workers) -> LoadedStudy:
    """The study with its function behind a ledger that is not kept, its model too, for workers to share its points."""
    if study.problem.user_function is None or workers == 1:
        return study
    own: Any = recorded(study, ledger, workers)
    function = own.problem.user_function
    return study if function.several is None else replace(own, model=own.model.with_function(function))


def _is_stored(study: LoadedStudy) -> bool:
    return study.problem.numbers_function is not None or study.settings.solver is not None


def point_label(space: ParameterSpace, values: Mapping[str, float]) -> str:
    """A point by its first free parameters, in words."""
    names = [n for n in space.free_names if n in values] or list(values)
    listed = ", ".join(f"{name} = {values[name]:.6g}" for name in names[:SHOWN])
    return listed + (", ..." if len(names) > SHOWN else "")


def _difference(study: LoadedStudy, one: Outcome, other: Outcome) -> str | None:
    """Largest difference between two results at the same point, in words; None where they are equal."""
    if one.transient or other.transient:  # caused by the machine, not by the model
        return None
    if one.status != other.status:
        said = [outcome.error or "a result" for outcome in (one, other)]
        return f"it gave {said[0]!r} and then {said[1]!r}"
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
