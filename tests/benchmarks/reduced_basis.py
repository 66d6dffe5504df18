"""How good and how fast the reduced basis of a study is on fresh points of the spaces it was trained for.

    python tests/benchmarks/reduced_basis.py [--study vehicle] [--spaces search] [--points 200] [--tolerance 1e-4]

Points are drawn with another seed than training uses, every one solved at full order as well. Checked are modes below
the frequency and damping ratio that training heeds; those nearer to critical damping are counted apart.
"""

from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"

import argparse
from pathlib import Path

import numpy as np
from page import Page
from stopwatch import HEADER, Point, compared, in_turn, short, spent
from subject import STUDIES, study_of

from calib.structure.reduction.certificate import certificate
from calib.structure.reduction.reduced import ReducedModel
from calib.structure.reduction.training import space_filling_points, train_basis

FRESH_SEED = 20260101
TIMED = 10


def main() -> None:
    """Train, compare and print."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("--study", choices=STUDIES, default="vehicle")
    arguments.add_argument("--spaces", choices=("search", "sensitivity"), nargs="+", default=["search"])
    arguments.add_argument("--points", type=int, default=200, help="fresh points of each space (default 200)")
    arguments.add_argument("--tolerance", type=float, help="of training (default: the study's)")
    arguments.add_argument("--write", type=Path, help="append the tables to this file")
    given = arguments.parse_args()
    page, study = Page(given.write), study_of(given.study)
    page.begin(f"Reduced basis of the {given.study} on fresh points")
    settings, count = study.settings.reduction, study.problem.mode_count
    spaces = {name: getattr(study, f"{name}_space") for name in given.spaces}
    window = study.problem.freq_window
    trained = []
    took = spent(
        lambda: trained.append(
            train_basis(
                study.model, list(spaces.values()), count, seed=settings.seed,
                freq_max=window[1] if window else np.inf, tolerance=given.tolerance or settings.tolerance,
            )
        )
    )  # fmt: skip
    (basis,) = trained
    reduced = ReducedModel(study.model, basis)
    page.say(
        f"{study.model.n_dof} degrees of freedom, basis of {basis.size} vectors from {len(basis.samples)} points for "
        f"{', '.join(spaces)}, trained in {short(took.wall)} s ({short(took.cpu)} s of processor time), tolerance "
        f"{basis.tolerance:.0e} of eigenvalues; {count} modes, checked below {basis.freq_max:g} Hz and a damping ratio "
        f"of {basis.damping_max:g}."
    )
    rng = np.random.default_rng(FRESH_SEED)
    for name, space in spaces.items():
        on_fresh_points(page, reduced, name, space_filling_points(space, given.points, rng), count)


def on_fresh_points(page: Page, reduced: ReducedModel, name: str, points: list[Point], count: int) -> None:
    """Errors, near-critical modes, the indicator against the truth, and times."""
    table, errors = certificate(reduced, points, count)
    page.say(f"{name} space, {len(points)} fresh points, {sum(len(e.mode) for e in errors)} modes checked:")
    page.table(table.columns, [[f"{v:.1e}" if isinstance(v, float) else v for v in row] for row in table.to_numpy()])
    found = [reduced.modes(point, count) for point in points]
    critical = [
        np.count_nonzero((m.natural_freq <= reduced.basis.freq_max) & (m.damping_ratio >= reduced.basis.damping_max))
        for m in found
    ]
    overdamped = [sum(root.kind == "overdamped" for root in m.excluded) for m in found]
    page.say(
        f"Near critical damping and so not checked: {sum(critical)} modes at {np.count_nonzero(critical)} points; the "
        f"highest damping ratio of the {count} modes is {max(m.damping_ratio.max() for m in found):.3f}; "
        f"{min(overdamped)} to {max(overdamped)} overdamped roots lie among them."
    )
    true, said = (np.concatenate([getattr(e, name) for e in errors]) for name in ("eigenvalue", "indicator"))
    bad = true > reduced.basis.tolerance
    page.say(
        f"Of {np.count_nonzero(bad)} eigenvalues beyond the tolerance the indicator tells "
        f"{np.count_nonzero(said[bad] > reduced.basis.tolerance)}."
    )
    above = true > 1e-6
    if above.any():
        ratio = said[above] / true[above]
        page.say(
            f"Indicator over true error, {np.count_nonzero(above)} modes above 1e-6: minimum {ratio.min():.2f}, "
            f"median {np.median(ratio):.2f}, maximum {ratio.max():.2f}."
        )
    tasks = {
        "reduced": lambda v: reduced.modes(v, count),
        "full order": lambda v: reduced.model.modes(v, count),
        "indicator": lambda v: reduced.indicator(v, found[0]),
    }
    page.table(HEADER, compared(in_turn(tasks, points[:TIMED])))


if __name__ == "__main__":
    main()
