"""Synthetic measurement of the bogie on its rig: a twin of the test, since no raw data were published.

    python studies/bogie/make_twin.py TRUTH.json

The twin differs from the fitted model (no inverse crime): its mesh is three times finer, its masses are distributed
instead of lumped, and its sensors sit up to 5 mm off their nominal places. Its parameter values are drawn by a seed
and written to TRUTH.json, which nothing under ``calib``, ``models`` or ``studies`` reads: those that enter the search
within its limits, left-out ones anywhere within theirs. Integers that are left out and parameters that the case study
calls deterministic keep their nominal values, as an analysis takes them to be exact.

Seeds are tried in turn until the initial model is off by about as much as in the case study (10.6 % mean frequency
error), the primary springs are stiffer than first assumed (as found there), and all eight modes can be identified. A
free twin (``--free``) only has to meet the last of these.

The standard deviation of the *mean* of the five repeats is 0.5 % of the natural frequency, 7 % of the damping ratio and
2.5 % of the shape's largest modulus in real and imaginary part; that of one repeat is sqrt(5) times as large.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from calib import ParameterSpace, Sensor, StructuralModel
from calib.measurement.files.uff_write import write_uff
from calib.measurement.mac import mac
from calib.problem.sampling import sample
from calib.structure import Modes
from calib.study.limits import search_space, sensitivity_space
from calib.study.study_text import read_settings
from models.railway import bogie_on_rig

HERE = Path(__file__).resolve().parent
MODES = tuple(f"{k}BT" for k in range(1, 9))
REPEATS = 5
STD_FREQ, STD_DAMPING, STD_SHAPE = 0.005, 0.07, 0.025
SENSOR_ERROR = 0.005
INITIAL_ERROR = (0.103, 0.109)


def sensors() -> tuple[Sensor, ...]:
    """The 30 measured directions with their nominal places (m) and the parts that carry them.

    Four of them sit on the outer arms of the axle boxes: only the rotation of the boxes separates the upper from the
    lower connecting rods, which act on all wheelset frequencies in nearly the same proportion.
    """
    places: list[tuple[str, tuple[float, float, float], str]] = []
    for z in (1.05, -1.05):
        places += [("y", (x, 0.62, z), "frame") for x in (-2.005, -1.115, 0.0, 1.115, 2.005)]
    places += [("y", (x, 0.62, z), "crossbar") for x in (-1.115, 1.115) for z in (1.315, -1.315)]
    for end, x in (("front", 1.45), ("rear", -1.45)):
        places += [("x", (x, 0.43, z), f"box_{end}_{side}") for side, z in (("left", 1.05), ("right", -1.05))]
    for end, x in (("front", 1.45), ("rear", -1.45)):
        places += [("x", (x, 0.43, z), f"axle_{end}") for z in (0.87, -0.87)]
    for side, z in (("left", 1.17), ("right", -1.17)):
        places += [("y", (x, 1.05, z), f"block_{side}") for x in (-0.28, 0.28)]
    for end, x in (("front", 1.73), ("rear", -1.73)):
        places += [("y", (x, 0.43, z), f"box_{end}_{side}") for side, z in (("left", 1.05), ("right", -1.05))]
    return tuple(Sensor(101 + k, d, point, on) for k, (d, point, on) in enumerate(places))


def moved(layout: tuple[Sensor, ...], rng: np.random.Generator) -> tuple[Sensor, ...]:
    """The sensors at their true places, displaced within a ball of 5 mm."""
    out = []
    for sensor in layout:
        step = rng.standard_normal(3)
        step *= SENSOR_ERROR * rng.random() ** (1 / 3) / np.linalg.norm(step)
        assert sensor.point is not None
        x, y, z = np.add(sensor.point, step)
        out.append(Sensor(sensor.node, sensor.direction, (float(x), float(y), float(z)), sensor.on))
    return tuple(out)


def draw(space: ParameterSpace, selected: ParameterSpace, rng: np.random.Generator) -> dict[str, float]:
    """True values: selected parameters within the search, other uncertain ones within their limits."""
    truth = selected.complete(sample(selected, 1, int(rng.integers(2**31))).points[0])
    for p in space.parameters:
        if p.name not in selected.free_names and not p.integer and p.distribution != "fixed":
            truth[p.name] = float(rng.uniform(p.lower, p.upper))
    return truth


def eight_modes(twin: StructuralModel, truth: dict[str, float], nominal: np.ndarray, rows: np.ndarray) -> Modes | None:
    """The twin's modes in the order of the nominal shapes; None when they cannot be identified."""
    modes = twin.modes(truth, 10)
    similar = mac(nominal, rows @ modes.shapes)
    best = similar.argmax(axis=1)
    if len(set(best)) < len(MODES) or similar.max(axis=1).min() < 0.6:
        return None
    return modes.subset(best)


