"""A bar with one end in a wall, of linear elements with consistent masses."""

import numpy as np
import pandas as pd
import scipy.sparse as sp

import calib
from calib.measurement.modal import Sensor
from calib.structure.affine import Term, parameter
from calib.structure.effects.extend import Addition

LENGTH = 2.0
SPEED = 5000.0
"""Of sound, m/s: the square root of stiffness over mass."""
PLACES = (500, 1000, 1500, 2000)
"""Nodes that all meshes have; nodes are named by their distance from the wall in mm."""


def bar(elements):
    """The bar with 500 Ns/m2 of damping in proportion to its stiffness; elements are a multiple of four."""
    h, n = LENGTH / elements, elements
    k = (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)) / h
    m = (4 * np.eye(n) + np.eye(n, k=1) + np.eye(n, k=-1)) * h / 6
    k[-1, -1], m[-1, -1] = 1 / h, 2 * h / 6
    x = h * np.arange(1, n + 1)
    dofs = pd.DataFrame({"node": np.round(1e3 * x).astype(int), "direction": "x", "x": x, "y": 0.0, "z": 0.0})
    stiffness = calib.Parameter("EA", 1.0, 0.5, 2.0, prior_sd=0.05)
    return calib.StructuralModel.from_matrices(
        {"EA": SPEED**2 * k}, {"own": m}, {"loss": 100.0 * k}, dofs=dofs, parameters=[stiffness], name="bar"
    )


def heavier():
    """The effect of a mass at the middle, kg over the mass of the bar per metre."""

    def build(model):
        row = model.sensor_rows([Sensor(1000, "x")])[0]
        matrix = sp.csr_array(np.outer(row, row))
        return Addition(mass=(Term("lump", matrix, parameter("lump")),))

    magnitude = calib.Parameter("lump", 0.0, 0.0, 1.0, "-", prior_sd=0.1)
    return calib.Effect("lump", "Mass at the middle", "It has none.", "Look there.", magnitude, build)
