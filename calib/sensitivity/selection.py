"""Which parameters to select: Spearman, partial rank correlation and influence together, one reason a parameter."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from calib.errors import InputError
from calib.sensitivity.induced import Decomposition, decompose, input_correlation
from calib.sensitivity.influence import RELEVANT, Influence, influence, joint_influence
from calib.sensitivity.partial import centred_ranks, orthonormal, partial, partial_noise_floor, table_arrays
from calib.sensitivity.spearman import FEWEST_ROWS, noise_floor, spearman

_ROOM = 0.1
"""Part of a parameter's variance that is its own, below which it counts as bound (variance inflation 10)."""


@dataclass(frozen=True, eq=False)
class Assessment:
    """All measures of one sample.

    Attributes
    ----------
    spearman, partial : DataFrame (n_parameters, n_responses)
    influence : Influence
    spearman_floor, partial_floor : Series (n_responses,)
        What chance alone reaches in the whole table; by response, since some are known in fewer rows.
    input_correlation : DataFrame (n_parameters, n_parameters)
    decomposition : Decomposition
        What of each Spearman value is lent by partners.
    selection : DataFrame
        See `assess`.
    """

    spearman: pd.DataFrame
    partial: pd.DataFrame
    influence: Influence
    spearman_floor: pd.Series[float]
    partial_floor: pd.Series[float]
    input_correlation: pd.DataFrame
    decomposition: Decomposition
    selection: pd.DataFrame

    @property
    def sentence(self) -> str:
        """What the measures select, and where the study differs."""
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
    relevant: float = RELEVANT,
) -> Assessment:
    """Measure every parameter's effect on every response and select.

    A parameter is selected when its influence passes both the noise floor and ``relevant`` on some response; where the
    rows are too few to tell influence, its partial rank correlation decides. Spearman's value never does: under a
    constraint it may belong to a partner. Parameters bound so tightly (variance inflation above 10) that none of them
    has influence of its own are tried together, and selected together.

    Parameters
    ----------
    points : DataFrame (n, n_parameters)
    responses : DataFrame (n, n_responses)
        Row for row with ``points``; NaN where unknown.
    forced : sequence of str, optional
        Parameters that the study selects; they and only they are then ``selected``, whatever the measures say.
    level : float
        Of all noise floors.
    relevant : float
        Influence below which a certain effect is too small.

    Returns
    -------
    Assessment
        Its ``selection`` has one row a parameter: ``parameter``; ``max_spearman, spearman_response, spearman_floor``,
        the same for ``partial`` and ``influence`` (largest value with its sign, where, and the floor there; that of
        the influence is at least ``relevant``); ``measured`` (what the measures say), ``forced``, ``selected``, and
        ``why`` in words.

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
        influence=influence(points, responses, level),
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
        influence=measures.influence,
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
    return pd.Series({c: floor(max(int(n), FEWEST_ROWS), cells) for c, n in responses.notna().sum().items()})


@dataclass(frozen=True, eq=False)
class _Measures:
    spearman: pd.DataFrame
    spearman_floor: pd.Series[float]
    partial: pd.DataFrame
    partial_floor: pd.Series[float]
    influence: Influence
    relevant: float
    decomposition: Decomposition

    def limit(self, name: str) -> pd.Series[float]:
        """Influence that counts, by response."""
        return _row(self.influence.floor, name).clip(lower=self.relevant)

    def counts(self, name: str) -> pd.Series[bool]:
        """Responses, as bool, for whose sake a parameter is selected."""
        value = _row(self.influence.table, name)
        certain = _row(self.partial, name).abs() >= self.partial_floor
        return (value >= self.limit(name)) | (value.isna() & certain)

    def largest(self, name: str) -> dict[str, object]:
        """Largest value of each measure, where it is, and its floor there."""
        out: dict[str, object] = {}
        for measure, values, floors in (
            ("spearman", _row(self.spearman, name), self.spearman_floor),
            ("partial", _row(self.partial, name), self.partial_floor),
            ("influence", _row(self.influence.table, name), self.limit(name)),
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
        value, part = _row(self.influence.table, name), _row(self.partial, name)
        straight, curved = _row(self.influence.straight, name), _row(self.influence.curved, name)
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
        turned = (rank.abs() >= self.spearman_floor) & (part.abs() >= self.partial_floor) & (rank * part < 0)
        where = _peak(rank, turned, only=True)
        if where is not None:
            out.append(self._lent(name, where))
        return out

    def _nothing(self, name: str) -> str:
        value, part, rank = (_row(t, name) for t in (self.influence.table, self.partial, self.spearman))
        if rank.isna().all():
            return "no response is known often enough, or the parameter never changed"
        if part.isna().all() and value.isna().all():
            return "it follows from the other parameters and cannot be told from them"
        where = _peak(rank, rank.abs() >= self.spearman_floor, only=True)
        certain = (value >= _row(self.influence.floor, name)) & (value < self.relevant)
        small = _peak(value, certain, only=True)
        out = []
        if where is not None and not certain[where]:
            out.append(self._lent(name, where))
        if small is not None:
            out.append(f"moves {small}, but by only {100 * value[small] ** 2:.1f} % of its variance")
        doubtful = _peak(part, (part.abs() >= self.partial_floor) & ~certain, only=True)
        if not out and doubtful is not None:
            out.append(
                f"its partial rank correlation with {doubtful} ({_signed(part[doubtful])}) is not confirmed once "
                "curved effects of the others are taken out"
            )
        return "; ".join(out) or "nothing above the noise"

    def _lent(self, name: str, where: str) -> str:
        """A Spearman value that is not the parameter's own."""
        rank, lent = _row(self.spearman, name)[where], _row(self.decomposition.lent, name)[where]
        lender = str(self.decomposition.lender.at[name, where])
        words = f"its Spearman value on {where} ({_signed(rank)})"
        if lender and lent * rank > 0 and abs(lent) >= 0.5 * abs(rank):
            return f"{words} belongs to {lender}"
        return f"{words} is not confirmed by an influence of its own"


