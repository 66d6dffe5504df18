"""Poles of ambient records at ascending model orders, by the stochastic subspace identification of pyOMA2."""

from __future__ import annotations

import contextlib
import io
import logging
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.errors.errors import InputError
from calib.measurement.record import MeasuredRecord
from calib.modal_analysis.rules import RULES
from calib.modal_analysis.stabilisation import Chain, stable

EXTRA = "pip install calib[ambient]"
"""What installs the package that identifies modes from records."""

PRESET = "Kvaale"
"""Clusters of pyOMA2: HDBSCAN by poles and MAC over the poles that are stable from one order to the next."""


@dataclass(frozen=True, eq=False)
class Correlations:
    """Correlations of records as a block Hankel matrix, mean over parts of equal length.

    Attributes
    ----------
    hankel : ndarray (n_rows * n_sensors, n_rows * n_sensors)
    parts : ndarray (n_parts, ...)
        The same of each part.
    rows : int
        Block rows.
    rate : float
        Hz.
    """

    hankel: np.ndarray
    parts: np.ndarray
    rows: int
    rate: float

    def without(self, left_out: Sequence[int]) -> np.ndarray:
        """Hankel matrix of all parts but some."""
        kept = np.delete(self.parts, left_out, axis=0)
        return np.asarray(kept.mean(axis=0))


@dataclass(frozen=True, eq=False)
class Poles:
    """Poles at all orders, ``(n_poles, n_orders)`` with NaN where there is none, and their shapes ``(..., n_sensors)``.

    ``steady`` says which of them are stable from the order before.
    """

    natural_freq: np.ndarray
    damping_ratio: np.ndarray
    shapes: np.ndarray
    steady: np.ndarray


