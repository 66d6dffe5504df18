"""Goodness of fit by kind of response and by mode."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol, TypeVar

import numpy as np
import pandas as pd
from scipy import special

from calib.freedom import chance, row_freedom
from calib.missing.rules import RULES
from calib.problem import Labelled, Rows

_Name = TypeVar("_Name", bound=Hashable)


class Fit(Protocol):
    """A fit at its end, of an explanation (`calib.missing.state.State`) or of a calibration."""

    @property
    def residual(self) -> np.ndarray:
        """Whitened, (n_rows,)."""
        ...

    @property
    def slope(self) -> np.ndarray:
        """Derivative of the residual of either sign, (n_rows, n_params)."""
        ...

    @property
    def prior_sd(self) -> np.ndarray:
        """Prior standard deviations, (n_params,)."""
        ...


def goodness(state: Fit, labelled: Labelled) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Sum of squares of every kind, and of every mode and kind, against what the scatter allows.

    The degrees of freedom of a block b are ``n_b - tr(G_b V G_b^T)`` (see `calib.freedom`) less the factors fitted to
    its shapes. The scatter was itself estimated, so that the ratio is an F variate. A single row is studentised,
    ``e^2/(1 - h)`` with one degree of freedom (Cook and Weisberg 1982), unless the parameters follow it nearly
    everywhere.

    Parameters
    ----------
    state : Fit
    labelled : Labelled
        Whose residual it is, such as a problem or hypotheses.

    Returns
    -------
    kinds : DataFrame
        ``kind, chi2, freedom, p``.
    modes : DataFrame
        ``mode, kind, chi2, freedom, p``.
    """
    layout = Layout.of(labelled)
    kept = np.ones((1, len(layout.which)), dtype=bool)
    found = layout.sums(state.residual[None] ** 2, row_freedom(state.slope, state.prior_sd)[None], kept)
    kinds = pd.DataFrame({"kind": list(layout.kinds), **{name: a[0] for name, a in found.kinds.items()}})
    modes = pd.DataFrame(list(layout.blocks), columns=["mode", "kind"])
    return kinds, modes.assign(**{name: a[0] for name, a in found.modes.items()})


class Sums(NamedTuple):
    """Sums of squares of several fits: ``chi2, freedom, p`` by kind (n_fits, n_kinds) and block (n_fits, n_blocks).

    ``p`` is 1 where a fit has no row of that kind or block; ``overall`` (n_fits,) is what the function `overall` gives.
    """

    kinds: dict[str, np.ndarray]
    modes: dict[str, np.ndarray]
    overall: np.ndarray


