"""Sensitivity analysis: rank correlations, variance shares, the selection of parameters, and metamodels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from calib.analyses.answers import of_sensitivity
from calib.analyses.failures import reasons, reasons_sentence
from calib.analyses.joint_responses import Responses
from calib.analyses.provenance.places import QUICK_SAMPLES, Workers, is_quick, open_evaluator
from calib.analyses.provenance.record import analyses_of, begin_analysis, write_record
from calib.analyses.provenance.recorded import recorded
from calib.analyses.provenance.state import made_from, state_differences
from calib.analyses.provenance.stored import confirmed
from calib.errors.errors import EvaluationError, InputError
from calib.execution.evaluate import BatchEvaluator
from calib.execution.outcome import Outcome
from calib.execution.stage import Progress, silent
from calib.problem.prior import Correlated
from calib.problem.sampling import Sample, sample, wide_sentence
from calib.problem.space import ParameterSpace
from calib.results.answer import Answer
from calib.results.ledger import Ledger
from calib.results.results import Results
from calib.results.written import is_own, require_unchanged
from calib.sensitivity.prognosis import Prognosis, prognosis
from calib.sensitivity.selection import Assessment, assess, selected_in
from calib.sensitivity.spearman import noise_floor
from calib.structure.function_model import FunctionModel
from calib.study.runs import Runs
from calib.study.several import AnyStudy
from calib.study.study import LoadedStudy
from calib.study.study_file import shell_argument

_BATCH = 50
"""Points evaluated and added to the ledger in one batch."""


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
    wide : str
        See `calib.problem.sampling.wide_sentence`.
    prognosis : Prognosis
        Metamodels of the responses, and how well they predict.
    """

    assessment: Assessment
    samples: int
    failed: int
    unpaired: int
    acceptance: float
    noise_floor: float
    sampled: pd.DataFrame
    why_failed: str = ""
    wide: str = ""
    prognosis: Prognosis = field(default_factory=lambda: Prognosis(()))

    @property
    def table(self) -> pd.DataFrame:
        """``selection.csv``."""
        return self.assessment.selection

    @property
    def answer(self) -> Answer:
        """What was found, how sure that is, and what to do next."""
        answer = of_sensitivity(self.assessment.selection, self.sentences[0])
        return replace(answer, then=self.wide) if self.wide else answer

    @property
    def sentences(self) -> tuple[str, ...]:
        """Number of samples, reasons of failure, and the selection."""
        samples = f"{self.samples} sample{'s' * (self.samples != 1)}"
        if self.acceptance < 1.0:
            samples += f" satisfied the constraints (acceptance {100 * self.acceptance:.0f} %)"
        unpaired = f", {self.unpaired} left a mode unpaired" if self.unpaired else ""
        return (
            f"{samples}, {self.failed} failed{unpaired}. "
            f"Chance alone gives rank correlations up to {self.noise_floor:.2f}.",
            *filter(None, [self.wide, self.why_failed]),
            self.assessment.sentence,
            *self.prognosis.sentences,
        )


def sensitivity(
    study: LoadedStudy,
    results: Results,
    ledger: Ledger,
    workers: Workers = None,
    quick: bool = False,
    progress: Progress = silent,
) -> Sensitivity:
    """Assess a study's parameters and write all tables; see `sampled`."""
    answer = sampled(study, ledger, workers, quick, progress)
    assessment = answer.assessment
    begin_analysis(results, "sensitivity")
    results.write_table("sensitivity", assessment.spearman, index=True)
    results.write_table("partial", assessment.partial, index=True)
    results.write_table("variance_share", assessment.variance_share.table, index=True)
    results.write_table("selection", assessment.selection)
    results.write_table("prognosis", answer.prognosis.table)
    results.write_table("prognosis_inputs", answer.prognosis.inputs)
    results.write_table("sensitivity_samples", answer.sampled)
    if study.sensitivity_space.constraints or Correlated.of(study.sensitivity_space.free).names:
        results.write_table("input_correlation", assessment.input_correlation, index=True)
    seeds = {"samples": study.settings.sensitivity.seed}
    write_record(study, results, "sensitivity", seeds, answer.sentences, quick, answer=answer.answer)
    return answer


