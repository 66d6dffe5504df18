"""Sensitivity analysis: rank correlations, variance shares, and the selection of parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd

from calib.analyses.answers import of_screening, of_sensitivity
from calib.analyses.failures import reasons, reasons_sentence
from calib.analyses.provenance.places import (
    QUICK_BASE,
    QUICK_SAMPLES,
    QUICK_TRAJECTORIES,
    Workers,
    is_quick,
    open_evaluator,
)
from calib.analyses.provenance.record import analyses_of, begin_analysis, write_record
from calib.analyses.provenance.recorded import recorded
from calib.analyses.provenance.state import changed, made_from
from calib.analyses.provenance.stored import confirmed
from calib.errors.errors import InputError
from calib.execution.outcome import Outcome
from calib.execution.stage import Progress, unheard
from calib.problem.sampling import Sample, sample
from calib.problem.space import ParameterSpace
from calib.results.answer import Answer
from calib.results.ledger import Ledger
from calib.results.results import Results
from calib.results.table import read_table
from calib.results.written import is_own
from calib.sensitivity.selection import Assessment, assess
from calib.sensitivity.spearman import noise_floor
from calib.sensitivity.variance import Design, morris_design, morris_effects, sobol_design, sobol_shares
from calib.study.study import Study
from calib.study.study_file import shell_argument

_BATCH = 50
"""Points evaluated and added to the ledger in one batch."""
TRAJECTORIES, BASE = 20, 128
"""Trajectories of Morris, twice the 10 that usually rank well (Campolongo and Saltelli 1997), and base points of Sobol,
a power of 2: the shares of a smooth function of five parameters then have a standard error of 0.01."""


@dataclass(frozen=True)
class Sensitivity:
    """Sensitivity measures and the sample behind them.

    Attributes
    ----------
    assessment : Assessment
        Spearman and partial rank correlations, variance shares, and the resulting selection.
    samples : int
        Accepted points.
    failed : int
        Points at which the model could not be evaluated.
    unpaired : int
        Points at which some measured mode found no partner.
    acceptance : float
        Fraction of the sampled points that satisfied the constraints.
    noise_floor : float
        Largest rank correlation in the whole table due to chance alone (95 %).
    sampled : DataFrame (samples, n_parameters + n_responses)
        Sampled points and responses, NaN where there is none.
    why_failed : str
        The commonest reasons of failure; empty without any.
    """

    assessment: Assessment
    samples: int
    failed: int
    unpaired: int
    acceptance: float
    noise_floor: float
    sampled: pd.DataFrame
    why_failed: str = ""

    @property
    def table(self) -> pd.DataFrame:
        """``selection.csv``."""
        return self.assessment.selection

    @property
    def answer(self) -> Answer:
        """What was found, how sure that is, and what to do next."""
        return of_sensitivity(self.assessment.selection, self.sentences[0])

    @property
    def sentences(self) -> tuple[str, ...]:
        """Number of samples, reasons of failure, and the selection."""
        samples = f"{self.samples} sample{'s' * (self.samples != 1)}"
        return (
            f"{samples} satisfied the constraints (acceptance {100 * self.acceptance:.0f} %), {self.failed} failed, "
            f"{self.unpaired} left a mode unpaired. "
            f"Chance alone gives rank correlations up to {self.noise_floor:.2f}.",
            *([self.why_failed] if self.why_failed else []),
            self.assessment.sentence,
        )


def sensitivity(
    study: Study,
    results: Results,
    ledger: Ledger,
    workers: Workers = None,
    quick: bool = False,
    progress: Progress = unheard,
) -> Sensitivity:
    """Sample all free parameters by a constrained Latin hypercube; rank correlations, variance shares, selection."""
    settings = study.settings.sensitivity
    space = study.sensitivity_space
    count = min(settings.samples, QUICK_SAMPLES) if quick else settings.samples
    drawn = sample(space, count, settings.seed)
    outcomes = _evaluate(study, ledger, [space.complete(x) for x in drawn.points], workers, progress)
    forced = study.settings.listed
    answer = measured(space, drawn, outcomes, {name: name for name in study.problem.sensitivity_responses}, forced)
    assessment = answer.assessment
    begin_analysis(results, "sensitivity")
    results.write_table("sensitivity", assessment.spearman, index=True)
    results.write_table("partial", assessment.partial, index=True)
    results.write_table("variance_share", assessment.variance_share.table, index=True)
    results.write_table("selection", assessment.selection)
    results.write_table("sensitivity_samples", answer.sampled)
    if space.constraints:
        results.write_table("input_correlation", assessment.input_correlation, index=True)
    seeds = {"samples": settings.seed}
    write_record(study, results, "sensitivity", seeds, answer.sentences, quick, answer=answer.answer)
    return answer


def measured(
    space: ParameterSpace,
    drawn: Sample,
    outcomes: Sequence[Outcome],
    names: Mapping[str, str],
    forced: Sequence[str] | None = None,
) -> Sensitivity:
    """Sensitivity measures of a sample; see `Sensitivity` and `calib.sensitivity.selection.assess`.

    Parameters
    ----------
    space : ParameterSpace
    drawn : Sample
    outcomes : sequence of Outcome
        Of the sampled points.
    names : mapping from response to str
        Responses to assess, with their names in tables.
    forced : sequence of str, optional
        Parameters that the user selected.
    """
    x = pd.DataFrame(drawn.points, columns=list(space.free_names))
    y = table_of(outcomes, list(names)).rename(columns=dict(names))
    assessment = assess(x, y, forced)
    known, failed = int((~y.isna().any(axis=1)).sum()), sum(o.status != "ok" for o in outcomes)
    floor = noise_floor(max(known, 3), max(int(assessment.spearman.notna().sum().sum()), 1))
    why = reasons_sentence(space, reasons(outcomes), len(outcomes))
    samples = pd.concat([x, y], axis=1)
    return Sensitivity(assessment, len(x), failed, len(x) - known - failed, drawn.acceptance, floor, samples, why)


def selected_by_measures(study: Study, home: Results) -> Study:
    """The study with the parameters that its sensitivity analysis selected, if the study leaves the selection to it.

    InputError where there is no selection, or an outdated one.
    """
    if why := outdated_selection(study, home):
        again = " --quick" * is_quick(study, home)
        raise InputError(
            f"parameters were selected {why}",
            place=home.path / "selection.csv",
            remedy=f"run 'calib sensitivity {shell_argument(study.file)}{again}' again",
        )
    return selecting(study, home)


def outdated_selection(study: Study, home: Results) -> str:
    """Why a selection by the sensitivity analysis is outdated; empty where it is valid, or made by the user."""
    if not study.settings.selected_by_sensitivity:
        return ""
    entry = analyses_of(home).get("sensitivity")
    if entry is None:  # `begin_analysis` removed it from the record, and the analysis did not end
        return "by an interrupted analysis" if is_own(home.path / "selection.csv") else ""
    found = changed(entry.get("made_from", {}), made_from(study, "sensitivity"))
    return f"at an earlier state of {', '.join(found)}" if found else ""


def selecting(study: Study, home: Results) -> Study:
    """As `selected_by_measures`, even with an outdated selection."""
    if not study.settings.selected_by_sensitivity:
        return study
    path: Path = home.path / "selection.csv"
    if not path.is_file():
        raise InputError(
            "the study selects its parameters by the sensitivity analysis, which has not been run yet",
            place=study.file,
            remedy=f"run 'calib sensitivity {shell_argument(study.file)}' first",
        )
    names, assessed = selected_in(path)
    if differing := sorted(set(study.sensitivity_space.free_names) ^ set(assessed)):
        raise InputError(
            f"it does not assess the free parameters of the study: {differing[0]!r} is in one of the two only",
            place=path,
            remedy=f"run 'calib sensitivity {shell_argument(study.file)}' again",
        )
    if not names:
        raise InputError(
            "the sensitivity analysis selected no parameter", place=path, remedy="name them in 'selection'"
        )
    return study.selecting(names)


def selected_in(path: Path) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Parameters that a ``selection.csv`` selects, and all that it assesses; InputError for an ambiguous table."""
    table = read_table(path, ["parameter"], flags=["selected"], complete=["selected"], unique="parameter")
    return tuple(table["parameter"][table["selected"].astype(bool)]), tuple(table["parameter"])


