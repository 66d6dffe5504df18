"""Goodness of fit by kind of response and by mode."""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol, TypeVar

import numpy as np
import pandas as pd
from scipy import special

from calib.missing.candidate_fit import AdequacyTests
from calib.missing.rules import RULES
from calib.problem.degrees_of_freedom import p_value, row_dof
from calib.problem.labels import Labelled, RowLabels

_Name = TypeVar("_Name", bound=Hashable)


class FittedRows(Protocol):
    """A fit at its end, of an explanation (`calib.missing.linearised_fit.LinearisedFit`) or of a calibration."""

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


def goodness(fit: FittedRows, labelled: Labelled) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Chi-square test of every kind, and of every mode and kind.

    The degrees of freedom of a block b are ``n_b - tr(G_b V G_b^T)`` (see `calib.problem.degrees_of_freedom`) less the
    factors fitted to its shapes. The standard deviation is itself an estimate, so that the ratio is an F variate. A
    single row is studentised, ``e^2/(1 - h)`` with one degree of freedom (Cook and Weisberg 1982), unless the
    parameters absorb nearly all of it.

    Parameters
    ----------
    fit : Fit
    labelled : Labelled
        Labels of the rows of the residual, such as a problem or hypotheses.

    Returns
    -------
    kinds : DataFrame
        ``kind, chi2, dof, p``.
    modes : DataFrame
        ``mode, kind, chi2, dof, p``.
    """
    layout, found = _sums_of(fit, labelled)
    kinds = pd.DataFrame({"kind": list(layout.kinds), **{name: a[0] for name, a in found.kinds.items()}})
    names = {"mode": [mode for mode, _ in layout.blocks], "kind": [kind for _, kind in layout.blocks]}
    return kinds, pd.DataFrame(names | {name: a[0] for name, a in found.modes.items()})


def _sums_of(fit: FittedRows, labelled: Labelled) -> tuple[Layout, Sums]:
    """Sums of squares of one fit to all rows."""
    layout = Layout.of(labelled)
    kept = np.ones((1, len(layout.which)), dtype=bool)
    return layout, layout.sums(fit.residual[None] ** 2, row_dof(fit.slope, fit.prior_sd)[None], kept)


class Sums(NamedTuple):
    """Sums of squares of several fits: ``chi2, dof, p`` by kind (n_fits, n_kinds) and block (n_fits, n_blocks).

    ``p`` is 1 where a fit has no row of that kind or block; ``overall`` (n_fits,) is what the function `overall` gives.
    """

    kinds: dict[str, np.ndarray]
    modes: dict[str, np.ndarray]
    overall: np.ndarray


@dataclass(frozen=True, eq=False)
class Layout:
    """Grouping of rows: blocks of one mode and kind, and kinds, each in the order of first appearance.

    Attributes
    ----------
    blocks : tuple of (mode, kind)
    kinds : tuple of str
    which : ndarray of int (n_rows,)
        Block of every row.
    kind_of : ndarray of int (n_blocks,)
        Kind of every block.
    factors : ndarray (n_blocks,)
        Number of factors fitted to each block.
    std : ndarray (n_kinds,)
        Degrees of freedom behind the standard deviation of each kind; infinite where it is known.
    """

    blocks: tuple[tuple[str, str], ...]
    kinds: tuple[str, ...]
    which: np.ndarray
    kind_of: np.ndarray
    factors: np.ndarray
    std: np.ndarray

    @classmethod
    def of(cls, labelled: Labelled) -> Layout:
        """Grouping of the rows of a residual."""
        fitted_factors, std_dof = labelled.fitted_factors, labelled.std_dof
        blocks, which = _numbered([(row.mode, row.kind) for row in labelled.rows])
        kinds, kind_of = _numbered([kind for _, kind in blocks])
        factors = np.array([float(fitted_factors.get(block, 0)) for block in blocks])
        std = np.array([std_dof.get(kind, np.inf) for kind in kinds])
        return cls(tuple(blocks), tuple(kinds), which, kind_of, factors, std)

    def sums(self, squares: np.ndarray, dof: np.ndarray, kept: np.ndarray) -> Sums:
        """Sums of squares of fits to some of the rows each.

        Parameters
        ----------
        squares, dof : ndarray (n_fits, n_rows)
            Squares of the residual, and the part of each row's variance that a fit leaves.
        kept : ndarray (n_fits, n_rows), bool
        """
        block = np.eye(len(self.blocks))[self.which]
        kind = np.eye(len(self.kinds))[self.kind_of]
        counts = kept.astype(float) @ block
        present = counts > 0
        chi2 = np.where(kept, squares, 0.0) @ block
        remaining_dof = np.where(kept, dof, 0.0) @ block - np.where(present, self.factors, 0.0)
        any_row = present.astype(float) @ kind > 0
        kinds = {"chi2": chi2 @ kind, "dof": remaining_dof @ kind}
        kinds["p"] = np.where(any_row, p_value(kinds["chi2"], kinds["dof"], self.std), 1.0)
        single = (counts == 1) & (remaining_dof > RULES.followed)
        chi2 = np.divide(chi2, remaining_dof, out=chi2.copy(), where=single)
        modes = {"chi2": chi2, "dof": np.where(single, 1.0, remaining_dof)}
        modes["p"] = np.where(present, p_value(modes["chi2"], modes["dof"], self.std[self.kind_of]), 1.0)
        shapes = present & np.array([name == "shape" for _, name in self.blocks])
        worst = np.min(np.where(shapes, modes["p"], np.inf), axis=1, initial=np.inf)
        number = shapes.sum(axis=1)
        return Sums(kinds, modes, _overall(kinds["p"].min(axis=1, initial=1.0), any_row.sum(axis=1), worst, number))


def _overall(kind: np.ndarray, kinds: np.ndarray, shape: np.ndarray, shapes: np.ndarray) -> np.ndarray:
    """p-value of the worst kind or shape, from the smallest p-value and the number of each (Bonferroni)."""
    several = np.where(shapes > 0, shape * np.maximum(shapes, 1), 1.0)
    return np.minimum(1.0, (kinds + 1) * np.minimum(kind, several))


def _numbered(names: Sequence[_Name]) -> tuple[list[_Name], np.ndarray]:
    """Unique names in the order of first appearance, and the index of each name among them, (n,)."""
    numbers = {name: k for k, name in enumerate(dict.fromkeys(names))}
    return list(numbers), np.array([numbers[name] for name in names], dtype=int)


def by_sensor(fit: FittedRows, labelled: Labelled) -> pd.DataFrame:
    """Chi-square test of every sensor, or scalar response, over all modes: ``sensor, chi2, dof, p``, worst first.

    ``p`` holds for one sensor; the worst of n has n times that p-value (Bonferroni).
    """
    names, kinds, chi2, dof = _sensors(fit, labelled)
    std_dof = labelled.std_dof
    p = p_value(chi2, dof, np.array([std_dof.get(kind, np.inf) for kind in kinds]))
    order = [k for k in np.lexsort((-chi2, p)) if names[k]]
    return pd.DataFrame({"sensor": [names[k] for k in order], "chi2": chi2[order], "dof": dof[order], "p": p[order]})


def _sensors(fit: FittedRows, labelled: Labelled) -> tuple[list[str], list[str], np.ndarray, np.ndarray]:
    """Sensors, kinds, chi2 and dof in the order of the rows; factors of a shape are divided evenly among its rows."""
    rows, fitted_factors = labelled.rows, labelled.fitted_factors
    blocks, which = _numbered([(row.mode, row.kind) for row in rows])
    share = np.array([fitted_factors.get(block, 0) for block in blocks]) / np.bincount(which)
    dof = row_dof(fit.slope, fit.prior_sd) - share[which]
    both, of = _numbered([(row.sensor, row.kind) for row in rows])
    return [s for s, _ in both], [k for _, k in both], np.bincount(of, fit.residual**2), np.bincount(of, dof)


def overall(kinds: pd.DataFrame, modes: pd.DataFrame) -> float:
    """p-value of the worst kind or the worst shape of one mode (Bonferroni)."""
    shapes = modes["p"].to_numpy()[_of_shapes(modes)]
    worst = np.array([p.min(initial=1.0) for p in (kinds["p"].to_numpy(), shapes)])
    return float(_overall(worst[:1], np.array([len(kinds)]), worst[1:], np.array([len(shapes)]))[0])


def overall_p(fit: FittedRows, labelled: Labelled) -> float:
    """What `overall` gives for the tables of `goodness`, without making them."""
    return float(_sums_of(fit, labelled)[1].overall[0])


def misfit_factor(kinds: pd.DataFrame, modes: pd.DataFrame, level: float) -> float:
    """Factor on the standard deviation that brings the worst failing part of the test of `overall` to its expectation.

    It is the largest root of chi2 over degrees of freedom (Birge ratio, 1932) among the kinds and the shapes of single
    modes that fail at ``level``; 1 when none fails.
    """
    shapes = modes[modes["kind"] == "shape"]
    parts = ((kinds, len(kinds) + 1), (shapes, (len(kinds) + 1) * len(shapes)))
    failing = [table[table["p"] * among <= level] for table, among in parts]
    squares = [(t["chi2"] / np.maximum(t["dof"], 1.0)).max() for t in failing if len(t)]
    return float(np.sqrt(max(squares, default=1.0)))


def noise_scale(modes: pd.DataFrame) -> float:
    """Common factor on the standard deviation of all mode shapes: root of the median of chi2 over degrees of freedom.

    A missing effect raises the misfit of a few modes; an understated standard deviation raises that of all modes alike.
    The factor is 1 when the modes differ by more than chance after it is taken out, and NaN without shapes of at least
    4 modes. The median of chi-square variates lies 1.5 % below their mean. For many modes it is as uncertain as the
    mean of 2/pi times as many (Cramer 1946), so that the ratio of a mode to it is approximately an F variate; modes
    that share a factor then test as different in 0.4 to 0.7 % of the cases, at a level of 1 %.
    """
    chi2, dof = modes["chi2"].to_numpy(dtype=float), modes["dof"].to_numpy(dtype=float)
    return _noise_scale(chi2, dof, _of_shapes(modes))


def _noise_scale(chi2: np.ndarray, dof: np.ndarray, of_shapes: np.ndarray) -> float:
    """See `noise_scale`; all (n_blocks,)."""
    used = of_shapes & (dof >= 5)
    chi2, dof = chi2[used], dof[used]
    if len(dof) < 4:
        return float("nan")
    square = float(np.median(chi2 / dof) / 0.985)
    variate = (dof, 2 / np.pi * dof.sum(), chi2 / dof / square)
    tail = 2 * np.minimum(special.fdtrc(*variate), special.fdtr(*variate))
    homogeneous = float(tail.min()) * len(dof) > RULES.alike_std
    return float(np.sqrt(square)) if homogeneous or square < 1 else 1.0


def lone_sensor(fit: FittedRows, labelled: Labelled, level: float) -> str | None:
    """The sensor whose misfit of all shapes is significantly larger than that of the others; None without one.

    The ratio of its chi2 over degrees of freedom to that of all other sensors is an F variate whatever the standard
    deviation; the worst of n sensors has n times its p-value (Bonferroni).
    """
    every, kinds, chi2, dof = _sensors(fit, labelled)
    shapes = [k for k, kind in enumerate(kinds) if kind == "shape"]
    names, chi2, dof = [every[k] for k in shapes], chi2[shapes], dof[shapes]
    rest, others = chi2.sum() - chi2, dof.sum() - dof
    usable = (dof >= 1) & (others >= 1)
    if not usable.any():
        return None
    p = np.ones(len(names))
    p[usable] = p_value((chi2 * others)[usable] / rest[usable], dof[usable], others[usable])
    worst = int(np.argmin(p))
    return names[worst] if p[worst] * len(names) <= level else None


def _of_shapes(table: pd.DataFrame) -> np.ndarray:
    """Whether each row of a table is about a shape, (n,)."""
    return np.array([kind == "shape" for kind in table["kind"]], dtype=bool)


def common_scale(fit: FittedRows, labelled: Labelled, level: float) -> float:
    """Common factor on the standard deviation of all mode shapes (`noise_scale`), without a sensor that stands out.

    A bad channel raises the misfit of all mode shapes as an understated standard deviation does, but at one sensor.
    When one stands out at ``level`` (`lone_sensor`), the factor is that of the other sensors.
    """
    factor = _noise_scale_of(fit, labelled)
    lone = lone_sensor(fit, labelled, level) if factor > 1 else None
    if lone is None:
        return factor
    kept = [k for k, row in enumerate(labelled.rows) if row.sensor != lone]
    rest = _Part(np.asarray(fit.residual)[kept], np.asarray(fit.slope)[kept], fit.prior_sd)
    return _noise_scale_of(rest, RowLabels.of(labelled, kept))


def _noise_scale_of(fit: FittedRows, labelled: Labelled) -> float:
    layout, found = _sums_of(fit, labelled)
    of_shapes = np.array([kind == "shape" for _, kind in layout.blocks], dtype=bool)
    return _noise_scale(found.modes["chi2"][0], found.modes["dof"][0], of_shapes)


class _Part(NamedTuple):
    """Some rows of a fit."""

    residual: np.ndarray
    slope: np.ndarray
    prior_sd: np.ndarray


_LEAST = 3 / RULES.samples
"""Smallest p-value that is stated: that of the samples, for the smallest of three tests (`AdequacyTests.p_family`)."""


def p_number(p: float) -> str:
    """A p-value as a number, down to the resolution of the samples."""
    return f"< {_LEAST:.1g}" if p < _LEAST else f"{p:.2g}"


def p_words(p: float) -> str:
    """A p-value, such as ``p = 0.03`` or ``p < 0.0004``."""
    return f"p {p_number(p)}" if p < _LEAST else f"p = {p_number(p)}"


def misfit_at(adequacy: AdequacyTests, disagreements: pd.DataFrame) -> dict[str, object]:
    """Where a fit is worst: ``sensor`` or scalar response, ``mode`` with its ``kind``; ``repeats`` that disagree."""
    sensor, mode = _worst(adequacy)
    return {
        "sensor": None if sensor is None else str(sensor["sensor"]),
        "mode": None if mode is None else str(mode["mode"]),
        "kind": None if mode is None else str(mode["kind"]),
        "repeats": worst_repeats(adequacy, disagreements),
    }


def worst_repeats(adequacy: AdequacyTests, disagreements: pd.DataFrame) -> list[str]:
    """Repeats that disagree with the others; first those that do where the fit is worst, then by how much."""
    sensor, mode = _worst(adequacy)
    places = {str(row[name]) for row, name in ((sensor, "sensor"), (mode, "mode")) if row is not None}
    here = disagreements[["sensor", "mode"]].isin(places).any(axis=1)
    order = disagreements.assign(here=here).sort_values(["here", "times"], ascending=False, kind="stable")
    return list(dict.fromkeys(order["repeat"].astype(str)))


def _worst(adequacy: AdequacyTests) -> tuple[pd.Series | None, pd.Series | None]:
    """Rows of the worst sensor and of the worst mode of a fit; None where it has none."""
    modes = adequacy.modes[adequacy.modes["mode"] != ""].sort_values("p", kind="stable")
    return (adequacy.sensors.iloc[0] if len(adequacy.sensors) else None, modes.iloc[0] if len(modes) else None)


def where(adequacy: AdequacyTests) -> str:
    """The worst sensor and the worst mode of a fit, each with its p-value, in words."""
    phrases = []
    worst, last = _worst(adequacy)
    if worst is not None:
        times = math.sqrt(float(worst["chi2"]) / max(float(worst["dof"]), 1.0))
        phrases.append(
            f"at {worst['sensor']} ({times:.1f} times its standard deviation, "
            f"{_of_many(worst['p'], len(adequacy.sensors))})"
        )
    if last is not None:
        count = int((adequacy.modes["mode"] != "").sum())
        phrases.append(f"in the {last['kind']} of mode {last['mode']} ({_of_many(last['p'], count)})")
    return " and ".join(phrases)


def _of_many(p: float, count: int) -> str:
    """p-value of the worst one of several, in words (Bonferroni)."""
    return f"{p_words(min(1.0, float(p) * count))} as the worst of {count}"
