"""What the answers stand on: assumptions, parameters, versions and seeds; and what was not asked."""

from __future__ import annotations

from collections.abc import Mapping

from calib.report.html.answers import Answers
from calib.report.html.numbers import counted, significant, with_unit, yes
from calib.report.html.page import Block, Section, Table, Words


def assumptions(answers: Answers) -> Section | None:
    """What is assumed and not known, and the parameters with limits and sources."""
    blocks: list[Block] = []
    table = answers.table("assumptions", ["item"], blank=["value", "unit", "reason"])
    if table is not None:
        rows = tuple(
            (str(r["item"]), f"{r['value']} {'' if r['unit'] == '-' else r['unit']}".strip(), str(r["reason"]))
            for r in table.to_dict("records")
        )
        told = f"{counted(len(rows), 'number')} of model and scatter are assumed and not published or measured."
        blocks.append(Words(told))
        blocks.append(Table("Assumptions", ("item", "value", "why"), rows, (1, 2)))
    elif answers.has("assumptions"):
        blocks.append(Words("The model names no assumptions."))
    return Section("assumptions", "Assumptions", (*blocks, *_parameters(answers))) if blocks else None


def _parameters(answers: Answers) -> list[Block]:
    space = answers.table(
        "parameter_space",
        ["parameter"],
        ["value", "lower", "upper", "prior_sd"],
        flags=["integer"],
        blank=["unit", "description", "source"],
    )
    if space is None:
        return []
    rows = tuple(
        (
            str(r["parameter"]),
            str(r["description"]),
            with_unit(r["value"], str(r["unit"])),
            f"{significant(r['lower'])} to {significant(r['upper'])}",
            significant(r["prior_sd"], 3),
            yes(r["integer"]),
            str(r["source"]),
        )
        for r in space.to_dict("records")
    )
    heads = ("parameter", "what it is", "adopted", "limits", "prior std", "whole number", "source")
    return [Table("Parameters of the model", heads, rows, (1, 5, 6))]


def versions(answers: Answers) -> Section | None:
    """When, with which versions and with which seeds every question was asked."""
    asked = answers.questions
    if not asked:
        return None
    record = answers.record
    used = {question: _listed(q.get("versions", {})) for question, q in asked.items()}
    same = len(set(used.values())) == 1
    rows = tuple(
        (
            question if record.get("notebook") else f"calib {question}",
            ("a quick look" if q.get("quick") else "whole") + ", of another state" * (question in answers.stale),
            str(q.get("when", "")).replace("T", " ").replace("+00:00", " UTC"),
            _listed(q.get("seeds", {})) or "none needed",
            *([] if same else [used[question]]),
        )
        for question, q in asked.items()
    )
    more = record.get("effects_in_model", [])
    model = f"Study {record.get('study', '')}; its model is {record.get('model', '')}"
    model += f" with {', '.join(more)} added." if more else "."
    files = f"Measured data: {', '.join(record.get('files', []))}."
    if record.get("notebook"):
        model = f"Made from Python; model and measurement are {record.get('model', '')}."
        files = "No study keeps it: what it was made from stands in the script."
    heads = ("question", "how", "when", "seeds of random numbers", *([] if same else ["versions"]))
    told = [Words(f"Versions: {next(iter(used.values()))}.")] if same else []
    table = Table("Questions asked", heads, rows, (1, 2, 3, 4))
    return Section("versions", "Versions and seeds", (Words(model), Words(files), *_adopted(answers), *told, table))


def stale(answers: Answers) -> Section | None:
    """What is not shown, since the study is not what it was asked of."""
    if not answers.stale:
        return None
    return Section("stale", "Not shown", tuple(Words(f"{words}.", "warning") for words in answers.stale.values()))


def _adopted(answers: Answers) -> list[Block]:
    """Values that an earlier study has found."""
    values = answers.record.get("adopted", {})
    if not values:
        return []
    told = ", ".join(f"{name} {significant(value, 5)}" for name, value in values.items())
    return [Words(f"Taken over from the study {answers.record.get('adopted_from')} and held: {told}.")]


def _listed(named: Mapping[str, object]) -> str:
    return ", ".join(f"{name} {value}" for name, value in named.items())


def not_asked(answers: Answers) -> Section | None:
    """One line for every question that has no answer in this folder."""
    if answers.record.get("notebook"):  # there is no folder of which the command could ask
        return None
    name = answers.name
    lines = []
    if not answers.has("comparison_before") and "compare" not in answers.stale:
        lines.append(f"Model against measurement, mode by mode: calib compare {name}")
    if not answers.has("selection") and "sensitivity" not in answers.stale:
        lines.append(f"Which parameters matter: calib sensitivity {name}")
    if not answers.has("parameters") and "calibrate" not in answers.stale:
        lines.append(f"Which parameter values fit: calib calibrate {name}")
    if not answers.explanation and answers.record.get("effects_known") and "explain" not in answers.stale:
        lines.append(f"What the model lacks: calib explain {name}")
    if not answers.added and answers.explanation.get("verdict") in ("effect", "two_effects"):
        lines.append(f"What it brings to add what is named: calib run {name}")
    if not lines:
        return None
    intro = Words(f"These questions have no answer here; the command adds it ({name} stands for the study's folder).")
    return Section("not-asked", "Not asked", (intro, *(Words(line) for line in lines)))
