"""Synthetic FRF test of the solar array with the Young's moduli of Li and Hong (2012).

    python studies/solar_panel/make_twin.py TRUTH.json

The twin differs from the fitted model (no inverse crime): its plates and beams are halved, which lowers its natural
frequencies by up to 3 %, and it has structural damping, where the model has damping ratios. Its Young's moduli are
those of the article's example: 1.2 times the nominal one in the panels, 1.3 and 1.5 times in the beams between the
panels and at the yoke. What the article does not give is assumed: a loss factor of 0.01 (a damping ratio of 0.5 %), a
force at the corner node 1, accelerometers of 5 g at the article's twelve nodes, gains within 1 % and phases within
0.5 degree (standard deviations), and noise of 1 % of the modulus with a floor.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from calib import Sensor
from calib.study.loading import module_of
from models.solar_panel import GROUPS, MASTERS, solar_panel

HERE = Path(__file__).resolve().parent

twin = module_of(HERE.parent / "frf_twin.py")

FACTORS = dict(zip(GROUPS, module_of(HERE / "article.py").FACTORS, strict=True))
"""Of the Young's moduli."""
REFERENCE = 1
LINES = 0.3 * np.arange(1, 201)
"""Hz; seven modes of the array lie below 60 Hz."""
FLOOR = 2e-3
"""m/(N s2): more than the share of the modulus at two fifths of the entries, those between resonances."""


def test() -> twin.FRFTest:
    """Deflections at the article's nodes under a force at a corner, which moves in every mode."""
    points = solar_panel().mesh.points
    sensors = {node: Sensor(node, "z", tuple(float(c) for c in points[node - 1])) for node in MASTERS}
    return twin.FRFTest(
        LINES, tuple(sensors.values()), (sensors[REFERENCE],), "accelerance", share=0.01, floor=FLOOR,
        loss_factor=0.01, gain=0.01, phase=0.5, accelerometer=0.005,
    )  # fmt: skip


def main() -> None:
    """Write truth and repeats; arguments from the command line."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("truth", type=Path, help="where the hidden values are written")
    arguments.add_argument("--seed", type=int, default=1, help="of gains, phases and noise (default 1)")
    arguments.add_argument("--into", type=Path, default=HERE / "measured", help="folder for the repeats")
    given = arguments.parse_args()
    structure = solar_panel(2)
    values = {name: factor * structure.space[name].value for name, factor in FACTORS.items()}
    simulated = twin.simulate(structure, values, test(), np.random.default_rng(given.seed))
    twin.write(simulated, given.into, "solar array")
    freq = structure.modes(values, 8).natural_freq.tolist()
    content = {"seed": given.seed, "parameters": values, "natural_freq": freq, **simulated.truth()}
    given.truth.parent.mkdir(parents=True, exist_ok=True)
    given.truth.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