def sampled(
    study: AnyStudy, ledger: Ledger, workers: Workers = None, quick: bool = False, progress: Progress = silent
) -> Sensitivity:
    """Sample all free parameters by a constrained Latin hypercube; rank correlations, variance shares, selection."""
    settings, space, names = study.settings.sensitivity, varied(study), Responses.of(study).measured
    count = min(settings.samples, QUICK_SAMPLES) if quick else settings.samples
    points = sample(space, count, settings.seed)
    outcomes = evaluated(study, ledger, [space.complete(x) for x in points.points], workers, progress)
    if imported := points_of_runs(study):  # for the list of designs
        evaluated(study, ledger, imported, workers, silent)
    return measured(
        space, points, outcomes, names, study.settings.listed, _of_runs(study, names), wide_sentence_of(study, space)
    )


def runs_of(study: AnyStudy) -> Runs | None:
    """The table of runs that is a study's model; None where its model computes."""
    models = [one.model for one in study.studies]
    runs = models[0].metamodels if len(models) == 1 and isinstance(models[0], FunctionModel) else None
    return runs if isinstance(runs, Runs) else None


def response_units(study: AnyStudy, names: Sequence[str]) -> dict[str, str]:
    """Units of responses, where they are known: of frequencies, of a table of runs, and as measured."""
    frequencies, runs = ("natural_freq_", "damped_freq_"), runs_of(study)
    out = {name: "Hz" for name in names if name.rpartition(": ")[2].startswith(frequencies)}
    out |= {} if runs is None else {name: unit for name, unit in runs.units.items() if name in names}
    for one in study.studies:
        stated = one.experiment.table()
        if {"response", "unit"} <= set(stated.columns):
            out |= {str(name): str(unit) for name, unit in zip(stated["response"], stated["unit"], strict=True) if unit}
    return out


def points_of_runs(study: AnyStudy) -> list[dict[str, float]]:
    """The runs of a table within the limits of the searches, as designs; none where not all inputs vary."""
    runs, space = runs_of(study), study.search_space
    if runs is None or set(space.free_names) != set(runs.points):
        return []
    x = runs.points[list(space.free_names)].to_numpy(dtype=float)
    return [space.complete(one) for one in x[space.feasible(x)]]


def wide_sentence_of(study: AnyStudy, space: ParameterSpace) -> str:
    """See `calib.problem.sampling.wide_sentence`."""
    runs = runs_of(study)
    return wide_sentence(space, None if runs is None else runs.points)


def _of_runs(study: AnyStudy, names: Sequence[str]) -> Prognosis | None:
    """The metamodels behind a study's responses, where its model is a table of runs; None where it computes."""
    if (runs := runs_of(study)) is None:
        return None
    return Prognosis(tuple(one for one in runs.prognosis.models if one.response in names), runs.prognosis.untried)


def varied(study: AnyStudy) -> ParameterSpace:
    """The parameters that are varied."""
    return study.search_space if len(study.studies) > 1 else study.studies[0].sensitivity_space


