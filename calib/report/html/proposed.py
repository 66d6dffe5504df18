"""Section on proposals: effects that nobody listed, composed from local perturbations."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from typing import Any

import pandas as pd

from calib.report.html.page import Block, Section, Table, Words
from calib.report.html.study_results import StudyResults
from calib.report.numbers import fixed, flag, significant, with_unit
from calib.report.proposals import drawn


def section(results: StudyResults) -> Section | None:
    """What is proposed, where, and what the data cannot discriminate; None where `propose` was not run."""
    answer = results.answer("propose")
    if not answer:
        return None
    told = results.proposals
    blocks: list[Block] = [Words(answer["found"], "verdict"), Words(answer["sure"], "reported")]
    blocks += [Words(words, "reported") for words in told.get("sentences", ())]
    table = results.table(
        "proposals", ["name", "kind", "at", "title"],
        ["rank", "magnitude", "lower", "upper", "freq", "evidence", "ln_bayes", "score", "choices"],
        flags=["close"], blank=["unit", "implausible", "alike"],
    )  # fmt: skip
    if table is not None:
        blocks += [*_figure(results), _table(table)]
    blocks.append(Words(answer["then"], "reported"))
    return Section("proposals", "Proposed effects", tuple(blocks))


def _figure(results: StudyResults) -> list[Block]:
    caption = (
        "Places of the best three proposals, and of those as good as the first; squares: compositions that these data "
        "cannot discriminate from it. Places to inspect, not causes."
    )
    table = results.table(
        "proposal_places", ["kind", "at"], ["rank", "evidence", "x", "y", "z"], flags=["fitted", "close"]
    )
    if table is None:
        return []
    rows = drawn(table)
    named = rows[rows["fitted"].map(flag)].drop_duplicates("rank")
    words = [f"{r['rank']:.0f}: {r['kind']}, {r['at']}" for r in named.to_dict("records")]
    return [*results.picture("proposals", caption, f"Numbered dots on the model. {'; '.join(words)}.")]


def _table(table: pd.DataFrame) -> Table:
    heads = (
        "rank", "effect", "magnitude, 95 %", "ln Bayes", "one of", "less ln of these", "as good as the first",
        "not discriminated from", "implausible because",
    )  # fmt: skip
    rows = tuple(
        (
            fixed(r["rank"], 0), str(r["title"]), _size(r), fixed(r["ln_bayes"], 1), fixed(r["choices"], 0),
            fixed(r["evidence"], 1), "yes" if flag(r["close"]) else "no", _few(str(r["alike"])),
            str(r["implausible"]),
        )
        for r in table.to_dict("records")
    )  # fmt: skip
    return Table("Proposals", heads, rows, (1, 2, 6, 7, 8))


def _size(r: Mapping[Hashable, Any]) -> str:
    """Fitted magnitude with its interval, and the natural frequency of a hung mass."""
    size = f"{with_unit(r['magnitude'], str(r['unit']))} ({significant(r['lower'], 3)} to {significant(r['upper'], 3)})"
    return size if r["freq"] != r["freq"] else f"{size}, at {with_unit(r['freq'], 'Hz')}"


def _few(alike: str) -> str:
    first = alike.split("; ")[:3]
    return "; ".join(first) + (" …" if len(alike.split("; ")) > len(first) else "")
