"""The recommended measurements as a test order: excitation, sensors, band, repeats and gain, the cheapest first."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from calib.missing.competing import CandidateMeasurement, Excitation
from calib.missing.recommendation import HELD_OUT, ExperimentalDesign, Interval, as_ratio, rounded, score_gain_words
from calib.missing.rules import RULES
from calib.problem.parameter import unit_words
from calib.results.answer import hertz, in_prose

COLUMNS = (
    "step", "kind", "what", "excite", "sensors", "how", "freq_low", "freq_high", "resolution", "repeats", "effect",
    "gain", "width_now", "width_then", "unit", "narrows", "best",
)  # fmt: skip
TABLE = "test_order"
"""Name of the table."""
_COSTS = ("repeats", "mode", "sensor", "reference", "bench")
"""Kinds, the cheapest first: the same set-up, another excitation, more sensors, another force, a part by itself."""
_LEAST_REPEATS = 3
"""Repeats without which a scatter cannot be seen."""
_HAMMER = 0.05
"""Damping ratio up to which an impact lets a mode ring long enough."""
_IMPACT = "an impact hammer or a shaker"
_BAND = (0.2, 3.0)
"""Half the width of the band of a mode over its frequency: at least this, and so many times its damping ratio."""
_LINES = 5
"""Frequency lines within the half-power width of a mode."""
_NARROW = 1e-3
"""Resolution over the frequency of a mode without damping."""
_AS_BEFORE = "as before"
_INTERVAL = "95 % interval"
"""Whose width a step narrows, as its words begin."""


def test_order(
    table: pd.DataFrame,
    design: ExperimentalDesign,
    told: Sequence[str],
    intervals: Mapping[str, Interval],
) -> pd.DataFrame:
    """The best worthwhile measurement of each kind for what is told, the cheapest kind first.

    Held-out data are measured already, so that no step asks for them.

    Parameters
    ----------
    table : DataFrame
        From `calib.missing.recommendation.recommend`.
    design : ExperimentalDesign
    told : sequence of str
        Effects that the recommendation is about.
    intervals : mapping from str to Interval
        Present 95 % intervals of magnitudes, as far as they are known.

    Returns
    -------
    DataFrame
        `COLUMNS`: frequencies in Hz, widths of 95 % intervals in ``unit``; NaN where nothing is to be stated.
        ``how`` are band, resolution and repeats in words, ``narrows`` the gain, ``best`` marks the step of the largest.
    """
    measurements = {one.name: one for one in design.measurements}
    own = table[table["effect"].isin(list(told)) & ~table["measurement"].str.endswith(HELD_OUT)]
    measure = "gain" if design.competing is None else "ln_bayes"
    own = own[own[measure] >= (RULES.worthwhile if design.competing is None else RULES.credible)]
    own = own[own["kind"].isin(_COSTS)].sort_values(measure, ascending=False, kind="stable").drop_duplicates("kind")
    own = own.assign(best=own.index == (own.index[0] if len(own) else -1))
    own = own.assign(cost=own["kind"].map(_COSTS.index)).sort_values("cost", kind="stable")
    records = enumerate(own.to_dict("records"), 1)
    of_which = "" if len(told) == 1 else " of {}"
    rows = [_row(k, r, measurements[str(r["measurement"])], design, intervals, of_which) for k, r in records]
    return pd.DataFrame(rows, columns=list(COLUMNS))


def first_steps(order: pd.DataFrame, purpose: str) -> str:
    """The cheapest step of a test order and, where it is another one, the best, in a sentence.

    Parameters
    ----------
    order : DataFrame
        From `test_order`, with at least one row.
    purpose : str
        What it is for, such as ``To tell them apart``.
    """
    gains = [str(words).removeprefix(f"{_INTERVAL}: ") for words in order["narrows"]]
    steps = [f"{what} ({gain})".replace("→", "->") for what, gain in zip(order["what"], gains, strict=True)]
    best = int(order["best"].to_numpy(dtype=bool).argmax())
    more = f"; the most is gained by {steps[best]}" if best else ""
    return f"{purpose}, the cheapest is {steps[0]}{more}."


def _row(
    number: int,
    r: Mapping[Hashable, Any],
    measurement: CandidateMeasurement,
    design: ExperimentalDesign,
    intervals: Mapping[str, Interval],
    of_which: str,
) -> dict[str, object]:
    name, gain = str(r["effect"]), float(r["gain"])
    low, high = design.band
    row: dict[str, object] = {
        "step": number, "kind": measurement.kind, "what": measurement.name, "excite": _AS_BEFORE, "sensors": _AS_BEFORE,
        "freq_low": low, "freq_high": high, "resolution": math.nan, "repeats": design.repeats, "effect": name,
        "gain": gain, "best": bool(r["best"]),
    }  # fmt: skip
    if measurement.kind == "repeats":
        more = max(2 * design.repeats, _LEAST_REPEATS)
        row |= {"repeats": more, "what": f"the same test again, {more} repeats in all instead of {design.repeats}"}
    elif measurement.kind == "mode" and measurement.excitation is not None:
        row |= _of_mode(measurement.excitation)
        if hung := in_prose(measurement.excitation.hung):
            row["what"] = f"the mode that the {hung} adds, computed at {hertz(measurement.excitation.freq)}"
        row["repeats"] = max(design.repeats, _LEAST_REPEATS)
    elif measurement.kind == "sensor":
        row["sensors"] = f"as before, and {measurement.name}"
    elif measurement.kind == "reference":
        row["excite"] = f"as before, and {measurement.name.removesuffix(' too')}"
    elif measurement.kind == "bench":
        row |= {"excite": "", "sensors": "", "freq_low": math.nan, "freq_high": math.nan}
        row["repeats"] = _LEAST_REPEATS
    return row | {"how": _how(row)} | _narrowing(name, gain, r, design, intervals.get(name), of_which)


def _of_mode(found: Excitation) -> dict[str, object]:
    """Where and with what a mode is excited, its band and the resolution that its damping asks for."""
    at = f"({', '.join(f'{c:.2f}' for c in found.at)}) m"
    damping = found.damping if np.isfinite(found.damping) else 0.0
    fading = f"a shaker and a slow sweep: at {100 * damping:.2g} % damping a tap only shows that there is a resonance"
    by = fading if damping > _HAMMER else _IMPACT
    hung = in_prose(found.hung)
    place = f"on the {hung} itself, which hangs at {at}," if hung else f"at {at}"
    half = found.freq * max(_BAND[0], _BAND[1] * damping)
    wanted = 2 * damping * found.freq / _LINES if damping > 0 else _NARROW * found.freq
    return {
        "excite": f"{place} along {found.direction}, with {by}",
        "sensors": f"as before, and an accelerometer {'on the ' + hung + ' itself' if hung else 'at ' + at}, along "
        f"{found.direction}",
        "freq_low": max(found.freq - half, 0.0),
        "freq_high": found.freq + half,
        "resolution": _rounded_down(wanted),
    }  # fmt: skip


def _rounded_down(value: float) -> float:
    """One significant digit, not above the value."""
    size = 10.0 ** math.floor(math.log10(value))
    return float(f"{math.floor(value / size + 1e-9) * size:.1g}")


def _narrowing(
    name: str,
    gain: float,
    r: Mapping[Hashable, Any],
    design: ExperimentalDesign,
    interval: Interval | None,
    of_which: str,
) -> dict[str, object]:
    """What a step narrows, from and to; ``of_which`` is empty where one effect alone is told."""
    now = math.nan if interval is None else interval.high - interval.low
    unit = "" if interval is None else interval.unit
    row: dict[str, object] = {"width_now": now, "width_then": now / gain, "unit": unit}
    if design.competing is not None:
        odds, chance = as_ratio(float(r["ln_bayes"])), 100 * float(r["chance"])
        words = f"odds of about {odds} for the true one of {' and '.join(design.competing.names)} ({chance:.0f} % sure)"
        return row | {"width_now": math.nan, "width_then": math.nan, "narrows": words}
    if math.isfinite(now) and now > 0:
        words = f"{_INTERVAL}{of_which.format(name)}: {rounded(now)} → {rounded(now / gain)}{unit_words(unit)} wide"
        return row | {"narrows": words}
    return row | {"narrows": f"{name} shows {score_gain_words(gain)} times as clearly"}


def _how(row: Mapping[str, Any]) -> str:
    """Band, resolution and repeats of a step in words."""
    low, high, resolution = (float(row[name]) for name in ("freq_low", "freq_high", "resolution"))
    fitted = " (the data that the fit uses)" if row["kind"] != "mode" else ""
    known = math.isfinite(low) and math.isfinite(high)
    band = f"band {hertz(low, high).replace(' and ', ' to ')}{fitted}" if known else ""
    lines = f"resolution {resolution:g} Hz or finer" if math.isfinite(resolution) else ""
    return ", ".join(filter(None, (band, lines, f"{row['repeats']:.0f} repeats")))