def measured(
    space: ParameterSpace,
    drawn: Sample,
    outcomes: Sequence[Outcome],
    names: Sequence[str],
    forced: Sequence[str] | None = None,
    metamodels: Prognosis | None = None,
    wide: str | None = None,
) -> Sensitivity:
    """Sensitivity measures of a sample; see `Sensitivity` and `calib.sensitivity.selection.assess`.

    Parameters
    ----------
    space : ParameterSpace
    drawn : Sample
    outcomes : sequence of Outcome
        Of the sampled points.
    names : sequence of str
        Responses to assess.
    forced : sequence of str, optional
        Parameters that the user selected.
    metamodels : Prognosis, optional
        Those that gave the responses; by default they are built from the sample.
    wide : str, optional
        What is said of wide limits; by default what they say by themselves.
    """
    x = pd.DataFrame(drawn.points, columns=list(space.free_names))
    y = table_of(outcomes, names)
    assessment = assess(x, y, forced)
    known, failed = int((~y.isna().any(axis=1)).sum()), sum(o.status != "ok" for o in outcomes)
    floor = noise_floor(max(known, 3), max(int(assessment.spearman.notna().sum().sum()), 1))
    why = reasons_sentence(space, reasons(outcomes), len(outcomes))
    samples = pd.concat([x, y], axis=1)
    unpaired, wide = len(x) - known - failed, wide_sentence(space) if wide is None else wide
    found = metamodels or prognosis(space, x, y)
    return Sensitivity(assessment, len(x), failed, unpaired, drawn.acceptance, floor, samples, why, wide, found)


def selected_by_measures(study: LoadedStudy, home: Results) -> LoadedStudy:
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


def outdated_selection(study: LoadedStudy, home: Results) -> str:
    """Why a selection by the sensitivity analysis is outdated; empty where it is valid, or made by the user."""
    if not study.settings.selected_by_sensitivity:
        return ""
    entry = analyses_of(home).get("sensitivity")
    if entry is None:  # `begin_analysis` removed it from the record, and the analysis did not end
        return "by an interrupted analysis" if is_own(home.path / "selection.csv") else ""
    found = state_differences(entry.get("made_from", {}), made_from(study, "sensitivity"))
    return f"at an earlier state of {', '.join(found)}" if found else ""


def selecting(study: LoadedStudy, home: Results) -> LoadedStudy:
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
    require_unchanged(path, f"run 'calib sensitivity {shell_argument(study.file)}' again")
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


# -- evaluations -------------------------------------------------------------------------------------------------------


def evaluated(
    study: AnyStudy,
    ledger: Ledger,
    points: Sequence[Mapping[str, float]],
    workers: Workers,
    progress: Progress,
) -> list[Outcome]:
    """Outcomes of points, in their order; an error where none could be evaluated."""
    outcomes: list[Outcome] = []
    responses = Responses.of(study)
    with _evaluator(study, ledger, responses, workers, len(points)) as evaluator:
        for start in range(0, len(points), _BATCH):
            batch = points[start : start + _BATCH]
            step = partial(_report, progress, len(outcomes), len(points))
            outcomes += ledger.evaluate(responses.fingerprint, batch, evaluator, step)
            progress("sampling", len(outcomes), len(points))
    if all(o.status != "ok" for o in outcomes):
        found = reasons(outcomes)
        words = reasons_sentence(varied(study), found, len(outcomes))
        if study.in_memory:
            raise EvaluationError(f"the model cannot be evaluated within its limits: {words}", at=found[0].first.at)
        raise InputError(words, place=study.file, remedy="check the model over the limits of its parameters")
    return outcomes


def _evaluator(
    study: AnyStudy, ledger: Ledger, responses: Responses, workers: Workers, count: int
) -> AbstractContextManager[BatchEvaluator]:
    """Evaluator of a sample: of one test in worker processes where that pays, of several in this one."""
    if len(study.studies) > 1:
        return responses.evaluator(study, workers)
    (one,) = study.studies
    seconds = confirmed(one, ledger)
    return open_evaluator(recorded(one, ledger), workers, count, seconds=seconds)


def _report(progress: Progress, before: int, total: int, batch: int) -> None:
    progress("sampling", before + batch, total)


def table_of(outcomes: Sequence[Outcome], names: Sequence[str]) -> pd.DataFrame:
    """Named responses, one row per point, NaN where there is none."""
    rows = [[o.responses.get(name, np.nan) for name in names] for o in outcomes]
    return pd.DataFrame(rows, columns=list(names)).astype(float)
