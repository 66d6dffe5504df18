"""Parameter selection from Spearman and partial rank correlation and variance share, with one reason per parameter."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from calib.errors.errors import InputError
from calib.results.answer import signed
from calib.results.table import read_table
from calib.sensitivity.induced import Decomposition, decompose, input_correlation
from calib.sensitivity.partial import orthonormal, partial, partial_noise_floor, table_arrays
from calib.sensitivity.rules import RULES
from calib.sensitivity.spearman import centred_ranks, noise_floor, spearman
from calib.sensitivity.variance_share import VarianceShare, joint_variance_share, variance_share


@dataclass(frozen=True, eq=False)
class Assessment:
    """All measures of one sample.

    Attributes
    ----------
    spearman, partial : DataFrame (n_parameters, n_responses)
    variance_share : VarianceShare
    spearman_floor, partial_floor : Series (n_responses,)
        Noise floor of the whole table; by response, since some are known in fewer rows.
    input_correlation : DataFrame (n_parameters, n_parameters)
    decomposition : Decomposition
        Own and induced part of each Spearman value.
    selection : DataFrame
        See `assess`.
    """

    spearman: pd.DataFrame
    partial: pd.DataFrame
    variance_share: VarianceShare
    spearman_floor: pd.Series[float]
    partial_floor: pd.Series[float]
    input_correlation: pd.DataFrame
    decomposition: Decomposition
    selection: pd.DataFrame

    @property
    def sentence(self) -> str:
        """What the measures select, and where the study's own selection differs."""
        table = self.selection
        named = {flag: table.loc[table[flag], "parameter"].tolist() for flag in ("measured", "selected")}
        out = f"The measures select {len(named['measured'])} of {len(table)} parameters"
        only = [n for n in named["measured"] if n not in named["selected"]]
        kept = [n for n in named["selected"] if n not in named["measured"]]
        if only:
            out += f"; the study leaves out {', '.join(only)}, which they would select"
        if kept:
            out += f"; the study keeps {', '.join(kept)}, which they would not"
        return out + "."


def assess(
    points: pd.DataFrame,
    responses: pd.DataFrame,
    forced: Sequence[str] | None = None,
    level: float = 0.95,
    relevant: float = RULES.relevant,
) -> Assessment:
    """Measure every parameter's effect on every response and select.

    A parameter is selected when its variance share exceeds both the noise floor and ``relevant`` on some response;
    with too few rows for a variance share, its partial rank correlation decides. Spearman's value never does: under a
    constraint it may be induced by a partner. Parameters so collinear (variance inflation factor above 10) that none
    has a variance share of its own are tested as a group, and selected together.

    Parameters
    ----------
    points : DataFrame (n, n_parameters)
    responses : DataFrame (n, n_responses)
        Row for row with ``points``; NaN where unknown.
    forced : sequence of str, optional
        Parameters that the study selects; exactly these are then ``selected``, whatever the measures say.
    level : float
        Confidence level of all noise floors.
    relevant : float
        Variance share below which a significant effect is too small.

    Returns
    -------
    Assessment
        Its ``selection`` has one row per parameter: ``parameter``; ``max_spearman, spearman_response, spearman_floor``,
        the same for ``partial`` and ``variance_share`` (largest value with its sign, where, and the floor there; that
        of the variance share is at least ``relevant``); ``measured`` (what the measures say), ``forced``, ``selected``,
        and ``why`` in words.

    Raises
    ------
    InputError
        When the tables do not belong together, or a forced name is no column of ``points``.
    """
    table_arrays(points, responses)
    unknown = [name for name in forced or () if name not in points.columns]
    if unknown:
        raise InputError(
            f"parameter {unknown[0]!r} is selected but was not sampled",
            place="selection",
            remedy=f"the sampled parameters are {', '.join(map(str, points.columns))}",
        )
    rank, part = spearman(points, responses), partial(points, responses)
    measures = _Measures(
        spearman=rank,
        spearman_floor=_floors(responses, rank, lambda n, m: noise_floor(n, m, level)),
        partial=part,
        partial_floor=_floors(responses, part, lambda n, m: partial_noise_floor(n, points.shape[1], m, level)),
        variance_share=variance_share(points, responses, level),
        relevant=relevant,
        decomposition=decompose(points, responses),
    )
    together = _bound_groups(points, responses, measures, level)
    rows = []
    for name in map(str, points.columns):
        own = measures.counts(name).any()
        measured = bool(own or name in together)
        keep = measured if forced is None else name in forced
        why = together.get(name) if not own else None
        rows.append(
            {
                "parameter": name,
                **measures.largest(name),
                "measured": measured,
                "forced": forced is not None and name in forced,
                "selected": keep,
                "why": _marked(why or measures.reason(name), measured, keep),
            }
        )
    return Assessment(
        spearman=rank,
        partial=part,
        variance_share=measures.variance_share,
        spearman_floor=measures.spearman_floor,
        partial_floor=measures.partial_floor,
        input_correlation=input_correlation(points),
        decomposition=measures.decomposition,
        selection=pd.DataFrame(rows),
    )


