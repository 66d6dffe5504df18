"""Standard deviations of measured modes, from repeats, files, accuracy and floors."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from calib.correlation.rules import RULES
from calib.errors.errors import InputError
from calib.measurement.accuracy import KINDS
from calib.measurement.mac import is_real
from calib.measurement.modal import MeasuredModes
from calib.problem import degrees_of_freedom
from calib.problem.degrees_of_freedom import beside_known, dof_each, widened_by
from calib.structure.model import Assumption


@dataclass(frozen=True)
class Floors:
    """Systematic errors, which repeats do not reduce, and defaults for unknown standard deviations.

    Attributes
    ----------
    freq : float
        Discretisation floor of natural frequencies, relative; added to the standard deviation in quadrature.
    damping : float
        The same for damping ratios, relative.
    shape : float
        The same for shapes, relative to the largest entry; of real and imaginary part each.
    unknown_freq : float
        Standard deviation of natural frequencies, relative, where the measurement states none.
    unknown_damping : float
        The same of damping ratios.
    unknown_shape : float
        The same of shapes, relative to the largest entry.
    """

    freq: float = 2e-4
    damping: float = 0.02
    shape: float = 5e-3
    unknown_freq: float = 5e-3
    unknown_damping: float = 0.10
    unknown_shape: float = 0.03

    def __post_init__(self) -> None:
        for label, number in vars(self).items():
            lowest = "positive" if label.startswith("unknown") else "not negative"
            if not (math.isfinite(number) and number >= 0 and (number > 0 or lowest == "not negative")):
                raise InputError(f"the floor {label} is {number}", place="residual", remedy=f"give a {lowest} number")


USUAL = Floors()


@dataclass(frozen=True, eq=False)
class StandardDeviations:
    """Standard deviations that whiten the residual: those of the mean over the repeats, with floors.

    Attributes
    ----------
    freq, damping : ndarray (n_modes,)
        Relative.
    shape : ndarray (n_sensors, n_modes)
        Of real and imaginary part each, in the scale of the measured shapes.
    """

    freq: np.ndarray
    damping: np.ndarray
    shape: np.ndarray

    def beside(self, measured: MeasuredModes) -> StandardDeviations:
        """These with the claimed accuracy of the measurement added in quadrature."""
        claim = measured.accuracy
        if not claim.given:
            return self
        return StandardDeviations(
            np.hypot(self.freq, claim.freq.relative(measured.natural_freq)),
            np.hypot(self.damping, np.nan_to_num(claim.damping.relative(measured.damping_ratio), posinf=0.0)),
            np.sqrt(self.shape**2 + (claim.shape.share + claim.shape.own) ** 2 + of_channels(measured) ** 2),
        )


def of_channels(measured: MeasuredModes) -> np.ndarray:
    """Standard deviation of shapes by claimed accuracies of gains and places, (n_sensors, n_modes).

    That of a place times the slope of the measured shape, its difference to the nearest sensor of the same direction
    over the distance. Entries count as independent, although one channel has the same error in all modes.
    """
    claim, shapes = measured.accuracy, np.nan_to_num(np.abs(measured.shapes))
    variance = (claim.gain.share * shapes) ** 2
    if claim.place.own:
        variance = variance + (claim.place.own * _slopes(measured)) ** 2
    return np.asarray(np.sqrt(variance))


def _slopes(measured: MeasuredModes) -> np.ndarray:
    """Size of the slope of every measured shape at every sensor, 1/m, (n_sensors, n_modes); 0 where it is unknown."""
    out = np.zeros(measured.shapes.shape)
    for k, sensor in enumerate(measured.sensors):
        others = [
            (float(np.linalg.norm(np.subtract(o.point, sensor.point))), j)
            for j, o in enumerate(measured.sensors)
            if j != k and o.direction == sensor.direction and o.point is not None and sensor.point is not None
        ]
        near = [one for one in others if one[0] > 0]
        if near:
            distance, j = min(near)
            out[k] = np.nan_to_num(np.abs(measured.shapes[k] - measured.shapes[j])) / distance
    return out


def std_for(measured: MeasuredModes, floors: Floors = USUAL, pool: bool | None = None) -> StandardDeviations:
    """Standard deviations for the residual.

    With 2 to 9 repeats they are pooled: relative ones of frequency and of damping over the modes, those of shapes over
    all entries (root mean square; for shapes over ``n_sensors - 1`` entries a mode, since a factor was fitted to every
    repeat). Values are weighted by their degrees of freedom, and the pooled standard deviation is scaled to the number
    of repeats of each value. Standard deviations from a file with a single repeat, and those of ten or more repeats,
    are used individually, the latter widened by `calib.problem.degrees_of_freedom.widened_by`. Unknown ones, and those
    of values with fewer than `RULES.own_from` repeats, take the pooled value if there is one, else ``unknown_*`` of the
    floors; see `assumed_deviations`. The claimed accuracy of the measurement is added in quadrature, and stands alone
    where the standard deviation is unknown.

    Parameters
    ----------
    measured : MeasuredModes
    floors : Floors
    pool : bool, optional
        Overrides that rule.
    """
    own = _estimated(measured, floors, pool)
    unknown = _unknown(measured, floors)
    return StandardDeviations(
        freq=_beside(own.freq, floors.freq, unknown["freq"]),
        damping=_beside(own.damping, floors.damping, unknown["damping"]),
        shape=_beside(own.shape, floors.shape, unknown["shape"]),
    ).beside(measured)


def known_std(measured: MeasuredModes, floors: Floors = USUAL, pool: bool | None = None) -> StandardDeviations:
    """Result of `std_for`, NaN for kinds without a stated standard deviation or accuracy."""
    taken, claim = std_for(measured, floors, pool), measured.accuracy
    contributions = (
        (taken.freq, measured.freq_std, claim.freq),
        (taken.damping, measured.damping_std, claim.damping),
        (taken.shape, measured.shape_std, claim.shape),
    )
    known = [np.isfinite(std).any() or own.given for _, std, own in contributions]
    return StandardDeviations(
        *(k if some else np.full(k.shape, np.nan) for (k, _, _), some in zip(contributions, known, strict=True))
    )


def dof_behind(
    measured: MeasuredModes,
    kind: str,
    own: np.ndarray | float = 1.0,
    floors: Floors = USUAL,
    pool: bool | None = None,
) -> np.ndarray:
    """Degrees of freedom of the repeats behind the standard deviations of `std_for`.

    Floors and claimed accuracy count as known, so that a larger part of them adds degrees of freedom; see
    `calib.problem.degrees_of_freedom.beside_known`. Infinite for a single repeat, and for a kind without standard
    deviations from repeats.

    Parameters
    ----------
    measured : MeasuredModes
    kind : {"frequency", "damping", "shape"}
    own : ndarray or float
        Degrees of freedom of the comparisons: values that are not pooled rest on their own repeats only.
    floors, pool
        As in `std_for`.
    """
    name: Literal["freq", "damping", "shape"] = "freq" if kind == "frequency" else "damping"
    repeats = measured.n_repeats
    if kind == "shape":
        name, known = "shape", np.isfinite(measured.shapes) & np.isfinite(measured.shape_std)
        parts = np.where(is_real(measured.shapes), 1, 2)
        count = int(np.sum(parts * np.maximum(known.sum(axis=0) - 1, 0)))
    else:
        known = np.isfinite(measured.freq_std if kind == "frequency" else measured.damping_std)
        count = int(known.sum())
    if repeats == 1 or not known.any():
        return np.full(np.shape(own), np.inf)
    each = max(float(np.mean(measured.counts(name)[known] - 1.0)), 1.0)
    estimated = getattr(_estimated(measured, floors, pool), name)[known]
    total = getattr(std_for(measured, floors, pool), name)[known]
    pooled = _pooled(measured, pool)
    # A kind whose repeats are all equal has only known contributions.
    more = beside_known(1.0, np.divide(estimated, total, out=np.zeros_like(total), where=total > 0) ** 2, pooled)
    if pooled:
        return np.full(np.shape(own), max(count, 1) * each * more)
    return np.asarray(own, dtype=float) * dof_each(each) * more


def assumed_deviations(measured: MeasuredModes, floors: Floors = USUAL) -> tuple[Assumption, ...]:
    """Unstated standard deviations that `std_for` assumes; damping and shapes where they were measured.

    Where some values of a kind have one, the others take it, which is reported too.
    """
    damped = measured.damping_ratio > 0
    names = np.array(measured.names, dtype=object)
    own = std_for(measured, floors)
    taken = {"freq": own.freq, "damping": own.damping[damped], "shape": own.shape[np.isfinite(measured.shapes)]}
    kinds = (
        ("freq", _relative(measured.freq_std, measured.natural_freq), floors.unknown_freq, "of each"),
        ("damping", _relative(measured.damping_std, measured.damping_ratio)[damped], floors.unknown_damping, "of each"),
        ("shape", measured.shape_std[np.isfinite(measured.shapes)], floors.unknown_shape, "of the largest entry"),
    )
    out = []
    for name, std, unknown, base in kinds:
        lost = ~np.isfinite(std)
        if not lost.any() or getattr(measured.accuracy, name).given:
            continue
        item = f"standard deviation of {KINDS[name]}"
        if lost.all():
            out.append(
                Assumption(item, f"{100 * unknown:g}", f"% {base}", "no standard deviation and no accuracy is stated")
            )
            continue
        used = 100 * np.unique(np.round(taken[name][lost], 6))
        common = f"{used[0]:.2g}" if len(used) == 1 else f"{used[0]:.2g} to {used[-1]:.2g}"
        which = "some entries"
        if name != "shape":
            which = ", ".join((names if name == "freq" else names[damped])[lost])
        reason = f"none is stated for {which}: that of the others"
        out.append(Assumption(item, common, f"% {base}", reason))
    return tuple(out)


def _relative(std: np.ndarray, value: np.ndarray) -> np.ndarray:
    return np.divide(std, value, out=np.full(np.shape(std), np.nan), where=value > 0)


def _pooled(measured: MeasuredModes, pool: bool | None) -> bool:
    return 1 < measured.n_repeats < degrees_of_freedom.RULES.pool_below if pool is None else pool


def _unknown(measured: MeasuredModes, floors: Floors) -> dict[str, float]:
    """Standard deviations assumed where a measurement states none; 0 where it claims an accuracy."""
    claim = measured.accuracy
    return {name: 0.0 if getattr(claim, name).given else getattr(floors, f"unknown_{name}") for name in KINDS}


def _estimated(measured: MeasuredModes, floors: Floors, pool: bool | None) -> StandardDeviations:
    """Standard deviations from repeats, files or assumptions, before floors and accuracy are added."""
    pooled = _pooled(measured, pool)
    freq = measured.freq_std / measured.natural_freq
    damped = measured.damping_ratio > 0
    damping = np.full(measured.n_modes, np.nan)
    damping[damped] = measured.damping_std[damped] / measured.damping_ratio[damped]
    shape = np.where(np.isfinite(measured.shapes), measured.shape_std, np.nan)
    counted = np.isfinite(shape)
    entries = int(counted.sum())
    dof = int(np.maximum(counted.sum(axis=0) - 1, 0).sum()) if measured.n_repeats > 1 else entries
    lost = entries / dof if dof else 1.0
    unknown = _unknown(measured, floors)
    return StandardDeviations(
        freq=_taken(freq, measured.counts("freq"), unknown["freq"], pooled, 1.0),
        damping=_taken(damping, measured.counts("damping"), unknown["damping"], pooled, 1.0),
        shape=_taken(shape, measured.counts("shape"), unknown["shape"], pooled, lost),
    )


def _taken(std: np.ndarray, counts: np.ndarray, unknown: float, pooled: bool, lost: float) -> np.ndarray:
    known = np.isfinite(std)
    if not known.any():
        return np.full(std.shape, unknown)
    # standard deviations of means over different numbers of repeats, scaled to one repeat and back
    n = np.maximum(counts, 1)
    dof = n[known] - 1.0 if np.any(n[known] > 1) else np.ones(int(known.sum()))
    single = float(np.average(std[known] ** 2 * n[known], weights=dof))
    common = np.sqrt(single * lost / n)
    if pooled:
        return common
    if not np.any(n[known] > 1):
        return np.where(known, std, common)
    return np.where(known & (n >= RULES.own_from), std * widened_by(n - 1.0), common)


def _beside(std: np.ndarray, floor: float, unknown: float) -> np.ndarray:
    total = np.hypot(std, floor)
    return np.where(total > 0, total, unknown)