def _bound_groups(points: pd.DataFrame, responses: pd.DataFrame, measures: _Measures, level: float) -> dict[str, str]:
    """Reasons of parameters that only show influence together with those they are bound to."""
    x = centred_ranks(points.to_numpy(dtype=float))
    size = np.linalg.norm(x, axis=0)
    names = [str(c) for c in points.columns]
    bound = []
    for i in range(len(names)):
        others = orthonormal(np.delete(x, i, axis=1))
        rest = np.linalg.norm(x[:, i] - others @ (others.T @ x[:, i]))
        if size[i] > 0 and (rest / size[i]) ** 2 < _ROOM:
            bound.append(i)
    correlation = input_correlation(points).abs().to_numpy()
    pairs = max(1, len(correlation) * (len(correlation) - 1) // 2)
    floor = noise_floor(max(len(points), FEWEST_ROWS), pairs, level)
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
    joint = joint_influence(points, responses, groups, level)
    out: dict[str, str] = {}
    for group, row in zip(groups, joint.table.index, strict=True):
        value = _row(joint.table, row)
        where = _peak(value, value >= _row(joint.floor, row).clip(lower=measures.relevant), only=True)
        if where is None:
            continue
        for name in group:
            partners = " and ".join(n for n in group if n != name)
            out[name] = (
                f"moves {where} together with {partners} ({100 * value[where] ** 2:.0f} % of its variance), from which "
                "the constraint leaves it too little room to be told"
            )
    return out


def _row(table: pd.DataFrame, name: str) -> pd.Series[float]:
    """One parameter's value on every response."""
    return pd.Series(table.loc[name].to_numpy(dtype=float), index=table.columns)


def _peak(values: pd.Series[float], wanted: pd.Series[bool], only: bool = False) -> str | None:
    """Name of the entry of largest size among the wanted; when there is none, among all unless ``only`` those count."""
    size = values.abs()
    chosen = size[wanted.to_numpy(dtype=bool) & size.notna().to_numpy()]
    if chosen.empty and not only:
        chosen = size.dropna()
    return None if chosen.empty else str(chosen.idxmax())


def _signed(value: float) -> str:
    return f"{value:+.2f}".replace("-", "−")
