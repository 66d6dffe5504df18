"""The cases of a calibration, what they found, how far it is known, and the model afterwards."""

from __future__ import annotations

import numpy as np
import pandas as pd

from calib.report.calibration import final_places, searched
from calib.report.html.answers import Answers
from calib.report.html.compared import error_plot, mac_plot, mode_table, plain_blocks
from calib.report.html.look import name_axis, new, number_axis, shown
from calib.report.html.numbers import counted, fixed, flag, percent, significant, with_unit, yes
from calib.report.html.page import Block, Plot, Section, Table, Terms, Words
from calib.report.style import CASES

TERMS = (
    ("case", "one search from its own random start; cases that end in different values have not found a unique answer"),
    (
        "misfit",
        "what a search makes small: weighted relative frequency errors and 1 − MAC, or relative errors of responses",
    ),
    (
        "std",
        "standard deviation of a parameter, given data and priors; where the model does not fit, for a scatter as "
        "large as its misfit",
    ),
    (
        "identified",
        "the data give at least half of what is known of it, std is at most 2.5 % of the range, and no limit holds it",
    ),
    ("spread", "difference of the searches in a parameter, before least squares, over its range"),
)
_SYMBOLS = ("circle", "square", "diamond", "triangle-up", "triangle-down", "cross", "x", "star")


def section(answers: Answers) -> Section | None:
    """Cases, verdicts on the parameters, and the comparison after the calibration."""
    table = answers.table(
        "parameters",
        ["case", "parameter", "unit"],
        ["value", "lower", "upper", "ratio", "spread", "std", "search_value"],
        flags=["on_bound", "stable", "identified"],
    )
    if table is None:
        return None
    best = str(answers.summary.get("best_case", table["case"].iloc[0]))
    cases = len(set(table["case"]))
    blocks: list[Block] = [
        Words(f"{counted(cases, 'case')} by {_method(answers, table)}; the values of case {best} are reported."),
        *_cases(answers),
        *_points(answers),
        *(Words(words, "told") for words in answers.sentences("calibrate")),
        Terms(TERMS),
        *_verdicts(answers, best),
        _parameter_plot(table, best),
        *_convergence(answers),
        *_after(answers, best),
        *_unknown(answers),
    ]
    return Section("calibrated", "Cases and verdicts", tuple(blocks))


def _method(answers: Answers, parameters: pd.DataFrame) -> str:
    if answers.summary.get("method") != "genetic":
        return "least squares from several starting points"
    fitted = parameters["search_value"].notna().any()  # told where least squares followed
    return "a genetic algorithm, then least squares" if fitted else "a genetic algorithm alone"


def _cases(answers: Answers) -> list[Block]:
    cases = answers.summary.get("cases", {})
    seeds = answers.questions.get("calibrate", {}).get("seeds", {})
    rows = tuple(
        (
            str(name),
            str(seeds.get(name, "–")),
            significant(_known(c.get("search_misfit"))),
            significant(_known(c.get("misfit"))),
            percent(_known(c.get("mean_freq_error_after"))),
            fixed(_known(c.get("mean_mac_after")), 4),
            *(str(c.get(count, "–")) for count in ("evaluations", "solved", "infeasible", "failed")),
            fixed(_known(c.get("seconds")), 0),
        )
        for name, c in cases.items()
    )
    heads = ("case", "seed", "misfit of the search", "misfit reported", "mean error, %", "mean MAC", "asked", "solved",
             "infeasible", "failed", "time, s")  # fmt: skip
    return [Table("The cases", heads, rows)] if rows else []


def _points(answers: Answers) -> list[Block]:
    numbers = ["objective", "sum_of_squares", "prior", "total"]
    table = answers.table("points", ["case", "point"], numbers)
    if table is None or table["point"].nunique() < 2:
        return []
    rows = tuple(
        (str(r["case"]), str(r["point"]), *(significant(r[name], 5) for name in numbers))
        for r in table.to_dict("records")
    )
    heads = ("case", "point", "objective of the search", "sum of squares", "of the priors", "total of least squares")
    return [Table("Both criteria where the search and where least squares ended, at full order", heads, rows, (1,))]


def _known(value: float | None) -> float:
    return float("nan") if value is None else float(value)


def _verdicts(answers: Answers, best: str) -> list[Block]:
    numbers = ["value", "ratio", "std", "spread"]
    table = answers.table("verdicts", ["parameter", "unit", "sentence"], numbers, flags=["identified"])
    if table is None:
        return []
    rows = tuple(
        (
            str(r["parameter"]),
            with_unit(r["value"], str(r["unit"]), 5),
            with_unit(r["std"], str(r["unit"]), 3),
            percent(r["ratio"], 0),
            percent(r["spread"], 0),
            yes(r["identified"]),
            str(r["sentence"]),
        )
        for r in table.to_dict("records")
    )
    heads = ("parameter", f"value in {best}", "std", "place in its range, %", "spread, %", "identified", "verdict")
    return [Table("Verdicts on the parameters", heads, rows, (5, 6))]