# -- on request --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Screening:
    """Elementary effects (Morris) or variance shares (Sobol).

    Attributes
    ----------
    method : {"morris", "sobol"}
    table : DataFrame
        One row per parameter and response.
    points : int
        Evaluated points.
    note : str
        What the sampling ignores, such as constraints.
    """

    method: str
    table: pd.DataFrame
    points: int
    note: str

    @property
    def answer(self) -> Answer:
        """What was found, how sure that is, and what to do next."""
        return of_screening(self.method, self.table, self.sentences[0])

    @property
    def sentences(self) -> tuple[str, ...]:
        """Number of points, and what the sampling ignores."""
        points = f"{self.points} point{'s' * (self.points != 1)}."
        return (f"{points} {self.note}".rstrip(),)


def screen(
    study: Study,
    results: Results,
    ledger: Ledger,
    method: Literal["morris", "sobol"],
    workers: Workers = None,
    quick: bool = False,
    ignore_constraints: bool = False,
    progress: Progress = unheard,
) -> Screening:
    """Morris' elementary effects or Sobol's variance shares, for independent inputs between their limits."""
    space, seed = study.sensitivity_space, study.settings.sensitivity.seed
    design: Design
    if method == "morris":
        design = morris_design(
            space, QUICK_TRAJECTORIES if quick else TRAJECTORIES, seed, ignore_constraints=ignore_constraints
        )
    else:
        design = sobol_design(space, QUICK_BASE if quick else BASE, seed, ignore_constraints)
    outcomes = _evaluate(study, ledger, [space.complete(x) for x in design.points], workers, progress)
    responses = table_of(outcomes, study.problem.sensitivity_responses)
    table = morris_effects(design, responses) if method == "morris" else sobol_shares(design, responses)
    analysis = f"sensitivity --method {method}"
    begin_analysis(results, analysis)
    results.write_table(method, table)
    options = ["--ignore-constraints"] * ignore_constraints
    answer = Screening(method, table, len(design.points), design.note)
    write_record(study, results, analysis, {"points": seed}, answer.sentences, quick, options, answer.answer)
    return answer


