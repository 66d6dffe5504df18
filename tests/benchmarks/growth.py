"""How cost grows with the mesh of the vehicle: assembly, one solution, training off-line, one answer on-line.

    python tests/benchmarks/growth.py [--sizes 1 2 4] [--samples 8] [--write FILE]

A size is ``refine`` of the vehicle: into how many every edge is cut. Each is a process of its own, and its row is told
when it is done. The basis is made of the static answers and the modes at the same few points at every size, so that
its cost can be compared; a search adds points where fresh ones still err, about three times as many in all. How much
the basis errs is told at one fresh point, by the largest error of a frequency.
"""

from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from child import in_child, report
from page import Page
from stopwatch import Spent, exponent, median, short, spent
from subject import study_of

from calib.problem.sampling import sample
from calib.structure.model import StructuralModel
from calib.structure.reduction.basis import CHECK_COLUMNS, Basis
from calib.structure.reduction.growth import Growth
from calib.structure.reduction.mode_target import ModeTarget
from calib.structure.reduction.reduced import ReducedModel
from calib.structure.reduction.training import box, mid_point, space_filling_points
from calib.study.study import LoadedStudy
from models.railway import vehicle

REPEATS, SEED = 20, 7
COLUMNS = ("assembly", "solve", "training", "projection", "answer")
HEADER = (
    "degrees of freedom", "assembly s", "one damped solution s", "off-line training s", "projection s", "on-line ms",
    "vectors", "training points", "frequency error", "peak MB",
)  # fmt: skip


def main() -> None:
    """One child a size."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("--sizes", type=int, nargs="+", default=[1, 2, 4])
    arguments.add_argument("--samples", type=int, default=8, help="training points (default 8)")
    arguments.add_argument("--write", type=Path, help="append the table to this file")
    arguments.add_argument("--size", type=int, help=argparse.SUPPRESS)
    given = arguments.parse_args()
    if given.size:
        measure(given.size, given.samples)
        return
    page, rows, every = Page(given.write), [], []
    page.begin("Growth with the mesh of the vehicle")
    for size in given.sizes:
        found = in_child(__file__, "--size", size, "--samples", given.samples)
        every.append(found)
        first = every[0]
        rows.append(
            (
                found["n_dof"], *(pair(found[name], 1e3 if name == "answer" else 1.0) for name in COLUMNS),
                found["vectors"], given.samples, f"{found['error']:.1e}", f"{found['own_mb']:.0f}",
            )
        )  # fmt: skip
        ratios = ", ".join(f"{name} {short(found[name][1] / first[name][1])}" for name in COLUMNS)
        page.say(
            f"refine {size}: {found['n_dof'] / first['n_dof']:.2f} times the degrees of freedom of the first, time "
            f"of the processor over its: {ratios}."
        )
    page.say("Wall clock (processor time):")
    page.table(HEADER, rows)
    if len(every) > 1:
        sizes = [found["n_dof"] for found in every]
        grown = {f"growth_{name}": exponent(sizes, [Spent(*found[name]) for found in every]) for name in COLUMNS}
        told = ", ".join(f"{name} {short(grown[f'growth_{name}'].cpu)}" for name in COLUMNS)
        page.say(f"Exponents of growth with the degrees of freedom, first to last, processor time: {told}.")
        print(json.dumps({**every[-1], **grown}))


def measure(size: int, samples: int) -> None:
    """Everything at one size."""
    study = study_of("vehicle")
    space, count = study.search_space, study.problem.mode_count
    made: list = []
    assembly = spent(lambda: made.append(vehicle(refine=size)))
    model = made.pop()
    solve = median([spent(lambda: model.modes(space.values, count)) for _ in range(1 if size > 2 else 3)])
    training = spent(lambda: made.append(basis_from(study, model, samples)))
    basis = made.pop()
    projection = spent(lambda: made.append(ReducedModel(model, basis)))
    reduced = made.pop()
    points = [space.complete(x) for x in sample(space, REPEATS, SEED).points]
    answer = median([spent(lambda p=p: reduced.modes(p, count)) for p in points])
    truth = model.modes(points[0], count).natural_freq
    report(
        n_dof=model.n_dof, assembly=assembly, solve=solve, training=training, projection=projection, answer=answer,
        vectors=basis.size, error=float(np.abs(reduced.modes(points[0], count).natural_freq / truth - 1).max()),
    )  # fmt: skip


def basis_from(study: LoadedStudy, model: StructuralModel, samples: int) -> Basis:
    """Static answers and the modes at so many points of the search, with nothing checked."""
    space, count, settings = study.search_space, study.problem.mode_count, study.settings.reduction
    window = study.problem.freq_window
    lower, upper = box([space])
    points = space_filling_points(space, samples, np.random.default_rng(settings.seed))
    basis = Basis(
        vectors=np.zeros((model.n_dof, 0)), model_fingerprint=model.fingerprint, names=model.space.names,
        reference=mid_point(lower, upper), lower=lower, upper=upper, offset=0.0, count=count,
        freq_max=window[1] if window else np.inf, damping_max=0.95, tolerance=settings.tolerance,
        samples=np.array([[p[name] for name in model.space.names] for p in points]),
        checks=np.zeros((0, len(CHECK_COLUMNS))), seed=settings.seed,
    )  # fmt: skip
    growth = Growth(model, basis)
    target = ModeTarget(count, basis.freq_max, basis.damping_max, basis.tolerance)
    snapshots = (target.snapshots(model, growth.matrix, p) for p in points)
    statics = growth.statics(target.forces(model))
    return replace(basis, vectors=growth.widened(statics, snapshots, settings.tolerance / 2))


def pair(found: list[float], factor: float) -> str:
    """Wall clock and processor time."""
    return f"{short(factor * found[0])} ({short(factor * found[1])})"


if __name__ == "__main__":
    main()
