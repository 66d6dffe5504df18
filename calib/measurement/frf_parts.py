"""Parts of measured FRFs: those in use and, by kind, those held out; and FRFs without gaps."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.errors.errors import InputError
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.frf_lines import in_bands
from calib.measurement.frf_repeats import few, hertz_of
from calib.measurement.places import Doubt
from calib.measurement.rules import RULES

SENSORS, REFERENCES, BANDS = "held_out_sensors", "held_out_references", "held_out_bands"
"""Groups of held-out FRFs, as tables name them."""

_Names = tuple[str, ...]
_Bands = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class HeldOutFRFs:
    """What no fit uses.

    Attributes
    ----------
    sensors, references : tuple of str
        Responses and references, such as ``12z``.
    bands : tuple of (float, float)
        Lines from the first to the second frequency, both included, Hz.
    """

    sensors: tuple[str, ...] = ()
    references: tuple[str, ...] = ()
    bands: tuple[tuple[float, float], ...] = ()

    def unknown(self, whole: MeasuredFRFs) -> tuple[tuple[str, int], InputError] | None:
        """The first entry that ``whole`` lacks, by field and position, and the error for it; None where all are known.

        The place of the error is for the caller to add.
        """
        tried = HeldOutFRFs()
        for field in ("sensors", "references", "bands"):
            for k in range(len(getattr(self, field))):
                tried = replace(tried, **{field: getattr(self, field)[: k + 1]})
                try:
                    whole.without(tried.sensors, tried.references, tried.bands)
                except InputError as fault:
                    return (field, k), fault
        return None

    def split(self, whole: MeasuredFRFs) -> tuple[MeasuredFRFs, dict[str, MeasuredFRFs]]:
        """The FRFs in use, and the held-out ones by their group.

        An entry held out twice counts in the first group; a group of which nothing is left is omitted. Check entries
        with `unknown` first.
        """
        rest, groups = whole, dict[str, MeasuredFRFs]()

        def take(group: str, sensors: _Names = (), references: _Names = (), bands: _Bands = ()) -> None:
            nonlocal rest
            left = (
                tuple(name for name in sensors if name in [s.name for s in rest.responses]),
                tuple(name for name in references if name in [s.name for s in rest.references]),
                tuple(one for one in bands if in_bands(rest.freq, [one]).any()),
            )
            if any(left):
                groups[group], rest = rest.only(*left), rest.without(*left)

        take(SENSORS, sensors=self.sensors)
        take(REFERENCES, references=self.references)
        take(BANDS, bands=self.bands)
        return rest, groups


def without_gaps(frfs: MeasuredFRFs, of: MeasuredFRFs | None = None) -> MeasuredFRFs:
    """FRFs for what needs every function on every line, such as the identification of modes.

    Lines at either end that a function lacks are left out, and single lines within (`RULES.gap_lines`) are interpolated
    between their neighbours; both are noted. Longer gaps stay.

    Parameters
    ----------
    frfs : MeasuredFRFs
    of : MeasuredFRFs, optional
        FRFs without gaps whose first and last line are kept instead, for a repeat of them.
    """
    known = np.isfinite([frfs.values[:, one.i, one.j] for one in frfs.functions])
    if known.all() and of is None:
        return frfs
    whole = np.flatnonzero(known.all(axis=0))
    if not len(whole):
        return frfs
    first, last = (frfs.freq[whole[0]], frfs.freq[whole[-1]]) if of is None else (of.freq[0], of.freq[-1])
    kept = in_bands(frfs.freq, [(first, last)])
    freq, out, std, filled = frfs.freq[kept], frfs.values[kept].copy(), frfs.std[kept].copy(), dict[str, list[str]]()
    for one, own in zip(frfs.functions, known, strict=True):
        here = own[kept]
        if here.all() or _longest(~here) > RULES.gap_lines:
            continue
        entry = out[:, one.i, one.j]
        parts = (np.interp(freq, freq[here], part[here]) for part in (entry.real, entry.imag))
        out[:, one.i, one.j] = next(parts) + 1j * next(parts)
        std[~here, one.i, one.j] = np.interp(freq, freq[here], std[here, one.i, one.j])[~here]
        filled.setdefault(hertz_of(freq[~here]), []).append(one.name)
    notes = [Doubt(f"{frfs.source}: {few(names)}: interpolated at {lines}") for lines, names in filled.items()]
    if (~kept).any():
        notes.append(Doubt(f"{frfs.source}: left out at {hertz_of(frfs.freq[~kept])}, where a function has no value"))
    return replace(frfs, freq=freq, values=out, std=std, notes=(*frfs.notes, *notes))


def _longest(lost: np.ndarray) -> int:
    """Length of the longest run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], lost.astype(int), [0]])))
    return int(np.max(edges[1::2] - edges[::2], initial=0))