# -- evaluations -------------------------------------------------------------------------------------------------------


def _evaluate(
    study: Study,
    ledger: Ledger,
    points: Sequence[Mapping[str, float]],
    workers: Workers,
    progress: Progress,
) -> list[Outcome]:
    outcomes: list[Outcome] = []
    seconds = confirmed(study, ledger)
    with open_evaluator(recorded(study, ledger), workers, len(points), seconds=seconds) as evaluator:
        for start in range(0, len(points), _BATCH):
            batch = points[start : start + _BATCH]
            told = partial(_tell, progress, len(outcomes), len(points))
            outcomes += ledger.evaluate(study.problem.fingerprint, batch, evaluator, told)
            progress("sampling", len(outcomes), len(points))
    if all(o.status != "ok" for o in outcomes):
        raise InputError(
            reasons_sentence(study.sensitivity_space, reasons(outcomes), len(outcomes)),
            place=study.file,
            remedy="check the model over the limits of its parameters",
        )
    return outcomes


def _tell(progress: Progress, before: int, total: int, batch: int) -> None:
    progress("sampling", before + batch, total)


def table_of(outcomes: Sequence[Outcome], names: Sequence[str]) -> pd.DataFrame:
    """Named responses, one row per point, NaN where there is none."""
    rows = [[o.responses.get(name, np.nan) for name in names] for o in outcomes]
    return pd.DataFrame(rows, columns=list(names)).astype(float)
