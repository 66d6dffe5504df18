"""The questions a study is asked, one function each: tables out, nothing drawn and nothing printed."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeAlias

import numpy as np
import pandas as pd

from calib.correlation.compare import Comparison
from calib.correlation.problem import FunctionProblem, ModalProblem
from calib.errors import EvaluationError, InputError
from calib.evaluate import Evaluator
from calib.ledger import Ledger
from calib.measurement.check import SensorFinding, check_sensors
from calib.results import Results
from calib.sensitivity.sampling import sample
from calib.sensitivity.spearman import noise_floor, spearman
from calib.study import EvaluationSource, Study
from calib.updating.cases import Case, CaseResult, agreement, convergence_table, parameters_table, run_case
from calib.updating.genetic import GeneticSettings
from calib.updating.objective import FrequencyMacObjective, ResponseObjective

QUICK = "quick"
"""Sub-folder of results made with ``--quick``."""

QUICK_SAMPLES, QUICK_POPULATION, QUICK_GENERATIONS = 60, 20, 15

LEDGER = "ledger.sqlite"

Objective: TypeAlias = FrequencyMacObjective | ResponseObjective


@dataclass(frozen=True)
class Answer:
    """Model against measurement at one point.

    Attributes
    ----------
    table : DataFrame
        ``comparison_*.csv``.
    mean_freq_error : float
        Mean absolute frequency error over the paired modes (of a plain-response study: mean absolute relative error).
    mean_mac : float
        Over the paired modes; NaN without shapes.
    noise_mac : float
        Mean MAC that noise alone would allow a perfect model; NaN where unknown.
    comparison : Comparison or None
        None for plain responses.
    findings : tuple of SensorFinding
        Suspicious sensors.
    """

    table: pd.DataFrame
    mean_freq_error: float
    mean_mac: float
    noise_mac: float
    comparison: Comparison | None
    findings: tuple[SensorFinding, ...] = ()


# -- compare -----------------------------------------------------------------------------------------------------------


def answer_at(study: Study, values: Mapping[str, float]) -> Answer:
    """Compare model and measurement at named values; raises EvaluationError when the model cannot be solved there."""
    if isinstance(study.problem, FunctionProblem):
        return _plain_answer(study.problem, values)
    comparison = study.problem.compare(values)
    table = comparison.comparison_table()
    paired = comparison.pairing.paired
    findings: tuple[SensorFinding, ...] = ()
    if comparison.measured.has_shapes:
        model_shapes = comparison.sensor_shapes[:, comparison.pairing.model_index[paired]]
        names = [s.name for s in comparison.measured.sensors]
        findings = check_sensors(comparison.measured.shapes[:, paired], model_shapes, names)
    return Answer(
        table=table,
        mean_freq_error=_mean(table["freq_error"].abs()),
        mean_mac=_mean(table["mac"]),
        noise_mac=_mean(pd.Series(comparison.noise_mac())),
        comparison=comparison,
        findings=findings,
    )


def _plain_answer(problem: FunctionProblem, values: Mapping[str, float]) -> Answer:
    responses = problem.evaluate(values)
    rows = []
    for name, (value, std) in problem.targets.items():
        error = (responses[name] - value) / abs(value) if value else np.nan
        rows.append(
            {
                "response": name,
                "measured": value,
                "model": responses[name],
                "error": error,
                "error_in_std": (responses[name] - value) / std if std else np.nan,
            }
        )
    table = pd.DataFrame(rows)
    return Answer(table, _mean(table["error"].abs()), np.nan, np.nan, None)


def compare(study: Study, results: Results) -> Answer:
    """Model at its adopted values against the measurement, nothing fitted; writes the ``*_before`` tables."""
    try:
        answer = answer_at(study, study.model.space.values)
    except EvaluationError as fault:
        raise InputError(
            f"the model cannot be evaluated at its adopted values: {fault}",
            place=study.file,
            remedy="check parameter values, supports and mode_count",
        ) from None
    write_answer(results, answer, "before")
    assumptions = pd.DataFrame(
        [(a.item, a.value, a.unit, a.reason) for a in study.model.assumptions]
        + [(p.name, f"{p.value:g}", p.unit, p.assumed) for p in study.model.space.parameters if p.assumed],
        columns=["item", "value", "unit", "reason"],
    )
    results.write_table("assumptions", assumptions)
    results.write_table("parameter_space", study.model.space.frame())
    findings = [(f.kind, " ".join(f.sensors), f.mac_before, f.mac_after, f.sentence) for f in answer.findings]
    columns = ["kind", "sensors", "mac_before", "mac_after", "sentence"]
    results.write_table("sensor_check", pd.DataFrame(findings, columns=columns))
    return answer


def write_answer(results: Results, answer: Answer, stage: str) -> None:
    """Write every table of one comparison, named ``*_before`` or ``*_after``."""
    results.write_table(f"comparison_{stage}", answer.table)
    if answer.comparison is None:
        return
    results.write_table(f"where_it_fails_{stage}", answer.comparison.where_it_fails())
    results.write_table(f"deflection_{stage}", answer.comparison.deflection_table())
    if answer.comparison.measured.has_shapes:
        results.write_table(f"mac_{stage}", answer.comparison.mac_table())
        results.write_table(f"comac_{stage}", answer.comparison.comac_table())
        results.write_table(f"shapes_{stage}", answer.comparison.shapes_table())


def _mean(values: pd.Series) -> float:
    return float(values.mean()) if values.notna().any() else float("nan")


# -- sensitivity -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Sensitivity:
    """Rank correlations and what is behind them.

    Attributes
    ----------
    table : DataFrame (n_parameters, n_responses)
    samples : int
        Accepted points.
    failed : int
        Points the model could not be evaluated at.
    unpaired : int
        Points at which some measured mode found no partner.
    acceptance : float
        Part of the drawn points that kept the constraints.
    noise_floor : float
        Largest correlation that chance alone would give in the whole table, 95 %.
    """

    table: pd.DataFrame
    samples: int
    failed: int
    unpaired: int
    acceptance: float
    noise_floor: float


def sensitivity(
    study: Study,
    results: Results,
    ledger: Ledger,
    workers: int | None = None,
    quick: bool = False,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Sensitivity:
    """Latin hypercube over all free parameters and Spearman's rank correlation with every frequency and MAC."""
    settings = study.settings.sensitivity
    space = study.sensitivity_space
    count = min(settings.samples, QUICK_SAMPLES) if quick else settings.samples
    drawn = sample(space, count, settings.seed)
    points = [space.complete(x) for x in drawn.points]
    outcomes = []
    with open_evaluator(study, workers, count) as evaluator:
        for start in range(0, count, 50):
            outcomes += ledger.evaluate(study.problem.fingerprint, points[start : start + 50], evaluator)
            progress(len(outcomes), count)
    names = _sensitivity_responses(study)
    x = pd.DataFrame(drawn.points, columns=list(space.free_names))
    y = pd.DataFrame([{n: o.responses.get(n, np.nan) for n in names} for o in outcomes], columns=names)
    y = y.astype(float)
    failed = sum(o.status != "ok" for o in outcomes)
    unpaired = int(y.isna().any(axis=1).sum()) - failed
    if failed == count:
        raise InputError(f"all {count} samples failed: {outcomes[0].error}", place=study.file)
    table = spearman(x, y)
    complete = int((~y.isna().any(axis=1)).sum())
    results.write_table("sensitivity", table, index=True)
    results.write_table("sensitivity_samples", pd.concat([x, y], axis=1))
    floor = noise_floor(max(complete, 3), max(int(table.notna().sum().sum()), 1))
    return Sensitivity(table, count, failed, unpaired, drawn.acceptance, floor)


