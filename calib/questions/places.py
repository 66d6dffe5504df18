"""Where answers go and who computes them: folders, ledger, worker processes."""

from __future__ import annotations

import os
import time
from pathlib import Path

from calib.correlation.problem import ModalProblem
from calib.errors import EvaluationError
from calib.evaluate import Evaluator
from calib.ledger import Ledger
from calib.results import Results
from calib.study import EvaluationSource, Study

QUICK = "quick"
"""Sub-folder of results made with ``--quick``."""

QUICK_SAMPLES, QUICK_POPULATION, QUICK_GENERATIONS = 60, 20, 15

LEDGER = "ledger.sqlite"


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
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)
