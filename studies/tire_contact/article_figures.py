"""Figures of `article.py`, each drawn from its tables."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LightSource, TwoSlopeNorm
from matplotlib.figure import Figure
from scipy.interpolate import CubicSpline

from calib.report.style import BLACK, BLUE, GREEN, GREY, ORANGE, VERMILLION, legend_above, new_figure
from calib.study.loading import module_of

figure_set = module_of(Path(__file__).resolve().parent.parent / "figure_set.py")

STATES = {"as built": GREY, "inflated": BLACK}
DEEPER = ("#9ecae1", "#6baed6", "#3182bd", "#08519c")
"""Of the steps, darker when deeper."""


def tire_figure(surface: pd.DataFrame) -> Figure:
    """The mesh from the side, and the tire coloured by how far its wall moved outward (`surface`)."""
    figure = new_figure(3.9)
    grid = figure.add_gridspec(1, 3, width_ratios=(1, 1, 0.04))
    names = ("x", "y", "z", "moved")
    mesh = [surface.pivot(index="ring", columns="hoop", values=name).to_numpy() for name in names]
    angle = surface[surface["ring"] == surface["ring"].max() // 2]["angle"].to_numpy()
    closed = [np.hstack([a, a[:, :1]]) for a in mesh]
    theta = np.append(angle, angle[0] + 2 * np.pi)
    fine = theta[0] + np.linspace(0.0, 2 * np.pi, 145)
    smooth = [CubicSpline(theta, a, axis=1, bc_type="periodic")(fine) for a in closed]
    norm = TwoSlopeNorm(0.0, mesh[3].min(), max(mesh[3].max(), 1e-6))
    middle = sum(smooth[3][i : i - 1 or None, j : j - 1 or None] for i in (0, 1) for j in (0, 1)) / 4
    level, reach = float(surface["ground"].iloc[0]), float(np.abs(surface["x"]).max())
    looks = (
        ("mesh of 61 x 24 cells", closed, {"color": "#F4F4F4", "edgecolor": "#505050", "linewidth": 0.3}, (5, -90)),
        ("displacement", smooth, {"facecolors": colormaps["RdBu_r"](norm(middle)), "edgecolor": "none"}, (4, -32)),
    )
    plate = np.array([[-0.7, 0.7], [-0.7, 0.7]]) * reach
    for place, (words, (x, y, z, _), look, (elevation, turn)) in enumerate(looks, 1):
        ax = figure.add_subplot(grid[0, place - 1], projection="3d", computed_zorder=False)
        ax.plot_surface(
            plate, 0.6 * plate.T, np.full((2, 2), level), color="#DDDDDD", edgecolor=GREY, zorder=0, shade=False
        )
        ax.plot_surface(
            x, y, z, rstride=1, cstride=1, shade=place == 2, lightsource=LightSource(315, 60), zorder=1, **look
        )
        ax.set_box_aspect((2, 1.2, 2), zoom=1.35)
        ax.set(xlim=(-reach, reach), ylim=(-0.6 * reach, 0.6 * reach), zlim=(-reach, reach))
        ax.view_init(elev=elevation, azim=turn)
        ax.set_axis_off()
        ax.set_title(words)
    scale = ScalarMappable(norm, colormaps["RdBu_r"])
    bar = figure.colorbar(scale, cax=figure.add_subplot(grid[0, 2]), label="outward since inflation (mm)")
    bar.outline.set_visible(False)
    bar.set_ticks([*np.arange(np.ceil(norm.vmin / 5) * 5, 0, 5), *np.arange(0, norm.vmax, 2)])
    return figure


PARTS = {"u": "u, along the section", "v": "v, around", "w": "w, outward"}
"""Displacements, and what each is."""


def surfaces_figure(table: pd.DataFrame) -> Figure:
    """u, v and w since inflation over the cover near the patch, each on a scale of its own (`cover`)."""
    figure = new_figure(2.9)
    for place, (name, words) in enumerate(PARTS.items(), 1):
        ax = figure.add_subplot(1, 3, place, projection="3d", computed_zorder=False)
        field = table.pivot(index="along", columns="around", values=name)
        across, around = np.meshgrid(field.index, field.columns, indexing="ij")
        reach = float(np.abs(field.to_numpy()).max())
        ax.plot_surface(
            around,
            across,
            field.to_numpy(),
            cmap="RdBu_r",
            vmin=-reach,
            vmax=reach,
            rstride=1,
            cstride=1,
            edgecolor="#404040",
            linewidth=0.15,
        )
        ax.set(xlim=(field.columns.min(), field.columns.max()), ylim=(field.index.min(), field.index.max()))
        ax.set_title(f"{words} (mm)", y=1.02)
        ax.set_xlabel("around (°)", labelpad=-6, fontsize=7.5)
        ax.set_ylabel("section (mm)", labelpad=-5, fontsize=7.5)
        ax.tick_params(labelsize=6.5, pad=-2)
        ax.set_xticks([-90, 0, 90])
        ax.view_init(elev=28, azim=-55)
        ax.set_box_aspect((1.0, 1.0, 0.75), zoom=0.88)
    return figure


def load_table_figure(table: pd.DataFrame) -> Figure:
    """The loads of some steps as a table: deflection, load, loaded radius, patch, and largest pressure (`loads`)."""
    fine = table[(table["cells"] == table["cells"].max()) & (table["pressure"] == 200.0)]
    columns = {
        "step": ("step", "{:.0f}"), "deflection": ("deflection\n(mm)", "{:.1f}"), "load": ("load\n(N)", "{:.0f}"),
        "loaded_radius": ("loaded radius\n(mm)", "{:.1f}"), "patch_length": ("patch length\n(mm)", "{:.0f}"),
        "patch_width": ("patch width\n(mm)", "{:.0f}"), "bulge": ("bulge\n(mm)", "{:.2f}"),
        "largest_pressure": ("largest pressure\n(kPa)", "{:.0f}"), "iterations": ("Newton\nsteps", "{:.0f}"),
    }  # fmt: skip
    shown = fine[(fine["step"] % 4 == 2) | (fine["step"] == 1)]
    cells = [[form.format(row[name]) for name, (_, form) in columns.items()] for row in shown.to_dict("records")]
    figure = new_figure(0.5 + 0.22 * (len(cells) + 2))
    ax = figure.add_subplot()
    ax.set_axis_off()
    grid = ax.table(cells, colLabels=[words for words, _ in columns.values()], loc="center", cellLoc="right", edges="B")
    grid.auto_set_font_size(False)
    grid.set_fontsize(8)
    for (row, _), cell in grid.get_celld().items():
        cell.set(height=(2.2 if row == 0 else 1.0) / (len(cells) + 2.2), linewidth=0.8 if row == 0 else 0.2)
    return figure


def displacements_figure(table: pd.DataFrame) -> Figure:
    """u, v and w along the section below the axle, and along the crown (`displacements`)."""
    figure = new_figure(3.2)
    left, right = figure.subplots(1, 2, sharey=True)
    for ax, (along, words) in zip(
        (left, right),
        (
            ("meridian", "along the section below the axle, bead to bead (mm)"),
            ("hoop", "around the crown (degrees from below)"),
        ),
        strict=True,
    ):
        own = table[table["along"] == along]
        for (name, meaning), colour in zip(PARTS.items(), (ORANGE, GREEN, BLUE), strict=True):
            ax.plot(own["place"], own[name], color=colour, marker=".", markersize=3, linewidth=1.2, label=meaning)
        ax.axhline(0.0, color=GREY, linewidth=0.6)
        ax.set_xlabel(words)
        ax.grid(axis="y")
    right.set_xticks([-180, -90, 0, 90, 180])
    left.set_ylabel("displacement since inflation (mm)")
    legend_above(left)
    return figure


def sections_figure(table: pd.DataFrame) -> Figure:
    """Cross-sections below the axle, as built, inflated, and at four steps (`sections`)."""
    figure = new_figure(4.0)
    ax = figure.add_subplot()
    steps = [state for state in table["state"].unique() if state not in STATES]
    colours = STATES | dict(zip(steps, DEEPER, strict=True))
    for state, own in table.groupby("state", sort=False):
        looks = {"linestyle": "--"} if state == "as built" else {}
        ax.plot(own["axial"], -own["height"], color=colours[state], linewidth=1.4, label=state, **looks)
        level = own["ground"].iloc[0]
        if np.isfinite(level):
            ax.plot([-60, 60], [-level, -level], color=colours[state], linewidth=0.6)
    ax.set(xlabel="axial position (mm)", ylabel="height over the axle (mm)", aspect="equal")
    ax.legend(loc="center left", bbox_to_anchor=(1.02, 0.5), title="thin line: the ground")
    return figure


def patch_figure(fine: pd.DataFrame, coarse: pd.DataFrame) -> Figure:
    """Contact pressure over the patch, and along the lines through its centre on both meshes (`patch`)."""
    figure = new_figure(3.6)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.15, 1))
    ax = figure.add_subplot(grid[:, 0])
    field = fine.pivot(index="across", columns="along", values="pressure")
    drawn = ax.pcolormesh(field.columns, field.index, field.to_numpy(), cmap="viridis", shading="nearest")
    ax.set(xlabel="along the crown (mm)", ylabel="across (mm)", aspect="equal", xlim=(-150, 150))
    figure.colorbar(drawn, ax=ax, label="contact pressure (kPa)", orientation="horizontal", shrink=0.9)
    for row, (key, other, words) in enumerate(
        (("along", "across", "along the crown (mm)"), ("across", "along", "across (mm)"))
    ):
        panel = figure.add_subplot(grid[row, 1])
        for table, colour, cells in ((coarse, ORANGE, "464 cells"), (fine, BLUE, "1464 cells")):
            nearest = table[other].abs().min()
            own = table[np.isclose(table[other].abs(), nearest)].groupby(key)["pressure"].mean()
            panel.plot(own.index, own, color=colour, marker=".", markersize=4, linewidth=1.1, label=cells)
        panel.set(xlabel=words, ylabel="kPa", ylim=(0, None), xlim=(-150, 150))
        panel.grid(axis="y")
        if row == 0:
            legend_above(panel)
    return figure


def loads_figure(table: pd.DataFrame) -> Figure:
    """Load over deflection: 38 steps at three pressures, and on the coarse mesh (`loads`)."""
    figure = new_figure(3.4)
    left, right = figure.subplots(1, 2)
    fine = table[table["cells"] == table["cells"].max()]
    for (pressure, own), colour in zip(fine.groupby("pressure"), (GREEN, BLUE, VERMILLION), strict=True):
        left.plot(own["deflection"], own["load"] / 1e3, ".-", color=colour, markersize=4, label=f"{pressure:g} kPa")
        right.plot(*chord_slope(own), ".-", color=colour, markersize=4)
    coarse = table[table["cells"] == table["cells"].min()]
    left.plot(coarse["deflection"], coarse["load"] / 1e3, "--", color=GREY, label="200 kPa, 464 cells")
    left.set(xlabel="deflection (mm)", ylabel="load (kN)", ylim=(0, None), xlim=(0, None))
    right.set(xlabel="deflection (mm)", ylabel="slope over four steps (N/mm)", ylim=(0, None), xlim=(0, None))
    for ax in (left, right):
        ax.grid(axis="y")
    left.legend(loc="upper left")
    return figure


def chord_slope(loads: pd.DataFrame, steps: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """Deflection, mm, and slope of the load between so many steps before and after, N/mm.

    The tangent itself jumps whenever a node comes to touch.
    """
    deflection, load = loads["deflection"].to_numpy(), loads["load"].to_numpy()
    slope = (load[2 * steps :] - load[: -2 * steps]) / (deflection[2 * steps :] - deflection[: -2 * steps])
    return deflection[steps:-steps], slope


def times_figure(times: pd.DataFrame, loads: pd.DataFrame) -> Figure:
    """Newton steps of each load step, and processor seconds (`times`, `loads`)."""
    figure = new_figure(2.8)
    left, right = figure.subplots(1, 2)
    own = loads[loads["pressure"] == 200.0]
    for (cells, one), colour in zip(own.groupby("cells"), (ORANGE, BLUE), strict=True):
        left.plot(one["step"], one["iterations"], ".-", color=colour, linewidth=1, label=f"{cells} cells")
    left.set(xlabel="load step", ylabel="Newton steps", ylim=(0, None))
    left.set_yticks(range(int(own["iterations"].max()) + 1))
    legend_above(left)
    place = np.arange(len(times))
    right.barh(place + 0.2, times["seconds_a_step"], 0.36, color=BLUE, label="one load step")
    right.barh(place - 0.2, times["sparse_factor"], 0.36, color=GREY, label="one sparse factorisation")
    right.set_yticks(place, [f"{cells} cells" for cells in times["cells"]])
    right.set(xlabel="processor time (s)", xlim=(0, 1.35 * times["seconds_a_step"].max()))
    legend_above(right)
    for k, total in enumerate(times["seconds"]):
        right.text(times["seconds_a_step"].iloc[k], k + 0.2, f"  {total:.1f} s in all", va="center", fontsize=8)
    return figure


FIGURES: dict[str, tuple[str, Callable[[Path], Figure]]] = {
    "tire": ("the tire on the ground at 25 mm", lambda f: tire_figure(_read(f, "surface"))),
    "displacements": ("displacements at 25 mm", lambda f: displacements_figure(_read(f, "displacements"))),
    "surfaces": ("displacements over the cover at 25 mm", lambda f: surfaces_figure(_read(f, "cover"))),
    "load_table": ("loads of some of 38 steps", lambda f: load_table_figure(_read(f, "loads"))),
    "sections": ("cross-sections below the axle", lambda f: sections_figure(_read(f, "sections"))),
    "patch": ("contact pressure at 25 mm", lambda f: patch_figure(_read(f, "patch"), _read(f, "patch_coarse"))),
    "loads": ("load and deflection, 38 steps", lambda f: loads_figure(_read(f, "loads"))),
    "times": ("work of the 38 steps", lambda f: times_figure(_read(f, "times"), _read(f, "loads"))),
}
"""Caption and drawing of each figure, from a folder of tables."""
SET = figure_set.FigureSet("Generic bias tire at 200 kPa", FIGURES, "surface")


def _read(folder: Path, name: str) -> pd.DataFrame:
    return pd.read_csv(folder / f"{name}.csv")