def _sensitivity_responses(study: Study) -> list[str]:
    if isinstance(study.problem, FunctionProblem):
        return list(study.problem.targets)
    kinds = ("natural_freq", "mac") if study.problem.measured.has_shapes else ("natural_freq",)
    return [f"{kind}_{mode}" for kind in kinds for mode in study.problem.measured.names]


# -- calibrate ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Calibration:
    """What a calibration found.

    Attributes
    ----------
    cases : tuple of CaseResult
    best : CaseResult
        Of the lowest misfit.
    before, after : Answer
        At the adopted values and at the best case's.
    parameters : DataFrame
        ``parameters.csv``.
    agreement : str
        Whether the cases agree on one solution, in a sentence.
    """

    cases: tuple[CaseResult, ...]
    best: CaseResult
    before: Answer
    after: Answer
    parameters: pd.DataFrame
    agreement: str


def objective_of(study: Study) -> Objective:
    """What the search makes small."""
    settings = study.settings.calibration
    if isinstance(study.problem, FunctionProblem):
        return ResponseObjective({name: value for name, (value, _) in study.problem.targets.items()})
    measured = study.problem.measured
    return FrequencyMacObjective(
        modes=measured.names,
        natural_freq=dict(zip(measured.names, measured.natural_freq.tolist(), strict=True)),
        weight_freq=settings.weight_freq,
        weight_mac=settings.weight_mac,
        use_mac=measured.has_shapes,
    )