def noisy(modes: Modes, shapes: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """One repeat with noise: frequencies, damping, complex shapes (n_sensors, n_modes) of arbitrary phases."""
    grow = np.sqrt(REPEATS)
    natural = modes.natural_freq * np.exp(STD_FREQ * grow * rng.standard_normal(modes.n_modes))
    damping = modes.damping_ratio * np.exp(STD_DAMPING * grow * rng.standard_normal(modes.n_modes))
    shapes = shapes / np.abs(shapes).max(axis=0)
    noise = rng.standard_normal(shapes.shape) + 1j * rng.standard_normal(shapes.shape)
    return natural, damping, (shapes + STD_SHAPE * grow * noise) * np.exp(2j * np.pi * rng.random(modes.n_modes))


def write_measurement(
    into: Path,
    names: tuple[str, ...],
    modes: Modes,
    shapes: np.ndarray,
    layout: tuple[Sensor, ...],
    rng: np.random.Generator,
    title: str = "bogie test",
) -> None:
    """Write all repeats of a test and the table of its sensors."""
    into.mkdir(parents=True, exist_ok=True)
    for k in range(1, REPEATS + 1):
        path = into / f"repeat_{k}.uff"
        natural, damping, complex_shapes = noisy(modes, shapes, rng)
        write_uff(
            path, names=names, natural_freq=natural, damping_ratio=damping, sensors=layout, shapes=complex_shapes,
            title=f"SYNTHETIC twin of the {title}, {path.stem}",
        )  # fmt: skip
    pd.DataFrame(
        [{"node": s.node, "x": s.point[0], "y": s.point[1], "z": s.point[2], "on": s.on} for s in layout if s.point]
    ).to_csv(into / "sensors.csv", index=False)


class Twin(NamedTuple):
    """A twin with its true values, before it is measured.

    Attributes
    ----------
    seed : int
    truth : dict from parameter name to value
    error : float
        Mean frequency error of the initial model.
    modes : Modes
    shapes : ndarray (n_sensors, n_modes)
        At the true places of the sensors.
    layout : tuple of Sensor
        Nominal places of the sensors.
    rng : Generator
        Generator of the measurement noise.
    """

    seed: int
    truth: dict[str, float]
    error: float
    modes: Modes
    shapes: np.ndarray
    layout: tuple[Sensor, ...]
    rng: np.random.Generator


def drawn(first: int = 1, free: bool = False) -> Twin:
    """The twin of the first seed, from a given one on, that meets the criteria; a free one only needs its modes."""
    twin = bogie_on_rig(element_size=0.025, distributed=True)
    settings = read_settings(HERE / "study.toml")
    space = sensitivity_space(twin.space, settings, lambda *keys: "study.toml", {})
    selected = search_space(space, settings, lambda *keys: "study.toml")
    layout = sensors()
    initial = bogie_on_rig().modes(space.values, len(MODES))
    nominal = bogie_on_rig().sensor_rows(layout) @ initial.shapes
    least, most = (0.0, np.inf) if free else INITIAL_ERROR
    for seed in range(first, first + 10_000):
        rng = np.random.default_rng(seed)
        truth = draw(space, selected, rng)
        if not free and truth["K_primary"] <= space["K_primary"].upper:
            continue
        rows = twin.sensor_rows(moved(layout, rng))
        modes = eight_modes(twin, truth, nominal, rows)
        if modes is not None:
            error = float(np.abs(initial.natural_freq / modes.natural_freq - 1).mean())
            if least <= error <= most:
                return Twin(seed, truth, error, modes, rows @ modes.shapes, layout, rng)
    raise SystemExit("no seed gave an initial model as far off as in the case study")


def write_truth(path: Path, names: tuple[str, ...], twin: Twin) -> None:
    """Write the true values behind a measurement to a file that no analysis reads."""
    content = {
        "seed": twin.seed,
        "parameters": twin.truth,
        "natural_freq": dict(zip(names, twin.modes.natural_freq.tolist(), strict=True)),
        "damping_ratio": dict(zip(names, twin.modes.damping_ratio.tolist(), strict=True)),
        "initial_mean_freq_error": twin.error,
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    print(f"seed {twin.seed}: the initial model's mean frequency error is {100 * twin.error:.1f} %")


def write_twin(
    what: str, home: Path, names: tuple[str, ...], draw_from: Callable[[int, bool], Twin], title: str = "bogie test"
) -> None:
    """Draw true values, measure the twin five times, write truth and repeats; arguments from the command line.

    Parameters
    ----------
    what : str
        What the command does, one sentence.
    home : Path
        Folder of the study.
    names : tuple of str
        Names of the modes.
    draw_from : callable
        Gives the twin of the first seed, from a given one on, that meets the criteria; a free one where that is asked.
    title : str
    """
    arguments = argparse.ArgumentParser(description=what)
    arguments.add_argument("truth", type=Path, help="where the hidden values are written")
    arguments.add_argument("--seed", type=int, default=1, help="first seed tried (default 1)")
    arguments.add_argument("--into", type=Path, default=home / "measured", help="folder for the repeats")
    arguments.add_argument("--free", action="store_true", help="whatever the error of the initial model")
    given = arguments.parse_args()
    twin = draw_from(given.seed, given.free)
    write_measurement(given.into, names, twin.modes, twin.shapes, twin.layout, twin.rng, title)
    write_truth(given.truth, names, twin)


if __name__ == "__main__":
    write_twin((__doc__ or "").splitlines()[0], HERE, MODES, drawn)
