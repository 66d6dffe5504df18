"""Instants that a table gives as dates and times of day."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from calib.errors.errors import InputError

_CLOCK = r"(?P<hour>\d{1,2}):(?P<minute>\d{2}):(?P<second>\d{2}(?:[.,]\d+)?)\s*(?P<half>[AaPp]\.?[Mm]\.?)?"
_ZONE = r"(?:Z|[+-]\d{2}:?\d{2})?"
_STAMP = re.compile(rf"\"?(?:(?P<date>\d{{1,4}}[-./]\d{{1,2}}[-./]\d{{1,4}})[T\s]\s*)?{_CLOCK}\s*{_ZONE}\"?", re.ASCII)
_ORDERS = ("%Y-%m-%d", "%d.%m.%Y", "%d-%m-%Y", "%Y/%m/%d", "%Y.%m.%d", "%m/%d/%Y", "%d/%m/%Y", "%d.%m.%y")
"""Of the parts of a date."""


def is_stamp(text: str) -> bool:
    """Whether an entry is a time of day, perhaps with a date before it, such as ``2026-11-28 12:00:00.005``."""
    return _STAMP.fullmatch(text.strip()) is not None


def seconds_of(stamps: Sequence[str], path: Path) -> np.ndarray:
    """Seconds from the first of ascending time stamps, (n,).

    Dates may be written as 2026-11-28, 28.11.2026, 11/28/2026 or 28/11/2026, times of day with seconds, and AM or PM;
    a time zone must be the same throughout and does not count. Without dates, a time of day that falls is that of the
    next day.

    Raises
    ------
    InputError
        For an entry that is none, and dates that can be read in two ways which differ by more than a shift.
    """
    dates, clock = [], np.empty(len(stamps))
    for k, text in enumerate(stamps):
        match = _STAMP.fullmatch(text.strip())
        if match is None:
            remedy = "write all of them like 2026-11-28 12:00:00.005, or give seconds"
            raise InputError(f"its time stamp {text.strip()[:40]!r} is none", place=path, remedy=remedy)
        hour = int(match["hour"])
        if match["half"]:
            hour = hour % 12 + 12 * (match["half"][0] in "Pp")
        clock[k] = 3600 * hour + 60 * int(match["minute"]) + float(match["second"].replace(",", "."))
        dates.append(match["date"] or "")
    days = _days(dates, path)
    if not any(dates):
        days = np.concatenate([[0], np.cumsum(np.diff(clock) < -43200)])
    whole = 86400.0 * (days - days[0]) + clock
    return np.asarray(whole - whole[0])


def _days(dates: Sequence[str], path: Path) -> np.ndarray:
    """Days from any origin, (n,)."""
    each = list(dict.fromkeys(dates))
    if len(each) == 1:
        return np.zeros(len(dates))
    found: list[list[int]] = []
    for order in _ORDERS:
        try:
            own = [datetime.strptime(one, order).replace(tzinfo=UTC) for one in each]
        except ValueError:
            continue
        days = [(one - own[0]) // timedelta(days=1) for one in own]
        if days == sorted(days) and days not in found:
            found.append(days)
    if len(found) != 1:
        what = "can be read in two ways" if found else "do not ascend, or are none"
        words = f"its dates {each[0]} to {each[-1]} {what}"
        raise InputError(words, place=path, remedy="write them like 2026-11-28")
    of = dict(zip(each, found[0], strict=True))
    return np.array([of[one] for one in dates], dtype=float)
