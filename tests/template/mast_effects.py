"""The example's mast with a library of effects that it may lack, and measurements of masts that have them.

A study copies this file as its ``effects.py``; tests call `write_study` and never tell the study what was hidden.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from functools import cache
from importlib import resources
from pathlib import Path
from types import ModuleType

import numpy as np
import scipy.sparse as sp

from calib.command.example import write_example
from calib.measurement.modal import Sensor
from calib.problem.effect import Effect
from calib.problem.space import Parameter
from calib.structure.affine import Term, parameter
from calib.structure.effects.extend import Addition, extend
from calib.study.loading import module_of

TRUTH = {"E": 206.0, "m_top": 46.0, "K_base": 1.8}
HEIGHTS = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
NAMES = ("B1x", "B1z", "B2x", "B2z", "B3x", "B3z")
STD_FREQ, STD_SHAPE = 0.002, 0.02
STUDY = """\
title = "A mast that may lack something"
model = "model.py:mast"
effects = "effects.py:library"
selection = ["E", "m_top", "K_base"]

[measurement]
files = ["modes.csv"]
shapes = ["shapes.csv"]
sensors = "sensors.csv"
std_of = "mean"
synthetic = true

[held_out]
modes = []
sensors = []

[pairing]
mode_count = 10
freq_window = [0.5, 100.0]

[pairing.clusters]
B1x = ["mast.x"]
B1z = ["mast.z"]
B2x = ["mast.x"]
B2z = ["mast.z"]
B3x = ["mast.x"]
B3z = ["mast.z"]

[parameters]
E = { prior_sd = 6.0 }
m_top = { prior_sd = 8.0 }
K_base = { value = 2.0, limits = [0.3, 5.0], search = [0.2, 8.0], prior_sd = 0.4 }

[calibration]
method = "gauss-newton"
cases = [{ name = "A1", seed = 1 }]
"""


def library() -> tuple[Effect, ...]:
    """Two masses, a spring to the ground, and a base that turns harder one way."""
    return (
        _one("platform", "Platform half way up", 3.0, (0, 1, 2), "mass", "kg", 10.0, 100.0),
        _one("lamp", "Lamp near the top", 4.5, (0, 1, 2), "mass", "kg", 10.0, 100.0),
        _one("guy", "Guy rope along x", 4.5, (0,), "stiffness", "N/m", 5e3, 1e5),
        _one("stuck_base", "Base that turns harder about z", 0.0, (5,), "stiffness", "MNm/rad", 0.3, 3.0),
    )


def _one(
    name: str, title: str, height: float, axes: tuple[int, ...], kind: str, unit: str, size: float, upper: float
) -> Effect:
    def build(model):
        rows = [model.locator.row((0.0, height, 0.0), axis, "mast")[0] for axis in axes]
        matrix = sp.csr_array(sum(np.outer(row, row) for row in rows))
        return Addition(**{kind: (Term(name, matrix, parameter(name)),)})

    magnitude = Parameter(name, 0.0, 0.0, upper, unit, prior_sd=size)
    return Effect(name, title, "It is left out.", f"Look at {height:g} m.", magnitude, build)


@cache
def _example() -> ModuleType:
    return module_of(Path(str(resources.files("calib") / "template/model.py.txt")))


def mast(element_size: float = 0.5):
    """The example's model."""
    return _example().mast(element_size=element_size)


def sensors() -> tuple[Sensor, ...]:
    """Two directions at six heights."""
    return tuple(Sensor(k + 1, d, (0.0, y, 0.0), "mast") for k, y in enumerate(HEIGHTS) for d in "xz")


def bending(model, values: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (Hz) and shapes at the sensors of the modes in the order of `NAMES`."""
    modes = model.modes(values, 12)
    shapes = model.sensor_rows(sensors()) @ modes.shapes
    x, z = (np.abs(shapes[[k for k, s in enumerate(sensors()) if s.direction == d]]).sum(0) for d in "xz")
    along, across = np.flatnonzero(x > 3 * z)[:3], np.flatnonzero(z > 3 * x)[:3]
    order = [int(k) for pair in zip(along, across, strict=True) for k in pair]
    return modes.natural_freq[order], shapes[:, order]


@cache
def _exact(hidden: tuple[tuple[str, float], ...]) -> tuple[np.ndarray, np.ndarray]:
    """What `bending` gives of the mast with finer elements and what is hidden."""
    magnitudes = dict(hidden)
    twin = extend(mast(0.1), [e for e in library() if e.name in magnitudes])
    return bending(twin, {**TRUTH, **magnitudes})


def write_study(folder: Path, hidden: Mapping[str, float] | None = None, seed: int = 1, noise: float = 1.0) -> Path:
    """A study whose measurement comes from five times finer elements, with hidden effects of given magnitudes."""
    write_example(folder)
    shutil.copy(__file__, folder / "effects.py")
    (folder / "study.toml").write_text(STUDY, encoding="utf-8")
    freq, shapes = _exact(tuple((hidden or {}).items()))
    rng = np.random.default_rng(seed)
    head = "# SYNTHETIC data of a finer model, with standard deviation.\n"
    rows, lines = ["mode,freq,freq_kind,freq_std"], ["mode,node,direction,re,im,std"]
    for name, f, shape in zip(NAMES, freq, shapes.T, strict=True):
        rows.append(f"{name},{f * (1 + noise * STD_FREQ * rng.standard_normal()):.6f},natural,{STD_FREQ * f:.6f}")
        seen = shape / shape[np.argmax(np.abs(shape))] + noise * STD_SHAPE * rng.standard_normal(len(shape))
        lines += [f"{name},{s.node},{s.direction},{v:.6f},0,{STD_SHAPE}" for s, v in zip(sensors(), seen, strict=True)]
    (folder / "modes.csv").write_text(head + "\n".join(rows) + "\n", encoding="utf-8")
    (folder / "shapes.csv").write_text(head + "\n".join(lines) + "\n", encoding="utf-8")
    places = ["node,x,y,z,on", *(f"{k + 1},0.0,{y},0.0,mast" for k, y in enumerate(HEIGHTS))]
    (folder / "sensors.csv").write_text("\n".join(places) + "\n", encoding="utf-8")
    return folder