@dataclass(frozen=True, eq=False)
class Layout:
    """Which rows belong together: blocks of one mode and kind, and kinds, each in the order of first appearance.

    Attributes
    ----------
    blocks : tuple of (mode, kind)
    kinds : tuple of str
    which : ndarray of int (n_rows,)
        Block of every row.
    kind_of : ndarray of int (n_blocks,)
        Kind of every block.
    factors : ndarray (n_blocks,)
        Numbers fitted to each.
    scatter : ndarray (n_kinds,)
        Degrees of freedom behind the scatter of each kind; infinite where it is known.
    """

    blocks: tuple[tuple[str, str], ...]
    kinds: tuple[str, ...]
    which: np.ndarray
    kind_of: np.ndarray
    factors: np.ndarray
    scatter: np.ndarray

    @classmethod
    def of(cls, labelled: Labelled) -> Layout:
        """See `goodness`."""
        fitted_factors, scatter_freedom = labelled.fitted_factors, labelled.scatter_freedom
        blocks, which = _numbered([(row.mode, row.kind) for row in labelled.rows])
        kinds, kind_of = _numbered([kind for _, kind in blocks])
        factors = np.array([float(fitted_factors.get(block, 0)) for block in blocks])
        scatter = np.array([scatter_freedom.get(kind, np.inf) for kind in kinds])
        return cls(tuple(blocks), tuple(kinds), which, kind_of, factors, scatter)

    def sums(self, squares: np.ndarray, freedom: np.ndarray, kept: np.ndarray) -> Sums:
        """Of fits with some of the rows each.

        Parameters
        ----------
        squares, freedom : ndarray (n_fits, n_rows)
            Squares of the residual, and what a fit leaves of each row's variance.
        kept : ndarray (n_fits, n_rows), bool
        """
        block = np.eye(len(self.blocks))[self.which]
        kind = np.eye(len(self.kinds))[self.kind_of]
        counts = kept.astype(float) @ block
        present = counts > 0
        chi2 = np.where(kept, squares, 0.0) @ block
        left = np.where(kept, freedom, 0.0) @ block - np.where(present, self.factors, 0.0)
        some = present.astype(float) @ kind > 0
        kinds = {"chi2": chi2 @ kind, "freedom": left @ kind}
        kinds["p"] = np.where(some, chance(kinds["chi2"], kinds["freedom"], self.scatter), 1.0)
        studied = (counts == 1) & (left > RULES.followed)
        chi2 = np.divide(chi2, left, out=chi2.copy(), where=studied)
        modes = {"chi2": chi2, "freedom": np.where(studied, 1.0, left)}
        modes["p"] = np.where(present, chance(modes["chi2"], modes["freedom"], self.scatter[self.kind_of]), 1.0)
        shapes = present & np.array([name == "shape" for _, name in self.blocks])
        worst = np.min(np.where(shapes, modes["p"], np.inf), axis=1, initial=np.inf)
        number = shapes.sum(axis=1)
        return Sums(kinds, modes, _overall(kinds["p"].min(axis=1, initial=1.0), some.sum(axis=1), worst, number))


def _overall(kind: np.ndarray, kinds: np.ndarray, shape: np.ndarray, shapes: np.ndarray) -> np.ndarray:
    """Chance of the worst of so many kinds or of so many shapes, each with the chance of its worst."""
    several = np.where(shapes > 0, shape * np.maximum(shapes, 1), 1.0)
    return np.minimum(1.0, (kinds + 1) * np.minimum(kind, several))


def _numbered(names: Sequence[_Name]) -> tuple[list[_Name], np.ndarray]:
    """Different names in the order of their first appearance, and the number of each name among them, (n,)."""
    numbers = {name: k for k, name in enumerate(dict.fromkeys(names))}
    return list(numbers), np.array([numbers[name] for name in names], dtype=int)


def by_sensor(state: Fit, labelled: Labelled) -> pd.DataFrame:
    """Sum of squares of every sensor, or plain response, over all modes: ``sensor, chi2, freedom, p``, worst first.

    ``p`` is that of one sensor; among n it counts n times.
    """
    table, scatter_freedom = _sensors(state, labelled), labelled.scatter_freedom
    scatter = np.array([scatter_freedom.get(kind, np.inf) for kind in table["kind"]])
    table["p"] = chance(table["chi2"].to_numpy(), table["freedom"].to_numpy(), scatter)
    table = table[table["sensor"] != ""].drop(columns="kind")
    return table.sort_values(["p", "chi2"], ascending=[True, False], ignore_index=True, kind="stable")


def _sensors(state: Fit, labelled: Labelled) -> pd.DataFrame:
    """``sensor, kind, chi2, freedom`` in the order of the rows; factors fitted to a shape are shared by its rows."""
    rows, fitted_factors = labelled.rows, labelled.fitted_factors
    blocks, which = _numbered([(row.mode, row.kind) for row in rows])
    share = np.array([fitted_factors.get(block, 0) for block in blocks]) / np.bincount(which)
    freedom = row_freedom(state.slope, state.prior_sd) - share[which]
    names, of = _numbered([(row.sensor, row.kind) for row in rows])
    table = pd.DataFrame(names, columns=["sensor", "kind"])
    return table.assign(chi2=np.bincount(of, state.residual**2), freedom=np.bincount(of, freedom))


def overall(kinds: pd.DataFrame, modes: pd.DataFrame) -> float:
    """Chance of the worst kind or the worst single-mode shape being as bad as found (Bonferroni)."""
    shapes = modes.loc[modes["kind"] == "shape", "p"]
    worst = np.array([table.min() if len(table) else 1.0 for table in (kinds["p"], shapes)])
    return float(_overall(worst[:1], np.array([len(kinds)]), worst[1:], np.array([len(shapes)]))[0])


