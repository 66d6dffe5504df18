"""Synthetic FRF test of the solar array with framed panels.

    python studies/solar_panel_framed/make_twin.py TRUTH.json

The twin differs from the fitted model (no inverse crime): the edges of its plates and beams are a quarter as long, and
it has structural damping, where the model has damping ratios. Its Young's moduli are those of the article's example, as
in ``studies/solar_panel``; ``--free`` draws each between 0.7 and 1.6 times the nominal one. What a test of a real array
would have besides is assumed: a loss factor of 0.01 (a damping ratio of 0.5 %), a shaker at the corner node 1, a
stepped sine with seven lines around each of the ten resonances below 80 Hz, accelerometers of 5 g at the article's
twelve nodes, gains within 1 % and phases within 0.5 degree (standard deviations), and noise of 1 % of the modulus with
a floor.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from calib import Sensor, StructuralModel
from calib.study.loading import module_of
from models.solar_panel import GROUPS, MASTERS, solar_panel

HERE = Path(__file__).resolve().parent

twin = module_of(HERE.parent / "frf_twin.py")

FACTORS = dict(zip(GROUPS, module_of(HERE.parent / "solar_panel/article.py").FACTORS, strict=True))
"""Of the Young's moduli."""
FREE = (0.7, 1.6)
"""Between which they are drawn instead."""
FRAME = 0.02
"""Side of the bars round the panels, m."""
FINE = 4
LOSS_FACTOR = 0.01
HIGHEST = 80.0
"""Hz."""
STEPS = (-3.0, -1.5, -0.6, 0.0, 0.6, 1.5, 3.0)
"""Of the sine around a resonance, over half its half-power width."""
FLOOR = 5e-4
"""m/(N s2)."""


def structure() -> StructuralModel:
    """The array that is measured."""
    return solar_panel(FINE, frame=FRAME)


def test(array: StructuralModel, values: Mapping[str, float]) -> twin.FRFTest:
    """Deflections at the article's nodes around the resonances of an array."""
    points = solar_panel().mesh.points
    sensors = {node: Sensor(node, "z", tuple(float(c) for c in points[node - 1])) for node in MASTERS}
    freq = [f for f in array.modes(values, 14).natural_freq.tolist() if f < HIGHEST]
    lines = {round(f * (1 + step * LOSS_FACTOR / 2), 4) for f in freq for step in STEPS}
    return twin.FRFTest(
        np.array(sorted(lines)), tuple(sensors.values()), (sensors[1],), "accelerance", share=0.01, floor=FLOOR,
        loss_factor=LOSS_FACTOR, gain=0.01, phase=0.5, accelerometer=0.005,
    )  # fmt: skip


def drawn(array: StructuralModel, rng: np.random.Generator) -> dict[str, float]:
    """Young's moduli of which nothing is chosen, GPa."""
    return {name: float(rng.uniform(*FREE)) * array.space[name].value for name in GROUPS}


def main() -> None:
    """Write truth and repeats; arguments from the command line."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("truth", type=Path, help="where the hidden values are written")
    arguments.add_argument("--seed", type=int, default=1, help="of gains, phases and noise (default 1)")
    arguments.add_argument("--free", action="store_true", help="draw the moduli by the seed too")
    arguments.add_argument("--into", type=Path, default=HERE / "measured", help="folder for the repeats")
    given = arguments.parse_args()
    array, rng = structure(), np.random.default_rng(given.seed)
    values = {name: factor * array.space[name].value for name, factor in FACTORS.items()}
    if given.free:
        values = drawn(array, rng)
    simulated = twin.simulate(array, values, test(array, values), rng)
    twin.write(simulated, given.into, "solar array with framed panels")
    freq = array.modes(values, 10).natural_freq.tolist()
    content = {"seed": given.seed, "parameters": values, "natural_freq": freq, **simulated.truth()}
    given.truth.parent.mkdir(parents=True, exist_ok=True)
    given.truth.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
