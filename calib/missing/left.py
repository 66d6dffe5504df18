"""What is left after something like an effect is in the model: near that effect, or elsewhere."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from calib.missing.explanation import Explanation
from calib.missing.partial import is_nearly
from calib.missing.rules import RULES


@dataclass(frozen=True)
class Left:
    """Where the rest of a misfit sits.

    Attributes
    ----------
    distance : float
        Root mean square distance from the effect of the local perturbations that would lower what is left, weighted by
        the decrease of the sum of squares beyond noise, over that of all of them; NaN without places, or where none
        would. 1 is anywhere.
    modes : float
        Share of what is left beyond noise in the modes that the effect changes; NaN without modes, or where nothing is.
    expected : float
        The same share if what is left were the same for every row.
    """

    distance: float
    modes: float
    expected: float

    @property
    def near(self) -> bool | None:
        """Whether it sits near the effect, or without places in its modes; None where neither can be told."""
        if not math.isnan(self.distance):
            return self.distance < RULES.left_near
        return None if math.isnan(self.modes) else self.modes > max(RULES.left_most, self.expected)

    @property
    def told(self) -> str:
        """In words; empty where nothing can be told."""
        parts = []
        if not math.isnan(self.distance):
            parts.append(
                f"local perturbations that would lower it lie at {self.distance:.2g} times the distance of all"
            )
        if not math.isnan(self.modes):
            parts.append(
                f"the modes that the effect changes most hold {100 * self.modes:.0f} % of it "
                f"({100 * self.expected:.0f} % if it were spread evenly)"
            )
        if self.near is None:
            return ""
        return f"What is left sits {'near it' if self.near else 'elsewhere'}: {'; '.join(parts)}."

    @property
    def plain(self) -> dict[str, object]:
        """As stored in ``explanation.json``."""
        numbers = {"distance": self.distance, "modes": self.modes, "modes_expected": self.expected}
        return {"near": self.near} | {name: None if math.isnan(x) else x for name, x in numbers.items()}


def left_of(
    found: Explanation,
    places: Mapping[str, tuple[str, tuple[float, float, float], str]],
    acting: Sequence[tuple[float, float, float]],
    modes: Sequence[str],
) -> Left | None:
    """Where the rest of a misfit sits that something like an effect nearly explains; None for any other verdict.

    Parameters
    ----------
    found : Explanation
    places : mapping from str to (kind, (x, y, z), sensor)
        Of every local perturbation, by name; m.
    acting : sequence of (x, y, z)
        Where the effect acts, m; empty where that is unknown.
    modes : sequence of str
        Mode of every row of the data; empty for rows without one.
    """
    if not is_nearly(found):
        return None
    return Left(_distance(found, places, np.array(acting, dtype=float).reshape(-1, 3)), *_modes(found, modes))


def _distance(
    found: Explanation, places: Mapping[str, tuple[str, tuple[float, float, float], str]], acting: np.ndarray
) -> float:
    assert found.chosen_adequacy is not None
    scores = found.chosen_adequacy.perturbations
    points = np.array([places[name][1] if name in places else (np.nan,) * 3 for name in scores.owners], dtype=float)
    points = points.reshape(-1, 3)
    known = np.isfinite(points).all(axis=1)
    if not len(acting) or not known.any():
        return math.nan
    square = ((points[known][:, None] - acting[None]) ** 2).sum(axis=2).min(axis=1)
    weight = np.maximum(scores.magnitude[known].clip(0.0) ** 2 - RULES.left_noise**2, 0.0)
    if not weight.any() or not square.any():
        return math.nan
    return float(np.sqrt(weight @ square / weight.sum() / square.mean()))


def _modes(found: Explanation, modes: Sequence[str]) -> tuple[float, float]:
    assert found.chosen is not None
    (name,) = found.chosen.names
    base, rest = found.base.fit, found.chosen.fit.residual
    column = found.base_adequacy.named.unit[: len(rest), found.base_adequacy.named.best(name)]
    assert len(base.residual) == len(rest)
    table = pd.DataFrame({"mode": modes, "own": column**2, "left": rest**2, "rows": 1.0})
    table = table[table["mode"] != ""].groupby("mode", sort=False).sum()
    beyond = (table["left"] - table["rows"]).clip(lower=0.0)
    if len(table) < 2 or not beyond.sum() > 0 or not table["own"].sum() > 0:
        return math.nan, math.nan
    order = table["own"].sort_values(ascending=False, kind="stable")
    count = int(np.searchsorted(order.cumsum().to_numpy(), RULES.left_changed * order.sum())) + 1
    own = list(order.index[:count])
    return float(beyond[own].sum() / beyond.sum()), float(table.loc[own, "rows"].sum() / table["rows"].sum())
