"""Which parameter moves which response."""

from __future__ import annotations

from itertools import groupby

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.transforms import blended_transform_factory

from calib.report.style import matrix_height, own_axes, separate_cells

RESPONSE_KINDS = {
    "natural_freq_": "natural frequency",
    "damped_freq_": "damped frequency",
    "damping_ratio_": "damping ratio",
    "emac_": "EMAC",
    "mac_": "MAC",
}
"""Beginning of a response's name, and what is written over its group of columns."""


def draw_sensitivity(
    table: pd.DataFrame, ax: Axes | None = None, threshold: float = 0.25, label: str = "rank correlation (–)"
) -> Axes:
    """Draw the sensitivity of responses to parameters as a matrix, after Ribeiro et al. (2013), figure 7.

    Parameters
    ----------
    table : DataFrame
        Column ``parameter`` and one column for every response, such as ``natural_freq_1BT`` or ``mac_1BT``; cells are
        -1 to 1, or NaN for a response that never changed.
    ax : Axes, optional
    threshold : float
        Cells whose modulus is below it stay blank.
    label : str
        What the cells are, for the colour bar.
    """
    responses = [c for c in table.columns if c != "parameter"]
    kinds = list(dict.fromkeys(_kind(r)[0] for r in responses))
    responses.sort(key=lambda r: kinds.index(_kind(r)[0]))
    values = table[responses].to_numpy(dtype=float)
    rows, columns = values.shape
    ax = own_axes(ax, matrix_height(rows, columns) + 0.3)
    shown = np.where(np.abs(values) >= threshold, values, np.nan)
    image = ax.imshow(np.isnan(values), cmap="Greys", norm=Normalize(0.0, 7.0), aspect="auto")
    image = ax.imshow(shown, cmap="RdBu_r", norm=Normalize(-1.0, 1.0), aspect="auto")
    size = 8.0 if columns <= 12 else max(4.5, 8.0 * 13.5 / columns)
    for i, j in np.argwhere(np.isfinite(shown)):
        colour = "white" if abs(shown[i, j]) > 0.65 else "black"
        text = f"{shown[i, j]:.2f}".replace("-", "−")
        ax.text(j, i, text, ha="center", va="center", fontsize=size, color=colour)
    names = [_kind(r)[1] for r in responses]
    ax.set_xticks(range(columns), names, rotation=90 if columns > 10 or max(map(len, names)) > 7 else 0)
    ax.set_yticks(range(rows), table["parameter"].astype(str))
    separate_cells(ax, rows, columns)
    ax.grid(which="minor", color="#D0D0D0", linewidth=0.6)
    _name_groups(ax, [_kind(r)[0] for r in responses])
    blank = f"blank: |value| < {threshold:g}" + ("; grey: no value" if np.isnan(values).any() else "")
    ax.set_xlabel(f"response of mode ({blank})")
    ax.figure.colorbar(image, ax=ax, label=label, fraction=0.04, pad=0.02, aspect=40)
    return ax


def _name_groups(ax: Axes, kinds: list[str]) -> None:
    """Write the kind of response over each group of columns and draw a line between the groups."""
    above = blended_transform_factory(ax.transData, ax.transAxes)
    start = 0
    for kind, members in groupby(kinds):
        end = start + len(list(members))
        ax.plot([start - 0.4, end - 0.6], [1.012, 1.012], transform=above, color="black", linewidth=1.2, clip_on=False)
        ax.annotate(
            kind,
            ((start + end - 1) / 2, 1.012),
            xycoords=above,
            xytext=(0, 3),
            textcoords="offset points",
            ha="center",
            va="bottom",
        )
        if start:
            ax.axvline(start - 0.5, color="black", linewidth=1.2)
        start = end


def _kind(response: str) -> tuple[str, str]:
    """Group and mode of a response."""
    for beginning, kind in RESPONSE_KINDS.items():
        if response.startswith(beginning):
            return kind, response.removeprefix(beginning)
    return "other", response
