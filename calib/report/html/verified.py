"""Errors on data that were used, left out and withheld, before and after, and what was added between."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from calib.report.html.answers import Answers
from calib.report.html.look import PATTERNS, filled, name_axis, new, number_axis, shown
from calib.report.html.numbers import chance, fixed, flag, percent, significant, with_unit
from calib.report.html.page import Block, Plot, Section, Table, Terms, Words
from calib.report.style import AFTER, BEFORE, BLACK, CASES
from calib.report.verification import GROUPS

TERMS = (
    ("rms", "root mean square of the errors, in units σ of the measurement's scatter"),
    (
        "right model",
        "the rms that a model without fault would show on these data; more where those left out were all that told of "
        "something",
    ),
    ("p", "chance that a right model errs as much"),
)
STAGES = {
    "before": ("base model", BEFORE),
    "after": ("with what is missing", AFTER),
    "attempt": ("best attempt, not believed", "#BDBDBD"),
}
_GAP = 0.3


def errors(answers: Answers) -> Section | None:
    """Before and after, by group of data; over the versions of a model that was extended."""
    told = [Words(str(answers.added["sentence"]).replace(" -> ", " → "), "verdict")] if answers.added else []
    if answers.added_names:
        title, blocks = "What was added, and the error before and after", _added(answers)
    else:
        title, blocks = (
            "Error before and after",
            [*_explained(answers), *_calibrated(answers), *_modes(answers), *_responses(answers)],
        )
    blocks += _versions(answers)
    if not blocks:
        return None
    intro = Words(
        "An explanation or a calibration is worth what it predicts: the error in data that were fitted, in modes left "
        "out one after the other, and in data that were withheld from every fit."
    )
    return Section("errors", title, (intro, *told, Terms(TERMS), *blocks))


def _added(answers: Answers) -> list[Block]:
    """What the effects bring that were added to the model, which was calibrated once more."""
    name = " + ".join(answers.added_names)
    note = (
        "Both models were calibrated alike; the verdict quotes strengths and errors of the explanation's own fits, "
        f"which are least squares alone. The extended study lies in {answers.added['study']}."
    )
    out: list[Block] = [Words(note)]
    table = answers.table("added_errors", ["group", "stage"], ["rows", "rms", "expected", "p"])
    if table is not None:
        what = f"before and after adding {name}, calibrated both times"
        out += [_error_plot(table, what), _both_table(table, f"Errors {what}")]
    called = {"initial": "nothing fitted", "before": "calibrated", "after": "extended"}
    caption = f"Every measured mode: nothing fitted, calibrated, and extended with {name} and calibrated again"
    return [*out, *_added_parameters(answers, name), *_mode_table(answers, "added_modes", called, caption)]


def _added_parameters(answers: Answers, name: str) -> list[Block]:
    numbers = ["adopted", "before", "before_std", "after", "after_std"]
    table = answers.table("added_parameters", ["parameter"], numbers, flags=["added"], blank=["unit"])
    if table is None:
        return []
    rows = tuple(
        (
            str(r["parameter"]),
            "added" if flag(r["added"]) else "",
            with_unit(r["adopted"], str(r["unit"]), 4),
            *(significant(r[n], 4 if n in ("before", "after") else 2) for n in numbers[1:]),
        )
        for r in table.to_dict("records")
    )
    heads = ("parameter", "", "adopted", "without", "std", f"with {name}", "std")
    moved = table[(table["after"] - table["before"]).abs() > 2 * table["before_std"]]
    told = "; ".join(
        f"{r['parameter']} {significant(r['before'])} → {with_unit(r['after'], str(r['unit']), 4)} "
        f"(adopted {significant(r['adopted'])})"
        for r in moved.to_dict("records")
    )
    words = f"Without what was added other parameters stood in for it, by more than two standard deviations: {told}."
    return [
        *([Words(words)] if told else []),
        Table("Calibrated parameters without and with what was added", heads, rows, (1,)),
    ]


def _explained(answers: Answers) -> list[Block]:
    table = answers.table("errors", ["group", "stage"], ["rows", "rms", "expected", "p"])
    if table is None:
        return []
    name = " + ".join(answers.explanation.get("chosen", []))
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
                f"{GROUPS.get(g, g)}, {label}: {fixed(r['rms'], 2)} σ; right model {fixed(r['expected'], 2)}; "
                f"p {chance(r['p'])}"
            )
            for g, r in zip(groups, rows.to_dict("records"), strict=True)
        ]
        figure.add_bar(
            x=list(range(len(groups))), y=rows["rms"].to_numpy(dtype=float), name=label, showlegend=True,
            hovertext=words, hoverinfo="text",
            marker=filled(colour, PATTERNS[stage]),
        )  # fmt: skip
        # Bars of a group share what bargap leaves of the room between two names.
        at = np.arange(len(groups)) + (k - (len(stages) - 1) / 2) * (1.0 - _GAP) / len(stages)
        figure.add_scatter(
            x=at, y=rows["expected"].to_numpy(dtype=float), mode="markers", name="right model", showlegend=k == 0,
            hoverinfo="skip",
            legendrank=2000, marker={"symbol": "line-ew", "size": 40, "line": {"width": 3, "color": BLACK}},
        )  # fmt: skip
    labels = [GROUPS.get(g, g) for g in groups]
    figure.update_layout(xaxis=name_axis(labels), yaxis=number_axis("rms error, σ", rangemode="tozero"))
    told = "; ".join(f"{GROUPS.get(g, g)} {_arrow(table, g)}" for g in groups)
    caption = f"Error {what}, in units of the scatter; black lines: what a right model would show."
    return Plot("errors", caption, f"Bars. {told}.", figure)


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
    return Table(caption, ("data", "model", "numbers", "rms, σ", "right model, σ", "p"), rows, (1,))


def _both_table(table: pd.DataFrame, caption: str) -> Table:
    """One row a group of data, both stages side by side."""
    groups = _groups(table)
    # A group that one stage does not have, such as modes without a partner there, is told with a dash.
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
    columns = ("rms before, σ", "after, σ", "right model before, σ", "after, σ", "p before", "after")
    return Table(caption, ("data", "numbers", *columns), rows)


def _calibrated(answers: Answers) -> list[Block]:
    table = answers.table("data_errors", ["group"], ["rows", "rms", "expected", "p"])
    return [] if table is None else [_error_table(table, "Errors of the calibrated model, nothing added")]


def _modes(answers: Answers) -> list[Block]:
    caption = "Damped frequencies and MAC of every measured mode, before and after calibration"
    table = _mode_table(answers, "modes", {"initial": "initial", "before": "before", "after": "after"}, caption)
    told = "Initial is the model whose earlier study was not calibrated either."
    return [Words(told), *table] if table and "initial, Hz" in table[0].heads else [*table]


def _responses(answers: Answers) -> list[Table]:
    stages = ("before", "after")
    numbers = ["measured", *stages, *(f"error_{stage}" for stage in stages)]
    table = answers.table("responses", ["response"], numbers, flags=["withheld"], unique="response")
    if table is None:
        return []
    rows = tuple(
        (
            str(r["response"]),
            "withheld" if flag(r["withheld"]) else "used",
            *(significant(r[n], 5) for n in numbers[:3]),
            *(percent(r[n], sign=True) for n in numbers[3:]),
        )
        for r in table.to_dict("records")
    )
    heads = ("response", "", "measured", *stages, *(f"error {stage}, %" for stage in stages))
    return [Table("Every measured response, before and after calibration", heads, rows, (1,))]


def _mode_table(answers: Answers, name: str, called: Mapping[str, str], caption: str) -> list[Table]:
    """Every measured mode from stage to stage, each stage by what it is called."""
    kinds = ("damped_freq", "error", "mac")
    numbers = [f"{kind}_{stage}" for kind in kinds for stage in ("before", "after")]
    table = answers.table(
        name, ["mode"], ["damped_freq_measured", *numbers], flags=["withheld"],
        if_there=[f"{kind}_initial" for kind in kinds],
    )  # fmt: skip
    if table is None:
        return []
    stages = [stage for stage in called if f"error_{stage}" in table]
    rows = tuple(
        (
            str(r["mode"]),
            "withheld" if flag(r["withheld"]) else "fitted",
            *(fixed(r[f"damped_freq_{stage}"], 3) for stage in ("measured", *stages)),
            *(percent(r[f"error_{stage}"], 2, sign=True) for stage in stages),
            *(fixed(r[f"mac_{stage}"], 3) for stage in stages),
        )
        for r in table.to_dict("records")
    )
    heads = ["mode", "", "measured, Hz", *(f"{called[stage]}, Hz" for stage in stages)]
    heads += [*(f"error {called[stage]}, %" for stage in stages), *(f"MAC {called[stage]}" for stage in stages)]
    return [Table(caption, tuple(heads), rows, (1,))]


def _versions(answers: Answers) -> list[Block]:
    table = answers.table(
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
            name=f"{name}, right model", showlegend=False,
        )  # fmt: skip
    figure.update_layout(xaxis=name_axis(labels), yaxis=number_axis("rms error, σ", rangemode="tozero"))
    told = "; ".join(f"{GROUPS.get(g, g)} {_arrow(table, g)}" for g in groups)
    rows = tuple(
        (f"{r['version']:g}", str(r["effects"]) or "base model", GROUPS.get(str(r["group"]), str(r["group"])),
         fixed(r["rms"], 2), fixed(r["expected"], 2))
        for r in table.to_dict("records")
    )  # fmt: skip
    caption = "Errors over the versions of the model; dashed: what a right model would show."
    heads = ("version", "added", "data", "rms, σ", "right model, σ")
    return [
        Plot("versions", caption, f"Lines. {told}.", figure),
        Table("Errors over the versions of the model", heads, rows, (1, 2)),
    ]


def _groups(table: pd.DataFrame) -> list[str]:
    there = set(table["group"][table["rms"].notna()])
    return [*(g for g in GROUPS if g in there), *sorted(there - set(GROUPS))]
