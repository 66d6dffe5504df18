"""The stabilisation diagram: poles over model orders, above the FRFs and the modal model's synthesis of them."""

from __future__ import annotations

import string
import textwrap

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from calib.report.style import BLUE, GREY, MEASURED, REST, legend_above, new_figure
from calib.report.svg import hover_points

LETTERS = string.ascii_lowercase
"""Of refused modes in the picture, which has no room for more."""
LINE = 110
"""Characters of a line below the picture."""


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
        Columns ``mode`` (empty where it was refused), ``freq`` (Hz), ``refused`` (why) and ``note`` of every stable
        mode.
    unit : str
        Of the functions.
    of : {"FRFs", "records"}
        What the modes were identified from: of records the functions are half-spectra, and orders count states.

    Returns
    -------
    Figure
        Upper panel the orders, lower panel the functions; lines at the modes that count, dashed ones at those refused.
        What was refused, or accepted although refused, bears a letter, by which the reason stands below.
    """
    reasons = _reasons(fit)
    figure = new_figure(5.2 + 0.15 * sum(words.count("\n") + 1 for _, words in reasons))
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
    for letter, (freq, _) in zip(LETTERS, reasons, strict=False):
        orders.annotate(
            letter, (freq, 1.0), (4, -3), xycoords=("data", "axes fraction"), textcoords="offset points", va="top",
            fontsize=9, fontweight="bold", bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.5},
        )  # fmt: skip
    for column, label, colour, line in (
        ("measured", "measured", MEASURED, "-"),
        ("synthesised", "synthesised from the modes", BLUE, "--"),
    ):
        functions.semilogy(curves["freq"], np.maximum(curves[column], 1e-300), line, color=colour, label=label)
    orders.set_ylabel("order (poles)" if of == "FRFs" else "order (states)")
    functions.set_ylabel(f"rms of all {'functions' if of == 'FRFs' else 'half-spectra'} ({unit})")
    functions.set_xlabel("frequency (Hz)")
    if reasons:
        below = [f"{letter}  {words}" for letter, (_, words) in zip(LETTERS, reasons, strict=False)]
        functions.annotate(
            "\n".join(below), (0.0, 0.0), (0, -34), xycoords="axes fraction", textcoords="offset points", va="top",
            fontsize=8,
        )  # fmt: skip
    functions.set_xlim(curves["freq"].iloc[0], curves["freq"].iloc[-1])
    for ax in (orders, functions):
        legend_above(ax)
    return figure


def _reasons(fit: pd.DataFrame) -> list[tuple[float, str]]:
    """Frequency, Hz, and the words of each mode that is refused or bears a note, as many as there are letters."""
    out = []
    for row in fit.to_dict("records"):
        if words := row["refused"] or row["note"]:
            head = f"{row['freq']:.4g} Hz{' refused' if row['refused'] else ''}"
            out.append((float(row["freq"]), textwrap.fill(f"{head}: {words}", LINE, subsequent_indent="    ")))
    return out[: len(LETTERS)]
