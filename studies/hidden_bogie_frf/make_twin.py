"""Synthetic FRF test of the bogie of ``studies/hidden_bogie``: the same twin, effect and sensors under two shakers.

    python studies/hidden_bogie_frf/make_twin.py TRUTH.json

The twin has a mesh six times finer than the model's default one, distributed masses, and sensors up to 5 mm off their
nominal places; its only damping is that of the primary dampers and of what may be hidden. The true values are written
to TRUTH.json, which no analysis reads.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from calib.study.loading import module_of

HERE = Path(__file__).resolve().parent

frf_twin = module_of(HERE.parent / "frf_twin.py")
modal = module_of(HERE.parent / "hidden_bogie" / "make_twin.py")

SHAKERS = ("102y", "115x")
"""Off the middle of the frame, and along a front axle box: together they excite every mode below 45 Hz."""
LINES = 6.0 + 0.4 * np.arange(101)
"""Hz; from below the first mode of the frame to above the bending of the rear axle."""
SHARE = 0.01
FLOOR = 2e-5
"""m/(N s2), a hundredth of a usual function."""
ELEMENT_SIZE = 0.0125
"""m, of the twin; half that of the modal test's twin, and less than half that of the fitted model."""
STREAM = 58
"""Second seed of the noise, beside that of the twin: the modal test of the same twin has its own."""


def main() -> None:
    """Write truth and repeats; arguments from the command line."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("truth", type=Path, help="where the hidden values are written")
    arguments.add_argument("--into", type=Path, default=HERE / "measured", help="folder for the repeats")
    given = arguments.parse_args()
    specimen = modal.specimen()
    found = modal.blind.drawn(specimen, modal.KINDS["effect"])
    named = {sensor.name: sensor for sensor in specimen.layout}
    test = frf_twin.FRFTest(
        LINES, specimen.layout, tuple(named[name] for name in SHAKERS), "accelerance", share=SHARE, floor=FLOOR
    )
    rng = np.random.default_rng([found.seed, STREAM])
    structure = modal.specimen(element_size=ELEMENT_SIZE).structure(found.effects)
    simulated = frf_twin.simulate(structure, found.values, test, rng, found.places)
    frf_twin.write(simulated, given.into, "bogie test")
    modal.blind.write_truth(given.truth, {**found.truth(specimen), **simulated.truth()})


if __name__ == "__main__":
    main()
