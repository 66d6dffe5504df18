"""Parts of measured FRFs: those in use and, by kind, those held out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from calib.errors import InputError
from calib.measurement.frf import MeasuredFRFs

SENSORS, REFERENCES, BANDS = "held_out_sensors", "held_out_references", "held_out_bands"
"""Groups of held-out FRFs, as tables name them."""


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
        """The first entry, by field and position, that ``whole`` lacks, and the error for it; None where all are known.

        The place of the error is for the caller to add.
        """
        for field, sensors in (("sensors", whole.responses), ("references", whole.references)):
            known = [sensor.name for sensor in sensors]
            for k, name in enumerate(getattr(self, field)):
                if name not in known:
                    problem = f"held-out {field[:-1]} {name!r} was not measured"
                    return (field, k), InputError(problem, remedy=f"the measured ones are {', '.join(known)}")
        for k, (low, high) in enumerate(self.bands):
            if not ((whole.freq >= low) & (whole.freq <= high)).any():
                remedy = f"the lines go from {whole.freq[0]:g} to {whole.freq[-1]:g} Hz; give [low, high]"
                return ("bands", k), InputError(f"no line is held out by [{low:g}, {high:g}] Hz", remedy=remedy)
        if not np.isfinite(self.split(whole)[0].values).any():
            field = next(name for name in ("bands", "references", "sensors") if getattr(self, name))
            return (field, 0), InputError("every measured FRF is held out", remedy="leave some to fit")
        return None

    def split(self, whole: MeasuredFRFs) -> tuple[MeasuredFRFs, dict[str, MeasuredFRFs]]:
        """The FRFs in use, and the held-out ones by their group; an entry held out twice counts in the first group."""
        free = np.ones(whole.values.shape, dtype=bool)
        groups = {}
        for group, chosen in self._masks(whole).items():
            if (free & chosen).any():
                groups[group] = _kept(whole, free & chosen)
            free &= ~chosen
        return _kept(whole, free), groups

    def _masks(self, whole: MeasuredFRFs) -> Mapping[str, np.ndarray]:
        lines = np.zeros(len(whole.freq), dtype=bool)
        for low, high in self.bands:
            lines |= (whole.freq >= low) & (whole.freq <= high)
        sensors = np.array([s.name in self.sensors for s in whole.responses])
        references = np.array([s.name in self.references for s in whole.references])
        shape = whole.values.shape
        return {
            SENSORS: np.broadcast_to(sensors[:, None], shape),
            REFERENCES: np.broadcast_to(references, shape),
            BANDS: np.broadcast_to(lines[:, None, None], shape),
        }


def _kept(whole: MeasuredFRFs, mask: np.ndarray) -> MeasuredFRFs:
    """The entries of a mask; lines, responses and references without any are left out."""
    mask = mask & np.isfinite(whole.values)
    if mask.all() or not mask.any():
        return whole if mask.all() else replace(whole, values=np.full_like(whole.values, np.nan))
    lines, responses, references = (np.flatnonzero(mask.any(axis=axes)) for axes in ((1, 2), (0, 2), (0, 1)))
    cut = np.ix_(lines, responses, references)
    return replace(
        whole,
        freq=whole.freq[lines],
        responses=tuple(whole.responses[i] for i in responses),
        references=tuple(whole.references[j] for j in references),
        values=np.where(mask[cut], whole.values[cut], np.nan),
        std=whole.std[cut],
    )
