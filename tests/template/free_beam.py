"""A beam that is modelled free and was measured on soft springs, with a library of effects that the model may lack.

A study copies this file as its ``beam.py``; tests call `write_study` and never tell the study what was hidden.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import scipy.sparse as sp

from calib.measurement.modal import Sensor
from calib.problem.effect import Effect
from calib.problem.space import Parameter, ParameterSpace
from calib.structure.affine import AffineMatrix, Term, parameter
from calib.structure.effects.extend import Addition, extend
from calib.structure.model import StructuralModel
from models.fem.discrete import FrameLocator, PointMass, mass_matrix
from models.fem.frame import Frame, Member
from models.fem.section import Section

LENGTH = 4.0
TRUTH = {"E": 206.0, "m_end": 11.0}
PLACES = (0.0, 0.6, 1.3, 2.0, 2.7, 3.4, 4.0)
STD_FREQ, STD_SHAPE = 0.002, 0.02
STUDY = """\
title = "A free beam that may stand on something"
model = "beam.py:beam"
effects = "beam.py:library"
selection = ["E", "m_end"]

[measurement]
files = ["modes.csv"]
shapes = ["shapes.csv"]
sensors = "sensors.csv"
std_of = "mean"
synthetic = true

[pairing]
mode_count = 10
freq_window = [0.5, 600.0]

[calibration]
method = "gauss-newton"
cases = [{ name = "A1", seed = 1 }]
"""


def library() -> tuple[Effect, ...]:
    """Soft springs under both ends, masses, and a spring that holds one end sideways."""
    return (
        _one("tool", "Tool at a third", ((1.3, (0, 1, 2), 1.0),), "mass", "kg", 5.0, 60.0),
        _one("box", "Box in the middle", ((2.0, (0, 1, 2), 1.0),), "mass", "kg", 5.0, 60.0),
        _one("supports", "Soft springs under both ends", ((0.6, (1, 2), 1.0), (3.4, (1,), 1.0), (3.4, (2,), 0.5)),
             "stiffness", "N/m", 3e5, 1e8),
        _one("hose", "Hose that holds the end sideways", ((4.0, (2,), 1.0),), "stiffness", "N/m", 1e4, 1e6),
    )  # fmt: skip


def _one(
    name: str, title: str, at: tuple[tuple[float, tuple[int, ...], float], ...], kind: str, unit: str, size: float,
    upper: float,
) -> Effect:  # fmt: skip
    def build(model):
        rows = [
            np.sqrt(share) * model.locator.row((x, 0.0, 0.0), axis, "beam")[0] for x, axes, share in at for axis in axes
        ]
        matrix = sp.csr_array(sum(np.outer(row, row) for row in rows))
        return Addition(**{kind: (Term(name, matrix, parameter(name)),)})

    magnitude = Parameter(name, 0.0, 0.0, upper, unit, prior_sd=size)
    return Effect(name, title, "It is left out.", "Look there.", magnitude, build)


def beam(element_size: float = 0.25) -> StructuralModel:
    """Young's modulus and a mass at the end; nothing holds it."""
    space = ParameterSpace(
        (
            Parameter("E", 210.0, 180.0, 240.0, "GPa", prior_sd=6.0),
            Parameter("m_end", 10.0, 5.0, 20.0, "kg", prior_sd=2.0),
        )
    )
    tube = Section(area=4.0e-3, i_y=4.0e-6, i_z=7.0e-6, torsion=6.0e-6, young_modulus=1.0, density=7850.0)
    ends = (0.0, 0.0, 0.0), (LENGTH, 0.0, 0.0)
    frame = Frame(members=(Member("beam", "tube", tube, *ends, element_size, up=(0.0, 1.0, 0.0)),))
    dofs = frame.dof_map()

    def over_free_dofs(matrix):
        return (dofs.expansion.T @ matrix @ dofs.expansion).tocsr()

    stiffness, mass = (over_free_dofs(m) for m in frame.beams())
    end = over_free_dofs(mass_matrix(frame, [PointMass(("beam", ends[1]), 1.0)]))
    n = dofs.n_dof
    return StructuralModel(
        name="beam",
        space=space,
        stiffness=AffineMatrix(n, (Term("tube", stiffness, parameter("E")),)),
        damping=AffineMatrix(n, ()),
        mass=AffineMatrix(n, (Term("tube", mass), Term("end", end, parameter("m_end")))),
        mesh=frame.mesh(),
        dofs=dofs,
        clusters={},
        locator=FrameLocator(frame, dofs.expansion),
    )


def sensors() -> tuple[Sensor, ...]:
    """Two directions at seven places."""
    return tuple(Sensor(k + 1, d, (x, 0.0, 0.0), "beam") for k, x in enumerate(PLACES) for d in "yz")


def write_study(folder: Path, hidden: Mapping[str, float], count: int = 9, seed: int = 1) -> Path:
    """A study measured on a beam of other elements, with what is hidden: its lowest modes that move the sensors."""
    folder.mkdir(parents=True)
    shutil.copy(__file__, folder / "beam.py")
    (folder / "study.toml").write_text(STUDY, encoding="utf-8")
    twin = extend(beam(0.09), [e for e in library() if e.name in hidden])
    modes = twin.modes({**TRUTH, **hidden}, count + 6)
    moves = twin.sensor_rows(sensors()) @ modes.shapes
    seen = np.flatnonzero(np.abs(moves).max(axis=0) > 0.05 * np.abs(modes.shapes).max(axis=0))[:count]
    rng = np.random.default_rng(seed)
    head = "# SYNTHETIC data of another mesh, with standard deviation.\n"
    rows, lines = ["mode,freq,freq_kind,freq_std"], ["mode,node,direction,re,im,std"]
    for k, j in enumerate(seen, start=1):
        freq, shape = modes.natural_freq[j], moves[:, j] / moves[np.argmax(np.abs(moves[:, j])), j]
        rows.append(f"M{k},{freq * (1 + STD_FREQ * rng.standard_normal()):.6f},natural,{STD_FREQ * freq:.6f}")
        shape = shape + STD_SHAPE * rng.standard_normal(len(shape))
        lines += [f"M{k},{s.node},{s.direction},{v:.6f},0,{STD_SHAPE}" for s, v in zip(sensors(), shape, strict=True)]
    (folder / "modes.csv").write_text(head + "\n".join(rows) + "\n", encoding="utf-8")
    (folder / "shapes.csv").write_text(head + "\n".join(lines) + "\n", encoding="utf-8")
    places = ["node,x,y,z,on", *(f"{k + 1},{x},0.0,0.0,beam" for k, x in enumerate(PLACES))]
    (folder / "sensors.csv").write_text("\n".join(places) + "\n", encoding="utf-8")
    return folder
