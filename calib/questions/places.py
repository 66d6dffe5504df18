"""Where answers go and who computes them: folders, ledger, worker processes."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import TypeAlias

from calib.correlation.problem import ModalProblem
from calib.errors import InputError
from calib.evaluate import BatchEvaluator, Evaluator
from calib.executor import ExecutorEvaluator, Injected
from calib.forward import ForwardProblem
from calib.ledger import Ledger
from calib.questions.isolation import ChildFunction
from calib.questions.recorded import ModesEvaluator, asked_anew, unrecorded
from calib.questions.user_function import function_of
from calib.results import Results
from calib.study import EvaluationSource, Study
from calib.study_file import StudyFile, shell_argument
from calib.written import LOG

QUICK = "quick"
"""Sub-folder of results made with ``--quick``."""

QUICK_SAMPLES, QUICK_POPULATION, QUICK_GENERATIONS = 60, 20, 15
"""Sizes of a first look: enough to see whether a study works and what it would tell, too few to rely on."""

LEDGER = "ledger.sqlite"

Workers: TypeAlias = int | Injected | None
"""Who evaluates points: so many processes of the own pool, None for one a core where that pays, or an executor."""


def results_of(
    study: StudyFile, root: Path, quick: bool = False, only: str | None = None, method: str | None = None
) -> Results:
    """Where the answers go: a whole run's folder, or a sub-folder for a quick look, a single case or another method."""
    other = method if method and method != study.settings.calibration.method else None
    parts = [part for part in (QUICK * quick, f"case_{only}" if only else "", other or "") if part]
    return _opened(study, root, "-".join(parts))


def is_quick(study: StudyFile, results: Results) -> bool:
    """Whether a folder is one for quick looks, as `results_of` names them."""
    return results.path.parent.name == study.name and results.path.name.split("-")[0] == QUICK


def ledger_of(study: StudyFile, root: Path) -> Ledger:
    """The one ledger of a study, shared by whole, quick and single-case runs."""
    home = results_of(study, root)
    home.claim()
    return Ledger.open(home.path / LEDGER)


def answers_of(study: StudyFile, root: Path) -> tuple[Results, ...]:
    """Every folder with answers of a study: a whole run's, then those of quick looks, single cases and methods.

    InputError when they are not that study's, or lie where no results may be.
    """
    home = root / study.name
    inside = sorted(p.parent for p in home.glob(f"*/{LOG}"))  # other folders there are the user's
    answered = [p for p in (home, *inside) if any(p.glob("*.csv"))]
    return tuple(_opened(study, root, "" if p is home else p.name) for p in answered)


def root_for(study_file: Path, root: Path) -> Path:
    """Where results of a study may go: the given place, or one within it that is not the study's own folder."""
    places = (root, root / "answers", *(root / f"answers_{number}" for number in range(2, 100)))
    own = study_file.resolve().parent
    return next((place for place in places if not _same(place / own.name, own)), root)


def _opened(study: StudyFile, root: Path, part: str) -> Results:
    """One folder of a study's results; InputError where these would meet what the study reads, or another's results."""
    home = Results(root / study.name)
    _refuse_inputs(study, root, home.path, part)
    home.check_owner(study.file)
    return Results(Results.at(root, study.name, part).path, (home.path, study.file))


def _refuse_inputs(study: StudyFile, root: Path, home: Path, part: str) -> None:
    own, elsewhere = study.file.resolve().parent, shell_argument(root_for(study.file, root))
    for folder in (home, home / part):
        if _same(folder, own):
            raise InputError(
                "results would be written over the study's own files",
                place=folder,
                remedy=f"choose another place, such as --results {elsewhere}",
            )
    place = home.resolve()
    apart = own.is_relative_to(place)  # a study among the results has a folder of its own
    for file in study.inputs:
        if file.is_relative_to(place) and not (apart and file.is_relative_to(own)):
            raise InputError(
                f"the study reads {file.name} from the folder that its results would go to",
                place=home,
                remedy="move that file, or choose another place with --results DIR",
            )


def _same(one: Path, other: Path) -> bool:
    """Whether two paths lead to one folder, by whatever links or spelling."""
    try:
        return one.samefile(other)
    except OSError:
        return one.resolve() == other.resolve()


def open_evaluator(
    study: Study,
    workers: Workers,
    count: int,
    problem: ForwardProblem | None = None,
    basis: Path | None = None,
    seconds: float | None = None,
) -> AbstractContextManager[BatchEvaluator]:
    """An evaluator for a study, or for its reduced problem; workers are only started when they pay for their start.

    One worker of a study whose function runs in a child process is that child.

    Parameters
    ----------
    study : Study
    workers : int, Injected or None
        Processes, or an executor that is given; None takes all cores where one process would take longer than a pool
        pays for, else one.
    count : int
        Evaluations that are foreseen.
    problem : ForwardProblem, optional
        Default that of the study.
    basis : Path, optional
        File of the basis that ``problem`` is reduced to, for the workers to read.
    seconds : float, optional
        How long one evaluation takes; tried out where it is not known.

    Raises
    ------
    InputError
        For an executor that does not keep the study's time limit.
    """
    given = problem or study.problem
    asked = unrecorded(given)
    source = EvaluationSource.of(study, asked, basis)
    if isinstance(workers, Injected):
        return _opened_for(given, ExecutorEvaluator(source, workers, limit_asked(study)))
    chosen = workers
    if chosen is None:
        if seconds is None:
            seconds = asked_anew(asked, study.model.space.values).seconds
        chosen = available_cores() if seconds * count > _WORTHWHILE else 1
    function = function_of(asked)
    if chosen == 1 and isinstance(function, ChildFunction):
        return nullcontext(_answering(given, function.evaluator))
    return _opened_for(given, Evaluator(source, chosen, study.settings.calibration.time_limit))


def limit_asked(study: StudyFile) -> float | None:
    """The time limit that a study's file names; None where it names none: the default is the own pool's alone."""
    given = study.settings.calibration
    return given.time_limit if "time_limit" in given.model_fields_set else None


@contextmanager
def _opened_for(problem: ForwardProblem, evaluator: Evaluator | ExecutorEvaluator) -> Iterator[BatchEvaluator]:
    with evaluator:
        yield _answering(problem, evaluator)


def _answering(problem: ForwardProblem, evaluator: Evaluator | ExecutorEvaluator) -> BatchEvaluator:
    """An evaluator of responses, from one that asks a function of modes for these."""
    if isinstance(problem, ModalProblem) and function_of(problem) is not None:
        return ModesEvaluator(problem, evaluator)
    return evaluator


_WORTHWHILE = 20.0
"""Seconds of work from which on a process pool is started."""


def available_cores() -> int:
    """Processor cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)