def _marked(why: str, measured: bool, selected: bool) -> str:
    if selected and not measured:
        return f"kept by the study: {why}"
    return f"left out by the study: {why}" if measured and not selected else why


def _floors(responses: pd.DataFrame, table: pd.DataFrame, floor: Callable[[int, int], float]) -> pd.Series[float]:
    """Noise floor of each response, from the rows in which it is known and all cells that have a value."""
    cells = max(int(table.notna().to_numpy().sum()), 1)
    return pd.Series({c: floor(max(int(n), RULES.rows_least), cells) for c, n in responses.notna().sum().items()})


@dataclass(frozen=True, eq=False)
class _Measures:
    spearman: pd.DataFrame
    spearman_floor: pd.Series[float]
    partial: pd.DataFrame
    partial_floor: pd.Series[float]
    variance_share: VarianceShare
    relevant: float
    decomposition: Decomposition

    def limit(self, name: str) -> pd.Series[float]:
        """Smallest variance share that counts, by response."""
        return _row(self.variance_share.floor, name).clip(lower=self.relevant)

    def counts(self, name: str) -> pd.Series[bool]:
        """Responses (bool) for which a parameter is selected."""
        value = _row(self.variance_share.table, name)
        significant = _row(self.partial, name).abs() >= self.partial_floor
        return (value >= self.limit(name)) | (value.isna() & significant)

    def largest(self, name: str) -> dict[str, object]:
        """Largest value of each measure, its response, and the floor there."""
        out: dict[str, object] = {}
        for measure, values, floors in (
            ("spearman", _row(self.spearman, name), self.spearman_floor),
            ("partial", _row(self.partial, name), self.partial_floor),
            ("variance_share", _row(self.variance_share.table, name), self.limit(name)),
        ):
            where = _peak(values, values.abs() >= floors)
            out[f"max_{measure}"] = np.nan if where is None else float(values[where])
            out[f"{measure}_response"] = "" if where is None else where
            out[f"{measure}_floor"] = float(floors.median() if where is None else floors[where])
        return out

    def reason(self, name: str) -> str:
        """Why a parameter is or is not selected."""
        counts = self.counts(name)
        return "; ".join(self._effects(name, counts)) if counts.any() else self._nothing(name)

    def _effects(self, name: str, counts: pd.Series[bool]) -> list[str]:
        value, part = _row(self.variance_share.table, name), _row(self.partial, name)
        straight, curved = _row(self.variance_share.straight, name), _row(self.variance_share.curved, name)
        monotone = (part.abs() >= self.partial_floor) & ~(straight < 0.5)
        out = []
        where = _peak(value.fillna(part.abs()), counts & monotone, only=True)
        if where is not None:
            out.append(f"moves {where} (partial rank correlation {_signed(part[where])})")
        where = _peak(value, counts & ~monotone, only=True)
        if where is not None and not (out and value[where] < 0.5 * value.max()):
            share = f"({100 * value[where] ** 2:.0f} % of its variance)"
            if curved[where] >= 0.5:
                out.append(f"acts evenly on {where} {share}")
            elif straight[where] + curved[where] < 0.5:
                out.append(f"acts on {where} together with other parameters {share}")
            else:
                out.append(f"acts on {where} {share}")
        rank = _row(self.spearman, name)
        reversed_sign = (rank.abs() >= self.spearman_floor) & (part.abs() >= self.partial_floor) & (rank * part < 0)
        where = _peak(rank, reversed_sign, only=True)
        if where is not None:
            out.append(self._induced(name, where))
        return out

    def _nothing(self, name: str) -> str:
        value, part, rank = (_row(t, name) for t in (self.variance_share.table, self.partial, self.spearman))
        if rank.isna().all():
            return "no response is known often enough, or the parameter never changed"
        if part.isna().all() and value.isna().all():
            return "it follows from the other parameters and is confounded with them"
        where = _peak(rank, rank.abs() >= self.spearman_floor, only=True)
        irrelevant = (value >= _row(self.variance_share.floor, name)) & (value < self.relevant)
        small = _peak(value, irrelevant, only=True)
        out = []
        if where is not None and not irrelevant[where]:
            out.append(self._induced(name, where))
        if small is not None:
            out.append(f"moves {small}, but by only {100 * value[small] ** 2:.1f} % of its variance")
        doubtful = _peak(part, (part.abs() >= self.partial_floor) & ~irrelevant, only=True)
        if not out and doubtful is not None:
            out.append(
                f"its partial rank correlation with {doubtful} ({_signed(part[doubtful])}) is not confirmed once "
                "nonlinear effects of the others are regressed out"
            )
        return "; ".join(out) or "nothing above the noise"

    def _induced(self, name: str, where: str) -> str:
        """Sentence on a Spearman value that is not the parameter's own."""
        rank, induced = _row(self.spearman, name)[where], _row(self.decomposition.induced, name)[where]
        partner = str(self.decomposition.partner.at[name, where])
        words = f"its Spearman value on {where} ({_signed(rank)})"
        if partner and induced * rank > 0 and abs(induced) >= 0.5 * abs(rank):
            return f"{words} is induced by {partner}"
        return f"{words} is not confirmed by a variance share of its own"


