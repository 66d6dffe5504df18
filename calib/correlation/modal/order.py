"""Pairing without shapes: alignment of two frequency lists in ascending order, with gaps on either side."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calib.correlation.rules import RULES

_STEP = 0.002
"""Resolution of the common ratio."""


class Costs(NamedTuple):
    """Common ratio of all modes: mean ln(model/measured) and the scale of deviations from it."""

    common: float
    scale: float


@dataclass(frozen=True, eq=False)
class Alignment:
    """Partners in ascending order.

    Attributes
    ----------
    partners : ndarray (n_measured,), int
        Index of the model mode, -1 for none; they ascend with the measured frequency.
    costs : Costs
    """

    partners: np.ndarray
    costs: Costs


def align_in_order(freq_measured: np.ndarray, freq_model: np.ndarray, costs: Costs | None = None) -> Alignment:
    """Pair two lists of frequencies so that the order is kept and the total cost is least.

    With d = ln(model/measured), a pair costs ``ln(2 b) + |d - c|/b``, an unpaired measured mode `RULES.skip_measured`,
    a run of unpaired model modes below or between the pairs `RULES.skip_model` and `RULES.skip_model_more` for each
    further one; model modes above the last pair, and those near 0 Hz (see `RULES.near_zero`), cost nothing. These are
    negative logarithms of probabilities: Laplace deviations of mean size b from a common ratio c, which costs
    ``|c|/0.15``. The sum is minimised over b (in `RULES.order_scales`), c and the pairs, by dynamic programming with
    affine gap costs (Gotoh 1982). A model that is too stiff by 10 % overall is therefore not shifted by one mode, and
    one unmeasured mode does not shift the others.

    Parameters
    ----------
    freq_measured, freq_model : ndarray (n_measured,), (n_model,)
        Hz, in any order.
    costs : Costs, optional
        Known from another alignment; default estimated.
    """
    rows, columns = np.argsort(freq_measured, kind="stable"), np.argsort(freq_model, kind="stable")
    partners = np.full(len(rows), -1)
    if not (len(rows) and len(columns)):
        return Alignment(partners, costs or Costs(0.0, RULES.order_scales[-1]))
    with np.errstate(divide="ignore"):
        d = np.log(np.asarray(freq_model, dtype=float)[columns]) - np.log(np.asarray(freq_measured)[rows])[:, None]
    if costs is None:
        ratios = _STEP * np.unique([0.0, *np.round(d[np.isfinite(d)] / _STEP)])
        tried = [(float(c), b) for c in ratios for b in RULES.order_scales]
        total = _Grid.of(d, np.array(tried)).least()
        costs = Costs(*tried[int(np.argmin(total))])
    pairs = _Grid.of(d, np.array([costs])).pairs()
    for i, j in pairs:
        partners[rows[i]] = columns[j]
    return Alignment(partners, costs)


@dataclass(frozen=True, eq=False)
class _Grid:
    """The dynamic program, for several common ratios and scales at once (last axis, n_tried).

    ``leading`` (n_model + 1, n_tried) is the cost of skipping the first j model modes.
    """

    d: np.ndarray
    common: np.ndarray
    scale: np.ndarray
    leading: np.ndarray

    @classmethod
    def of(cls, d: np.ndarray, tried: np.ndarray) -> _Grid:
        common, scale = tried[:, 0], tried[:, 1]
        counted = np.cumsum(d[0][:, None] - common > -math.log(RULES.near_zero), axis=0)
        skipped = np.where(counted > 0, RULES.skip_model + RULES.skip_model_more * (counted - 1), 0.0)
        leading = np.vstack([np.zeros((1, len(tried))), skipped])
        return cls(d, common, scale, leading)

    def _pair(self, i: int, j: int) -> np.ndarray:
        return np.log(2 * self.scale) + np.abs(self.d[i, j] - self.common) / self.scale

    def _row(
        self, i: int, before: list[np.ndarray], gap_before: list[np.ndarray]
    ) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Least costs after i measured and j model modes, ending otherwise or in a run of skipped model modes."""
        never = np.full(len(self.common), np.inf)
        closed, gap = [np.minimum(before[0], gap_before[0]) + RULES.skip_measured], [never]
        for j in range(self.d.shape[1]):
            paired = np.minimum(before[j], gap_before[j]) + self._pair(i, j)
            skipped = np.minimum(before[j + 1], gap_before[j + 1]) + RULES.skip_measured
            closed.append(np.minimum(paired, skipped))
            gap.append(np.minimum(closed[j] + RULES.skip_model, gap[j] + RULES.skip_model_more))
        return closed, gap

    def _start(self) -> tuple[list[np.ndarray], list[np.ndarray]]:
        never = np.full(len(self.common), np.inf)
        closed = [np.zeros(len(self.common)), *[never] * self.d.shape[1]]
        return closed, [never, *self.leading[1:]]

    def least(self) -> np.ndarray:
        """Least total cost of each candidate, (n_tried,)."""
        closed, gap = self._start()
        for i in range(len(self.d)):
            closed, gap = self._row(i, closed, gap)
        return np.min(closed, axis=0) + np.minimum(np.abs(self.common) / RULES.order_common, RULES.order_common_most)

    def pairs(self) -> list[tuple[int, int]]:
        """Pairs of the single candidate."""
        rows = [self._start()]
        for i in range(len(self.d)):
            rows.append(self._row(i, *rows[-1]))
        out = []
        i, j = len(self.d), int(np.argmin([float(cost[0]) for cost in rows[-1][0]]))
        in_gap = False
        while i > 0:
            closed, gap = rows[i]
            if in_gap:
                in_gap = bool(gap[j - 1][0] + RULES.skip_model_more < closed[j - 1][0] + RULES.skip_model)
                j -= 1
                continue
            before, gap_before = rows[i - 1]
            paired = math.inf
            if j > 0:
                paired = float((np.minimum(before[j - 1], gap_before[j - 1]) + self._pair(i - 1, j - 1))[0])
            i -= 1
            if paired <= float(closed[j][0]):
                j -= 1
                out.append((i, j))
            in_gap = bool(gap_before[j][0] < before[j][0])
        return out
