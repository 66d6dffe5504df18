"""Steps of a study in a folder: each runs one analysis with the study's ledger and folder, and tells its listener."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Unpack

from calib.analyses.provenance import places
from calib.errors.arguments import integer

if TYPE_CHECKING:
    from calib.analyses.again import Repeated
    from calib.analyses.calibrate import Method
    from calib.analyses.calibration import Fitted
    from calib.analyses.compare import ComparisonResult
    from calib.analyses.designs import Designs
    from calib.analyses.intervals import Intervals
    from calib.analyses.pareto import Pareto
    from calib.analyses.propose import ProposalResult
    from calib.analyses.refine import Refined
    from calib.analyses.robustness import Robustness
    from calib.analyses.screening import Screening
    from calib.analyses.sensitivity import Sensitivity
    from calib.api.arguments import ParetoKeys, RobustnessKeys
    from calib.api.problem import Problem
    from calib.execution.stage import Progress
    from calib.missing.explanation import Explanation
    from calib.missing.findings import ExplanationResult
    from calib.results.ledger import Ledger
    from calib.results.results import Results
    from calib.study.several import AnyStudy
    from calib.study.study import LoadedStudy


@contextmanager
def opened_ledger(study: Any, loaded: AnyStudy) -> Iterator[Ledger]:
    """The ledger of a study; how many of its rows are damaged is told when it is closed."""
    with places.ledger_of(loaded, study.results) as ledger:
        try:
            yield ledger
        finally:
            study.listener.damaged(ledger.damaged)


def compare_step(study: Any, undamped: bool = False) -> ComparisonResult:
    """The model of the only test against its measurement, at the nominal values; ``study`` is a `calib.Study`."""
    from calib.analyses.compare import compare
    from calib.analyses.provenance.stored import with_stored_modes

    loaded = study.one
    study.listener.begins(loaded, "compare")
    with study.listener.progress() as step:
        step("solving the model")
        with with_stored_modes(loaded, lambda: opened_ledger(study, loaded)) as stored:
            answer = compare(stored.studies[0], study.folder, undamped)
    study.listener.compared(loaded, answer, study.folder, undamped)
    return answer


def sensitivity_step(
    study: Any, method: Literal["ranks", "morris", "sobol"] = "ranks", ignore_constraints: bool = False,
    drawn: bool = False,
) -> Sensitivity | Screening:  # fmt: skip
    """Of the only test rank correlations over a Latin hypercube, or indices of Morris or Sobol.

    ``drawn``: whether its metamodels are to be drawn.
    """
    from calib.api.sensitivity import require_suited

    require_suited(method, ignore_constraints, drawn)
    if method != "ranks":
        return _screen(study, method, ignore_constraints)
    from calib.analyses.reduction import fingerprints
    from calib.analyses.runs_ahead import runs_ahead
    from calib.analyses.sensitivity import sensitivity

    loaded, root = study.one, study.results
    study.listener.begins(loaded, "sensitivity")
    with opened_ledger(study, loaded) as ledger, study.listener.progress() as step:
        study.listener.will_run(runs_ahead(loaded, ledger, "sensitivity", study.workers, study.quick))
        study.listener.other_state(ledger.other_fingerprints(*fingerprints(loaded, places.results_of(loaded, root))))
        answer = sensitivity(loaded, study.folder, ledger, study.workers, study.quick, step)
    study.listener.sampled(loaded, answer, study.folder)
    return answer


def _screen(study: Any, method: Literal["morris", "sobol"], ignore_constraints: bool) -> Screening:
    from calib.analyses.screening import screen

    loaded, workers, quick = study.one, study.workers, study.quick
    study.listener.begins(loaded, f"sensitivity, {method.capitalize()}")
    with opened_ledger(study, loaded) as ledger, study.listener.progress() as step:
        answer = screen(loaded, study.folder, ledger, method, workers, quick, ignore_constraints, step)
    study.listener.sampled(loaded, answer, study.folder)
    return answer


def refine_step(study: Any, runs: int, seed: int) -> Refined:
    """New runs of the only test where they help the question most."""
    from calib.analyses.refine import refine
    from calib.analyses.runs_ahead import runs_ahead

    loaded = study.one
    study.listener.begins(loaded, "refine")
    with opened_ledger(study, loaded) as ledger, study.listener.progress() as step:
        study.listener.will_run(runs_ahead(loaded, ledger, "sensitivity", study.workers, study.quick))
        found = refine(loaded, study.folder, ledger, runs, seed, study.workers, study.quick, step)
    study.listener.refined(found, study.folder)
    return found


def calibrate_step(study: Any, case: str | None = None, method: Method | None = None) -> Fitted:
    """The fit of all tests together, of the parameters that the sensitivity analysis selected where that is asked."""
    from calib.analyses.calibrate import calibrate, chosen_cases
    from calib.analyses.reduction import fingerprints
    from calib.analyses.runs_ahead import runs_ahead

    root, quick = study.results, study.quick
    chosen_cases(study.loaded, case)
    loaded = _selecting(study)
    study.listener.begins(loaded, "calibrate")
    folder = places.results_of(loaded, root, quick, case, method)
    homes = {one.test: places.results_of(one, root) for one in loaded.studies}
    with (
        opened_ledger(study, loaded) as ledger,
        study.listener.progress() as step,
        places.tasks_shared(study.workers),
    ):
        study.listener.will_run(runs_ahead(loaded, ledger, "calibrate", study.workers, quick))
        known = [mark for one in loaded.studies for mark in fingerprints(one, homes[one.test])]
        study.listener.other_state(ledger.other_fingerprints(*known))
        folders = {one.test: places.results_of(one, root, quick, case, method) for one in loaded.studies}
        found: Fitted = calibrate(loaded, folder, ledger, study.workers, case, quick, method, step, folders, homes)
    study.listener.calibrated(loaded, found, folder)
    return found


def _selecting(study: Any) -> AnyStudy:
    """The study with those parameters free that its sensitivity analysis selected, where that is asked."""
    from calib.analyses.sensitivity import selected_by_measures

    chosen = [selected_by_measures(one.one, one.folder) for one in study.tests]
    selected = tuple(dict.fromkeys(name for one in chosen for name in one.search_space.free_names))
    by_measures = study.loaded.settings.selected_by_sensitivity
    loaded: AnyStudy = study.loaded
    return loaded.each(lambda one: one.selecting(selected)) if by_measures else loaded


@contextmanager
def _about_calibration(study: Any, verb: str) -> Iterator[tuple[AnyStudy, dict[str, Results], Ledger, Progress]]:
    """What an analysis about the stored calibration needs: the study, the folder of each test, ledger and progress."""
    loaded = _selecting(study)
    study.listener.begins(loaded, verb)
    homes = {one.test: places.results_of(one, study.results) for one in loaded.studies}
    with (
        opened_ledger(study, loaded) as ledger,
        study.listener.progress() as step,
        places.tasks_shared(study.workers),
    ):
        yield loaded, homes, ledger, step


def intervals_step(study: Any, parameters: tuple[str, ...], samples: int, seed: int) -> Intervals:
    """Intervals of the parameters about the stored calibration."""
    from calib.analyses.intervals import IntervalsRun, intervals

    with _about_calibration(study, "intervals") as (loaded, homes, ledger, step):
        run = IntervalsRun(ledger, homes, study.workers, parameters, samples, seed, step)
        found = intervals(loaded, study.folder, run, study.quick)
    study.listener.bounded(found, study.folder)
    return found


def robustness_step(study: Any, **keys: Unpack[RobustnessKeys]) -> Robustness:
    """Responses over the posterior of the parameters, about the stored calibration."""
    from calib.analyses.robustness import RobustnessRun, posterior_samples, robustness
    from calib.api.arguments import robustness_settings

    with _about_calibration(study, "robustness") as (loaded, homes, ledger, step):
        settings = robustness_settings(loaded.settings, keys).robustness
        run = RobustnessRun(ledger, settings, posterior_samples(study.folder), homes, study.workers, step)
        found = robustness(loaded, study.folder, run, study.quick)
    study.listener.pushed(found, study.folder)
    return found


def pareto_step(study: Any, **keys: Unpack[ParetoKeys]) -> Pareto:
    """The front of two groups of responses, beside the stored calibration."""
    from calib.analyses.pareto import ParetoRun, pareto
    from calib.analyses.runs_ahead import runs_ahead
    from calib.api.arguments import pareto_settings

    with _about_calibration(study, "pareto") as (loaded, homes, ledger, step):
        settings = pareto_settings(loaded.settings, keys).pareto
        study.listener.will_run(runs_ahead(loaded, ledger, "pareto", study.workers, study.quick, settings))
        found = pareto(loaded, study.folder, ParetoRun(ledger, settings, homes, study.workers, study.quick, step))
    study.listener.weighed(found, study.folder)
    return found


def repeat_step(study: Any) -> Repeated:
    """Failed points of the study, evaluated once more."""
    from calib.analyses.again import again

    study.listener.begins(study.loaded, "again")
    with opened_ledger(study, study.loaded) as ledger, study.listener.progress() as step:
        found = again(study.loaded, ledger, study.workers, step)
    study.listener.repeated(study.loaded, found)
    return found


def decks_step(study: Any, into: Path) -> tuple[Path, ...]:
    """Decks of the study's solver with the values of its calibration."""
    from calib.analyses.decks import write_decks

    return write_decks(_selecting(study), study.folder, into)