def _bound_groups(points: pd.DataFrame, responses: pd.DataFrame, measures: _Measures, level: float) -> dict[str, str]:
    """Reasons of parameters that have a variance share only together with those they are collinear with."""
    x = centred_ranks(points.to_numpy(dtype=float))
    size = np.linalg.norm(x, axis=0)
    names = [str(c) for c in points.columns]
    bound = []
    for i in range(len(names)):
        others = orthonormal(np.delete(x, i, axis=1))
        rest = np.linalg.norm(x[:, i] - others @ (others.T @ x[:, i]))
        if size[i] > 0 and (rest / size[i]) ** 2 < RULES.bound:
            bound.append(i)
    correlation = input_correlation(points).abs().to_numpy()
    pairs = max(1, len(correlation) * (len(correlation) - 1) // 2)
    floor = noise_floor(max(len(points), RULES.rows_least), pairs, level)
    groups: list[tuple[str, ...]] = []
    left = list(bound)
    while left:
        near = [left.pop(0)]
        for member in near:
            near += [k for k in left if correlation[member, k] > floor]
            left = [k for k in left if k not in near]
        group = tuple(names[k] for k in near)
        if len(group) > 1 and not any(measures.counts(n).any() for n in group):
            groups.append(group)
    if not groups:
        return {}
    joint = joint_variance_share(points, responses, groups, level)
    out: dict[str, str] = {}
    for group, row in zip(groups, joint.table.index, strict=True):
        value = _row(joint.table, row)
        where = _peak(value, value >= _row(joint.floor, row).clip(lower=measures.relevant), only=True)
        if where is None:
            continue
        for name in group:
            partners = " and ".join(n for n in group if n != name)
            out[name] = (
                f"moves {where} together with {partners} ({100 * value[where] ** 2:.0f} % of its variance); the "
                "constraint makes them collinear"
            )
    return out


def _row(table: pd.DataFrame, name: str) -> pd.Series[float]:
    """One parameter's value on every response."""
    return pd.Series(table.loc[name].to_numpy(dtype=float), index=table.columns)


def _peak(values: pd.Series[float], wanted: pd.Series[bool], only: bool = False) -> str | None:
    """Name of the largest entry (absolute) among the wanted; without any, among all entries, or None if ``only``."""
    size = values.abs()
    chosen = size[wanted.to_numpy(dtype=bool) & size.notna().to_numpy()]
    if chosen.empty and not only:
        chosen = size.dropna()
    return None if chosen.empty else str(chosen.idxmax())


def _signed(value: float) -> str:
    return signed(value, 2).replace("-", "−")


def selected_in(path: Path) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Parameters that a ``selection.csv`` selects, and all that it assesses; InputError for an ambiguous table."""
    table = read_table(path, ["parameter"], flags=["selected"], complete=["selected"], unique="parameter")
    return tuple(table["parameter"][table["selected"].astype(bool)]), tuple(table["parameter"])
