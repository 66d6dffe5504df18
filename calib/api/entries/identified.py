"""What the identification of modes has to say."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from typing import Any

from calib.api.entries.entry import Entry, Rows, Warned, Words, count, decimals
from calib.api.modes import Written


def identified_entries(written: Written) -> list[Entry]:
    """Verdict, modes that count, those refused with the reason, and how a study names the files."""
    found = written.found
    rows = found.fit.to_dict("records")
    accepted, refused = ([row for row in rows if bool(row["refused"]) is wanted] for wanted in (False, True))
    good = not refused and not found.missed
    out: list[Entry] = [Words(found.verdict, "always") if good else Warned(found.verdict)]
    out.append(Rows.of(f"{count(len(accepted), 'mode')}:", _HEADS, map(_row, accepted), most=len(accepted)))
    out.append(Rows.of("Refused:", ("Hz", "damping %", "why"),
                       [(decimals(r["freq"], 3), decimals(100 * r["damping"], 2), r["refused"]) for r in refused],
                       left=("why",), most=len(refused)))  # fmt: skip
    out += [Words(f"\nNote: {note}.", "always") for note in found.modes.notes]
    out += [Words(f"\nIn study.toml, beside these files:\n{written.keys}", "always")]
    return [*out, *(Words(f"Written: {path}", when="verbose") for path in written.paths)]


_HEADS = (
    "mode",
    "Hz",
    "std Hz",
    "damping %",
    "std %",
    "orders",
    "FRAC",
    "residual (std)",
    "one shape",
    "MPC",
    "MPD deg",
)


def _row(row: Mapping[Hashable, Any]) -> tuple[str, ...]:
    return (
        str(row["mode"]), decimals(row["freq"], 4), f"{row['freq_std']:.2g}", decimals(100 * row["damping"], 3),
        f"{100 * row['damping_std']:.2g}", str(row["orders"]), decimals(row["frac"], 4),
        decimals(row["residual_std"], 2), decimals(row["rank_one"], 4), decimals(row["mpc"], 3),
        decimals(row["mpd"], 1),
    )  # fmt: skip
