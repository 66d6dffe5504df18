"""Synthetic measurement of the air supply unit, as a workshop has it: one run, one file, no standard deviation.

    python studies/hidden_bushing/make_twin.py TRUTH.json

The twin is not the fitted model: its elements are three times shorter, every bush is a ring of three springs, and
sensors sit up to 5 mm off. True parameters are normal about their nominal values with half their prior standard
deviations. A seed draws which of the eight effects of the bushes is hidden and its magnitude; it is built into the ring
of that bush, where a crack opens on one side. The first seed is taken whose effect changes the data by at least 8
standard deviations that no parameter can explain (``visible`` in ``studies/blind_twin.py``) while all nine modes are
there; no result of a search enters. The noise of the one run is 0.5 % of the natural frequency, 10 % of the damping
ratio and 3 % of a shape's largest amplitude. TRUTH.json is read by no analysis.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from calib import Sensor, StructuralModel
from calib.measurement.files.uff_write import write_uff
from calib.study.loading import module_of
from models.compressor import (
    BEARERS,
    BUSH_X,
    RAIL_Y,
    SIDEWAYS,
    UPRIGHT,
    bushes,
    compressor_set,
)
from models.compressor_effects import compressor_effects
from models.fem.discrete import Spring

HERE = Path(__file__).resolve().parent

blind = module_of(HERE.parent / "blind_twin.py")

MODES = tuple(f"M{k}" for k in range(1, 10))
STD_FREQ, STD_DAMPING, STD_SHAPE = 0.005, 0.10, 0.03
ELEMENT = 0.04
RING, UNEVEN = 0.03, 0.3
"""Radius of the ring of a bush in m, and how much more than the mean the open side of a crack loses."""


def sensors() -> tuple[Sensor, ...]:
    """Eleven accelerometers of three axes: corners and middles of the frame, tops and ends of the machines."""
    rail = [(x, y, 0.0) for y in (RAIL_Y, -RAIL_Y) for x in (BUSH_X, 0.0, -BUSH_X)]
    places = [(p, "rail") for p in rail] + [((BEARERS["middle front"], 0.0, 0.0), "bearer middle front")]
    places += [((x, 0.0, 0.45), "compressor") for x in (-0.5, -0.14)] + [((x, 0.0, 0.34), "motor") for x in (0.2, 0.5)]
    return tuple(Sensor(k + 1, axis, place, on) for k, (place, on) in enumerate(places) for axis in "xyz")


def ring(spring: Spring, lost: float) -> list[Spring]:
    """A bush as three springs on a circle, without a share of its stiffness, more of it on one side."""
    body, (x, y, z) = spring.end
    shares = 1 - lost * (1 + UNEVEN * np.array([1.0, 0.0, -1.0]))
    turns = np.arange(3) * 2 * np.pi / 3
    return [
        replace(spring, end=(body, (x + RING * np.cos(t), y + RING * np.sin(t), z)), weight=max(share, 0.0) / 3)
        for t, share in zip(turns.tolist(), shares.tolist(), strict=True)
    ]


def unit(names: Sequence[str] = (), values: Mapping[str, float] | None = None) -> StructuralModel:
    """The unit of rings, with named effects of its bushes built into them."""
    springs, dampers = [], []
    for spring in (*bushes(UPRIGHT), *bushes(SIDEWAYS)):
        corner = "_".join(spring.name.split(",")[0].split()[1:])
        loose, dead = (f"{kind}_{corner}" for kind in ("loose_bush", "dead_damper"))
        lost = 0.01 * (values or {})[loose] if loose in names else 0.0
        fluid = 0.01 * (values or {})[dead] if dead in names and spring.direction[2] else 0.0
        springs += ring(spring, lost)
        dampers += ring(spring, max(lost, fluid))
    return compressor_set(ELEMENT, tuple(springs), tuple(dampers))


def specimen() -> blind.Specimen:
    """The unit for the maker of blind studies; only effects of the bushes may be hidden."""
    base, layout = compressor_set(), sensors()
    nominal = base.sensor_rows(layout) @ base.modes(base.space.values, len(MODES)).shapes
    library = tuple(e for e in compressor_effects() if e.name.startswith(("loose_bush", "dead_damper")))
    return blind.Specimen(
        file=HERE / "study.toml", base=base, fine=unit(), library=library, outside=(), modes=MODES, layout=layout,
        nominal=nominal, built=unit,
    )  # fmt: skip


def drawn(whole: blind.Specimen) -> blind.Drawn:
    """The twin of the first seed that meets the criteria."""
    for seed in range(1, 1000):
        rng = np.random.default_rng(seed)
        values = whole.draw(rng)
        effect = whole.library[int(rng.integers(len(whole.library)))]
        values |= blind.draw_effect(effect, float(rng.uniform(*blind.MAGNITUDES)), rng)
        places = blind.twin.moved(whole.layout, rng)
        names, modes, shapes = whole.solved((effect,), values, places)
        if names != whole.modes:
            continue
        size = blind.visible(whole.problem(whole.noiseless(names, modes, shapes)), whole.space, [effect], values)
        if size >= blind.VISIBLE[0]:
            return blind.Drawn(seed, (effect,), values, [size], modes, shapes, places, rng)
    raise SystemExit("no seed gave a visible effect")


def write_run(into: Path, found: blind.Drawn, layout: Sequence[Sensor]) -> None:
    """Write one noisy run without standard deviations, and the table of sensors."""
    into.mkdir(parents=True, exist_ok=True)
    rng, modes = found.rng, found.modes
    shapes = found.shapes / blind.turn(found.shapes) / np.abs(found.shapes).max(axis=0)
    noise = rng.standard_normal(shapes.shape) + 1j * rng.standard_normal(shapes.shape)
    write_uff(
        into / "run_1.uff", names=MODES,
        natural_freq=modes.natural_freq * np.exp(STD_FREQ * rng.standard_normal(modes.n_modes)),
        damping_ratio=modes.damping_ratio * np.exp(STD_DAMPING * rng.standard_normal(modes.n_modes)),
        sensors=layout, shapes=shapes + STD_SHAPE * noise, title="SYNTHETIC twin of the air supply unit, run 1",
    )  # fmt: skip
    known = {s.node: s for s in layout}
    rows = [{"node": n, **dict(zip("xyz", s.point or (), strict=True)), "on": s.on} for n, s in known.items()]
    pd.DataFrame(rows).to_csv(into / "sensors.csv", index=False)


def main() -> None:
    """Draw, measure once and write; arguments from the command line."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("truth", type=Path, help="where the hidden values are written")
    given = arguments.parse_args()
    whole = specimen()
    found = drawn(whole)
    write_run(HERE / "measured", found, whole.layout)
    frequencies = dict(zip(MODES, found.modes.natural_freq.tolist(), strict=True))
    damping = dict(zip(MODES, found.modes.damping_ratio.tolist(), strict=True))
    blind.write_truth(given.truth, {**found.truth(whole), "natural_freq": frequencies, "damping_ratio": damping})
    print(f"seed {found.seed}")


if __name__ == "__main__":
    main()
