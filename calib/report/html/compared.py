"""Section on model against measurement, mode by mode."""

from __future__ import annotations

import numpy as np
import pandas as pd
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from calib.report.html.look import PATTERNS, add_matrix, filled, name_axis, new, number_axis, shown
from calib.report.html.numbers import fixed, percent, significant
from calib.report.html.page import Block, Plot, Section, Shapes, Table, Terms, Words
from calib.report.html.space import AXES_NOTE, scene
from calib.report.html.study_results import StudyResults
from calib.report.style import AFTER, BEFORE, GREY

COLOURS = {"before": BEFORE, "after": AFTER}
TERMS = (
    ("MAC", "modal assurance criterion: 1 for proportional shapes, 0 for orthogonal ones"),
    (
        "EMAC",
        "MAC times the share of strain energy in the part of the model that carries the mode; used to pair modes",
    ),
    ("margin", "EMAC of the pair minus that of the next best candidate; a small margin means a doubtful pair"),
    ("CoMAC", "coordinate MAC: agreement of the shapes at one sensor over all modes"),
)


def section(results: StudyResults) -> Section | None:
    """The model at its nominal values, nothing fitted, and mode shapes of every stage."""
    title = "Model against measurement, nothing fitted"
    if results.scalar:
        blocks = scalar_blocks(results, "before")
        return Section("compared", title, tuple(blocks)) if blocks else None
    table = results.compared("before")
    if table is None:
        return None
    sentences = [Words(words, "reported") for words in results.sentences("compare")[:-1]]
    blocks = [
        Words("The model at its nominal values, before calibration. Errors are model minus measurement."),
        *sentences,
        mode_table(table, "Mode by mode before calibration"),
        Terms(TERMS if table["mac"].notna().any() else ()),
        error_plot({"before": table}, "errors-before", results.noise_mac),
        *mac_plot(results, "before"),
        *_shapes(results),
        *comac_plot(results),
    ]
    return Section("compared", title, tuple(blocks))


def mode_table(table: pd.DataFrame, caption: str) -> Table:
    """One row per mode: number of its model mode, frequencies, damping, MAC, EMAC and margin."""
    shapes = table["mac"].notna().any()
    heads = ["mode", "model mode", "measured, Hz", "model, Hz", "error, %", "damping measured, %", "model, %"]
    rows = []
    for r in table.to_dict("records"):
        unpaired = np.isnan(r["natural_freq_model"])
        cells = [
            str(r["mode"]),
            fixed(r["model_mode"], 0),
            fixed(r["natural_freq_measured"], 3),
            "not paired" if unpaired else fixed(r["natural_freq_model"], 3),
            percent(r["freq_error"], 2, sign=True),
            percent(r["damping_ratio_measured"]),
            percent(r["damping_ratio_model"]),
        ]
        rows.append((*cells, *(fixed(r[n], 3) for n in ("mac", "emac", "margin"))) if shapes else tuple(cells))
    return Table(caption, (*heads, "MAC", "EMAC", "margin") if shapes else tuple(heads), tuple(rows))


def error_plot(stages: dict[str, pd.DataFrame], name: str, noise_mac: float) -> Plot:
    """Bars of the frequency error and of the MAC of every mode, by stage."""
    modes = list(dict.fromkeys(mode for table in stages.values() for mode in table["mode"]))
    shapes = any(table["mac"].notna().any() for table in stages.values())
    count = 2 if shapes else 1
    figure = make_subplots(rows=1, cols=count, horizontal_spacing=0.09, figure=new(380))
    for stage, table in stages.items():
        rows = table.set_index("mode").reindex(modes)
        for k, (column, factor, unit, digits) in enumerate(
            (("freq_error", 100.0, " %", 2), ("mac", 1.0, "", 3))[:count]
        ):
            values = factor * rows[column].to_numpy(dtype=float)
            words = [f"{m}, {stage}: {fixed(v, digits, sign=not k)}{unit}" for m, v in zip(modes, values, strict=True)]
            marker = filled(COLOURS[stage], PATTERNS[stage])
            figure.add_bar(
                x=list(range(len(modes))), y=values, name=f"{stage} calibration", marker=marker, legendgroup=stage,
                hovertext=[shown(w) for w in words], hoverinfo="text", showlegend=k == 0, row=1, col=k + 1,
            )  # fmt: skip
    figure.update_layout(
        xaxis=name_axis(modes, "measured mode"), yaxis=number_axis("error of the natural frequency, %"), barmode="group"
    )
    if shapes:
        figure.update_layout(xaxis2=name_axis(modes, "measured mode"), yaxis2=number_axis("MAC", range=[0, 1.05]))
        if not np.isnan(noise_mac):
            figure.add_hline(y=noise_mac, line={"color": GREY, "dash": "dash"}, row=1, col=2)
    summary = " ".join(_summary(stage, table, shapes) for stage, table in stages.items())
    line = " Dashed: the mean MAC that noise alone allows." if shapes and not np.isnan(noise_mac) else ""
    what = "Frequency errors, and MAC of the shapes." if shapes else "Frequency errors."
    return Plot(name, f"{what} {summary}{line}", f"Bars. {summary}", figure)


def _summary(stage: str, table: pd.DataFrame, shapes: bool) -> str:
    error = table["freq_error"].abs()
    if not error.notna().any():
        return f"{stage.capitalize()} calibration no mode is paired."
    worst = table.iloc[int(np.nanargmax(error))]
    note = f"{stage.capitalize()} calibration: mean error {percent(error.mean())} %, "
    note += f"largest {percent(worst['freq_error'], 2, sign=True)} % ({worst['mode']})"
    if shapes and table["mac"].notna().any():
        note += f"; mean MAC {fixed(table['mac'].mean(), 3)}"
    return note + "."


