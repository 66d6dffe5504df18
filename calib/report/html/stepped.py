"""Section on a stepwise search: how the error falls with every effect, and what was tried and rejected."""

from __future__ import annotations

from calib.report.html.page import Block, Section, Table, Words
from calib.report.html.study_results import StudyResults
from calib.report.numbers import chance, fixed
from calib.report.verification import GROUPS, STEP_ERRORS


def section(results: StudyResults) -> Section | None:
    """The models in turn with their errors, and the rejected effects."""
    steps = results.table(
        "steps", ["effects"], ["step", "misfit", "ln_bayes", "p_family", "p_fit", "dof"], blank=["added", "left_again"]
    )
    if steps is None:
        return None
    intro = Words(
        "No single effect explains the data. The effect of the highest evidence is taken in, the others are fitted "
        "beside it, and so on; an effect that is no longer needed is left out again. The search stops when nothing "
        "systematic is left, when the error of data left out rises, or when fewer than two effective degrees of "
        "freedom remain."
    )
    rows = tuple(
        (fixed(r["step"], 0), str(r["effects"]), str(r["left_again"]), fixed(r["misfit"], 1), fixed(r["ln_bayes"], 1),
         chance(r["p_family"]), chance(r["p_fit"]), fixed(r["dof"], 1))
        for r in steps.to_dict("records")
    )  # fmt: skip
    heads = (
        *("step", "effects", "left out again", "misfit", "ln Bayes"), "p, largest score", "p, misfit",
        "degrees of freedom",
    )  # fmt: skip
    blocks: list[Block] = [intro, *_errors(results), Table("Models in turn", heads, rows, (1, 2))]
    return Section("steps", "Effects taken in one after the other", (*blocks, *_rejected(results)))


def _errors(results: StudyResults) -> list[Block]:
    table = results.table("steps_errors", ["effects", "group"], ["step", "rms", "expected", "p"])
    if table is None:
        return []
    notes = []
    for group in (g for g in GROUPS if (table["group"] == g).any()):
        own = table[table["group"] == group].sort_values("step")["rms"]
        notes.append(f"{GROUPS[group]} {' → '.join(fixed(value, 2) for value in own)}")
    caption = "Error at every step, in standard deviations; dashed: expected for a correctly specified model."
    return [*results.picture(STEP_ERRORS, caption, f"Lines. {'; '.join(notes)}.")]


def _rejected(results: StudyResults) -> list[Block]:
    table = results.table("steps_rejected", ["beside", "effect", "title", "why"], ["ln_bayes", "left_out"])
    if table is None:
        return []
    rows = tuple(
        (str(r["beside"]), str(r["title"]), fixed(r["ln_bayes"], 1), fixed(r["left_out"], 2), str(r["why"]))
        for r in table.to_dict("records")
    )
    heads = ("effects in the model", "tried beside them", "ln Bayes", "rms of data left out, σ", "rejected because")
    return [Table("Effects tried and rejected", heads, rows, (0, 1, 4))]