def block_rows(n_sensors: int) -> int:
    """Block rows of the Hankel matrix of so many sensors."""
    return max(RULES.rows_least, -(-RULES.record_order_most // n_sensors) + 1)


def samples_needed(n_sensors: int, n_parts: int) -> int:
    """Samples that a record needs for correlations of so many parts."""
    return RULES.samples_per_row * block_rows(n_sensors) * n_parts


def record_correlations(records: Sequence[MeasuredRecord], n_parts: int) -> Correlations:
    """Block Hankel matrices of records, cut into parts.

    Parameters
    ----------
    records : sequence of MeasuredRecord
        With the same sensors and rate.
    n_parts : int
        Of all records together, at least one each.

    Raises
    ------
    InputError
        When pyOMA2 is not installed, or parts are too short.
    """
    ssi = _package().ssi
    n_sensors = len(records[0].sensors)
    rows = block_rows(n_sensors)
    each = -(-n_parts // len(records))
    parts = []
    for one in records:
        length = len(one.values) // each
        least = samples_needed(n_sensors, each)
        if length < least // each:
            raise InputError(
                f"its {len(one.values)} samples are too few to identify modes from {n_sensors} sensors",
                place=one.source or "record", remedy=f"give at least {least}, or more sensors",
            )  # fmt: skip
        for k in range(each):
            own = one.values[k * length : (k + 1) * length].T
            with _quietly():
                parts.append(ssi.build_hank(own, own, rows, "cov")[0])
    every = np.array(parts)
    return Correlations(every.mean(axis=0), every, rows, records[0].rate)


def poles_at_orders(hankel: np.ndarray, rows: int, rate: float) -> Poles:
    """Poles at orders 0, 1, ... states from a Hankel matrix, and which are stable by the limits of the preset.

    Covariance-driven subspace identification (Peeters and De Roeck 1999) in the form of Döhler and Mevel (2013).
    """
    package = _package()
    with _quietly():
        found = _solved(package.ssi, hankel, rows, rate, RULES.record_order_most, 1)
        limits = package.Clustering(name=PRESET, quick=PRESET).steps[0].sc_dict
        steady = package.gen.SC_apply(
            *found[:3], 0, RULES.record_order_most, 1, limits["err_fn"], limits["err_xi"], limits["err_phi"]
        )
    return Poles(*found[:3], np.asarray(steady, dtype=bool))


def poles_at(hankel: np.ndarray, rows: int, rate: float, order: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Natural frequencies (Hz), damping ratios (n_poles,) and shapes (n_poles, n_sensors) at one order."""
    with _quietly():
        freq, damping, shapes, _ = _solved(_package().ssi, hankel, rows, rate, order, order)
    there = np.isfinite(freq[:, -1])
    return freq[there, -1], damping[there, -1], shapes[there, -1]


def stable_clusters(poles: Poles) -> tuple[Chain, ...]:
    """Clusters of poles that count as modes by pyOMA2's preset and by the rules of `stable`, in ascending frequency.

    The residues of a chain are its mode shapes.
    """
    package = _package()
    steps = package.Clustering(name=PRESET, quick=PRESET).steps
    row, order = np.nonzero(poles.steady)
    least = int(steps[1].min_size)
    if len(row) <= least:
        return ()
    size, ratio = 2 * np.pi * poles.natural_freq[row, order], poles.damping_ratio[row, order]
    own, shapes = size * (-ratio + 1j * np.sqrt(1 - ratio**2)), poles.shapes[row, order]
    distance = pole_distance(own, shapes)
    with _quietly():
        labels = np.asarray(package.clus.hdbscan(distance, least))
        clusters = {label: np.flatnonzero(labels == label) for label in set(labels.tolist()) - {-1}}
        clusters, _ = package.clus.post_1xorder(clusters, labels, distance, order)
    chains = []
    farthest = steps[0].sc_dict["err_fn"]  # a cluster may hold poles of noise at single orders
    for one in clusters.values():
        near = one[np.abs(size[one] / np.median(size[one]) - 1) <= farthest]
        members = near[np.argsort(order[near])]
        chains.append(Chain(tuple(order[members].tolist()), own[members], shapes[members]))
    return stable(chains, RULES.record_order_most)


def pole_distance(poles: np.ndarray, shapes: np.ndarray) -> np.ndarray:
    """Distance of poles (n_poles,) with shapes (n_poles, n_sensors): relative difference plus 1 - MAC.

    That of the preset, which the package computes pair by pair: a hundred times slower. The MAC is the Hermitian one,
    which is symmetric.
    """
    size = np.abs(poles)
    apart = np.abs(poles[:, None] - poles) / np.maximum(size[:, None], size)
    unit = shapes / np.maximum(np.linalg.norm(shapes, axis=1, keepdims=True), 1e-300)
    agreement = np.abs(unit.conj() @ unit.T) ** 2
    return np.asarray(apart + np.clip(1 - (agreement + agreement.T) / 2, 0.0, None))


def _solved(
    ssi: Any, hankel: np.ndarray, rows: int, rate: float, order: int, step: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    observability, a, c, _ = ssi.SSI_fast(hankel, rows, order, step=step)
    found = ssi.SSI_poles(observability, a, c, order, 1 / rate, step=step, xi_max=RULES.record_overdamped)
    return found[0], found[1], found[2], found[3]


@dataclass(frozen=True)
class _Package:
    ssi: Any
    gen: Any
    clus: Any
    Clustering: Any


def _package() -> _Package:
    # it silences matplotlib's warnings for the whole process when it is imported
    log = logging.getLogger("matplotlib")
    level = log.level
    try:
        from pyoma2.algorithms.data.run_params import Clustering
        from pyoma2.functions import clus, gen, ssi
    except ImportError:
        raise InputError("pyOMA2, which identifies modes from time records, is not installed", remedy=EXTRA) from None
    finally:
        log.setLevel(level)
    logging.getLogger("pyoma2").setLevel(logging.CRITICAL)
    return _Package(ssi, gen, clus, Clustering)


@contextlib.contextmanager
def _quietly() -> Iterator[None]:
    """Without its bars of progress, and without warnings of poles that it discards itself."""
    quiet = io.StringIO()
    with warnings.catch_warnings(), contextlib.redirect_stderr(quiet), contextlib.redirect_stdout(quiet):
        warnings.simplefilter("ignore")
        with np.errstate(all="ignore"):
            yield
