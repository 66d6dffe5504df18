"""Identified modes, what they were judged by, and the tables that are written of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from calib.measurement.files.csv_format import FINEST
from calib.measurement.modal import MeasuredModes
from calib.results.in_short import Short

INSTEAD = 'fit the FRFs themselves: kind = "frf" in study.toml, or calib.FRFTest'
"""Remedy where modes do not describe the FRFs."""
AMBIENT = "measure longer, or give a band around the modes that are wanted"
"""Remedy where time records do not tell."""


@dataclass(frozen=True, eq=False)
class Identification(Short):
    """Modes of a structure, identified from its FRFs.

    Attributes
    ----------
    modes : MeasuredModes
        Those that count, in ascending frequency, with standard deviations of the mean; names ``1``, ``2``, ...
    fit : DataFrame
        Every stable mode: ``mode`` (its name; empty where it was refused), ``freq``, ``freq_std`` (Hz), ``damping``,
        ``damping_std`` (ratios), ``orders`` (at which it is stable), ``frac``, ``residual_std`` and ``excess`` (see
        `calib.modal_analysis.adequacy.Adequacy`), ``rank_one`` (share of its residues that one shape describes; NaN
        under one reference, where one always does), ``mpc`` and ``mpd`` (degrees; see
        `calib.measurement.mac.phase_collinearity`), ``scatter`` (relative standard deviation of its frequency between
        functions; 0 where noise explains it, NaN where too few show it), ``refused`` (why; empty where it counts) and
        ``note`` (that it was accepted although refused, and why; that its resonances differ between functions).
    poles : DataFrame
        See `calib.modal_analysis.stabilisation.pole_table`, with the names of the modes in ``mode``.
    curves : DataFrame
        ``freq`` (Hz), ``measured`` and ``synthesised``: root mean squares over all functions, in the quantity's unit.
    missed : tuple of float
        Resonances without a mode, Hz.
    std_from : {"repeats", "functions", "parts"}
        Whether standard deviations come from leaving out each repeat in turn, from residuals and contradictions of the
        functions of one measurement, or from leaving out parts of the one record.
    of : {"FRFs", "records"}
        What they were identified from; of records ``curves`` are half-spectra, in the squared unit a Hz, and an order
        of ``poles`` is a number of states, two a mode.
    """

    modes: MeasuredModes
    fit: pd.DataFrame
    poles: pd.DataFrame
    curves: pd.DataFrame
    missed: tuple[float, ...]
    std_from: str
    of: str = "FRFs"

    def __str__(self) -> str:
        """Verdict, the modes, what was refused, and notes."""
        refused = [f"refused: {row['freq']:.4g} Hz, {row['refused']}" for row in self.fit.to_dict("records")
                   if row["refused"]]  # fmt: skip
        notes = [f"note: {note}" for note in self.modes.notes]
        return "\n".join([self.verdict, str(self.modes), *refused, *notes])

    @property
    def verdict(self) -> str:
        """Whether the modes describe what they were identified from, in one sentence."""
        refused = self.fit[self.fit["refused"] != ""]
        doubts = [f"{hz(refused['freq'])} refused"] * bool(len(refused))
        doubts += [f"no mode for the resonances at {hz(self.missed)}"] * bool(self.missed)
        whole = self.fit["frac"][self.fit["refused"] == ""]
        if not doubts:
            what = "FRFs" if self.of == "FRFs" else "correlations of the records"
            return f"The modes describe the {what} around their resonances (FRAC {whole.min():.4f} or more)."
        if self.of == "records":
            return f"Not all of these records is described by modes that count ({'; '.join(doubts)}): {AMBIENT}."
        return f"Modes alone do not describe these FRFs ({'; '.join(doubts)}): {INSTEAD}."


def hz(values: Sequence[float] | pd.Series) -> str:
    """Frequencies in words."""
    return f"{', '.join(f'{value:.4g}' for value in values)} Hz"


def modes_table(found: Identification) -> pd.DataFrame:
    """Columns of `read_modes_csv`; standard deviations of the mean, NaN where unknown, and notes if there are any."""
    modes, fit = found.modes, found.fit[found.fit["mode"] != ""]
    table = pd.DataFrame({
        "mode": modes.names, "freq": modes.natural_freq, "freq_kind": "natural",
        "freq_std": _known(modes.freq_std, modes.natural_freq), "damping": modes.damping_ratio,
        "damping_std": _known(modes.damping_std, modes.damping_ratio), "mpc": fit["mpc"].to_numpy(),
        "mpd": fit["mpd"].to_numpy(),
    })  # fmt: skip
    return table.assign(note=fit["note"].to_numpy()) if (fit["note"] != "").any() else table


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
