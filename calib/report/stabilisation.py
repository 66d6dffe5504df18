"""The stabilisation diagram: poles over model orders, above the FRFs and the modal model's synthesis of them."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from calib.report.style import BLUE, GREY, MEASURED, REST, legend_above, new_figure
from calib.report.svg import hover_points


def stabilisation_figure(
    poles: pd.DataFrame, curves: pd.DataFrame, fit: pd.DataFrame, *, unit: str, of: str = "FRFs"
) -> Figure:
    """Draw poles by frequency and order, and the FRFs on the same axis of frequency.

    Parameters
    ----------
    poles : DataFrame
        Columns ``order, freq`` (Hz), ``damping`` (ratio), ``stable`` (bool) and ``mode`` (empty for poles of no mode).
    curves : DataFrame
        Columns ``freq`` (Hz), ``measured`` and ``synthesised``, root mean squares over all functions.
    fit : DataFrame
        Columns ``mode`` (empty where it was refused) and ``freq`` (Hz) of every stable mode.
    unit : str
        Of the functions.
    of : {"FRFs", "records"}
        What the modes were identified from: of records the functions are half-spectra, and orders count states.

    Returns
    -------
    Figure
        Upper panel the orders, lower panel the functions; lines at the modes that count, dashed ones at those refused.
    """
    figure = new_figure(5.2)
    orders, functions = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    named = poles["mode"] != ""
    looks = (
        ("not stable", ~poles["stable"], {"marker": "x", "color": REST, "s": 10, "linewidth": 0.7}),
        ("stable", poles["stable"] & ~named, {"marker": "o", "facecolor": "none", "edgecolor": GREY, "s": 14}),
        ("of a mode", named, {"marker": "o", "color": BLUE, "s": 14}),
    )
    for label, chosen, look in looks:
        rows = poles[chosen]
        orders.scatter(rows["freq"], rows["order"], label=label, **look)
        words = [f"{f:.4g} Hz, damping {100 * d:.3g} %" for f, d in zip(rows["freq"], rows["damping"], strict=True)]
        hover_points(orders, rows["freq"], rows["order"], words)
    for row in fit.itertuples():
        for ax in (orders, functions):
            ax.axvline(row.freq, color=BLUE if row.mode else GREY, linestyle="-" if row.mode else "--", linewidth=0.6)
    for column, label, colour, line in (
        ("measured", "measured", MEASURED, "-"),
        ("synthesised", "synthesised from the modes", BLUE, "--"),
    ):
        functions.semilogy(curves["freq"], np.maximum(curves[column], 1e-300), line, color=colour, label=label)
    orders.set_ylabel("order (pole pairs)" if of == "FRFs" else "order (states)")
    functions.set_ylabel(f"rms of all {'functions' if of == 'FRFs' else 'half-spectra'} ({unit})")
    functions.set_xlabel("frequency (Hz)")
    functions.set_xlim(curves["freq"].iloc[0], curves["freq"].iloc[-1])
    for ax in (orders, functions):
        legend_above(ax)
    return figure
