"""Study: a problem in a folder, with every analysis as a method; results are stored on disk."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Unpack

from calib.analyses.provenance import places
from calib.analyses.provenance.isolation import stated_time_limit
from calib.api import steps
from calib.api.arguments import ParetoKeys, RobustnessKeys
from calib.api.display import Compared, FolderResult, entries_by_test
from calib.api.listener import Listener, Showing
from calib.api.problem import Problem
from calib.errors.arguments import integer
from calib.errors.arguments import path as path_of
from calib.execution.executor import AnyExecutor, Injected, injected
from calib.problem.joint import prefixed, stacked
from calib.results.results import RESULTS, Results

if TYPE_CHECKING:
    from calib.analyses.again import Repeated
    from calib.analyses.calibrate import Method
    from calib.analyses.staged import Found
    from calib.api.designs import DesignKeys
    from calib.problem.effect import Effect
    from calib.report.kept import Format
    from calib.report.style import Width
    from calib.study.several import AnyStudy
    from calib.study.study import LoadedStudy as Loaded


@dataclass(frozen=True, eq=False, repr=False)
class Study:
    """A study in a folder, described by its ``study.toml``; each method is a subcommand of ``calib``.

    Results and figures go to a results folder; solved points are stored there and are not solved again.

    Attributes
    ----------
    path : Path
        Folder with a ``study.toml``, or that file.
    results : Path
        Parent of ``<study>/``, the folder with the results.
    workers : int, Injected or None
        Number of worker processes; None for one per core where that pays. An executor or a cluster takes their place.
    quick : bool
        A quick run, with small searches; its results go to a sub-folder.
    figures : bool
        Whether each analysis draws its tables. Where not, those of older ones are removed; `run` and `report` draw all.
    listener : Listener
        Receives progress and results.
    read : Study, JointStudy or None
        Model, measurement and settings if already loaded; otherwise they are loaded on first use.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import calib
    >>> from calib.command.example import write_example
    >>> there = Path(tempfile.mkdtemp())
    >>> _ = write_example(there / "mast")
    >>> study = calib.Study.load(there / "mast", results=there / "results")
    >>> found = study.compare()
    >>> (there / "results/mast/comparison_before.csv").exists()
    True
    """

    path: Path
    results: Path = RESULTS
    workers: places.Workers = None
    quick: bool = False
    figures: bool = True
    listener: Listener = field(default_factory=Listener)
    read: AnyStudy | None = None

    @staticmethod
    def load(
        path: str | Path,
        results: str | Path = RESULTS,
        *,
        workers: int | None = None,
        quick: bool = False,
        progress: bool = True,
        listener: Listener | None = None,
        executor: AnyExecutor | None = None,
        figures: bool = True,
    ) -> Study:
        """Read a study with everything it names; InputError for anything wrong in it.

        A study whose values it adopts is calibrated first, where it is not yet. A terminal or a notebook shows how far
        its analyses are, unless ``progress`` is false or a listener receives it. ``executor`` evaluates the points of
        every analysis, see `run`; by default it is that of ``[compute]``. Without ``figures`` only `run` and `report`
        draw.
        """
        receiver = listener or (Showing() if progress else Listener())
        study = Study(path_of(path, "study"), path_of(results, "results"), workers, quick, figures, receiver)
        chosen = executor or study.loaded.settings.compute.executor
        if chosen == "processes":
            return study
        return study._with(Injected.of(chosen, workers, receiver.at_once))

    def __repr__(self) -> str:
        return f"Study({self.loaded.settings.title!r}, results in {self.folder.path})"

    @cached_property
    def loaded(self) -> AnyStudy:
        """Model, measurement and settings; a user's function runs in a child process."""
        if self.read is not None:
            return self.read
        from calib.api.staged import loaded_after

        return loaded_after(self.path, self._calibrated)

    def _calibrated(self, study: Loaded, file: Path) -> Found | None:
        """Values that a study whose values another one adopts has found; it is calibrated first where it has none."""
        from calib.analyses.staged import values_found

        found = values_found(study, self.results, self.quick)
        if found is None:
            self.listener.first(study, self.path)
            own = replace(self, path=file, read=study)
            steps.fit_step(own)
            own.draw()
            found = values_found(study, self.results, self.quick)
        return found

    @property
    def tests(self) -> tuple[Study, ...]:
        """Each test as a study of its own; a study with one test is its only element."""
        loaded = self.loaded
        return tuple(replace(self, read=one) for one in loaded.studies) if loaded.settings.several else (self,)

    @property
    def one(self) -> Loaded:
        """The study with its only test."""
        (only,) = self.loaded.studies
        return only

    @contextmanager
    def _by(self, executor: AnyExecutor | None) -> Iterator[Study]:
        """A copy with an executor instead of worker processes, for as long as this lasts; itself without one."""
        own = self.workers if isinstance(self.workers, int) else None
        with injected(executor, own, self.listener.at_once) as workers:
            yield self if workers is None else self._with(workers)

    def _with(self, workers: Injected) -> Study:
        """A copy whose points others evaluate; InputError for a setting that they do not support."""
        workers.require(stated_time_limit(self.loaded))
        return replace(self, workers=workers, read=self.loaded)

    @cached_property
    def folder(self) -> Results:
        """The results folder."""
        return places.results_of(self.loaded, self.results, self.quick)

    @property
    def problem(self) -> Problem:
        """The study as a `Problem` in memory, with its settings and the selected parameters free; nothing is stored."""
        first, *others = map(steps.in_memory, self.loaded.studies)
        return replace(first, beside=tuple(others))

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Effects of the study's library: what `explain` tests; empty where it names none."""
        return self.loaded.candidates

    # -- analyses ------------------------------------------------------------------------------------------------------

    def compare(self, *, undamped: bool = False) -> Compared:
        """Compare models and measurements at the nominal values, without fitting.

        With ``undamped`` the frequencies of stiffness and mass alone are written as well; see `Compared.undamped`.
        """
        answers, studies = {}, {}
        for study in self.tests:
            name = study.one.test or study.one.name
            answers[name], studies[name] = steps.compare_step(study, undamped), study.one
        self.draw()
        return Compared(answers, studies)

    def sensitivity(
        self,
        method: Literal["ranks", "morris", "sobol"] = "ranks",
        *,
        ignore_constraints: bool = False,
        residuals: Sequence[str] = (),
        surfaces: Sequence[tuple[str, str, str]] = (),
        executor: AnyExecutor | None = None,
    ) -> FolderResult:
        """Global sensitivity: rank correlations over a Latin hypercube, or the indices of Morris or Sobol.

        Each test is analysed by itself. Metamodels of the responses in ``residuals`` are drawn against the model, those
        of ``surfaces`` (response and two inputs) over the inputs. ``executor`` evaluates the points; see `run`.
        """
        from calib.api.entries.compared import sensitivity_entries
        from calib.api.metamodel_figures import draw_metamodels

        answers, entries = dict[str, Any](), {}
        with self._by(executor) as whole:
            for study in whole.tests:
                found = steps.sensitivity_step(study, method, ignore_constraints, bool(residuals or surfaces))
                answers[study.one.test], entries[study.one.test] = found, sensitivity_entries(study.one, found)
                if residuals or surfaces:
                    drawn = draw_metamodels(found, study.one, study.folder.path, residuals, surfaces)
                    self.listener.requested(drawn)
        self.draw()
        printed = entries_by_test(entries)
        if len(answers) == 1:
            return FolderResult(found.sentences, found.table, self.tests[0].folder.path, found, printed)
        table = stacked({test: one.table for test, one in answers.items()})
        words = prefixed({test: one.sentences for test, one in answers.items()})
        return FolderResult(words, table, self.folder.path, answers, printed)

    def refine(self, runs: int = 20, *, seed: int = 1) -> FolderResult:
        """New runs of the only test where they help most; see `calib.api.sensitivity.Assessed.refine`."""
        from calib.api.entries.compared import refined_entries

        found = steps.refine_step(self, integer(runs, 1, "runs"), seed)
        self.draw()
        return FolderResult(found.sentences, found.table, self.folder.path, found, tuple(refined_entries(found)))

    def calibrate(
        self,
        case: str | None = None,
        *,
        method: Method | None = None,
        executor: AnyExecutor | None = None,
    ) -> FolderResult:
        """Fit the parameters in several independent cases, and assess how well each is identified.

        Several tests are fitted together. ``executor`` evaluates the points of searches; see `run`.
        """
        from calib.api.entries.calibrated import calibrated_entries

        with self._by(executor) as study:
            found = steps.calibrate_step(study, case, method)
            study.draw(places.results_of(self.loaded, self.results, self.quick, case, method))
        folder = places.results_of(self.loaded, self.results, self.quick, case, method)
        printed = tuple(calibrated_entries(self.loaded, found))
        return FolderResult(found.sentences, found.verdicts, folder.path, found, printed)

    def intervals(self, parameters: Sequence[str] = (), *, samples: int = 0, seed: int = 1) -> FolderResult:
        """Intervals of the parameters of the stored calibration; see `calib.api.fit.Fit.intervals`."""
        from calib.api.entries.calibrated import interval_entries

        found = steps.intervals_step(self, tuple(parameters), samples, seed)
        self.draw()
        return FolderResult(found.sentences, found.table, self.folder.path, found, tuple(interval_entries(found)))

    def robustness(self, **keys: Unpack[RobustnessKeys]) -> FolderResult:
        """Responses over what is known of the parameters; see `calib.api.fit.Fit.robustness`.

        Samples of the posterior are those of `intervals`, where it has drawn some.
        """
        from calib.api.entries.calibrated import robustness_entries

        found = steps.robustness_step(self, **keys)
        self.draw()
        return FolderResult(found.sentences, found.table, self.folder.path, found, tuple(robustness_entries(found)))

    def pareto(self, **keys: Unpack[ParetoKeys]) -> FolderResult:
        """The front of two groups of responses beside the stored calibration; see `calib.api.fit.Fit.pareto`."""
        from calib.api.entries.calibrated import pareto_entries

        found = steps.pareto_step(self, **keys)
        self.draw()
        return FolderResult(found.sentences, found.table, self.folder.path, found, tuple(pareto_entries(found)))

    def designs(self, best: int = 12, **keys: Unpack[DesignKeys]) -> FolderResult:
        """Every design that searches and samples of the study as it is have evaluated, ranked by the objective.

        Parameters
        ----------
        best : int
            Designs that are printed.
        **keys
            What else is told, written and drawn; see `calib.api.designs.DesignKeys`.
        """
        from calib.api.designs import designs_result

        return designs_result(self, integer(best, 1, "best"), keys)

    def again(self) -> Repeated:
        """Evaluate failed points once more, such as those without a licence; others stay. Analyses then use them."""
        return steps.repeat_step(self)

    def explain(self, *, executor: AnyExecutor | None = None) -> FolderResult:
        """Find which effect of the study's library the model lacks; ``executor`` evaluates points, see `run`."""
        from calib.api.entries.explained import explained_entries

        with self._by(executor) as study, places.tasks_shared(study.workers):
            found = steps.explain_step(study)
            self.listener.may_add(self.loaded, found.explanation)
            self.draw()
        printed = tuple(explained_entries(self.loaded, found))
        return FolderResult((*found.sentences, *found.notes), found.effects, self.folder.path, found, printed)

    def propose(self, rank: int | None = None) -> FolderResult:
        """Compose effects that explain what no effect of the library explains, after `explain`.

        The best ``rank`` are written as a library of effects, in a study of its own among the results.
        """
        from calib.api.entries.proposed import proposed_entries

        found = steps.propose_step(self, rank)
        words = (found.answer.found, found.answer.sure, *found.sentences)
        return FolderResult(words, found.table, self.folder.path, found, tuple(proposed_entries(found)))

    def extend(self, effects: Sequence[str], into: str | Path) -> Study:
        """Write a new study whose model also has the named effects; this one stays as it is.

        Where an explanation has fitted these effects, the calibration of the new study starts at its fit.
        """
        from calib.analyses.explained_fit import explained_fit
        from calib.analyses.extend import write_extension

        chosen = list(effects)
        begin_at = explained_fit(self.loaded, places.results_of(self.loaded, self.results), chosen)
        written = write_extension(self.loaded, chosen, path_of(into, "into"), begin_at)
        self.listener.extended(written)
        return replace(self, path=written.file, results=places.root_for(written.file, self.results), read=None)

    def decks(self, into: str | Path) -> tuple[Path, ...]:
        """Write the solver's decks with the calibrated values into a new folder; see `calib.analyses.decks`."""
        return steps.decks_step(self, path_of(into, "into"))

    def run(self, *, executor: AnyExecutor | None = None) -> Study:
        """Run every analysis, add the named effects, calibrate again, and write ``report.html``.

        Parameters
        ----------
        executor : concurrent.futures.Executor, distributed.Client, str or calib.execution.executor.Injected, optional
            Evaluates the points of samples, searches and derivatives instead of worker processes; tables are the same.
            Its processes must see the study's folder and its results. The caller shuts it down. ``"dask"`` is a cluster
            on this machine, ``"dask://HOST:PORT"`` one that runs already.

        Returns
        -------
        Study
            The extended study where effects were named and added, else this one.

        Raises
        ------
        InputError
            For an executor together with a number of workers, and for a ``time_limit`` of the study that the executor
            is not stated to keep; a cluster keeps it.
        """
        if executor is not None:
            with self._by(executor) as study:
                found = study.run()
            return self if found is study else replace(found, workers=self.workers)
        for study in self.tests:
            steps.compare_step(study)
            steps.sensitivity_step(study)
        before, extended = steps.calibrate_step(self), None
        if before.too_few:
            self.listener.nothing_added(f"Nothing was explained: {before.too_few}.")
        elif self.loaded.candidates:
            extended = steps.with_named(self, before, steps.explain_step(self).explanation)
        with places.tasks_shared(self.workers):
            if extended is not None:
                extended.draw(report=True)
            self.draw(report=True)
        return extended or self

    def report(self, formats: Sequence[Format] = ("png",), width: Width = "page") -> Path:
        """Write ``report.html`` from the stored results and redraw every figure; no code of the study is run.

        Parameters
        ----------
        formats : sequence of {"png", "svg", "pdf"}
            Formats of the figures beside the report.
        width : {"page", "column"}
            Width of these figures: 190 mm, or 90 mm where a figure is legible in a journal's column.
        """
        from calib.api.figures import redraw

        with places.tasks_shared(self.workers):
            return redraw(self.path, self.results, self.listener, formats, width)

    # -- figures -------------------------------------------------------------------------------------------------------

    def draw(self, folder: Results | None = None, report: bool = False) -> None:
        """Draw the figures of all tables, and of each test; see `calib.api.figures.draw`."""
        from calib.api.figures import draw

        place = folder or self.folder
        draw(self.loaded, place, self.results, self.listener, report, workers=self.workers, wanted=self.figures)