def designs_step(study: Any) -> Designs:
    """Every evaluated point of the study as it is."""
    from calib.analyses.designs import designs

    loaded = _selecting(study)
    study.listener.begins(loaded, "designs")
    with opened_ledger(study, loaded) as ledger:
        return designs(loaded, ledger, study.folder)


def fit_step(study: Any) -> Fitted:
    """The same, after a sensitivity analysis where the study leaves the selection to it."""
    if study.loaded.settings.selected_by_sensitivity:
        for one in study.tests:
            sensitivity_step(one)
    return calibrate_step(study)


def explain_step(study: Any) -> ExplanationResult:
    """Which effect of the study's library the model lacks, by all tests together."""
    from calib.analyses.explain import explain
    from calib.analyses.provenance.stored import with_stored_modes
    from calib.analyses.runs_ahead import runs_ahead

    loaded, root = study.loaded, study.results
    study.listener.begins(loaded, "explain")
    if loaded.settings.solver is not None:
        with opened_ledger(study, loaded) as ledger:
            study.listener.will_run(runs_ahead(loaded, ledger, "explain", study.workers))
    with (
        study.listener.progress() as step,
        places.tasks_shared(study.workers),
        with_stored_modes(loaded, lambda: opened_ledger(study, loaded), study.workers) as stored,
    ):
        homes = {one.test: places.results_of(one, root) for one in loaded.studies}
        answer = explain(stored, study.folder, step, homes, {one.one.test: one.folder for one in study.tests})
    study.listener.explained(loaded, answer, study.folder)
    return answer


