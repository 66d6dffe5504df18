"""Figure of the faults that the measurement may have: their scores, sensor by sensor."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from calib.report.numbers import fixed, flag
from calib.report.style import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILLION, YELLOW, legend_above, own_axes
from calib.report.svg import hover

LOOKS = {
    "gain": ("o", BLUE), "delay": ("s", SKY), "rotation": ("^", GREEN), "place": ("D", ORANGE),
    "cross-talk": ("v", PURPLE), "set-up": ("P", YELLOW), "damping": ("X", GREY), "modulus": ("*", BLACK),
    "mass": ("h", GREY), "phase": ("<", GREEN),
}  # fmt: skip
"""Marker and colour of every kind of fault; others are grey dots."""
WHOLE = "whole test"
"""Label of the faults that concern no single sensor."""
MOST = 30
"""Sensors drawn, those of the largest scores."""


def draw_suspects(table: pd.DataFrame, ax: Axes | None = None) -> Axes:
    """Draw the score of every fault of the measurement over the sensor it concerns.

    Parameters
    ----------
    table : DataFrame
        Columns ``fault, kind, sensor`` (empty for the whole test), ``score``, ``limit`` that noise alone exceeds in 1 %
        of all cases, ``blamed`` whether the verdict names it, ``told`` what its fit means.
    ax : Axes, optional

    Returns
    -------
    Axes
        Dots with the gid of their kind, rings with the gid ``blamed``, lines with the gid ``limit``.
    """
    rows = table.assign(at=table["sensor"].where(table["sensor"].astype(str) != "", WHOLE)).dropna(subset=["score"])
    largest = rows.assign(size=rows["score"].abs()).groupby("at", sort=False)["size"].max()
    kept = set(largest.sort_values(ascending=False, kind="stable").index[:MOST])
    names = [name for name in largest.index if name in kept]
    place = {name: k for k, name in enumerate(sorted(names, key=_natural))}
    rows = rows[rows["at"].isin(kept)]
    ax = own_axes(ax, max(2.4, 0.9 + 0.19 * len(place)))
    limit = float(table["limit"].iloc[0])
    for side in (-limit, limit):
        ax.axvline(side, color=BLACK, linewidth=0.8, linestyle="--", gid="limit")
    ax.axvline(0.0, color=GREY, linewidth=0.8)
    for kind in dict.fromkeys(rows["kind"]):
        own = rows[rows["kind"] == kind]
        marker, colour = LOOKS.get(str(kind), ("o", GREY))
        heights = [place[name] for name in own["at"]]
        dots = ax.scatter(
            own["score"], heights, s=22, marker=marker, c=colour, label=str(kind), gid=str(kind), zorder=3
        )
        hover(dots, *(_words(r) for r in own.to_dict("records")))
    blamed = rows[[flag(b) for b in rows["blamed"]]]
    if len(blamed):
        heights = [place[name] for name in blamed["at"]]
        ring: dict[str, Any] = {"s": 110, "facecolors": "none", "edgecolors": VERMILLION, "linewidths": 1.6}
        ax.scatter(blamed["score"], heights, label="named by the verdict", gid="blamed", zorder=4, **ring)
    ax.set_yticks(range(len(place)), list(place))
    ax.set_ylim(len(place) - 0.4, -0.6)
    ax.set_xlabel(f"score of the fault (noise alone stays within ± {fixed(limit, 1)} in 99 % of all cases)")
    ax.grid(axis="y")
    legend_above(ax)
    return ax


def _words(row: dict[str, object]) -> str:
    told = f": {row['told']}" if row.get("told") else ""
    return f"{row['fault']}, score {fixed(float(np.asarray(row['score'])), 1)}{told}"


def _natural(name: str) -> tuple[bool, int, str]:
    """Order of sensors: by the number of the node, the whole test last."""
    digits = "".join(c for c in name if c.isdigit())
    return name == WHOLE, int(digits) if digits else 0, name
