"""Section on errors in fitted, left-out and held-out data, and on the effects that were added."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from calib.report.html.look import PATTERNS, filled, name_axis, new, number_axis, shown
from calib.report.html.numbers import chance, fixed, flag, percent, significant, with_unit
from calib.report.html.page import Block, Plot, Section, Table, Terms, Words
from calib.report.html.study_results import StudyResults
from calib.report.style import AFTER, BEFORE, BLACK, CASES
from calib.report.verification import GROUPS

TERMS = (
    ("rms", "root mean square of the errors, in standard deviations σ of the measurement"),
    (
        "expected",
        "rms of a correctly specified model on these data; larger where the left-out data alone determine a parameter",
    ),
    ("p", "probability that a correctly specified model has at least this error"),
)
STAGES = {
    "before": ("base model", BEFORE),
    "after": ("with the missing effect", AFTER),
    "attempt": ("best attempt, not believed", "#BDBDBD"),
}
_GAP = 0.3


def errors(results: StudyResults) -> Section | None:
    """Errors before and after by group of data, and over the versions of an extended model."""
    sentence = [Words(str(results.added["sentence"]).replace(" -> ", " → "), "verdict")] if results.added else []
    if results.added_names:
        title, blocks = "Prediction errors before and after adding the effects", _added(results)
    else:
        title, blocks = (
            "Prediction errors",
            [*_explained(results), *_calibrated(results), *_modes(results), *_responses(results)],
        )
    blocks += _versions(results)
    if not blocks:
        return None
    intro = Words(
        "An explanation or a calibration is assessed by its predictions: errors in fitted data, in data left out in "
        "turn, and in data held out from every fit."
    )
    return Section("errors", title, (intro, *sentence, Terms(TERMS), *blocks))


def _added(results: StudyResults) -> list[Block]:
    """Errors and parameters of the model with the added effects, calibrated again."""
    name = " + ".join(results.added_names)
    note = (
        "Both models were calibrated in the same way; the verdict quotes magnitudes and errors of the explanation's "
        f"own fits, by least squares alone. The extended study is in {results.added['study']}."
    )
    out: list[Block] = [Words(note)]
    table = results.table("added_errors", ["group", "stage"], ["rows", "rms", "expected", "p"])
    if table is not None:
        what = f"before and after adding {name}, both models calibrated"
        out += [_error_plot(table, what), _both_table(table, f"Errors {what}")]
    labels = {"initial": "nothing fitted", "before": "calibrated", "after": "extended"}
    caption = f"Every measured mode: nothing fitted, calibrated, and extended with {name} and calibrated again"
    return [*out, *_added_parameters(results, name), *_mode_table(results, "added_modes", labels, caption)]


def _added_parameters(results: StudyResults, name: str) -> list[Block]:
    numbers = ["nominal", "before", "before_std", "after", "after_std"]
    table = results.table("added_parameters", ["parameter"], numbers, flags=["added"], blank=["unit"])
    if table is None:
        return []
    rows = tuple(
        (
            str(r["parameter"]),
            "added" if flag(r["added"]) else "",
            with_unit(r["nominal"], str(r["unit"]), 4),
            *(significant(r[n], 4 if n in ("before", "after") else 2) for n in numbers[1:]),
        )
        for r in table.to_dict("records")
    )
    heads = ("parameter", "", "nominal", "without", "std", f"with {name}", "std")
    moved = table[(table["after"] - table["before"]).abs() > 2 * table["before_std"]]
    note = "; ".join(
        f"{r['parameter']} {significant(r['before'])} → {with_unit(r['after'], str(r['unit']), 4)} "
        f"(nominal {significant(r['nominal'])})"
        for r in moved.to_dict("records")
    )
    words = f"Without {name}, other parameters compensated by more than two standard deviations: {note}."
    return [
        *([Words(words)] if note else []),
        Table("Calibrated parameters without and with the added effects", heads, rows, (1,)),
    ]


def _explained(results: StudyResults) -> list[Block]:
    table = results.table("errors", ["group", "stage"], ["rows", "rms", "expected", "p"])
    if table is None:
        return []
    name = " + ".join(results.explanation.get("chosen", []))
    what = f"before and after adding {name}" if name else "of the base model"
    return [_error_plot(table, what), _error_table(table, f"Errors {what}")]


def _error_plot(table: pd.DataFrame, what: str) -> Plot:
    """Errors by stage and group of data."""
    groups = _groups(table)
    stages = [s for s in STAGES if (table["stage"] == s).any()]
    figure = new(400, barmode="group", bargap=_GAP)
    for k, stage in enumerate(stages):
        rows = table[table["stage"] == stage].set_index("group").reindex(groups)
        label, colour = STAGES[stage]
        words = [
            shown(
                f"{GROUPS.get(g, g)}, {label}: {fixed(r['rms'], 2)} σ; expected {fixed(r['expected'], 2)}; "
                f"p {chance(r['p'])}"
            )
            for g, r in zip(groups, rows.to_dict("records"), strict=True)
        ]
        figure.add_bar(
            x=list(range(len(groups))), y=rows["rms"].to_numpy(dtype=float), name=label, showlegend=True,
            hovertext=words, hoverinfo="text",
            marker=filled(colour, PATTERNS[stage]),
        )  # fmt: skip
        # The bars of a group share the width that bargap leaves between two names.
        at = np.arange(len(groups)) + (k - (len(stages) - 1) / 2) * (1.0 - _GAP) / len(stages)
        figure.add_scatter(
            x=at, y=rows["expected"].to_numpy(dtype=float), mode="markers", name="expected", showlegend=k == 0,
            hoverinfo="skip",
            legendrank=2000, marker={"symbol": "line-ew", "size": 40, "line": {"width": 3, "color": BLACK}},
        )  # fmt: skip
    labels = [GROUPS.get(g, g) for g in groups]
    figure.update_layout(xaxis=name_axis(labels), yaxis=number_axis("rms error, σ", rangemode="tozero"))
    note = "; ".join(f"{GROUPS.get(g, g)} {_arrow(table, g)}" for g in groups)
    caption = f"Error {what}, in standard deviations; black lines: expected for a correctly specified model."
    return Plot("errors", caption, f"Bars. {note}.", figure)


def _arrow(table: pd.DataFrame, group: str) -> str:
    return " → ".join(fixed(v, 2) for v in table[table["group"] == group]["rms"])


def _error_table(table: pd.DataFrame, caption: str) -> Table:
    rows = tuple(
        (
            GROUPS.get(str(r["group"]), str(r["group"])),
            STAGES.get(str(r.get("stage", "")), ("calibrated model",))[0],
            fixed(r["rows"], 0),
            fixed(r["rms"], 2),
            fixed(r["expected"], 2),
            chance(r["p"]),
        )
        for r in table.to_dict("records")
    )
    return Table(caption, ("data", "model", "residuals", "rms, σ", "expected, σ", "p"), rows, (1,))


def _both_table(table: pd.DataFrame, caption: str) -> Table:
    """One row per group of data, both stages side by side."""
    groups = _groups(table)
    # A group that one stage lacks, such as modes that are unpaired there, has a dash.
    before, after = (table[table["stage"] == s].set_index("group").reindex(groups) for s in ("before", "after"))
    rows = tuple(
        (
            GROUPS.get(group, group),
            fixed(after["rows"][group], 0),
            *(fixed(stage[number][group], 2) for number in ("rms", "expected") for stage in (before, after)),
            *(chance(stage["p"][group]) for stage in (before, after)),
        )
        for group in groups
    )
    columns = ("rms before, σ", "after, σ", "expected before, σ", "after, σ", "p before", "after")
    return Table(caption, ("data", "residuals", *columns), rows)


def _calibrated(results: StudyResults) -> list[Block]:
    table = results.table("data_errors", ["group"], ["rows", "rms", "expected", "p"])
    return [] if table is None else [_error_table(table, "Errors of the calibrated model, no effect added")]


def _modes(results: StudyResults) -> list[Block]:
    caption = "Damped frequencies and MAC of every measured mode, before and after calibration"
    table = _mode_table(results, "modes", {"initial": "initial", "before": "before", "after": "after"}, caption)
    note = "Initial: the model before the calibration of the earlier study."
    return [Words(note), *table] if table and "initial, Hz" in table[0].heads else [*table]


def _responses(results: StudyResults) -> list[Table]:
    stages = ("before", "after")
    numbers = ["measured", *stages, *(f"error_{stage}" for stage in stages)]
    table = results.table("responses", ["response"], numbers, flags=["held_out"], unique="response")
    if table is None:
        return []
    rows = tuple(
        (
            str(r["response"]),
            "held out" if flag(r["held_out"]) else "used",
            *(significant(r[n], 5) for n in numbers[:3]),
            *(percent(r[n], sign=True) for n in numbers[3:]),
        )
        for r in table.to_dict("records")
    )
    heads = ("response", "", "measured", *stages, *(f"error {stage}, %" for stage in stages))
    return [Table("Every measured response, before and after calibration", heads, rows, (1,))]


def _mode_table(results: StudyResults, name: str, labels: Mapping[str, str], caption: str) -> list[Table]:
    """Every measured mode at each stage; ``labels`` names the stages."""
    kinds = ("damped_freq", "error", "mac")
    numbers = [f"{kind}_{stage}" for kind in kinds for stage in ("before", "after")]
    table = results.table(
        name, ["mode"], ["damped_freq_measured", *numbers], flags=["held_out"],
        if_there=[f"{kind}_initial" for kind in kinds],
    )  # fmt: skip
    if table is None:
        return []
    stages = [stage for stage in labels if f"error_{stage}" in table]
    rows = tuple(
        (
            str(r["mode"]),
            "held out" if flag(r["held_out"]) else "fitted",
            *(fixed(r[f"damped_freq_{stage}"], 3) for stage in ("measured", *stages)),
            *(percent(r[f"error_{stage}"], 2, sign=True) for stage in stages),
            *(fixed(r[f"mac_{stage}"], 3) for stage in stages),
        )
        for r in table.to_dict("records")
    )
    heads = ["mode", "", "measured, Hz", *(f"{labels[stage]}, Hz" for stage in stages)]
    heads += [*(f"error {labels[stage]}, %" for stage in stages), *(f"MAC {labels[stage]}" for stage in stages)]
    return [Table(caption, tuple(heads), rows, (1,))]


def _versions(results: StudyResults) -> list[Block]:
    table = results.table(
        "versions", ["group"], ["version", "rms", "expected"], complete=["version"], blank=["study", "effects"]
    )
    if table is None:
        return []
    groups, versions = _groups(table), sorted(set(table["version"]))
    effects = table.groupby("version")["effects"].first()
    labels = [f"{v:g}: {effects[v] or 'base model'}" for v in versions]
    figure = new(400)
    for k, group in enumerate(groups):
        over = table[table["group"] == group].groupby("version")[["rms", "expected"]].first().reindex(versions)
        looks = {"color": CASES[k % len(CASES)]}
        at, name = list(range(len(versions))), GROUPS.get(group, group)
        figure.add_scatter(
            x=at, y=over["rms"].to_numpy(dtype=float), mode="lines+markers", name=name, line=looks,
            marker={"size": 9, "symbol": ("circle", "square", "diamond", "triangle-up")[k % 4]},
        )  # fmt: skip
        figure.add_scatter(
            x=at, y=over["expected"].to_numpy(dtype=float), mode="lines", line={**looks, "dash": "dash", "width": 1},
            name=f"{name}, expected", showlegend=False,
        )  # fmt: skip
    figure.update_layout(xaxis=name_axis(labels), yaxis=number_axis("rms error, σ", rangemode="tozero"))
    note = "; ".join(f"{GROUPS.get(g, g)} {_arrow(table, g)}" for g in groups)
    rows = tuple(
        (f"{r['version']:g}", str(r["effects"]) or "base model", GROUPS.get(str(r["group"]), str(r["group"])),
         fixed(r["rms"], 2), fixed(r["expected"], 2))
        for r in table.to_dict("records")
    )  # fmt: skip
    caption = "Errors over the versions of the model; dashed: expected for a correctly specified model."
    heads = ("version", "added", "data", "rms, σ", "expected, σ")
    return [
        Plot("versions", caption, f"Lines. {note}.", figure),
        Table("Errors over the versions of the model", heads, rows, (1, 2)),
    ]


def _groups(table: pd.DataFrame) -> list[str]:
    known = set(table["group"][table["rms"].notna()])
    return [*(g for g in GROUPS if g in known), *sorted(known - set(GROUPS))]