def misfit_factor(kinds: pd.DataFrame, modes: pd.DataFrame, level: float) -> float:
    """Factor on the scatter with which the worst of what fails the test of `overall` would be as a right model has it.

    The largest root of chi2 over the degrees of freedom (Birge 1932), of kinds and of shapes of single modes; 1 where
    nothing fails.
    """
    shapes = modes[modes["kind"] == "shape"]
    parts = ((kinds, len(kinds) + 1), (shapes, (len(kinds) + 1) * len(shapes)))
    failing = [table[table["p"] * among <= level] for table, among in parts]
    squares = [(t["chi2"] / np.maximum(t["freedom"], 1.0)).max() for t in failing if len(t)]
    return float(np.sqrt(max(squares, default=1.0)))


def noise_scale(modes: pd.DataFrame) -> float:
    """Common factor on the scatter that the shapes of all modes ask for: root of the median of chi2 over freedom.

    What a model lacks spoils a few modes; a scatter that is stated too small spoils all of them alike. The factor is 1
    when the modes differ by more than chance once it is taken out, and NaN without shapes of at least 4 modes. The
    median of chi-square variates lies 1.5 % below their mean. For many modes it is as uncertain as the mean of 2/pi
    times as many (Cramer 1946), so that the ratio of a mode to it is about an F variate; modes that share a factor then
    look different in 0.4 to 0.7 % of the cases, for a level of 1 %.
    """
    shapes = modes[(modes["kind"] == "shape") & (modes["freedom"] >= 5)]
    if len(shapes) < 4:
        return float("nan")
    chi2, freedom = shapes["chi2"].to_numpy(dtype=float), shapes["freedom"].to_numpy(dtype=float)
    square = float(np.median(chi2 / freedom) / 0.985)
    variate = (freedom, 2 / np.pi * freedom.sum(), chi2 / freedom / square)
    tail = 2 * np.minimum(special.fdtrc(*variate), special.fdtr(*variate))
    alike = float(tail.min()) * len(shapes) > RULES.alike_scatter
    return float(np.sqrt(square)) if alike or square < 1 else 1.0


def lone_sensor(state: Fit, labelled: Labelled, level: float) -> str | None:
    """The sensor whose share of the misfit of all shapes is more than that of the others explains; None without one.

    Its sum of squares over its degrees of freedom, against that of all other sensors, is an F variate whatever the
    scatter; the largest of n sensors counts n times (Bonferroni).
    """
    table = _sensors(state, labelled)
    table = table[table["kind"] == "shape"]
    chi2, freedom = table["chi2"].to_numpy(), table["freedom"].to_numpy()
    rest, others = chi2.sum() - chi2, freedom.sum() - freedom
    usable = (freedom >= 1) & (others >= 1)
    if not usable.any():
        return None
    p = np.ones(len(table))
    p[usable] = chance((chi2 * others)[usable] / rest[usable], freedom[usable], others[usable])
    worst = int(np.argmin(p))
    return str(table["sensor"].iloc[worst]) if p[worst] * len(table) <= level else None


def common_scale(state: Fit, labelled: Labelled, level: float) -> float:
    """Factor on the scatter that all modes ask for, see `noise_scale`, without a sensor that alone may ask for it.

    A bad channel spoils the shapes of all modes as an understated scatter does, but at one sensor; at the level that
    one stands out (`lone_sensor`), the others tell.
    """
    factor = noise_scale(goodness(state, labelled)[1])
    lone = lone_sensor(state, labelled, level) if factor > 1 else None
    if lone is None:
        return factor
    kept = [k for k, row in enumerate(labelled.rows) if row.sensor != lone]
    rest = _Part(np.asarray(state.residual)[kept], np.asarray(state.slope)[kept], state.prior_sd)
    return noise_scale(goodness(rest, Rows.of(labelled, kept))[1])


class _Part(NamedTuple):
    """Some rows of a fit."""

    residual: np.ndarray
    slope: np.ndarray
    prior_sd: np.ndarray
