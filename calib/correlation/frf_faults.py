"""Faults that a test of FRFs may have: gain, phase and delay of every channel."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from calib.correlation.fault_library import PHASE, gain_words
from calib.correlation.frf_nuisance import ChannelError, ChannelKind, Nuisance
from calib.fault import NOWHERE, Fault
from calib.measurement.frf import MeasuredFRFs

GAIN, TURN = 100.0, 60.0
"""Plausible gain (%) and phase (deg) of a fault; a swapped sign is a gain of -200 %."""
_SWAPPED = -300.0
"""Smallest gain error, %: at -200 the sign is swapped."""
_LOOK = {
    "gain": "Check its calibration, its mounting and its sign.",
    "phase": "Check its filter and its conditioning.",
    "delay": "Check its filter and its sampling.",
}


@dataclass(frozen=True)
class FRFFault(Fault):
    """An error of one channel; its magnitude is the parameter of the error.

    Attributes
    ----------
    error : ChannelError
    """

    error: ChannelError = field(kw_only=True)


def frf_faults(measured: MeasuredFRFs, nuisances: Sequence[Nuisance] = ()) -> tuple[FRFFault, ...]:
    """Faults of the channels of a test, without errors that its fits determine anyway.

    An error of the only reference is the same as that of all responses.

    Parameters
    ----------
    measured : MeasuredFRFs
    nuisances : sequence of Nuisance
        Those that are fitted.
    """
    known = {(n.kind, n.sensor, n.side) for n in nuisances if isinstance(n, ChannelError)}
    return tuple(f for f in _all(measured) if (f.error.kind, f.error.sensor, f.error.side) not in known)


def _all(measured: MeasuredFRFs) -> Iterator[FRFFault]:
    sides = (("response", measured.responses), ("reference", measured.references))
    sizes: dict[ChannelKind, float] = {
        "gain": GAIN, "phase": TURN, "delay": PHASE / (2 * np.pi * float(measured.freq.max()))
    }  # fmt: skip
    for side, sensors in sides:
        for sensor in sensors:
            for kind, size in sizes.items():
                error = ChannelError(kind, sensor.name, "response" if side == "response" else "reference", size)
                yield _fault(error, sensor.point or NOWHERE)


def _fault(error: ChannelError, place: tuple[float, float, float]) -> FRFFault:
    what = f"{'force at' if error.side == 'reference' else 'sensor'} {error.sensor}"
    words: dict[str, Callable[[float], str]] = {
        "gain": partial(_gain, what), "phase": partial(_phase, what), "delay": partial(_delay, what)
    }  # fmt: skip
    p = error.parameter
    if error.kind == "gain":
        p = replace(p, lower=_SWAPPED)
    return FRFFault(
        p, f"{error.kind} of {what}", "Every channel reads as it is calibrated.", _LOOK[error.kind], words[error.kind],
        error.kind, error.sensor, place, error=error,
    )  # fmt: skip


def _gain(what: str, percent: float) -> str:
    return gain_words(what, percent / 100)


def _phase(what: str, angle: float) -> str:
    return f"{what} {'leads' if angle > 0 else 'lags'} by {abs(angle):.2g} deg"


def _delay(what: str, seconds: float) -> str:
    return f"{what} is {'late' if seconds > 0 else 'early'} by {1e3 * abs(seconds):.2g} ms"
