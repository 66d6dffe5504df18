"""Least squares of one case from several starting points: a given number of them, or until they agree."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import TypeAlias

import numpy as np
import pandas as pd

from calib.analyses.fit_statistics import FitStatistics
from calib.analyses.provenance.places import QUICK_SAMPLED, QUICK_STARTS
from calib.errors.errors import EvaluationError, InputError
from calib.errors.place import Place
from calib.execution.outcome import as_cause
from calib.inference.cases import Case, CaseResult
from calib.inference.rules import RULES
from calib.inference.starts import UntilLowestTwice
from calib.measurement.files.csv_record import header_of
from calib.problem.problem import Counts
from calib.problem.sampling import sample
from calib.results.ledger import Ledger
from calib.results.table import TableRow, read_rows
from calib.study.several import AnyStudy

Starts: TypeAlias = Sequence[Mapping[str, float]]
Fit: TypeAlias = Callable[..., FitStatistics]
"""Takes starts, the number of integer combinations, a callback after every fit (`FitProgress`), the counts of requested
points, and ``enough``, which tells after every start whether the others may be left out."""


def known_starts(study: AnyStudy, ledger: Ledger, *others: Mapping[str, float]) -> tuple[dict[str, float], ...]:
    """Further starting points of least squares: those of the study, and other points known to fit.

    Raises
    ------
    InputError
        Where the study begins at a design that the ledger does not have.
    """
    space, begin_at = study.search_space, study.settings.calibration.begin_at
    named = _of_design("begin_at", begin_at, ledger, Place(str(study.file))) if isinstance(begin_at, str) else begin_at
    given = {name: value for name, value in named.items() if name in space}
    return tuple(space.complete(start) for start in (given, *others) if start)


def _of_design(key: str, design: str, ledger: Ledger, place: Place) -> Mapping[str, float]:
    """Values of a design by its number, ``design 4711``."""
    found = ledger.design(int(design.split()[1]))
    if found is None:
        raise InputError(
            f"{key} names {design}, and no design has that number", place=place,
            remedy="choose one that 'calib designs STUDY' lists",
        )  # fmt: skip
    return found.values


def initial_population(study: AnyStudy, ledger: Ledger, size: int, seed: int) -> np.ndarray:
    """First individuals of a search, (size, n_free): those that the study states, then sampled ones.

    Raises
    ------
    InputError
        For a design that the ledger does not have, a value that is missing, outside the search limits or no integer
        where it must be one, and more designs than individuals.
    """
    space, points = study.search_space, sample(study.search_space, size, seed).points
    given, place = study.settings.calibration.start_population, Place(str(study.file)).of("start_population")
    rows: list[tuple[Mapping[str, float], TableRow | None]] = []
    if isinstance(given, str):
        file = study.file.resolve().parent / given
        columns = dict.fromkeys([*space.free_names, *header_of(file)[0]])
        own = read_rows(file, list(columns))
        rows = [({name: row.number(name) for name in space.free_names}, row) for row in own]
    else:
        for one in given:
            named = _of_design("start_population", one, ledger, place) if isinstance(one, str) else one
            rows.append((named, None))
    if len(rows) > (stated := max(size, study.settings.calibration.population)):
        remedy = f"name fewer, or set population = {len(rows)}"
        raise InputError(f"{len(rows)} designs are named for {stated} individuals", place=place, remedy=remedy)
    for k, (values, row) in enumerate(rows[:size]):  # a quick run has fewer individuals
        for j, p in enumerate(space.free):
            value = float(values.get(p.name, math.nan))
            if not p.lower <= value <= p.upper or (p.integer and value != round(value)):
                remedy = f"give {'an integer' if p.integer else 'a value'} from {p.lower:g} to {p.upper:g}"
                if row is not None:
                    raise row.error(p.name, f"it is {value:g}", remedy)
                words = "missing" if math.isnan(value) else f"{value:g}"
                raise InputError(f"{p.name} of design {k + 1} is {words}", place=place, remedy=remedy)
            points[k, j] = value
    return points


def least_squares(
    case: Case, study: AnyStudy, known: Sequence[dict[str, float]], quick: bool, fit: Fit
) -> tuple[CaseResult, FitStatistics]:
    """One case by least squares alone: from known points, the nominal values, and points sampled with its seed."""
    space, given = study.search_space, study.settings.calibration.starts
    count = min(given, QUICK_STARTS) if quick else given
    sampled = [space.complete(x) for x in sample(space, count, case.seed).points]
    starts = [*known, space.values, *sampled][: max(count, len(known) + 1)]
    with evaluable(study):
        return from_starts(case, starts, fit)


def until_agreed(
    case: Case, study: AnyStudy, known: Sequence[dict[str, float]], quick: bool, fit: Fit
) -> tuple[CaseResult, FitStatistics]:
    """One case by least squares from known points, the nominal values, and as many sampled ones as ``fit`` takes."""
    space = study.search_space
    most = min(RULES.most_starts, QUICK_SAMPLED) if quick else RULES.most_starts
    sampled = [space.complete(x) for x in sample(space, most, case.seed).points]
    return from_starts(case, [*known, space.values, *sampled], fit)


def from_further_starts(
    case: Case, study: AnyStudy, result: CaseResult, before: FitStatistics, fit: Callable[..., FitStatistics]
) -> tuple[tuple[CaseResult, FitStatistics], str]:
    """A case that is rejected, fitted from sampled points too, and a note on that.

    A minimum where resonances do not overlap looks like a model that lacks something. Points are tried until two fits
    end at the lowest sum of squares, no more than `Rules.further_starts`; none where two of the case's own starts do.
    """
    until = UntilLowestTwice()
    if until(before.ends):
        return (result, before), ""
    space = study.search_space
    sampled = [space.complete(x) for x in sample(space, RULES.further_starts, case.seed).points]
    again, found = from_starts(case, [before.values, *sampled], partial(fit, enough=until))
    tried, better = until.tried - 1, found.criterion < before.criterion - RULES.equal
    ends = f"a better one: {before.criterion:.4g} -> {found.criterion:.4g}" if better else "none is better"
    note = f"{case.name}: the fit was rejected, so that {tried} further starts were tried; {ends}."
    return (again, found) if better else (result, before), note


def from_starts(case: Case, starts: Starts, fit: Fit) -> tuple[CaseResult, FitStatistics]:
    """One case by least squares from given points."""
    started, steps, counts = time.perf_counter(), Steps(), Counts()
    statistics = fit(starts, RULES.refits, steps, counts)
    seconds = time.perf_counter() - started
    return CaseResult.fitted(case.name, statistics.values, counts, steps.table(), seconds), statistics


@dataclass(frozen=True)
class Steps:
    """Records the lowest misfit after every fit of a case."""

    lowest: list[float] = field(default_factory=list)

    def __call__(self, start: int, fits: int, misfit: float) -> None:
        """A fit has ended."""
        self.lowest.append(misfit)

    def table(self) -> pd.DataFrame:
        """Convergence table with fits in place of generations."""
        numbers = range(1, len(self.lowest) + 1)
        return pd.DataFrame({"generation": numbers, "best": self.lowest, "mean": np.nan, "feasible": 1})


@contextmanager
def evaluable(study: AnyStudy) -> Iterator[None]:
    """Turn the failure of every point of a case into an InputError with a remedy; not of a study in memory."""
    try:
        yield
    except EvaluationError as fault:
        if study.in_memory:
            raise
        remedy = "check the model over the search limits"
        raise InputError(str(fault), place=study.file, remedy=remedy, at=fault.at) from as_cause(fault)
