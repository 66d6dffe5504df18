"""Synthetic measurement of the frame: modes of another mesh in CalculiX, with one effect that the study's model lacks.

    python studies/calculix_frame/make_twin.py TRUTH.json

The twin differs from the model (no inverse crime): its plates have three times as many shells, its columns more beams.
TRUTH.json states its parameters and a motor of some mass on the upper plate, which the model does not have; nothing
under ``calib``, ``models`` or ``studies`` reads it otherwise. Five repeats have independent noise: 0.08 % of a
frequency, 0.01 of the largest motion of a shape.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import calib
from calib.study.solver import solver_model
from studies.calculix_frame.make_frame import HEIGHT, SENSORS, frame

HERE = Path(__file__).resolve().parent
COUNT, REPEATS, SEED = 10, 5, 20
FREQ_NOISE, SHAPE_NOISE = 0.0008, 0.01
STEP = "*STEP\n*FREQUENCY\n16\n*NODE PRINT, NSET=SENSORS\nU\n*END STEP\n** {{ nothing }}"
"""The step of the twin; its deck has numbers alone, and a parameter that changes nothing."""


def places() -> list[tuple[float, float, float]]:
    """Measured places, m."""
    return [(x / 1e3, y / 1e3, (0.0 if plate == "base" else HEIGHT) / 1e3) for plate, x, y in SENSORS]


def sensors() -> list[calib.Sensor]:
    """Measured places in all three directions."""
    return [calib.Sensor(k, d, point) for k, point in enumerate(places(), start=1) for d in "xyz"]


def true_modes(truth: dict[str, Any]) -> Any:
    """Modes of the twin without noise."""
    x, y, z = truth["motor"]["at"]
    motor = f"*ELEMENT, TYPE=MASS, ELSET=MOTOR\n900001,NODE {x} {y} {z}\n*MASS, ELSET=MOTOR\n{truth['motor']['mass']}"
    return solved(frame(truth["parameters"], columns=24, rows=16, segments=6, more=motor, step=STEP))


def solved(deck: str) -> Any:
    """Modes of a deck with numbers alone, from CalculiX, at the `sensors`."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "frame.inp").write_text(deck, encoding="utf-8")
        model = solver_model(
            "ccx -i frame", template="frame.inp", modes="frame.dat", sensors=sensors(), n_modes=COUNT, units="mm-t-N",
            parameters=[calib.Parameter("nothing", 0.0, -1.0, 1.0)], folder=folder,
        )  # fmt: skip
        return model.modes({}, COUNT)


def measurement(truth: dict[str, Any]) -> dict[str, pd.DataFrame]:
    """Tables ``modes, shapes, sensors``."""
    found, rng = true_modes(truth), np.random.default_rng(SEED)
    modes, shapes = [], []
    for repeat in range(1, REPEATS + 1):
        for j in range(COUNT):
            label, shape = f"M{j + 1}", found.shapes[:, j] / np.abs(found.shapes[:, j]).max()
            freq = found.natural_freq[j] * (1 + FREQ_NOISE * rng.standard_normal())
            modes.append((repeat, label, round(freq, 4), "natural"))
            noisy = shape + SHAPE_NOISE * rng.standard_normal(len(shape))
            shapes += [(repeat, label, s.node, s.direction, round(e, 4)) for s, e in zip(sensors(), noisy, strict=True)]
    return {
        "modes": pd.DataFrame(modes, columns=["repeat", "mode", "freq", "freq_kind"]),
        "shapes": pd.DataFrame(shapes, columns=["repeat", "mode", "node", "direction", "re"]),
        "sensors": pd.DataFrame([(k, *at) for k, at in enumerate(places(), start=1)], columns=["node", "x", "y", "z"]),
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("truth", type=Path)
    for name, table in measurement(json.loads(parser.parse_args().truth.read_text("utf-8"))).items():
        table.to_csv(HERE / f"{name}.csv", index=False)
