"""The study of a command: loaded, with a listener that prints its answer and tells other processes its progress."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from calib.api.study import Study


@contextmanager
def loaded_study(
    verb: str,
    path: Path,
    results: Path,
    verbose: bool,
    workers: int | None = None,
    quick: bool = False,
    load: bool = True,
    cache: Path | None = None,
    case: str | None = None,
    method: str | None = None,
    executor: str | None = None,
    figures: bool = True,
) -> Iterator[Study]:
    """The study of a command, which prints its answer at the end.

    Parameters
    ----------
    verb : str
        The subcommand.
    path, results : Path
        Of the study, and of the folder in which that of its results is.
    verbose : bool
    workers, quick, cache, executor
        See `calib.command.options`.
    load : bool
        Whether to read model and data at once.
    case, method : str, optional
        Further options with which the command is given again once it was interrupted.
    figures : bool
        Whether to draw those of the tables.
    """
    gc.disable()  # what is imported stays: the collector's passes over it, at the exit too, would take 0.1 s
    try:
        from calib.api.study import Study
        from calib.command.printing import printing, tell_cache
        from calib.execution.executor import Injected
        from calib.execution.tasks import one_thread
        from calib.results.running import RunningNote
        from calib.structure.reduction.cache import using
        from calib.study.study_file import study_file
    finally:
        if not gc.get_freeze_count():  # once, or what a process leaves from study to study would stay too
            gc.freeze()
        gc.enable()
    options = {"workers": workers, "quick": quick, "case": case, "method": method, "executor": executor}
    file = study_file(path)
    home, given = results / file.resolve().parent.name, {name: value for name, value in options.items() if value}
    note = RunningNote(home, verb, given, file)
    # The matrices are small: several threads of one product wait for each other. Only loaded libraries are limited.
    with (
        using(cache) as notes, tell_cache(notes, verbose), one_thread(), note,
        printing(verb, verbose, note) as listener,
    ):  # fmt: skip
        if load:
            found = Study.load(
                path, results, workers=workers, quick=quick, listener=listener, executor=executor, figures=figures
            )
            try:
                yield found
            finally:
                if isinstance(found.workers, Injected):
                    found.workers.close()
        else:
            yield Study(path, results, listener=listener)
