"""Sections on provenance: assumptions, parameters, versions and seeds, stale results, and analyses not run."""

from __future__ import annotations

import math
from collections.abc import Mapping

from calib.report.html.page import Block, Section, Table, Words
from calib.report.html.study_results import StudyResults
from calib.report.numbers import counted, significant, with_unit, yes


def assumptions(results: StudyResults) -> Section | None:
    """Assumed values, and the parameters with limits and sources."""
    blocks: list[Block] = []
    table = results.table("assumptions", ["item"], blank=["value", "unit", "reason"])
    if table is not None:
        rows = tuple(
            (str(r["item"]), f"{r['value']} {'' if r['unit'] == '-' else r['unit']}".strip(), str(r["reason"]))
            for r in table.to_dict("records")
        )
        values = counted(len(rows), "value")
        blocks.append(Words(f"Assumed, neither published nor measured: {values} of model and measurement uncertainty."))
        blocks.append(Table("Assumptions", ("item", "value", "why"), rows, (1, 2)))
    elif results.has("assumptions"):
        blocks.append(Words("The model names no assumptions."))
    return Section("assumptions", "Assumptions", (*blocks, *_parameters(results))) if blocks else None


def _parameters(results: StudyResults) -> list[Block]:
    space = results.table(
        "parameter_space",
        ["parameter"],
        ["value", "lower", "upper", "prior_sd"],
        if_there=["search_lower", "search_upper"],
        flags=["integer"],
        blank=["unit", "description", "source", "distribution"],
    )
    if space is None:
        return []
    told = "search_lower" in space  # a table of an earlier version lacks them
    rows = tuple(
        (
            str(r["parameter"]),
            str(r["description"]),
            with_unit(r["value"], str(r["unit"])),
            _between(math.nan if told and r["distribution"] == "fixed" else r["lower"], r["upper"]),
            *([_between(r["search_lower"], r["search_upper"])] if told else []),
            significant(r["prior_sd"], 3),
            yes(r["integer"]),
            str(r["source"]),
        )
        for r in space.to_dict("records")
    )
    limits = ["limits of the sensitivity", "search limits"] if told else ["limits"]
    heads = ("parameter", "what it is", "nominal", *limits, "prior std", "integer", "source")
    table = Table("Parameters of the model", heads, rows, (1, len(heads) - 2, len(heads) - 1))
    note = (
        "Calibration and explanation vary a parameter between its search limits: every position in its range, share of "
        "its range and remark on a limit refers to these. Held: they keep the nominal value."
    )
    return [Words(note), table] if told else [table]


def _between(lower: float, upper: float) -> str:
    """Limits in the unit of the nominal value; held where there are none."""
    return "held" if math.isnan(lower) else f"{significant(lower)} to {significant(upper)}"


def versions(results: StudyResults) -> Section | None:
    """Time, versions and seeds of every analysis."""
    analyses = results.analyses
    if not analyses:
        return None
    record = results.record
    used = {analysis: _listed(a.get("versions", {})) for analysis, a in analyses.items()}
    same = len(set(used.values())) == 1
    rows = tuple(
        (
            analysis if record.get("notebook") else f"calib {analysis}",
            ("quick run" if a.get("quick") else "full run") + ", stale" * (analysis in results.stale),
            str(a.get("when", "")).replace("T", " ").replace("+00:00", " UTC"),
            _listed(a.get("seeds", {})) or "none needed",
            *([] if same else [used[analysis]]),
        )
        for analysis, a in analyses.items()
    )
    more = record.get("effects_in_model", [])
    model = f"Study {record.get('study', '')}; its model is {record.get('model', '')}"
    model += f" with {', '.join(more)} added." if more else "."
    files = f"Measured data: {', '.join(record.get('files', []))}."
    if record.get("notebook"):
        model = f"Made from Python; model and measurement: {record.get('model', '')}."
        files = "There is no study folder: the script holds the inputs."
    heads = ("analysis", "extent", "when", "random seeds", *([] if same else ["versions"]))
    common = [Words(f"Versions: {next(iter(used.values()))}.")] if same else []
    table = Table("Analyses run", heads, rows, (1, 2, 3, 4))
    return Section("versions", "Versions and seeds", (Words(model), Words(files), *_adopted(results), *common, table))


def stale(results: StudyResults) -> Section | None:
    """Results that are not shown, since they belong to another state of the study."""
    if not results.stale:
        return None
    return Section(
        "stale", "Stale results, not shown", tuple(Words(f"{words}.", "warning") for words in results.stale.values())
    )


def _adopted(results: StudyResults) -> list[Block]:
    """Values adopted from an earlier study."""
    values = results.record.get("adopted", {})
    if not values:
        return []
    held = ", ".join(f"{name} {significant(value, 5)}" for name, value in values.items())
    return [Words(f"Adopted from the study {results.record.get('adopted_from')} and held fixed: {held}.")]


def _listed(named: Mapping[str, object]) -> str:
    return ", ".join(f"{name} {value}" for name, value in named.items())


def not_run(results: StudyResults) -> Section | None:
    """One line for every analysis without results in this folder."""
    if results.record.get("notebook"):  # there is no study folder for the command
        return None
    name = results.name
    lines = []
    if not results.has("comparison_before") and "compare" not in results.stale:
        lines.append(f"Model against measurement, mode by mode: calib compare {name}")
    if not results.has("selection") and "sensitivity" not in results.stale:
        lines.append(f"Which parameters matter: calib sensitivity {name}")
    if not results.has("parameters") and "calibrate" not in results.stale:
        lines.append(f"Identified parameters and errors after a calibration: calib calibrate {name}")
    if not results.explanation and results.record.get("effects_known") and "explain" not in results.stale:
        lines.append(f"Which effects the model lacks: calib explain {name}")
    if not results.added and results.explanation.get("verdict") in ("effect", "two_effects", "several_effects"):
        lines.append(f"The model with the named effects added: calib run {name}")
    if not lines:
        return None
    intro = Words(f"These analyses have no results here; the commands run them ({name} stands for the study's folder).")
    return Section("not_run", "Analyses not run", (intro, *(Words(line) for line in lines)))
