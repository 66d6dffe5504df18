"""Claimed accuracy of a measurement, in addition to its repeatability."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calib.errors.errors import InputError

KINDS = {"freq": "natural frequencies", "damping": "damping ratios", "shape": "shapes"}
"""Kinds of a modal measurement, as a study names them."""
CHANNELS = {"gain": "gains of channels", "place": "places of sensors"}
"""What else a study may claim of a modal measurement: it adds to the standard deviations of shapes."""


@dataclass(frozen=True)
class Claim:
    """Claimed standard deviation: a share of the value, or a number in its own unit.

    Attributes
    ----------
    share : float
        Relative to the value; for a shape, to its largest entry; for an FRF, to its modulus.
    own : float
        In the value's own unit: Hz, a damping ratio, parts of a shape's largest entry, the unit of a scalar response or
        of an FRF.
    """

    share: float = 0.0
    own: float = 0.0

    @classmethod
    def of(cls, given: str | float) -> Claim:
        """From ``"1 %"`` or a number in the value's own unit; ValueError for anything else."""
        if isinstance(given, str):
            match = re.fullmatch(r"\s*([0-9.]+(?:[eE][+-]?[0-9]+)?)\s*%\s*", given)
            try:
                share = float(match.group(1)) / 100 if match else math.nan
            except ValueError:
                share = math.nan
            if not 0 < share < 1:
                raise ValueError(f"the accuracy {given!r} is no share such as '1 %'")
            return cls(share=share)
        if not (math.isfinite(given) and given > 0):
            raise ValueError(f"the accuracy {given} is no positive number")
        return cls(own=float(given))

    @property
    def given(self) -> bool:
        """Whether anything is claimed."""
        return self.share > 0 or self.own > 0

    def relative(self, values: np.ndarray) -> np.ndarray:
        """Standard deviations over the values, in the shape of the values."""
        size = np.abs(np.asarray(values, dtype=float))
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(self.share + (self.own / size if self.own else 0.0 * size))

    def words(self, unit: str = "") -> str:
        """Such as ``1 %``, or ``1 % and 2e-06 m/N``."""
        own = f"{self.own:g}{f' {unit}' if unit else ''}"
        if not self.share:
            return own
        return f"{100 * self.share:g} %" + (f" and {own}" if self.own else "")


NOTHING = Claim()


def frf_claim(given: str | float | Mapping[str, str | float] | None) -> Claim:
    """Claimed accuracy of FRFs: a share of the modulus such as ``"2 %"``, a floor in their unit, or both by name.

    Both by name are ``{"share": "2 %", "floor": 1e-7}``. ValueError for anything else.
    """
    if given is None:
        return NOTHING
    if not isinstance(given, Mapping):
        return Claim.of(given)
    for name in given:
        if name not in ("share", "floor"):
            raise ValueError(f"there is no accuracy {name!r} of FRFs; it is a share, a floor or both")
    share = Claim.of(given["share"]) if "share" in given else NOTHING
    floor = Claim.of(given["floor"]) if "floor" in given else NOTHING
    if share.own or floor.share:
        raise ValueError("the share is written like '2 %', the floor is a number in the unit of the FRFs")
    return Claim(share.share, floor.own)


@dataclass(frozen=True)
class Accuracy:
    """Claimed accuracy of a modal measurement by kind, and of its channels; nothing by default.

    Its variance is added to that of the repeats, which do not show systematic errors, such as those of a calibration
    factor, the mass of sensors or the suspension.

    Attributes
    ----------
    freq, damping, shape : Claim
    gain : Claim
        Of every channel's gain, a share: of each entry of a shape by its modulus.
    place : Claim
        Of every sensor's place along the structure, m: of each entry by the slope of the shape there.
    """

    freq: Claim = NOTHING
    damping: Claim = NOTHING
    shape: Claim = NOTHING
    gain: Claim = NOTHING
    place: Claim = NOTHING

    @property
    def given(self) -> bool:
        """Whether anything is claimed."""
        return any(claim.given for claim in (self.freq, self.damping, self.shape, self.gain, self.place))

    @classmethod
    def of(cls, given: str | float | Mapping[str, str | float] | None) -> Accuracy:
        """From one share for all kinds, or by kind; ValueError for anything else."""
        if given is None:
            return cls()
        if not isinstance(given, Mapping):
            if not isinstance(given, str):
                raise ValueError("one accuracy for all kinds is a share such as '1 %'; give numbers by kind")
            return cls(*(Claim.of(given),) * 3)
        for name in given:
            if name not in (*KINDS, *CHANNELS):
                raise ValueError(f"there is no accuracy of {name!r}; the kinds are {', '.join((*KINDS, *CHANNELS))}")
        claims = {name: Claim.of(value) for name, value in given.items()}
        if claims.get("gain", NOTHING).own:
            raise ValueError("the accuracy of gain is a share such as '1 %'")
        if claims.get("place", NOTHING).share:
            raise ValueError("the accuracy of place is a number, in m")
        return cls(**claims)

    @property
    def words(self) -> str:
        """Such as ``1 % of natural frequencies, 3 % of shapes``; empty when nothing is claimed."""
        units, kinds = {"freq": "Hz", "place": "m"}, {**KINDS, **CHANNELS}
        claims = {name: getattr(self, name) for name in kinds}
        return ", ".join(f"{c.words(units.get(name, ''))} of {kinds[name]}" for name, c in claims.items() if c.given)


NONE_CLAIMED = Accuracy()

Plain = Mapping[str, tuple[float, float | None]]


def widened(
    targets: Plain, kinds: Mapping[str, str], given: str | float | Mapping[str, str | float] | None
) -> dict[str, tuple[float, float | None]]:
    """Scalar responses whose variances are increased by a claimed accuracy.

    Parameters
    ----------
    targets : mapping from response name to (value, std or None)
    kinds : mapping from response name to kind
        See `calib.measurement.responses.response_kinds`.
    given
        A share for all responses, or shares and numbers by the name of a response or of a kind; the name of a response
        takes precedence.

    Raises
    ------
    InputError
        For a name that is neither a response nor a kind.
    """
    if given is None:
        return dict(targets)
    by_name = dict(given) if isinstance(given, Mapping) else dict.fromkeys(targets, given)
    for name in by_name:
        if name not in targets and name not in kinds.values():
            raise InputError(
                f"there is no response or kind {name!r} to have an accuracy", place="measurement",
                remedy=f"the responses are {', '.join(targets)}",
            )  # fmt: skip
    out = {}
    for name, (value, std) in targets.items():
        claimed = by_name.get(name, by_name.get(kinds[name]))
        if claimed is None:
            out[name] = (value, std)
            continue
        claim = Claim.of(claimed)
        more = claim.share * abs(value) + claim.own
        total = math.hypot(std or 0.0, more)
        out[name] = (value, total if total > 0 else None)
    return out
