"""How good and how fast the reduced basis of the bogie is on fresh points of both of its spaces.

Run ``python tests/benchmarks/reduced_basis.py [points] [tolerance]`` from the project's folder; default are 200 points
of each space and the tolerance that training has by default.
"""

import sys
import time
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from calib.structure.certificate import certificate
from calib.structure.cover import covering_points
from calib.structure.reduced import ReducedModel
from calib.structure.training import train_basis
from calib.study import Study

ROOT = Path(__file__).resolve().parents[2]
COUNT, FREQ_MAX, SEED, FRESH_SEED = 10, 50.0, 1, 20260101


def milliseconds(model, points, count):
    """Median time of one evaluation."""
    spent = []
    for point in points:
        start = time.perf_counter()
        model.modes(point, count)
        spent.append(1e3 * (time.perf_counter() - start))
    return float(np.median(spent))


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    study = Study.load(ROOT / "studies" / "bogie")
    spaces = {"search": study.search_space, "sensitivity": study.sensitivity_space}
    options = {"tolerance": float(sys.argv[2])} if len(sys.argv) > 2 else {}
    start = time.perf_counter()
    basis = train_basis(study.model, list(spaces.values()), COUNT, seed=SEED, freq_max=FREQ_MAX, **options)
    seconds = time.perf_counter() - start
    reduced = ReducedModel(study.model, basis)
    print(f"{study.model.n_dof} degrees of freedom, basis of {basis.size} vectors, trained in {seconds:.1f} s")
    print(f"tolerance {basis.tolerance:.0e} of eigenvalues; 1 - MAC also depends on the distance to the next mode")
    print(f"{len(basis.samples)} full-order samples; modes below {FREQ_MAX:g} Hz with damping ratio < 0.95 are judged")
    rng = np.random.default_rng(FRESH_SEED)
    for name, space in spaces.items():
        points = covering_points(space, count, rng)
        table, errors = certificate(reduced, points, COUNT)
        true = np.concatenate([e.eigenvalue for e in errors])
        ratio = np.concatenate([e.indicator for e in errors])[true > 1e-6] / true[true > 1e-6]
        full, small = (milliseconds(model, points[:60], COUNT) for model in (study.model, reduced))
        print(f"\n{name} space, {count} fresh points, {len(true)} modes")
        print(table.to_string(index=False, float_format=lambda x: f"{x:.1e}"))
        if len(ratio):
            low, middle, high = np.quantile(ratio, [0.0, 0.5, 1.0])
            print(f"indicator over true error, modes above 1e-6: {low:.2f} .. {middle:.2f} .. {high:.2f}")
        print(f"full {full:.2f} ms, reduced {small:.2f} ms: {full / small:.1f} times faster")
    modes = reduced.modes({}, COUNT)
    reduced.indicator({}, modes)
    start = time.perf_counter()
    for _ in range(50):
        reduced.indicator({}, modes)
    print(f"\nindicator {20 * (time.perf_counter() - start):.2f} ms a point")


if __name__ == "__main__":
    with threadpool_limits(1):
        main()
