"""Identified modes as the tables that `calib.read_modes` reads."""

from __future__ import annotations

import numpy as np
import pandas as pd

from calib.measurement.files.csv_format import FINEST
from calib.measurement.modal import MeasuredModes


def modes_table(modes: MeasuredModes) -> pd.DataFrame:
    """Columns of `read_modes_csv`; standard deviations of the mean, NaN where unknown."""
    return pd.DataFrame({
        "mode": modes.names, "freq": modes.natural_freq, "freq_kind": "natural",
        "freq_std": _known(modes.freq_std, modes.natural_freq), "damping": modes.damping_ratio,
        "damping_std": _known(modes.damping_std, modes.damping_ratio),
    })  # fmt: skip


def _known(std: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Standard deviations, NaN where they are rounding errors of data without noise."""
    return np.where(std > FINEST * np.abs(value), std, np.nan)


def shapes_table(modes: MeasuredModes) -> pd.DataFrame:
    """Columns of `calib.measurement.files.csv_format.read_shapes_csv`, mode by mode."""
    return pd.DataFrame([
        {
            "mode": name, "node": sensor.node, "direction": sensor.direction, "re": modes.shapes[i, k].real,
            "im": modes.shapes[i, k].imag, "std": modes.shape_std[i, k],
        }
        for k, name in enumerate(modes.names)
        for i, sensor in enumerate(modes.sensors)
    ])  # fmt: skip


def sensor_table(modes: MeasuredModes) -> pd.DataFrame:
    """Columns of `calib.measurement.files.csv_format.read_sensor_table`, for the nodes whose places are known."""
    places = {sensor.node: sensor for sensor in modes.sensors if sensor.point is not None}
    rows = [
        {"node": node, **dict(zip("xyz", sensor.point or (), strict=True)), "on": sensor.on or ""}
        for node, sensor in places.items()
    ]
    return pd.DataFrame(rows, columns=["node", "x", "y", "z", "on"])