def _parameter_plot(table: pd.DataFrame, best: str) -> Plot:
    names, cases = list(dict.fromkeys(table["parameter"])), list(dict.fromkeys(table["case"]))
    figure = new(130 + 36 * len(names))
    for k, case in enumerate(cases):
        rows = table[table["case"] == case].set_index("parameter").reindex(names)
        words = [
            shown(
                f"{n}, {case}: {with_unit(r['value'], str(r['unit']), 5)} (limits {significant(r['lower'])} to "
                f"{significant(r['upper'])}; the search {significant(r['search_value'], 5)})"
            )
            for n, r in rows.iterrows()
        ]
        shift = (k - (len(cases) - 1) / 2) * min(0.14, 0.7 / len(cases))
        figure.add_scatter(
            x=searched(rows).to_numpy(dtype=float), y=np.arange(len(names)) + shift, mode="markers", hovertext=words,
            hoverinfo="text", showlegend=True,
            name=shown(f"{case} (reported)" if case == best else case),
            marker={"color": CASES[k % len(CASES)], "size": 9, "symbol": _SYMBOLS[k % len(_SYMBOLS)]},
        )  # fmt: skip
    final = final_places(table, best)
    if final is not None:
        final = final.reindex(names)
        figure.add_scatter(
            x=final["place"].to_numpy(), y=np.arange(len(names)), mode="markers", hoverinfo="skip", showlegend=True,
            name=shown(f"{best} after least squares (± 2 std)"),
            marker={"color": "black", "size": 8, "symbol": "diamond"},
            error_x={"type": "data", "array": final["reach"].to_numpy(), "thickness": 1.5},
        )  # fmt: skip
    figure.update_layout(
        xaxis=number_axis("place between the limits of the search: 0 is the lower, 1 the upper", range=[-0.05, 1.05]),
        yaxis=name_axis(names, reverse=True),
    )
    bound = table[(table["case"] == best) & table["on_bound"].map(flag)]["parameter"].tolist()
    told = f"At a limit: {', '.join(bound)}." if bound else "None lies at a limit."
    what = "Parameters found by every case" if final is None else "Parameters that every search found"
    caption = f"{what}, between their limits. {told}"
    rows = table[table["case"] == best]
    places = ", ".join(f"{n} {fixed(v, 2)}" for n, v in zip(rows["parameter"], rows["ratio"], strict=True))
    return Plot("parameters", caption, f"Dots. Places in case {best}: {places}. {told}", figure)


def _convergence(answers: Answers) -> list[Block]:
    misfit = ["best", "mean"]
    table = answers.table("convergence", ["case"], ["generation", *misfit], complete=["generation"], unbounded=misfit)
    if table is None:
        return []
    step = "generation" if answers.summary.get("method") == "genetic" else "fit"
    figure = new(380, xaxis=number_axis(step), yaxis=number_axis("misfit", type="log"))
    ends = []
    for k, (case, rows) in enumerate(table.groupby("case", sort=False)):
        best = rows["best"].replace(np.inf, np.nan).to_numpy(dtype=float)
        line = {"color": CASES[k % len(CASES)], "dash": ("solid", "dash", "dot", "dashdot")[k % 4], "width": 2}
        figure.add_scatter(
            x=rows["generation"].to_numpy(), y=best, mode="lines", line=line, name=shown(case), showlegend=True
        )
        ends.append(f"{case} {significant(float(best[-1]))}" if len(best) else str(case))
    caption = f"The lowest misfit so far over the {step}s of every case."
    return [Plot("convergence", caption, f"Lines that fall. They end at: {', '.join(ends)}.", figure)]


def _after(answers: Answers, best: str) -> list[Block]:
    if answers.plain:
        return [Words(f"The model after calibration, case {best}:"), *plain_blocks(answers, "after")]
    after, before = answers.compared("after"), answers.compared("before")
    if after is None:
        return []
    stages = {"after": after} if before is None else {"before": before, "after": after}
    return [
        mode_table(after, f"The model after calibration (case {best})"),
        error_plot(stages, "errors-after", answers.noise_mac),
        *mac_plot(answers, "after"),
    ]


def _unknown(answers: Answers) -> list[Block]:
    return [*_pairs(answers), *_directions(answers), *_predictions(answers)]


def _pairs(answers: Answers) -> list[Block]:
    table = answers.table("confounded", ["parameter_a", "parameter_b", "words"], ["correlation"])
    if table is None:
        return []
    rows = tuple(
        (f"{r['parameter_a']}, {r['parameter_b']}", fixed(r["correlation"], 2, sign=True), str(r["words"]))
        for r in table.to_dict("records")
    )
    return [Table("Parameters that trade one for the other", ("pair", "correlation", ""), rows, (2,))]


def _directions(answers: Answers) -> list[Block]:
    table = answers.table("unseen_directions", ["words"], ["signal"], flags=["seen"])
    if table is None:
        return []
    rows = tuple((str(r["words"]), yes(r["seen"])) for r in table.to_dict("records"))
    return [Table("What the data see of combined changes, the weakest first", ("combination", "seen"), rows, (1,))]


def _predictions(answers: Answers) -> list[Block]:
    numbers = ["natural_freq", "std", "lower", "upper"]
    table = answers.table("predictions", ["mode"], numbers)
    if table is None:
        return []
    rows = tuple((str(r["mode"]), *(fixed(r[n], 3) for n in numbers)) for r in table.to_dict("records"))
    heads = ("mode", "natural frequency, Hz", "std, Hz", "lower, Hz", "upper, Hz")
    return [Table("Frequencies of the calibrated model with their 95 % intervals", heads, rows)]
