"""Parts of measured FRFs: those in use and, by kind, those held out."""

from __future__ import annotations

from dataclasses import dataclass, replace

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
        """The FRFs in use, and the held-out ones by their group; an entry held out twice counts in the first group."""
        rest, groups = whole, dict[str, MeasuredFRFs]()
        if self.sensors:
            groups[SENSORS], rest = rest.only(self.sensors), rest.without(self.sensors)
        if self.references:
            groups[REFERENCES] = rest.only(references=self.references)
            rest = rest.without(references=self.references)
        if self.bands:
            groups[BANDS], rest = rest.only(bands=self.bands), rest.without(bands=self.bands)
        return rest, groups
