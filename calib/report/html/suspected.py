"""Section on the measurement as a suspect: its faults, their scores, and what the best ones mean."""

from __future__ import annotations

from calib.report.html.page import Section, Table, Words
from calib.report.html.study_results import StudyResults
from calib.report.numbers import fixed, flag, with_unit, yes

_SHOWN = 12
"""Faults in the table."""


def section(results: StudyResults) -> Section | None:
    """Scores of all faults of the measurement; None where the test has none."""
    numbers = ["score", "unabsorbed", "magnitude", "low", "high", "magnitude_min", "ln_bayes", "limit"]
    table = results.table(
        "faults", ["fault", "kind"], numbers, flags=["fitted", "blamed"], blank=["sensor", "unit", "told"],
        unbounded=["magnitude_min"],
    )  # fmt: skip
    if table is None:
        return None
    limit = float(table["limit"].iloc[0])
    blamed = [str(r["told"]) for r in table.to_dict("records") if flag(r["blamed"])]
    beyond = int((table["score"].abs() > limit).sum())
    if blamed:
        found = f"The verdict names {'; or '.join(blamed)}."
    elif beyond:
        scores = f"{beyond} of {len(table)} scores lie beyond the limit"
        found = f"No fault is named; {scores}: what the model lacks takes some of them along."
    else:
        found = "No fault is named, and none stands out."
    intro = (
        f"{len(table)} faults that the measurement itself may have were tested beside the effects, of single sensors "
        "and of the whole test. A fault that explains the data better than every effect is named instead of it, and "
        "never added to the model. "
    )
    rows = tuple(
        (
            str(r["fault"]),
            fixed(r["score"], 1, sign=True),
            fixed(r["unabsorbed"], 2),
            with_unit(r["magnitude"], str(r["unit"])),
            fixed(r["ln_bayes"], 1),
            yes(r["blamed"]),
            str(r["told"]),
        )
        for r in table.head(_SHOWN).to_dict("records")
    )
    heads = ("fault", "score", "not absorbed", "magnitude", "ln Bayes", "named", "in words")
    caption = f"Scores of the faults of the measurement, by sensor. {found}"
    return Section(
        "suspect",
        "Suspect: the measurement",
        (
            Words(intro + found),
            *results.picture("suspects", caption, f"Dots. {found}"),
            Table("Faults of the largest scores", heads, rows, (5, 6)),
        ),
    )
