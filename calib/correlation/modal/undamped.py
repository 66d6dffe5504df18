"""Undamped frequencies of a damped model, from stiffness and mass alone, beside those of its damped modes."""

from __future__ import annotations

import numpy as np
import pandas as pd

from calib.correlation.modal.comparison import Comparison
from calib.structure.eigenproblem.solve import solve_modes

UNDAMPED = ("mode", "natural_freq_measured", "damped_freq_measured", "undamped_freq_model", "natural_freq_model",
            "damped_freq_model", "alike", "undamped_error")  # fmt: skip


def undamped_table(found: Comparison) -> pd.DataFrame | None:
    """Every paired mode with the undamped mode that is most like it.

    A damped mode and an undamped one are alike by their shapes in the inner product of the mass matrix: 1 where damping
    does not couple undamped modes. Without that coupling ``undamped_freq_model`` is ``natural_freq_model``.

    Returns
    -------
    DataFrame or None
        `UNDAMPED`: measured frequencies; of the model the undamped frequency, ``|lambda|/2 pi`` and the frequency of
        the damped oscillation, Hz; ``alike``, 0 to 1; and the error of the undamped frequency against the measured
        natural one, a fraction. None for a model without matrices.
    """
    model = found.model.reducible
    if model is None:
        return None
    stiffness, _, mass = model.matrices(found.values)
    free = solve_modes(stiffness, None, mass, found.modes.n_modes, rotational=model.dofs.direction >= 3)
    moved = mass @ found.modes.shapes
    products = np.abs(free.shapes.T @ moved) ** 2
    size = np.real(np.sum(found.modes.shapes.conj() * moved, axis=0))
    own = np.sum(free.shapes * (mass @ free.shapes), axis=0)
    alike = products / np.outer(own, size)
    table = found.comparison_table()
    rows = []
    for row in table.to_dict("records"):
        if np.isnan(row["natural_freq_model"]):
            continue
        k = int(row["model_mode"]) - 1
        j = int(np.argmax(alike[:, k]))
        undamped, measured = float(free.natural_freq[j]), float(row["natural_freq_measured"])
        rows.append(
            (
                str(row["mode"]), measured, row["damped_freq_measured"], undamped, row["natural_freq_model"],
                row["damped_freq_model"], float(alike[j, k]), undamped / measured - 1.0,
            )
        )  # fmt: skip
    return pd.DataFrame(rows, columns=list(UNDAMPED))