def genetic_settings(study: Study, quick: bool) -> GeneticSettings:
    """Settings of the genetic algorithm, smaller for a quick look."""
    given = study.settings.calibration
    return GeneticSettings(
        population=min(given.population, QUICK_POPULATION) if quick else given.population,
        generations=min(given.generations, QUICK_GENERATIONS) if quick else given.generations,
        crossover=given.crossover,
        mutation=given.mutation,
        sigma_start=given.sigma_start,
        sigma_end=given.sigma_end,
    )


def chosen_cases(study: Study, only: str | None) -> tuple[Case, ...]:
    """All cases of the study, or the one named; InputError for an unknown name."""
    cases = tuple(Case(c.name, c.seed) for c in study.settings.calibration.cases)
    if only is None:
        return cases
    for case in cases:
        if case.name == only:
            return (case,)
    raise InputError(
        f"there is no case {only!r}", place=study.file, remedy=f"the cases are {', '.join(c.name for c in cases)}"
    )


def calibrate(
    study: Study,
    results: Results,
    ledger: Ledger,
    workers: int | None = None,
    only: str | None = None,
    quick: bool = False,
    progress: Callable[[str, int, int, float], None] = lambda case, generation, generations, best: None,
) -> Calibration:
    """Search every case, compare before and after, write all tables and ``summary.json``."""
    started = time.perf_counter()
    settings, objective, space = genetic_settings(study, quick), objective_of(study), study.search_space
    cases = chosen_cases(study, only)
    before = compare(study, results)
    found = []
    with open_evaluator(study, workers, settings.population * settings.generations) as evaluator:
        for case in cases:
            initial = sample(space, settings.population, case.seed).points
            try:
                result = run_case(
                    case, space, objective, settings, evaluator, ledger, study.problem.fingerprint, initial,
                    progress=partial(progress, case.name),
                )  # fmt: skip
            except EvaluationError as fault:
                raise InputError(
                    str(fault), place=study.file, remedy="check the model over the search limits"
                ) from None
            found.append(result)
    best = min(found, key=lambda r: r.misfit)
    after = answer_at(study, best.values)
    parameters = parameters_table(found, space)
    verdict = agreement(found, space, expected_misfit(study, before))
    write_answer(results, after, "after")
    results.write_table("parameters", parameters)
    results.write_table("convergence", convergence_table(found))
    seconds = time.perf_counter() - started
    results.write_json("summary", _summary(study, found, best, before, after, seconds))
    return Calibration(tuple(found), best, before, after, parameters, verdict.sentence)


