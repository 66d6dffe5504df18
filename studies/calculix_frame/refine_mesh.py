"""What accuracy the mesh of the model can claim: its modes beside those of the same frame with elements half as long.

    python studies/calculix_frame/refine_mesh.py

Both are solved by CalculiX at the nominal values of the parameters; nothing of the measurement is used. Each column
meets a plate in one node, so that the mesh is a part of this joint: the joint turns the more, the smaller the elements
around it, and frequencies have no limit. The halved elements are about as large as a column (22 mm), which is the
length over which a real one is held. The study states the largest change to them of any mode, rounded up, as the
accuracy of its mesh.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from scipy.optimize import linear_sum_assignment

from studies.calculix_frame.make_frame import frame
from studies.calculix_frame.make_twin import STEP, solved

NOMINAL = {"E_plates": 210e3, "E_columns": 210e3, "t_top": 6.0, "k_feet": 20e3}
"""Values of the parameters in ``study.toml``."""
MODEL, HALVED = (16, 8, 4), (32, 16, 8)
"""Elements along the length and the width of a plate, and along a column; see `make_frame.Deck`."""


def modes_of(mesh: tuple[int, int, int]) -> Any:
    """The lowest modes of the frame at its nominal values, at the sensors."""
    columns, rows, segments = mesh
    return solved(frame(NOMINAL, columns=columns, rows=rows, segments=segments, step=STEP))


def change() -> pd.DataFrame:
    """Change from the mesh of the model to the halved one, each mode beside the one most like it.

    Returns
    -------
    DataFrame
        ``model, halved`` (Hz), ``freq`` (over the frequency of the model) and ``shape`` (root mean square over the
        sensors, over the largest entry).
    """
    found, finer = modes_of(MODEL), modes_of(HALVED)
    a, b = found.shapes.real, finer.shapes.real
    mac = (a.T @ b) ** 2 / np.outer((a**2).sum(axis=0), (b**2).sum(axis=0))
    which = linear_sum_assignment(-mac)[1]
    b, halved = b[:, which], finer.natural_freq[which]
    b = b * (a * b).sum(axis=0) / (b**2).sum(axis=0)
    shape = np.sqrt(((b - a) ** 2).mean(axis=0)) / np.abs(a).max(axis=0)
    freq = found.natural_freq
    return pd.DataFrame({"model": freq, "halved": halved, "freq": halved / freq - 1, "shape": shape})


if __name__ == "__main__":
    table = change()
    print(table.to_string(float_format="{:.4g}".format))
    for kind in ("freq", "shape"):
        print(f"largest change of {kind}: {100 * table[kind].abs().max():.2g} %")
