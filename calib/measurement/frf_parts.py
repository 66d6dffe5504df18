"""Parts of measured FRFs: those in use and, by kind, those held out."""

from __future__ import annotations

from dataclasses import dataclass, replace

from calib.errors.errors import InputError
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.frf_lines import in_bands

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
