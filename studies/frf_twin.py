"""Synthetic FRF tests: a structure with its transducers, measured several times with noise, in universal files.

The structure is never the model that is fitted: it has another mesh, and may have structural damping. Its functions
are solved here, line by line, and not by the code that fits them:

    H = R [K (1 + i eta) + i omega C - omega^2 (M + M_a)]^-1 F^T (i omega)^n

with the masses M_a of the accelerometers in all three directions. Errors that all repeats share are a relative gain
and a phase of each transducer, drawn once; each repeat has its own normal noise in real and imaginary part, of the
standard deviation ``sqrt((share |H|)^2 + floor^2)`` of the noise-free function.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from calib import Sensor, StructuralModel
from calib.measurement.files.uff_frf_write import Form, write_uff_frfs
from calib.measurement.frf import MeasuredFRFs, Quantity
from calib.structure.frf import motion_factor


@dataclass(frozen=True, eq=False)
class FRFTest:
    """How a structure is measured.

    Attributes
    ----------
    freq : ndarray (n_freq,)
        Hz.
    responses, references : tuple of Sensor
        Nominal places, as the table of sensors states them.
    quantity : {"receptance", "mobility", "accelerance"}
    share, floor : float
        Standard deviation of one repeat, in real and imaginary part each: over the modulus, and in the quantity's unit.
    repeats : int
    loss_factor : float
        eta of the structure's stiffness; its dashpots are its own.
    gain, phase : float
        Standard deviations of the transducers' errors: relative, and in degrees.
    accelerometer : float
        Mass of each response sensor, kg; all are mounted in all repeats.
    """

    freq: np.ndarray
    responses: tuple[Sensor, ...]
    references: tuple[Sensor, ...]
    quantity: Quantity = "accelerance"
    share: float = 0.01
    floor: float = 0.0
    repeats: int = 5
    loss_factor: float = 0.0
    gain: float = 0.0
    phase: float = 0.0
    accelerometer: float = 0.0


@dataclass(frozen=True, eq=False)
class Simulated:
    """A test that was simulated.

    Attributes
    ----------
    test : FRFTest
    noise_free : ndarray (n_freq, n_responses, n_references), complex
        Of the structure that carries its accelerometers, before errors and noise.
    gain, phase : mapping from the name of a transducer to its error
        Relative, and in degrees; names as ``response 12z``.
    repeats : tuple of MeasuredFRFs
    """

    test: FRFTest
    noise_free: np.ndarray
    gain: Mapping[str, float]
    phase: Mapping[str, float]
    repeats: tuple[MeasuredFRFs, ...]

    def truth(self) -> dict[str, Any]:
        """What no analysis may know, besides the values of the structure's parameters."""
        test = self.test
        return {
            "loss_factor": test.loss_factor,
            "noise": {"share": test.share, "floor": test.floor},
            "gain": dict(self.gain),
            "phase": dict(self.phase),
            "accelerometer": test.accelerometer,
        }


def functions(
    structure: StructuralModel, values: Mapping[str, float], test: FRFTest, places: Sequence[Sensor] | None = None
) -> np.ndarray:
    """Noise-free functions of a structure that carries its accelerometers.

    Parameters
    ----------
    structure : StructuralModel
    values : mapping
        Its parameters, each in its unit.
    test : FRFTest
    places : sequence of Sensor, optional
        Where the response sensors truly sit; nominal without. A force acts where the sensor of its name sits.

    Returns
    -------
    ndarray (n_freq, n_responses, n_references), complex
    """
    mounted = test.responses if places is None else tuple(places)
    true = {sensor.name: sensor for sensor in mounted}
    acting = [true.get(reference.name, reference) for reference in test.references]
    responses, forces = structure.sensor_rows(mounted), structure.sensor_rows(acting).T.astype(complex)
    stiffness, damping, mass = structure.matrices(values)
    mass = mass + test.accelerometer * _carried(structure, mounted)
    out = []
    for line in test.freq:
        omega = 2 * np.pi * line
        dynamic = (1 + 1j * test.loss_factor) * stiffness + 1j * omega * damping - omega**2 * mass
        out.append(responses @ _solved(sp.csc_matrix(dynamic), forces))
    return np.array(out) * motion_factor(test.quantity, test.freq)[:, None, None]


def _solved(dynamic: sp.csc_matrix, forces: np.ndarray) -> np.ndarray:
    """Solution with pivots near the diagonal, which keep the factor of a large structure sparse, and one refinement."""
    factor = spla.splu(dynamic, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.01, options={"SymmetricMode": True})
    first = factor.solve(forces)
    return np.asarray(first + factor.solve(forces - dynamic @ first))


def _carried(structure: StructuralModel, mounted: Sequence[Sensor]) -> sp.csr_array:
    """Mass matrix of 1 kg at each node with a sensor; motions that the model suppresses take no part."""
    at = {sensor.node: sensor for sensor in mounted}
    moved = sp.csr_array(np.vstack([structure.translations(sensor) for sensor in at.values()]))
    return sp.csr_array(moved.T @ moved)


def simulate(
    structure: StructuralModel,
    values: Mapping[str, float],
    test: FRFTest,
    rng: np.random.Generator,
    places: Sequence[Sensor] | None = None,
) -> Simulated:
    """Measure a structure; see `functions` for the arguments."""
    true = functions(structure, values, test, places)
    ends = [[f"response {s.name}" for s in test.responses], [f"reference {s.name}" for s in test.references]]
    gain, phase = ([size * rng.standard_normal(len(names)) for names in ends] for size in (test.gain, test.phase))
    factor = [(1 + g) * np.exp(1j * np.radians(p)) for g, p in zip(gain, phase, strict=True)]
    seen = true * factor[0][:, None] * factor[1]
    size = np.hypot(test.share * np.abs(true), test.floor)
    repeats = []
    for _ in range(test.repeats):
        noise = size * (rng.standard_normal(true.shape) + 1j * rng.standard_normal(true.shape))
        repeats.append(MeasuredFRFs(
            test.freq, test.responses, test.references, test.quantity, seen + noise, np.full(true.shape, np.nan),
            synthetic=True,
        ))  # fmt: skip
    named = [dict(zip((*ends[0], *ends[1]), np.concatenate(errors).tolist(), strict=True)) for errors in (gain, phase)]
    return Simulated(test, true, *named, tuple(repeats))


def write(simulated: Simulated, into: Path, title: str, form: Form = "single") -> None:
    """Write one universal file a repeat and the table of the nominal places of all transducers."""
    into.mkdir(parents=True, exist_ok=True)
    for k, repeat in enumerate(simulated.repeats, start=1):
        write_uff_frfs(into / f"repeat_{k}.uff", repeat, f"twin of the {title}, repeat {k}", form)
    nodes = {s.node: s for s in (*simulated.test.references, *simulated.test.responses)}
    table = [
        {"node": node, **dict(zip("xyz", nodes[node].point, strict=True)), "on": nodes[node].on}
        for node in sorted(nodes)
    ]
    pd.DataFrame(table).dropna(axis=1, how="all").to_csv(into / "sensors.csv", index=False, float_format="%.6g")
