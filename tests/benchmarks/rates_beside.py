"""What two counts of the same structures say beside each other."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

Row = Mapping[str, Any]


def report_alike(rows: Iterable[Row], other: Iterable[Row]) -> None:
    """Print how many runs of two counts with the same scenario and number end in the same answer, and which do not."""
    before = {key_of(row): row for row in other if row["outcome"] != "failed"}
    both = [(before[key_of(row)], row) for row in rows if row["outcome"] != "failed" and key_of(row) in before]
    differ = [(a, b) for a, b in both if answer_of(a) != answer_of(b)]
    print(f"\n{len(both)} runs are in both counts, {len(both) - len(differ)} end alike")
    for a, b in differ:
        print(f"- {b['scenario']} #{b['number']}: {' '.join(answer_of(a))} -> {' '.join(answer_of(b))}")


def report_widths(rows: Mapping[str, Iterable[Row]]) -> None:
    """Print the widths of the intervals of two ways, where both name an effect rightly, over each other."""
    first, second = rows
    width = {way: {key_of(r): r["interval"][1] - r["interval"][0] for r in own if "interval" in r}
             for way, own in rows.items()}  # fmt: skip
    ratios = [width[first][key] / width[second][key] for key in width[first] if key in width[second]]
    if ratios:
        print(f"\nwidth of intervals, {first} over {second}: median {np.median(ratios):.1f}, n {len(ratios)}")
    for way, own in rows.items():
        off = sorted(abs(r["magnitude_over_true"] - 1) for r in own if "covers" in r and not r["covers"])
        if off:
            print(f"{way}: intervals that miss the truth are off by {off[0]:.1%} to {off[-1]:.1%}, n {len(off)}")


def key_of(row: Row) -> tuple[str, int]:
    """Which structure it is."""
    return row["scenario"], row["number"]


def answer_of(row: Row) -> tuple[str, ...]:
    """The verdict and what it names or blames."""
    blamed = Counter(map(str, row.get("blamed", ())))
    return (row["verdict"], *sorted(map(str, row["best"])), *sorted(blamed))