def expected_misfit(study: Study, answer: Answer) -> float:
    """Misfit that a perfect model would show on average from the measurement's scatter alone; 0 where unknown."""
    settings = study.settings.calibration
    if isinstance(study.problem, FunctionProblem):
        return float(sum((std or 0.0) / abs(value) for value, std in study.problem.targets.values()) * _MEAN_ABSOLUTE)
    measured = study.problem.measured
    relative = np.nan_to_num(measured.freq_std / measured.natural_freq)
    total = settings.weight_freq * _MEAN_ABSOLUTE * float(relative.sum())
    if measured.has_shapes and answer.comparison is not None:
        total += settings.weight_mac * float(np.nansum(1.0 - answer.comparison.noise_mac()))
    return total


_MEAN_ABSOLUTE = float(np.sqrt(2 / np.pi))
"""Mean absolute value of a standard normal variate."""


def open_evaluator(study: Study, workers: int | None, count: int) -> Evaluator:
    """An evaluator for a study; workers are only started when they can pay for their start."""
    chosen = workers
    if chosen is None:
        started = time.perf_counter()
        try:
            study.problem.evaluate(study.model.space.values)
        except EvaluationError:
            pass
        worthwhile = (time.perf_counter() - started) * count > _WORTHWHILE
        chosen = available_cores() if worthwhile else 1
    source = EvaluationSource(str(study.file.resolve()), study.problem.fingerprint)
    return Evaluator(source, chosen)


_WORTHWHILE = 20.0
"""Seconds of work from which on a process pool is started."""


def available_cores() -> int:
    """Processor cores this process may use."""
    import os

    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)


def _summary(
    study: Study,
    cases: Sequence[CaseResult],
    best: CaseResult,
    before: Answer,
    after: Answer,
    seconds: float,
) -> dict[str, object]:
    def figures(result: CaseResult, answer: Answer) -> dict[str, object]:
        return {
            "misfit": result.misfit,
            "mean_freq_error_before": before.mean_freq_error,
            "mean_freq_error_after": answer.mean_freq_error,
            "mean_mac_before": before.mean_mac,
            "mean_mac_after": answer.mean_mac,
            "evaluations": result.asked,
            "solved": result.solved,
            "reused": result.reused,
            "infeasible": result.infeasible,
            "failed": result.failed,
            "seconds": result.seconds,
        }

    counts = {
        key: sum(getattr(r, name) for r in cases)
        for key, name in (
            ("evaluations", "asked"),
            ("solved", "solved"),
            ("reused", "reused"),
            ("infeasible", "infeasible"),
            ("failed", "failed"),
        )
    }
    return {
        "study": study.name,
        "synthetic": study.synthetic,
        "best_case": best.name,
        "mean_freq_error_before": before.mean_freq_error,
        "mean_freq_error_after": after.mean_freq_error,
        "mean_mac_before": before.mean_mac,
        "mean_mac_after": after.mean_mac,
        "noise_mac": after.noise_mac,
        **counts,
        "seconds": seconds,
        "withheld_modes": list(study.settings.withheld.modes),
        "withheld_sensors": list(study.settings.withheld.sensors),
        "cases": {r.name: figures(r, after if r is best else answer_at(study, r.values)) for r in cases},
    }


# -- places ------------------------------------------------------------------------------------------------------------


def results_of(study: Study, root: Path, quick: bool = False, only: str | None = None) -> Results:
    """Where the answers go: a whole run's folder, or a sub-folder for a quick look or a single case."""
    part = "-".join(([QUICK] if quick else []) + ([f"case_{only}"] if only else []))
    return Results.at(root, study.name, part)


def ledger_of(study: Study, root: Path) -> Ledger:
    """The one ledger of a study, shared by whole, quick and single-case runs."""
    return Ledger.open(Results.at(root, study.name).path / LEDGER)


def stale_rows(study: Study, ledger: Ledger) -> int:
    """Rows of the ledger that belong to another state of model or measurement and are ignored."""
    return ledger.other_fingerprints(study.problem.fingerprint)


def is_modal(study: Study) -> bool:
    """Whether the study compares modes."""
    return isinstance(study.problem, ModalProblem)
