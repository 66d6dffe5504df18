"""Intervals of fitted parameters that assume no linear model: profile likelihood, and samples of the posterior."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from calib.analyses.fit_statistics import FitProblem, ObjectiveTerms, fit_problem, statistics_at
from calib.analyses.provenance.places import Workers, tasks_shared
from calib.analyses.provenance.record import begin_analysis, write_record
from calib.analyses.provenance.recorded import recorded
from calib.analyses.provenance.state import INTERVALS, ROBUSTNESS, SAMPLES
from calib.analyses.reduction import reduction_noted
from calib.analyses.staged import required_calibration
from calib.errors.errors import InputError
from calib.execution.stage import Progress, silent
from calib.inference.gauss_newton import fit
from calib.inference.identify import posterior
from calib.inference.profile_likelihood import Profile, profile_likelihood, profile_table
from calib.inference.sampled_posterior import SampledPosterior, sampled_posterior
from calib.problem.prior import Prior
from calib.results.answer import Answer, names_in_words
from calib.results.ledger import Ledger
from calib.results.results import Results
from calib.study.several import AnyStudy


@dataclass(frozen=True)
class IntervalsRun:
    """What intervals are computed with besides the study.

    Attributes
    ----------
    ledger : Ledger
    homes : mapping from str to Results
        They hold the reduced basis of each test; none for a study in memory.
    workers : int, Injected or None
        See `calib.analyses.provenance.places.Workers`.
    parameters : tuple of str
        To profile; all fitted ones that are not integers if empty.
    samples : int
        Steps of every walker that samples the posterior; 0 for no samples.
    seed : int
        Of the walkers.
    progress : callable
    """

    ledger: Ledger
    homes: Mapping[str, Results] = field(default_factory=dict)
    workers: Workers = None
    parameters: tuple[str, ...] = ()
    samples: int = 0
    seed: int = 1
    progress: Progress = silent


@dataclass(frozen=True, eq=False)
class Intervals:
    """Intervals of fitted parameters beside the linearised ones.

    Attributes
    ----------
    table : DataFrame
        See `calib.inference.profile_likelihood.profile_table`.
    profiles : tuple of Profile
    sampled : SampledPosterior or None
    notes : tuple of str
        What the intervals rest on.
    seconds : float
    """

    table: pd.DataFrame
    profiles: tuple[Profile, ...]
    sampled: SampledPosterior | None
    notes: tuple[str, ...]
    seconds: float

    @property
    def curves(self) -> pd.DataFrame:
        """Every point of every profile; see `calib.inference.profile_likelihood.Profile.frame`."""
        return pd.concat([one.frame for one in self.profiles], ignore_index=True)

    @property
    def sentences(self) -> tuple[str, ...]:
        """One for each parameter, then on samples, then what all rests on."""
        each = tuple(f"{p}: {s}" for p, s in zip(self.table["parameter"], self.table["sentence"], strict=True))
        return (*each, *(() if self.sampled is None else self.sampled.sentences), *self.notes)

    @property
    def answer(self) -> Answer:
        """What the data say of the parameters, and where the standard deviations mislead."""
        kinds = {kind: self.table.loc[self.table["kind"] == kind, "parameter"].tolist() for kind in _KINDS}
        found = "; ".join(words.format(names_in_words(kinds[k])) for k, words in _KINDS.items() if kinds[k])
        differing = self.table.loc[self.table["differs"].astype(bool), "parameter"].tolist()
        better = self.table.loc[self.table["lower_misfit_at"].notna(), "parameter"].tolist()
        sure = "The linearised intervals hold."
        if differing:
            sure = f"The linearised interval of {names_in_words(differing)} does not hold: use the one of the profile."
        if self.sampled is not None and not self.sampled.converged:
            sure += " The samples are too few to judge by."
        then = "Use the intervals as they are."
        if better:
            then = f"Calibrate again: along {names_in_words(better)} the model fits better than at the fitted values."
        elif kinds["one-sided"] or kinds["unbounded"]:
            open_ones = names_in_words(kinds["one-sided"] + kinds["unbounded"])
            then = f"Measure more, or state how well {open_ones} is known before the test (prior_sd)."
        return Answer(found[:1].upper() + found[1:] + ".", sure, then)


_KINDS = {
    "two-sided": "the data bound {} on both sides",
    "one-sided": "the data bound {} on one side only",
    "unbounded": "the data exclude no value of {} within its limits",
}


def intervals_at(study: AnyStudy, values: Mapping[str, float], run: IntervalsRun) -> Intervals:
    """Intervals of the parameters about fitted values, on the reduced basis where there is one; nothing is written.

    Raises
    ------
    InputError
        For a parameter that was not fitted, and for samples without emcee.
    """
    started = time.perf_counter()
    study = study.each(lambda one: recorded(one, run.ledger, run.workers))
    problem, notes = scanned_problem(study, run.homes, run.ledger, run.workers, run.progress)
    space = problem.space
    names = tuple(p.name for p in space.free if not p.integer)
    chosen = run.parameters or names
    if unknown := [name for name in chosen if name not in names]:
        integers = [p.name for p in space.free if p.integer]
        why = "is an integer" if unknown[0] in integers else "was not fitted"
        raise InputError(
            f"{unknown[0]} {why}, so it has no profile", place="intervals",
            remedy=f"the parameters are {', '.join(names)}",
        )  # fmt: skip
    scaled = _Scaled(problem, statistics_at(problem, ObjectiveTerms.of(study), values).birge)
    # The optimum of the problem that is scanned: a reduced one ends elsewhere by its tolerance.
    whole = {p.name: values[p.name] for p in space.free if p.integer}
    prior = Prior.of(space)
    best = fit(scaled, space.freeze(whole), values, prior)
    rows = np.vstack([best.jacobian, prior.beside(best.values, names)[1]])
    known = posterior(names, rows, prior.widths(best.values, names))
    profiles = []
    for k, name in enumerate(chosen):
        told = _Counted(run.progress, f"profile of {name}", k, len(chosen))
        profiles.append(profile_likelihood(scaled, space, best.values, known, name, told))
    std = dict(zip(names, known.std.tolist(), strict=True))
    table = profile_table(profiles, best.values, std, best.misfit)
    sampled = None
    if run.samples:
        told = _Counted(run.progress, "sampling the posterior", 0, 1, run.samples)
        sampled = sampled_posterior(scaled, space, best.values, known, run.samples, run.seed, told)
    if scaled.birge > 1.0:
        notes.append(f"The model does not fit: all intervals are for {scaled.birge:.3g} times the standard deviations.")
    if study.held_sd:
        notes.append(f"Neither interval counts how well {', '.join(study.held_sd)} is known.")
    return Intervals(table, tuple(profiles), sampled, tuple(notes), time.perf_counter() - started)


def scanned_problem(
    study: AnyStudy, homes: Mapping[str, Results], ledger: Ledger, workers: Workers, progress: Progress
) -> tuple[FitProblem, list[str]]:
    """The problem to scan, on the reduced bases of large models, and what is to be said of them."""
    notes, instead = list[str](), {}
    with tasks_shared(workers):
        for one in study.studies:
            reduction = reduction_noted(one, homes.get(one.test), notes, progress)
            if reduction is not None:
                instead[one.test] = reduction.problem
    return fit_problem(study, ledger, instead), notes


@dataclass(frozen=True, eq=False)
class _Scaled:
    """A problem whose standard deviations are larger by the Birge ratio."""

    problem: FitProblem
    birge: float

    def residual(self, values: Mapping[str, float]) -> np.ndarray:
        return np.asarray(self.problem.residual(values)) / self.birge

    def jacobian(self, values: Mapping[str, float], names: Sequence[str]) -> np.ndarray:
        return np.asarray(self.problem.jacobian(values, names)) / self.birge


@dataclass(eq=False)
class _Counted:
    """Tells the share of a scan that is behind; the number of its points is not known before."""

    progress: Progress
    stage: str
    part: int
    parts: int
    steps: int = 0
    count: int = 0

    def __call__(self) -> None:
        self.count += 1
        inside = self.count / self.steps if self.steps else 1.0 - math.exp(-self.count / 10.0)
        self.progress(self.stage, (self.part + inside) / self.parts, 1)


# -- of a study in a folder --------------------------------------------------------------------------------------------


def intervals(
    study: AnyStudy,
    results: Results,
    run: IntervalsRun,
    quick: bool = False,
) -> Intervals:
    """Intervals about the stored calibration of a study; writes ``intervals.csv``, ``profiles.csv`` and samples.

    Raises
    ------
    InputError
        Where the study is not calibrated as it is now.
    """
    found = intervals_at(study, required_calibration(study, results).values, run)
    begin_analysis(results, "intervals")
    sampled = found.sampled is not None or results.has(f"{SAMPLES}.csv")
    results.remove(*INTERVALS, *(ROBUSTNESS if sampled else ()))  # which may rest on the samples that were
    results.write_table("intervals", found.table)
    results.write_table("profiles", found.curves)
    if found.sampled is not None:
        results.write_table("posterior_intervals", found.sampled.table)
        results.write_table(SAMPLES, found.sampled.samples)
    seeds = {"posterior": run.seed} if run.samples else {}
    options = [*(part for name in run.parameters for part in ("--parameter", name))]
    options += ["--samples", str(run.samples)] if run.samples else []
    write_record(study, results, "intervals", seeds, found.sentences, quick, tuple(options), found.answer)
    return found
