"""A small study of FRFs with a hidden effect, whose tables the list of the documents is held to.

Three masses in a row, the last of which a spring to the ground holds that the model lacks. The measurement is computed
here from matrices of its own; synthetic.
"""

from pathlib import Path

import numpy as np

NODES, FORCES = (1, 2, 3), (1, 3)
FREQ = np.linspace(2.0, 36.0, 24)
MODEL = '''
"""Three masses in a row."""

import numpy as np

import calib
from calib.structure.affine import parameter
from calib.structure.effects.attach import outer_term
from calib.structure.effects.extend import Addition

LINKS = np.array([[1.0, 0.0, 0.0], [-1.0, 1.0, 0.0], [0.0, -1.0, 1.0]])


def chain():
    matrices = {f"k{i}": np.outer(link, link) for i, link in enumerate(LINKS, start=1)}
    return calib.StructuralModel.from_matrices(
        stiffness=matrices,
        mass=np.eye(3),
        damping={"c": sum(matrices.values())},
        dofs=[(1, "x"), (2, "x"), (3, "x")],
        parameters=[
            *(calib.Parameter(f"k{i}", 10.0, 5.0, 20.0, "kN/m", prior_sd=2.0) for i in (1, 2, 3)),
            calib.Parameter("c", 8.0, 1.0, 30.0, "Ns/m"),
        ],
    )


def library():
    def prop(model):
        return Addition(stiffness=(outer_term("prop", [np.array([0.0, 0.0, 1.0])], parameter("prop")),))

    magnitude = calib.Parameter("prop", 0.0, 0.0, 10.0, "kN/m", prior_sd=2.0)
    words = {"phrase": "a prop", "lacks": "The last mass is free.", "look_for": "A prop at the last mass."}
    return (calib.Effect(name="prop", title="Prop", magnitude=magnitude, build=prop, **words),)
'''
STUDY = """
title = "Chain"
model = "model.py:chain"
effects = "model.py:library"

[measurement]
kind = "frf"
files = ["repeat_1.csv", "repeat_2.csv", "repeat_3.csv"]
synthetic = true

[held_out]
sensors = ["2x"]
references = ["3x"]
bands = [[30.0, 36.0]]

[sensitivity]
samples = 20

[calibration]
method = "gauss-newton"
starts = 1
"""


def write(folder: Path) -> None:
    """Write the study into a folder, which is made."""
    folder.mkdir(parents=True)
    (folder / "model.py").write_text(MODEL, "utf-8")
    (folder / "study.toml").write_text(STUDY, "utf-8")
    rng = np.random.default_rng(1)
    true = _receptance(np.array([11e3, 9e3, 10.5e3]), prop=1.5e3, damping=9.0)
    for repeat in (1, 2, 3):
        noise = rng.standard_normal((2, *true.shape)) * (0.01 * np.abs(true) + 1e-7)
        (folder / f"repeat_{repeat}.csv").write_text(_table(true + noise[0] + 1j * noise[1]), "utf-8")


def _receptance(stiffness: np.ndarray, prop: float, damping: float) -> np.ndarray:
    """(n_freq, n_nodes, n_forces), m/N."""
    links = np.eye(3) - np.eye(3, k=-1)
    held = np.diag([0.0, 0.0, prop])
    k, c = links.T @ np.diag(stiffness) @ links + held, damping * links.T @ links
    omega = 2 * np.pi * FREQ
    whole = np.array([np.linalg.inv(k + 1j * w * c - w**2 * np.eye(3)) for w in omega])
    return whole[:, :, [node - 1 for node in FORCES]]


def _table(values: np.ndarray) -> str:
    rows = ["# unit: m/N", "freq,response,reference,re,im"]
    for j, force in enumerate(FORCES):
        for i, node in enumerate(NODES):
            for freq, value in zip(FREQ, values[:, i, j], strict=True):
                rows.append(f"{freq:.6g},{node}x,{force}x,{value.real:.9g},{value.imag:.9g}")
    return "\n".join(rows) + "\n"
