"""Measured frequency response functions, and which of their entries are in use."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from calib.errors.errors import InputError
from calib.measurement.accuracy import NOTHING, Claim
from calib.measurement.disagreements import Disagreement
from calib.measurement.frf_lines import Resonance, in_bands, resonances
from calib.measurement.modal import Sensor
from calib.measurement.places import Misplaced
from calib.measurement.rules import RULES
from calib.results.fingerprint import digest_of
from calib.results.in_short import Short, marked, names_in_line

Quantity = Literal["receptance", "mobility", "accelerance"]
QUANTITIES: Mapping[Quantity, str] = {"receptance": "", "mobility": "s", "accelerance": "s2"}
"""With the power of seconds in the denominator of their units."""

NO_PHASE = "an FRF needs amplitude and phase: export complex values"
"""Remedy for real values."""


@dataclass(frozen=True, eq=False)
class MeasuredFunction:
    """One function of `MeasuredFRFs`.

    Attributes
    ----------
    i, j : int
        Its response and its reference, as indices of the arrays.
    response, reference : Sensor
    lines : ndarray (n_lines,), int
        Where it was measured, as indices of the frequencies; at least one.
    """

    i: int
    j: int
    response: Sensor
    reference: Sensor
    lines: np.ndarray

    @property
    def index(self) -> tuple[np.ndarray, int, int]:
        """Of its entries in arrays (n_freq, n_responses, n_references)."""
        return self.lines, self.i, self.j

    @property
    def name(self) -> str:
        """Label such as ``12z/3z``: response over reference."""
        return f"{self.response.name}/{self.reference.name}"


@dataclass(frozen=True, eq=False)
class MeasuredFRFs(Short):
    """Frequency response functions of one structure.

    Attributes
    ----------
    freq : ndarray (n_freq,)
        Hz, ascending.
    responses, references : tuple of Sensor
        Lengths n_responses and n_references; a reference is the place and direction of a force or moment.
    quantity : {"receptance", "mobility", "accelerance"}
    values : ndarray (n_freq, n_responses, n_references), complex
        SI, over force or moment; NaN where not measured.
    std : ndarray (n_freq, n_responses, n_references)
        Standard deviation of the mean of the real and of the imaginary part each; NaN where unknown.
    n_repeats : int
    synthetic : bool
        True when no structure was measured.
    source : str
    notes : tuple of str
        Assumptions made on reading.
    misplaced : tuple of Misplaced
        Nodes whose places in two files contradict each other.
    accuracy : Claim
        Claimed accuracy in addition to the repeatability, not in ``std``: a share of the modulus and a floor in the
        unit of the quantity, each a standard deviation of the real and of the imaginary part.
    window_rate : float
        By how much an exponential window of the records moved every pole to the left, rad/s; 0 without one.
    behind : ndarray (n_freq, n_responses, n_references), int, optional
        Lines whose mean an entry is, where lines are thinned (see `calib.measurement.thinning.thinned`): ``std`` is
        that of the mean, and claimed and assumed standard deviations are those of a line.

    Notes
    -----
    Errors of different entries count as independent, between lines too. A claimed error that is the same on all lines,
    such as that of a calibration factor, is then averaged away over the lines: free it as a parameter of the test (see
    `calib.correlation.frf.nuisance`) where it matters.
    """

    freq: np.ndarray
    responses: tuple[Sensor, ...]
    references: tuple[Sensor, ...]
    quantity: Quantity
    values: np.ndarray
    std: np.ndarray
    n_repeats: int = 1
    synthetic: bool = False
    source: str = ""
    notes: tuple[str, ...] = ()
    misplaced: tuple[Misplaced, ...] = ()
    accuracy: Claim = NOTHING
    window_rate: float = 0.0
    behind: np.ndarray | None = None

    def __str__(self) -> str:
        """How many functions and lines there are, and their responses and references."""
        count = int(np.any(np.isfinite(self.values), axis=0).sum())
        repeats = f", {self.n_repeats} repeats" if self.n_repeats > 1 else ""
        head = (
            f"{count} FRFs ({self.quantity}), {len(self.freq)} lines from {self.freq[0]:.4g} to {self.freq[-1]:.4g} Hz"
            f"{repeats}{marked(self.synthetic)}"
        )
        both = (("responses", self.responses), ("references", self.references))
        return "\n".join([head, *(f"{what}: {names_in_line([one.name for one in sensors])}" for what, sensors in both)])

    def __post_init__(self) -> None:
        place, shape = self._place, (len(self.freq), len(self.responses), len(self.references))
        for label, array in (("values", self.values), ("std", self.std)):
            if np.shape(array) != shape:
                raise InputError(
                    f"{label} have shape {np.shape(array)}", place=place,
                    remedy=f"give {shape}: lines, responses, references",
                )  # fmt: skip
        if self.quantity not in QUANTITIES:
            raise InputError(
                f"the quantity is {self.quantity!r}", place=place, remedy=f"one of {', '.join(QUANTITIES)}"
            )
        if not np.any(self.freq > 0):
            raise InputError("it has no line above 0 Hz", place=place, remedy="give at least one frequency in Hz")
        if not np.all(np.diff(self.freq) > 0) or not 0 <= self.freq[0] <= self.freq[-1] < np.inf:
            raise InputError("its frequencies do not ascend from 0 or more", place=place, remedy="give them in Hz")
        if not np.iscomplexobj(self.values):
            raise InputError("its values are real", place=place, remedy=NO_PHASE)
        if np.isinf(self.values).any():
            raise InputError("values hold an infinity", place=place, remedy="give NaN where nothing was measured")
        if np.any(self.std < 0):
            raise InputError("std has a negative value", place=place, remedy="give NaN where it is unknown")
        for kind, sensors in (("response", self.responses), ("reference", self.references)):
            names = [sensor.name for sensor in sensors]
            if twice := next((name for name in names if names.count(name) > 1), None):
                raise InputError(f"a {kind} is given twice ({twice})", place=place, remedy="average it or keep one")

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        """Responses and references, each once."""
        return tuple(dict.fromkeys((*self.responses, *self.references)))

    @cached_property
    def functions(self) -> tuple[MeasuredFunction, ...]:
        """Functions that were measured on at least one line, reference by reference."""
        known = np.isfinite(self.values)
        return tuple(
            MeasuredFunction(i, j, response, reference, np.flatnonzero(known[:, i, j]))
            for j, reference in enumerate(self.references)
            for i, response in enumerate(self.responses)
            if known[:, i, j].any()
        )

    @property
    def disagreements(self) -> tuple[Disagreement, ...]:
        """Empty: repeats of FRFs are not compared with each other."""
        return ()

    @property
    def claimed(self) -> str:
        """The claimed accuracy in words; empty without."""
        words = "at each line by itself; errors that lines share, such as places and gains, belong in nuisances"
        return f"{self.accuracy.words('SI')} of FRFs, {words}" if self.accuracy.given else ""

    @property
    def sensor_std(self) -> np.ndarray:
        """NaN, (n_sensors,): an FRF has a standard deviation of its own on every line."""
        return np.full(len(self.sensors), np.nan)

    @property
    def content(self) -> str:
        """The fingerprint, as a digest of the measurement takes it."""
        return self.fingerprint

    @property
    def frequencies(self) -> np.ndarray:
        """Lines, Hz, (n_freq,)."""
        return self.freq

    @property
    def lowest_freq(self) -> float:
        """Lowest line above zero, Hz."""
        return float(self.freq[self.freq > 0][0])

    def unit(self, response: Sensor, reference: Sensor) -> str:
        """Of one function, such as ``m/N``, ``m/(N s2)`` or, of a rotation under a moment, ``rad/(Nm s2)``."""
        motion = "rad" if response.direction.startswith("r") else "m"
        load = "Nm" if reference.direction.startswith("r") else "N"
        time = QUANTITIES[self.quantity]
        return f"{motion}/({load} {time})" if time else f"{motion}/{load}"

    @cached_property
    def fingerprint(self) -> str:
        """Hash over everything an evaluation may depend on."""
        content = (self.responses, self.references, self.quantity, self.n_repeats, self.accuracy)
        window = [self.window_rate] if self.window_rate else []
        return digest_of(content, *window, *(a.tobytes() for a in (self.freq, self.values, self.std)))[:16]

    @property
    def total_std(self) -> np.ndarray:
        """Repeatability and claimed accuracy in quadrature, (n_freq, n_responses, n_references).

        Of the real and of the imaginary part each; NaN where neither is known.
        """
        if not self.accuracy.given:
            return self.std
        claimed = np.hypot(self.accuracy.share * np.abs(self.values), self.accuracy.own)
        return np.asarray(np.hypot(np.nan_to_num(self.std), claimed * self.per_line))

    @property
    def per_line(self) -> np.ndarray | float:
        """Standard deviation of an entry over that of a line, of errors that are independent."""
        return 1.0 if self.behind is None else 1 / np.sqrt(np.maximum(self.behind, 1))

    # -- which entries enter -------------------------------------------------------------------------------------------

    @property
    def power(self) -> np.ndarray:
        """Sum of squared moduli over all functions, (n_freq,), whose peaks are resonances."""
        return np.asarray(np.nansum(np.abs(self.values) ** 2, axis=(1, 2)))

    def resonances(self, prominence: float = RULES.prominence) -> tuple[Resonance, ...]:
        """Peaks of `power` above the valleys beside them, dB, and above the noise of the repeats, in ascending order.

        See `calib.measurement.frf_lines.resonances`.
        """
        noise = 2 * np.nansum(np.where(np.isfinite(self.values), self.std, 0.0) ** 2, axis=(1, 2))
        return resonances(self.freq, self.power, prominence, noise)

    def lines_near_resonances(
        self, widths: float = RULES.resonance_widths, prominence: float = RULES.prominence
    ) -> MeasuredFRFs:
        """The lines around peaks of `power`, which bear nearly all information on frequencies and damping.

        A peak rises above the valleys beside it and above the noise of the repeats (see `RULES.above_noise`).

        Parameters
        ----------
        widths : float
            Width of the window centred on each peak, over the peak's half-power width.
        prominence : float
            Least rise of a peak above the valleys beside it, dB; at least 3.

        Raises
        ------
        InputError
            When there is no such peak.
        """
        if not widths > 0:
            raise InputError(f"the window is {widths:g} half-power widths", place="FRFs", remedy="give a positive one")
        found = self.resonances(prominence)
        if not found:
            raise InputError(
                f"no resonance rises {prominence:g} dB above its surroundings", place=self._place,
                remedy="use all lines, or a lower prominence",
            )  # fmt: skip
        bands = [(r.freq - 0.5 * widths * r.width, r.freq + 0.5 * widths * r.width) for r in found]
        return self._kept(in_bands(self.freq, bands)[:, None, None])

    def in_band(self, low: float, high: float) -> MeasuredFRFs:
        """The lines from ``low`` to ``high``, Hz; InputError where there are none."""
        return self._kept(self._lines([(low, high)])[:, None, None])

    def without(
        self,
        responses: Iterable[str] = (),
        references: Iterable[str] = (),
        bands: Sequence[tuple[float, float]] = (),
    ) -> MeasuredFRFs:
        """All but some responses and references (named like ``12y``) and lines in bands [low, high], Hz.

        Raises
        ------
        InputError
            For an unknown name, a band without a line, or when nothing is left.
        """
        return self._kept(~self._chosen(responses, references, bands))

    def only(
        self,
        responses: Iterable[str] = (),
        references: Iterable[str] = (),
        bands: Sequence[tuple[float, float]] = (),
    ) -> MeasuredFRFs:
        """The complement of `without`: what that takes away, NaN elsewhere; raises alike."""
        return self._kept(self._chosen(responses, references, bands))

    @property
    def _place(self) -> str:
        return self.source or "FRFs"

    def _lines(self, bands: Sequence[tuple[float, float]]) -> np.ndarray:
        for low, high in bands:
            if not 0 <= low <= high or not in_bands(self.freq, [(low, high)]).any():
                raise InputError(
                    f"no line lies in the band [{low:g}, {high:g}] Hz", place=self._place,
                    remedy=f"give it in Hz, low first; the lines reach from {self.freq[0]:g} to {self.freq[-1]:g} Hz",
                )  # fmt: skip
        return in_bands(self.freq, bands)

    def _chosen(
        self, responses: Iterable[str], references: Iterable[str], bands: Sequence[tuple[float, float]]
    ) -> np.ndarray:
        """Entries of any of these, bool, in the shape of the values."""
        out = np.zeros(self.values.shape, dtype=bool)
        out[self._lines(bands)] = True
        for kind, given, sensors, axis in (
            ("response", responses, self.responses, 1), ("reference", references, self.references, 2),
        ):  # fmt: skip
            names = [sensor.name for sensor in sensors]
            for name in given:
                if name not in names:
                    raise InputError(
                        f"held-out {kind} {name!r} was not measured", place=self._place,
                        remedy=f"the measured {kind}s are {', '.join(names)}",
                    )  # fmt: skip
                np.moveaxis(out, axis, 0)[names.index(name)] = True
        return out

    def _kept(self, chosen: np.ndarray) -> MeasuredFRFs:
        """Some entries, NaN elsewhere, without lines, responses and references that have none."""
        kept = np.broadcast_to(chosen, self.values.shape) & np.isfinite(self.values)
        k, i, j = (np.flatnonzero(kept.any(axis=axes)) for axes in ((1, 2), (0, 2), (0, 1)))
        if not len(k):
            raise InputError("no measured FRF is left", place=self._place, remedy="hold out less")
        here = np.ix_(k, i, j)
        return replace(
            self,
            freq=self.freq[k],
            responses=tuple(self.responses[n] for n in i),
            references=tuple(self.references[n] for n in j),
            values=np.where(kept, self.values, complex(np.nan, np.nan))[here],
            std=np.where(kept, self.std, np.nan)[here],
            behind=None if self.behind is None else self.behind[here],
        )
