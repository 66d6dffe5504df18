"""Folders of results, the ledger, and the evaluator of a study."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from calib.analyses.provenance.isolation import ChildFunction, Workers, injected_evaluator
from calib.analyses.provenance.recorded import Evaluated, ModesEvaluator, reevaluated, unrecorded
from calib.errors.errors import InputError
from calib.execution.ahead import points_shared
from calib.execution.evaluate import BatchEvaluator, Evaluator
from calib.execution.executor import ExecutorEvaluator, Injected
from calib.execution.tasks import are_shared, shared_by
from calib.execution.team import Team
from calib.execution.worker import available_cores
from calib.experiment.test import ForwardProblem
from calib.results.ledger import Ledger
from calib.results.results import Results
from calib.results.written import LOG
from calib.study.study import EvaluationSource, LoadedStudy
from calib.study.study_file import StudyFile, shell_argument

if TYPE_CHECKING:
    from calib.execution.cluster import ClusterEvaluator

QUICK = "quick"
"""Sub-folder of results made with ``--quick``."""

QUICK_SAMPLES, QUICK_POPULATION, QUICK_GENERATIONS, QUICK_STARTS = 60, 20, 15, 2
QUICK_TRAJECTORIES, QUICK_BASE = 5, 16
QUICK_SAMPLED = 5
"""Sizes of a quick run: enough to see whether a study works, too few to rely on its results."""

LEDGER = "ledger.sqlite"


def results_of(
    study: StudyFile, root: Path, quick: bool = False, only: str | None = None, method: str | None = None
) -> Results:
    """Folder of results: that of a full run, or a sub-folder for a quick run, a single case or another method."""
    other = method if method and method != study.settings.calibration.method else None
    parts = [part for part in (QUICK * quick, f"case_{only}" if only else "", other or "") if part]
    return opened(study, root, "-".join(parts))


def is_quick(study: StudyFile, results: Results) -> bool:
    """Whether a folder is that of a quick run, as named by `results_of`."""
    return results.path.parent.name == study.name and results.path.name.split("-")[0] == QUICK


def ledger_of(study: StudyFile, root: Path) -> Ledger:
    """The one ledger of a study, shared by full, quick and single-case runs."""
    home = results_of(study, root)
    home.claim()
    return Ledger.open(home.path / LEDGER)


def answers_of(study: StudyFile, root: Path) -> tuple[Results, ...]:
    """Every folder with results of a study: that of a full run, then those of quick runs, single cases and methods.

    InputError when they belong to another study, or lie where no results may be written.
    """
    home = root / study.name
    inside = sorted(p.parent for p in home.glob(f"*/{LOG}"))  # other folders there are the user's
    filled = [p for p in (home, *inside) if any(p.glob("*.csv"))]
    return tuple(opened(study, root, "" if p is home else p.name) for p in filled)


def root_for(study_file: Path, root: Path) -> Path:
    """Root folder for results of a study: the given one, or one within it that is not the study's own folder."""
    places = (root, root / "answers", *(root / f"answers_{number}" for number in range(2, 100)))
    own = study_file.resolve().parent
    return next((place for place in places if not _same(place / own.name, own)), root)


def opened(study: StudyFile, root: Path, part: str) -> Results:
    """One folder of a study's results; InputError where it would overlap its inputs, or another study's results."""
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
    apart = own.is_relative_to(place)  # a study written among the results has its own folder
    for file in study.inputs:
        if file.is_relative_to(place) and not (apart and file.is_relative_to(own)):
            raise InputError(
                f"the study reads {file.name} from the folder of its results",
                place=home,
                remedy="move that file, or choose another place with --results DIR",
            )


def _same(one: Path, other: Path) -> bool:
    """Whether two paths lead to the same folder, links resolved."""
    try:
        return one.samefile(other)
    except OSError:
        return one.resolve() == other.resolve()


def open_evaluator(
    study: LoadedStudy,
    workers: Workers,
    count: int,
    problem: ForwardProblem | None = None,
    basis: Path | None = None,
    seconds: float | None = None,
) -> AbstractContextManager[BatchEvaluator]:
    """An evaluator for a study, or for its reduced problem; workers are started only when they pay off.

    For a study whose function runs in a child process, a single worker is that child.

    Parameters
    ----------
    study : Study
    workers : int, Injected or None
        Number of processes, or an injected executor; None takes all cores where that pays off, else one process.
    count : int
        Expected number of evaluations.
    problem : ForwardProblem, optional
        By default that of the study.
    basis : Path, optional
        File of the basis that ``problem`` is reduced to, for the workers to read.
    seconds : float, optional
        Duration of one evaluation (s); measured where it is not known.

    Raises
    ------
    InputError
        For an executor that does not enforce the study's time limit.
    """
    given = problem or study.problem
    bare = unrecorded(given)
    if study.in_memory:
        here = Evaluated(bare)
        return injected_evaluator(study, here, workers) if isinstance(workers, Injected) else Evaluator(here)
    source = EvaluationSource.of(study, bare, basis)
    if isinstance(workers, Injected):
        return _opened_for(given, injected_evaluator(study, source, workers))
    chosen = workers
    if chosen is None:
        if seconds is None:
            seconds = reevaluated(bare, study.model.space.values).seconds
        chosen = available_cores() if seconds * count > _WORTHWHILE else 1
    function = bare.user_function
    if chosen == 1 and isinstance(function, ChildFunction):
        return nullcontext(_answering(given, function.evaluator))
    return _opened_for(given, Evaluator(source, chosen, study.settings.evaluation_limit))


@contextmanager
def tasks_shared(workers: Workers) -> Iterator[None]:
    """While this lasts, worker processes share the tasks of `each`; they are started when they pay off.

    Where they are shared already, that goes on, whatever ``workers`` is. An injected executor does not take them: each
    task needs matrices and bases, which are large. A cluster takes those of a second and more, and processes of this
    machine the others. Points of a user's function that are asked for together are shared by either, see
    `calib.analyses.provenance.recorded.recorded`.
    """
    with nullcontext() if workers == 1 else points_shared():
        if are_shared() or (isinstance(workers, Injected) and workers.cluster is None):
            yield
            return
        team = Team(workers) if isinstance(workers, int) else Team(available_cores(), PATIENCE)
        with team, shared_by(workers.tasks(team) if isinstance(workers, Injected) else team):
            yield


@contextmanager
def _opened_for(
    problem: ForwardProblem, evaluator: Evaluator | ExecutorEvaluator | ClusterEvaluator
) -> Iterator[BatchEvaluator]:
    with evaluator:
        yield _answering(problem, evaluator)


def _answering(problem: ForwardProblem, evaluator: BatchEvaluator) -> BatchEvaluator:
    """The evaluator of responses; for a function of modes it wraps the evaluator of its modes."""
    if problem.numbers_function is not None:
        return ModesEvaluator(problem, evaluator)
    return evaluator


_WORTHWHILE = 10.0
"""Expected seconds of work above which a process pool is started."""

PATIENCE = 1.0
"""Seconds of shared tasks after which worker processes are started; see `calib.execution.team.Team`."""
