"""What the search for proposals has to say, and what follows from it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from calib.analyses.propose import FILE, ProposalResult
from calib.api.entries.entry import Entry, Rows, Warned, Words, count, decimals
from calib.missing.explanation import OPEN, Explanation
from calib.problem.parameter import unit_words
from calib.results.answer import hertz
from calib.results.results import RESULTS
from calib.study.study_file import StudyFile, shell_argument


def proposed_entries(result: ProposalResult) -> list[Entry]:
    """Proposals."""
    rows = [_row(r) for r in result.table.to_dict("records")]
    heads = ("", "effect", "kind", "at", "magnitude, 95 %", "evidence", "of", "remark")
    title = "Proposals, best first by evidence less ln of the number of its kind:"
    out: list[Entry] = [Rows.of(title, heads, rows, left=("effect", "kind", "at", "remark"))]
    out += [Words(sentence, when="always") for sentence in result.sentences]
    if result.proposals is not None:
        found = result.proposals
        work = f"{count(found.tested, 'composition')} tested, {count(found.evaluations, 'model evaluation')}"
        out.append(Words(f"{work}, {result.seconds:.0f} s."))
    return out


def written_entries(result: ProposalResult, root: Path) -> list[Entry]:
    """Where their code is, and what to do with it; ``root`` is the root folder of all results."""
    out: list[Entry] = []
    if result.aside is not None:
        there = "The study that was there had been changed, and is" if result.folder else "Earlier proposals are"
        out.append(Warned(f"{there} kept as {result.aside}."))
    if result.folder is not None:
        place = "" if root == RESULTS else f" --results {shell_argument(root)}"
        study, first = shell_argument(result.folder), result.table["name"].iloc[0]
        out += [
            Words(f"Written: {result.folder / FILE}, the proposals as effects, for you to correct.", when="always"),
            Words(f"Test them with: calib explain {study}{place}", when="always"),
            Words(f"Add one with: calib extend {study} {first} --into FOLDER", when="always"),
        ]
    return out


def _row(r: Mapping[Any, Any]) -> tuple[str, ...]:
    size = f"{r['magnitude']:.3g} [{r['lower']:.3g}, {r['upper']:.3g}]{unit_words(r['unit'])}"
    if r["freq"] == r["freq"]:
        size += f" at {hertz(r['freq'])}"
    others = r["alike"].split("; ") if r["alike"] else []
    alike = f"{count(len(others), 'other')} alike" if others else ""
    remarks = ["as good" if r["close"] and r["rank"] > 1 else "", "implausible" if r["implausible"] else "", alike]
    return (
        str(r["rank"]), r["name"], r["kind"], r["at"], size, decimals(r["ln_bayes"], 1), str(r["choices"]),
        "; ".join(filter(None, remarks)),
    )  # fmt: skip


def may_propose(study: StudyFile, found: Explanation) -> list[Entry]:
    """The command that composes proposals, after a verdict that leaves a misfit open."""
    if found.verdict not in OPEN:
        return []
    command = f"calib propose {shell_argument(study.file)}"
    return [Words(f"What nobody listed may be missing; compose it with: {command}", when="always")]