def propose_step(study: Any, rank: int | None) -> ProposalResult:
    """Effects that nobody listed, composed after an explanation; the best ``rank`` are written as a study."""
    from calib.analyses import propose as proposal
    from calib.analyses.provenance.stored import with_stored_modes

    wanted = proposal.RANKED if rank is None else integer(rank, 1, "rank")
    loaded, root = study.loaded, study.results
    study.listener.begins(loaded, "propose")
    with (
        study.listener.progress() as step,
        with_stored_modes(loaded, lambda: opened_ledger(study, loaded)) as stored,
    ):
        homes = {one.test: places.results_of(one, root) for one in loaded.studies}
        found = proposal.propose(stored, study.folder, wanted, step, homes)
    study.listener.proposed(loaded, found, study.folder, root)
    return found


def with_named(study: Any, before: Fitted, found: Explanation) -> Any:
    """The study extended by the named effects, calibrated and compared with it before; None when none is named.

    Parameters
    ----------
    study : Study
    before : Fitted
    found : Explanation
    """
    from calib.analyses import added
    from calib.analyses import extend as extension
    from calib.analyses.versions import write_versions

    loaded, named = study.loaded, added.to_add(found)
    if named is None:
        study.listener.nothing_added(added.nothing_added(found))
        for one in study.tests:
            added.write_nothing_added(one.one, found, one.folder, study.quick)
        return None
    study.listener.begins(loaded, "extend")
    free = {*loaded.search_space.free_names, *(name for e in named.effects for name in e.names)}
    free &= set(named.fit.fit_problem.space.free_names)
    begin_at = {name: value for name, value in named.fit.values.items() if name in free}
    written = extension.extend_among(loaded, named.names, study.folder.path, begin_at)
    study.listener.extended(written)
    extended = replace(study, path=written.file, read=None)
    after = fit_step(extended)
    study.listener.begins(loaded, "before and after")
    for own, other in zip(study.tests, extended.tests, strict=True):
        test = own.one.test
        was, now = before.seen(test), after.seen(test)
        answer = added.write_added(own.one, was, named, other.one, now, own.folder, study.quick)
        if not study.quick:
            write_versions(other.one, study.results)
        study.listener.added(answer, written, other.folder)
    return extended


def in_memory(study: LoadedStudy) -> Problem:
    """One test of a study as a problem in memory; parameters of its nuisances belong to the test."""
    from calib.api.problem import Problem

    space, settings = study.search_space, study.settings
    if file := settings.calibration.start_file:
        own_path = {"start_population": str(study.file.resolve().parent / file)}
        settings = settings.model_copy(update={"calibration": settings.calibration.model_copy(update=own_path)})
    own = {name: value for name, value in space.values.items() if name not in study.model.space}
    model = replace(study.model, space=space.without(own))
    finer = study.on_finer_mesh()
    return Problem(
        model, study.experiment, unselected=study.unselected, settings=settings, base=study.base,
        held_sd=study.held_sd, finer={} if finer is None else {model.name: finer},
    )  # fmt: skip
