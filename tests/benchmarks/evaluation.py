"""One evaluation of a study side by side: on its reduced basis and at full order, real and complex.

    python tests/benchmarks/evaluation.py [--study vehicle] [--points 10] [--workers 1 2] [--basis DIR] [--write FILE]

Prints milliseconds with their ratios, all taken in turn at the same points; where the processor time of a reduced
evaluation goes; and evaluations a second for one and two worker processes. "Modes" are as many as the study asks, with
the matrices at the point; "evaluation" adds pairing with what was measured. The basis is the one that a search of the
study trains; a folder given keeps it for the next time. Other codes are timed by `full_order.py`.
"""

from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"

import argparse
import cProfile
import pstats
import tempfile
import time
from pathlib import Path

from page import Page
from stopwatch import HEADER, Point, Task, compared, in_turn, short, spent
from subject import STUDIES, study_of, undamped

from calib.analyses.provenance.places import open_evaluator
from calib.analyses.reduction import Reduction, reduction_of
from calib.problem.sampling import sample
from calib.results.results import Results
from calib.study.study import LoadedStudy

SEED, SHOWN = 7, 12


def main() -> None:
    """Time everything and print tables."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("--study", choices=STUDIES, default="vehicle")
    arguments.add_argument("--points", type=int, default=10)
    arguments.add_argument("--workers", type=int, nargs="*", default=[1, 2])
    arguments.add_argument("--basis", type=Path, help="folder that keeps the basis")
    arguments.add_argument("--write", type=Path, help="append the tables to this file")
    given = arguments.parse_args()
    page, study = Page(given.write), study_of(given.study)
    page.begin(f"One evaluation of the {given.study}")
    with tempfile.TemporaryDirectory() as scratch:
        home = given.basis or Path(scratch)
        home.mkdir(parents=True, exist_ok=True)
        took = time.perf_counter()
        reduction = reduction_of(study, Results(home))
        assert reduction is not None
        page.say(
            f"{study.model.n_dof} degrees of freedom, {study.problem.mode_count} modes; basis of "
            f"{reduction.basis.size} vectors in {time.perf_counter() - took:.1f} s (trained or loaded)."
        )
        points = [study.search_space.complete(x) for x in sample(study.search_space, given.points, SEED).points]
        side_by_side(page, study, reduction, points)
        where_it_goes(page, study, reduction, points)
        for_workers(page, study, reduction, points, given.workers)


def side_by_side(page: Page, study: LoadedStudy, reduction: Reduction, points: list[Point]) -> None:
    """Reduced and full, real, complex, and the whole evaluation."""
    count, full, reduced = study.problem.mode_count, study.problem, reduction.problem
    pairs = {
        "real modes": (undamped(reduced.model).modes, undamped(full.model).modes),
        "complex modes": (reduced.model.modes, full.model.modes),
    }
    for name, both in pairs.items():
        small, large = (lambda v, modes=modes: modes(v, count) for modes in both)
        compare(page, {f"reduced, {name}": small, f"full order, {name}": large}, points)
    compare(page, {"reduced, evaluation": reduced.evaluate, "full order, evaluation": full.evaluate}, points)


def compare(page: Page, tasks: dict[str, Task], points: list[Point]) -> None:
    """A table of tasks in turn; the first turn only warms up."""
    in_turn(tasks, points[:1])
    page.table(HEADER, compared(in_turn(tasks, points)))


def where_it_goes(page: Page, study: LoadedStudy, reduction: Reduction, points: list[Point]) -> None:
    """The functions in which reduced complex modes and a whole reduced evaluation spend their time."""
    count = study.problem.mode_count
    tasks: dict[str, Task] = {
        "reduced complex modes": lambda v: reduction.problem.model.modes(v, count),
        "reduced evaluation": reduction.problem.evaluate,
    }
    for name, task in tasks.items():
        profile = cProfile.Profile(time.process_time)
        profile.enable()
        for values in points:
            task(values)
        profile.disable()
        stats = pstats.Stats(profile)
        each = 1e3 / len(points)
        page.say(f"Where the processor time of {name} goes ({short(stats.total_tt * each)} ms under the profiler):")
        slowest = sorted(stats.stats.items(), key=lambda item: -item[1][2])[:SHOWN]
        rows = []
        for (file, line, function), (_, calls, own, whole, _) in slowest:
            place = function if file == "~" else f"{Path(file).name}:{line} {function}"
            share = f"{own / stats.total_tt:.0%}"
            rows.append((place, short(calls / len(points)), short(own * each), short(whole * each), share))
        page.table(("function", "calls", "own ms", "ms with what it calls", "own share"), rows)


def for_workers(
    page: Page, study: LoadedStudy, reduction: Reduction, points: list[Point], counts: list[int], population: int = 30
) -> None:
    """Evaluations a second in populations of 30, reduced; one population at full order."""
    rows = []
    for label, problem, basis, turns in (
        ("reduced", reduction.problem, reduction.path, 4), ("full order", study.problem, None, 1),
    ):  # fmt: skip
        for workers in counts:
            with open_evaluator(study, workers, 1, problem, basis) as evaluator:
                evaluator.evaluate(points[:2])

                def populations(evaluator=evaluator, turns=turns) -> None:
                    for k in range(turns):
                        evaluator.evaluate([points[(7 * k + i) % len(points)] for i in range(population)])

                rate = turns * population / spent(populations).wall
            rows.append((label, workers, short(rate)))
    page.say(f"Evaluations a second by the wall clock, populations of {population}:")
    page.table(("", "workers", "evaluations/s"), rows)


if __name__ == "__main__":
    main()