def mac_plot(results: StudyResults, stage: str) -> list[Plot]:
    """Matrix of the MAC of every measured mode with every model mode."""
    table = results.table(f"mac_{stage}", ["mode"], others_are_numbers=True)
    if table is None:
        return []
    columns = [c for c in table.columns if c != "mode"]
    modes = table["mode"].astype(str).tolist()
    values = table[columns].to_numpy(dtype=float)
    figure = new(max(260, 120 + 34 * len(modes)), plot_bgcolor="#EDEDED")
    cells = [[fixed(v, 2) for v in row] for row in values]
    add_matrix(figure, values, modes, columns, cells, colours="Blues", span=(0.0, 1.0), label="MAC")
    figure.update_layout(
        xaxis=name_axis(columns, "model mode", tickangle=-90 if len(columns) > 8 else 0),
        yaxis=name_axis(modes, "measured mode", reverse=True),
    )
    best = np.nanmax(values, axis=1) if np.isfinite(values).any() else np.full(len(modes), np.nan)
    note = "; ".join(f"{m} {fixed(v, 2)}" for m, v in zip(modes, best, strict=True))
    caption = f"MAC of measured with model modes, {stage} calibration. One dark cell per row is a clear pair."
    return [Plot(f"mac-{stage}", caption, f"Matrix of MAC values. The largest of each measured mode: {note}.", figure)]


def _shapes(results: StudyResults) -> list[Block]:
    found = scene(results)
    if found is None:
        return []
    caption = (
        "Measured and computed mode shapes. Choose a mode, play or pause it, drag to turn it. Grey: the model at rest; "
        f"blue: the model; red, with lines from the position at rest: the sensors. {AXES_NOTE} Real parts are shown; "
        "measurement and model have the same scale."
    )
    first = found["stages"][0]  # which the page shows first
    words = "; ".join(mode["words"] for mode in first["modes"])
    return [Shapes("mode-shapes", caption, f"Mode shapes {first['name']}: {words}.", found)]


def comac_plot(results: StudyResults) -> list[Plot]:
    """CoMAC of the sensors before and after calibration, worst first."""
    stages = {s: t for s in COLOURS if (t := results.table(f"comac_{s}", ["sensor"], ["comac"])) is not None}
    if not stages:
        return []
    newest = list(stages.values())[-1].set_index("sensor")["comac"]
    order = list(newest.sort_values(kind="stable", na_position="last").index)
    figure = new(360, xaxis=name_axis(order, "sensor, worst first", tickangle=-90), yaxis=number_axis("CoMAC"))
    for stage, table in stages.items():
        values = table.set_index("sensor")["comac"].reindex(order).to_numpy(dtype=float)
        symbol = "circle-open" if stage == "before" else "circle"
        marker = {"color": COLOURS[stage], "size": 9, "symbol": symbol, "line": {"width": 2, "color": COLOURS[stage]}}
        words = [shown(f"{s}, {stage}: {fixed(v, 3)}") for s, v in zip(order, values, strict=True)]
        figure.add_scatter(
            x=list(range(len(order))), y=values, mode="markers", marker=marker, name=f"{stage} calibration",
            hovertext=words, hoverinfo="text", showlegend=True,
        )  # fmt: skip
    worst = ", ".join(f"{s} {fixed(newest[s], 3)}" for s in order[:3])
    stage = list(stages)[-1]
    alt = f"Dots. The worst sensors {stage} calibration: {worst}; the mean is {fixed(newest.mean(), 3)}."
    return [Plot("comac", "CoMAC of every sensor; low values show where the shapes disagree.", alt, figure)]


def scalar_blocks(results: StudyResults, stage: str) -> list[Block]:
    """Mean error, bars and table of scalar responses."""
    table = results.table(f"comparison_{stage}", ["response"], ["measured", "model", "error", "error_in_std"])
    if table is None:
        return []
    rows = tuple(
        (
            str(r["response"]),
            significant(r["measured"], 6),
            significant(r["model"], 6),
            percent(r["error"], 2, sign=True),
            fixed(r["error_in_std"], 1, sign=True),
        )
        for r in table.to_dict("records")
    )
    heads = ("response", "measured", "model", "error, %", "error in std")
    figure, known = new(380), table["error_in_std"].notna().any()
    column, unit = ("error_in_std", "in standard deviations") if known else ("error", "relative to the response")
    names = table["response"].astype(str).tolist()
    _add_responses(figure, names, table[column].to_numpy(dtype=float), stage)
    figure.update_layout(xaxis=name_axis(names, "", tickangle=-90), yaxis=number_axis(f"error {unit}"))
    size = table[column].abs()
    worst = "" if not size.notna().any() else f" The largest is that of {names[int(size.argmax())]}."
    note = f"Mean absolute error {stage} calibration: {percent(table['error'].abs().mean())} %.{worst}"
    return [
        Words(note),
        Plot(f"responses-{stage}", f"Errors of all responses {unit}, {stage} calibration.", f"Bars. {note}", figure),
        Table(f"Every response {stage} calibration", heads, rows),
    ]


def _add_responses(figure: go.Figure, names: list[str], values: np.ndarray, stage: str) -> None:
    marker = filled(COLOURS[stage], PATTERNS[stage])
    words = [shown(f"{n}: {fixed(v, 2, sign=True)}") for n, v in zip(names, values, strict=True)]
    figure.add_bar(x=list(range(len(names))), y=values, marker=marker, hovertext=words, hoverinfo="text")
