"""Local perturbations that change the data as an effect does: they tell where it acts on the structure."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.colors import Normalize
from mpl_toolkits.mplot3d.axes3d import Axes3D

from calib.report.numbers import fixed
from calib.report.scene import PLACE, draw_dots, frame_panel, new_axes, number_points, plot_coordinates, plot_lines
from calib.report.style import BLACK, REST, YELLOW

ALIKE = 0.5
"""Absolute correlation of two signatures from which a local perturbation tells where an effect acts."""
CORRELATION, TICKS = Normalize(-1.0, 1.0), (-1.0, -0.5, 0.0, 0.5, 1.0)
STAR: dict[str, Any] = {"marker": "*", "color": YELLOW, "markersize": 13, "markeredgecolor": BLACK}


def most_alike(places: pd.DataFrame, effect: str) -> pd.Series | None:
    """Return the row of the local perturbation whose signature is most like the effect's; None where none is alike.

    Parameters
    ----------
    places : DataFrame
        Columns ``effect, perturbation, kind, x, y, z, correlation``; perturbations without coordinates do not count.
    effect : str
    """
    own = located_rows(places, effect)
    if own.empty or not own["correlation"].abs().max() >= ALIKE:
        return None
    return own.iloc[int(np.argmax(own["correlation"].abs()))]


def draw_alike(
    places: pd.DataFrame,
    rest: np.ndarray,
    ax: Axes3D | None = None,
    *,
    effect: str,
    acts: pd.DataFrame | None = None,
) -> Axes3D:
    """Draw where local perturbations change the data as the effect does, and where it acts on the model.

    Parameters
    ----------
    places : DataFrame
        Columns ``effect, perturbation, kind, x, y, z`` (m) and ``correlation`` of both signatures, -1 to 1.
    rest : ndarray (n, 2, 3)
        Lines of the mesh, in metres.
    ax : Axes3D, optional
    effect : str
        The rows to draw.
    acts : DataFrame, optional
        Columns ``effect, x, y, z`` (m): where each effect acts.

    Returns
    -------
    Axes3D
        Circles with the gid ``correlation``, the largest at the back; the perturbation of `most_alike` is numbered.
        Stars with the gid ``acts``.
    """
    ax = new_axes(ax)
    rows = located_rows(places, effect)
    rows = rows.iloc[np.argsort(-rows["correlation"].abs().to_numpy(dtype=float), kind="stable")]
    place, best = rows[PLACE].to_numpy(dtype=float), most_alike(places, effect)
    plot_lines(ax, rest, color=REST, linewidth=0.8, gid="structure", zorder=1)
    draw_dots(ax, place, rows["correlation"].to_numpy(dtype=float), CORRELATION, "RdBu_r", "correlation")
    stars = acting(acts, effect)
    if len(stars):
        ax.plot(*plot_coordinates(stars).T, linestyle="none", gid="acts", zorder=6, clip_on=False, **STAR)
    frame_panel(ax, np.concatenate([rest.reshape(-1, 3), place, stars]), "")
    number_points(ax, place, {} if best is None else {list(rows.index).index(best.name): 1})
    return ax


def alike_words(places: pd.DataFrame, effect: str) -> str:
    """Name the local perturbation of `most_alike`; empty where no perturbation has coordinates."""
    best = most_alike(places, effect)
    if best is None:
        none = "no local stiffness or mass change changes the data as it does"
        return "" if located_rows(places, effect).empty else none
    return f"{best['perturbation']} ({best['kind']}, ρ = {fixed(best['correlation'], 2, sign=True)})"


def located_rows(places: pd.DataFrame, effect: str) -> pd.DataFrame:
    """Rows of an effect whose perturbations have coordinates and a correlation."""
    return places[(places["effect"] == effect) & places[[*PLACE, "correlation"]].notna().all(axis=1)]


def acting(acts: pd.DataFrame | None, effect: str) -> np.ndarray:
    """Where an effect acts, (n, 3) in metres."""
    return np.empty((0, 3)) if acts is None else acts.loc[acts["effect"] == effect, PLACE].to_numpy(dtype=float)
