"""Synthetic FRF test of the vehicle of ``studies/vehicle``: the same true values under two exciters.

    python studies/vehicle_frf/make_twin.py TRUTH.json

The twin has every edge of its shells halved, finer beams and distributed masses; its sensors sit up to 5 mm off their
nominal places, anew, since it is a test of its own. The true values are written to TRUTH.json, which no analysis reads.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from calib.study.loading import module_of
from models.railway import vehicle

HERE = Path(__file__).resolve().parent

frf_twin = module_of(HERE.parent / "frf_twin.py")
modal = module_of(HERE.parent / "vehicle" / "make_twin.py")

EXCITERS = ("201y", "226y")
"""At a rear corner of the car, and at one end of a girder of the front bogie: bouncing, rolling and pitching of all."""
LINES = 0.5 + 0.2 * np.arange(36)
"""Hz; the suspended modes, which are damped by 18 to 40 %, up to below the car's first flexible mode."""
SHARE = 0.01
FLOOR = 3e-7
"""m/(N s2), a hundredth of a usual function."""
STREAM = 58
"""Second seed of places and noise, beside that of the twin."""


def main() -> None:
    """Write truth and repeats; arguments from the command line."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("truth", type=Path, help="where the hidden values are written")
    arguments.add_argument("--seed", type=int, default=1, help="first seed tried (default 1)")
    arguments.add_argument("--into", type=Path, default=HERE / "measured", help="folder for the repeats")
    given = arguments.parse_args()
    found, layout = modal.drawn(given.seed), modal.sensors()
    named = {sensor.name: sensor for sensor in layout}
    test = frf_twin.FRFTest(
        LINES, layout, tuple(named[name] for name in EXCITERS), "accelerance", share=SHARE, floor=FLOOR
    )
    rng = np.random.default_rng([found.seed, STREAM])
    places = modal.bogie.moved(layout, rng)
    simulated = frf_twin.simulate(vehicle(refine=2, distributed=True), found.truth, test, rng, places)
    frf_twin.write(simulated, given.into, "vehicle test")
    modal.bogie.write_truth(given.truth, modal.MODES, found)


if __name__ == "__main__":
    main()
