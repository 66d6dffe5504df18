"""Section on model against measurement, mode by mode."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from calib.report.comparison import STILL
from calib.report.html.frf import frf_blocks
from calib.report.html.page import Block, Picture, Section, Table, Terms, Viewer, Words
from calib.report.html.space import scene
from calib.report.html.study_results import STAGES, StudyResults
from calib.report.numbers import fixed, percent, significant

TERMS = (
    ("MAC", "modal assurance criterion: 1 for proportional shapes, 0 for orthogonal ones"),
    (
        "EMAC",
        "MAC times the share of strain energy in the part of the model that carries the mode; used to pair modes",
    ),
    ("margin", "EMAC of the pair minus that of the next best candidate; a small margin means a doubtful pair"),
    ("CoMAC", "coordinate MAC: agreement of the shapes at one sensor over all modes"),
)
EXPANSION = (
    ("cross-orthogonality", "as the MAC, but by mass: at least 0.9 for pairs and at most 0.1 for others is usual"),
    ("residual of the expansion", "share of the measured shape that the paired shapes of the model cannot form"),
    ("imaginary part", "share of the measured shape that is out of phase; the orthogonality leaves it out"),
    ("error of the reduction", "of the model's own shape, known at the sensors only; where it is large, the "
                               "orthogonality tells little"),
)  # fmt: skip


def section(results: StudyResults) -> Section | None:
    """The model at its nominal values, nothing fitted, and the viewer."""
    title = "Model against measurement, nothing fitted"
    if results.kind != "modes":
        blocks = plain_blocks(results, "before")
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
        *([] if results.compared("after") is not None else error_picture(results, {"before": table})),
        *mac_picture(results, "before"),
        *orthogonality_blocks(results, "before"),
        *_viewer(results),
        *shapes_picture(results, "before"),
        *comac_picture(results),
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


def error_picture(results: StudyResults, stages: Mapping[str, pd.DataFrame]) -> list[Picture]:
    """Frequency error and MAC of every mode, by stage."""
    shapes = any(table["mac"].notna().any() for table in stages.values())
    summary = " ".join(_summary(results.in_words(stage), table, shapes) for stage, table in stages.items())
    what = "Frequency errors, and MAC of the shapes." if shapes else "Frequency errors."
    return results.picture("comparison", f"{what} {summary}", f"Bars. {summary}")


def _summary(words: str, table: pd.DataFrame, shapes: bool) -> str:
    words = f"{words[:1].upper()}{words[1:]}"
    error = table["freq_error"].abs()
    if not error.notna().any():
        return f"{words}: no mode is paired."
    worst = table.iloc[int(np.nanargmax(error))]
    note = f"{words}: mean error {percent(error.mean())} %, "
    note += f"largest {percent(worst['freq_error'], 2, sign=True)} % ({worst['mode']})"
    if shapes and table["mac"].notna().any():
        note += f"; mean MAC {fixed(table['mac'].mean(), 3)}"
    return note + "."


def mac_picture(results: StudyResults, stage: str) -> list[Picture]:
    """Matrix of the MAC of every measured mode with every model mode."""
    table = results.table(f"mac_{stage}", ["mode"], others_are_numbers=True)
    if table is None:
        return []
    modes = table["mode"].astype(str).tolist()
    values = table.drop(columns="mode").to_numpy(dtype=float)
    best = np.nanmax(values, axis=1) if np.isfinite(values).any() else np.full(len(modes), np.nan)
    note = "; ".join(f"{m} {fixed(v, 2)}" for m, v in zip(modes, best, strict=True))
    caption = f"MAC of measured with model modes, {results.in_words(stage)}. One dark cell per row is a clear pair."
    alt = f"Matrix of MAC values. The largest of each measured mode: {note}."
    return results.picture(f"mac_{stage}", caption, alt)


def orthogonality_blocks(results: StudyResults, stage: str) -> list[Block]:
    """Matrices of cross- and self-orthogonality, and how far they and the expanded shapes can be trusted."""
    found = results.table(f"expansion_{stage}", ["mode", "reduction"], ["residual", "imaginary", "tam_error"],
                          blank=["reason"])  # fmt: skip
    if found is None:
        return []
    words = results.in_words(stage)
    caption = f"Mass-orthogonality of the measured shapes, {words}: (a) to those of the model, (b) among themselves. "
    caption += "Frames mark pairs below 0.9 and others above 0.1."
    rows = tuple(
        (
            str(r["mode"]),
            percent(r["residual"], 1),
            percent(r["imaginary"], 1),
            str(r["reduction"]),
            percent(r["tam_error"], 1),
            str(r["reason"]),
        )
        for r in found.to_dict("records")
    )
    heads = ("mode", "residual of the expansion, %", "imaginary part, %", "reduction", "error of the reduction, %", "")
    return [
        *results.picture(f"orthogonality_{stage}", caption, f"Two matrices. {caption}"),
        Table(f"Expansion of the measured shapes and reduction of the mass matrix, {words}", heads, rows, (3, 5)),
        *([Terms(EXPANSION)] if stage == "before" else []),
    ]


def _viewer(results: StudyResults) -> list[Viewer]:
    found = scene(results)
    if found is None:
        return []
    caption = (
        "The model in space. Drag to turn it, or focus it and press the arrow keys; the wheel zooms with Ctrl or after "
        f"a click, double-click or Home resets the view. Point at a dot for its name, or press N and P. {results.axes} "
    )
    if found["stages"]:
        caption += "Mode shapes are real parts, with one scale for measurement and model."
        first = found["stages"][0]  # which the page shows first
        alt = f"Mode shapes {first['name']}: {'; '.join(mode['words'] for mode in first['modes'])}."
    else:
        first = found["layers"][0]
        alt = f"{first['title']}: {first['words']}."
    return [Viewer("viewer", caption.strip(), alt, found)]


def shapes_picture(results: StudyResults, stage: str) -> list[Picture]:
    """All measured mode shapes, the test beside the model; that of the latest stage alone."""
    if stage == "before" and results.has("shapes_after"):
        return []
    words = results.in_words(stage)
    caption = f"All mode shapes, {words}: left the test, "
    if results.has(f"expanded_shapes_{stage}"):
        caption += (
            "its shape expanded to the whole mesh by the paired shapes of the model; dots off the mesh show what "
        )
        caption += "these cannot explain. "
    else:
        caption += "its sensors joined to their neighbours along the mesh. "
    caption += "Right the model with the measured motion."
    return results.picture(f"mode_shapes_{stage}", caption, f"Mode shapes, {words}, measured and computed.")


def comac_picture(results: StudyResults) -> list[Picture]:
    """CoMAC of the sensors before and after calibration, worst first."""
    stages = {
        s: t
        for s in STAGES
        if (t := results.table(f"comac_{s}", ["sensor"], ["comac"], if_there=["motion"])) is not None
    }
    if not stages:
        return []
    stage = list(stages)[-1]
    table = stages[stage].set_index("sensor")
    newest = table["comac"].sort_values(kind="stable", na_position="last")
    still = set(table.index[table["motion"] < STILL]) if "motion" in table else set()
    worst = ", ".join(f"{s} {fixed(v, 3)}{' (hardly moves)' if s in still else ''}" for s, v in newest.head(3).items())
    alt = f"Dots. The worst sensors, {results.in_words(stage)}: {worst}; the mean is {fixed(newest.mean(), 3)}."
    caption = "CoMAC of every sensor; low values show where the shapes disagree."
    caption += " At grey sensors, which hardly move, noise alone lowers it." if still else ""
    return results.picture("comac", caption, alt)


def plain_blocks(results: StudyResults, stage: str) -> list[Block]:
    """Scalar responses or FRFs of one stage."""
    return frf_blocks(results, stage) if results.kind == "frf" else scalar_blocks(results, stage)


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
    column, unit = (
        ("error_in_std", "in standard deviations")
        if table["error_in_std"].notna().any()
        else ("error", "relative to the response")
    )
    size = table[column].abs()
    worst = f" The largest is that of {table['response'][int(size.argmax())]}." if size.notna().any() else ""
    words = results.in_words(stage)
    note = f"Mean absolute error, {words}: {percent(table['error'].abs().mean())} %.{worst}"
    return [
        Words(note),
        *results.picture(f"responses_{stage}", f"Errors of all responses {unit}, {words}.", f"Bars. {note}"),
        Table(f"Every response, {words}", heads, rows),
    ]
