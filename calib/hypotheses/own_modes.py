"""Modes of an added effect's own: the degrees of freedom that it adds hold most of their kinetic energy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from calib.correlation.modal.comparison import Comparison
from calib.hypotheses.rules import RULES
from calib.problem.effect import Effect
from calib.results.answer import hertz
from calib.structure.effects.extend import addition_of
from calib.structure.model import StructuralModel
from calib.study.loading import Model

COLUMNS = ("effect", "model_mode", "natural_freq", "share", "paired")


def own_modes(base: Model, effects: Sequence[Effect], found: Comparison) -> pd.DataFrame:
    """Modes of the extended model that are the effects' own.

    Parameters
    ----------
    base : StructuralModel, ModalFunctionModel or FunctionModel
        Without the effects.
    effects : sequence of Effect
        In the order in which the extended model has them, after all others.
    found : Comparison
        Of the extended model with all measured modes.

    Returns
    -------
    DataFrame
        ``effect, model_mode`` (number, from 1), ``natural_freq`` (Hz), ``share`` of the mode's kinetic energy in the
        degrees of freedom that the effect adds, and ``paired``: name of the measured mode, empty without one. Empty for
        models without matrices.
    """
    model, own, rows = found.model.reducible, base.reducible, []
    if own is None or model is None:
        return pd.DataFrame(columns=list(COLUMNS))
    paired = {int(found.pairing.model_index[i]): found.measured.names[i] for i in found.pairing.paired}
    for name, share in added_shares(own, effects, model, found.values, found.modes.shapes).items():
        rows += [
            (name, j + 1, float(found.modes.natural_freq[j]), float(share[j]), paired.get(j, ""))
            for j in np.flatnonzero(share > RULES.own_mode).tolist()
        ]
    return pd.DataFrame(rows, columns=list(COLUMNS))


def added_shares(
    base: StructuralModel,
    effects: Sequence[Effect],
    model: StructuralModel,
    values: Mapping[str, float],
    shapes: np.ndarray,
) -> dict[str, np.ndarray]:
    """Share of the kinetic energy of each mode in the degrees of freedom that each effect adds, (n_modes,), by name.

    Parameters
    ----------
    base : StructuralModel
        Without the effects.
    effects : sequence of Effect
        In the order in which the extended model has them, after all others.
    model : StructuralModel
        The extended model.
    values : mapping from str to float
    shapes : ndarray (n_dof, n_modes)
        Of the extended model.
    """
    energy = np.real(np.conj(shapes) * (model.matrices(values)[2] @ shapes))
    out, first = {}, base.n_dof
    for effect in effects:
        last = first + addition_of(base, effect).n_added
        out[effect.name] = energy[first:last].sum(axis=0) / energy.sum(axis=0)
        first = last
    return out


def own_modes_sentence(table: pd.DataFrame) -> str:
    """The own modes that no measured mode pairs with, in words, a sentence an effect; empty without any."""
    out = []
    for name, rows in table[table["paired"] == ""].groupby("effect", sort=False):
        one = len(rows) == 1
        shares = sorted({f"{100 * share:.0f}" for share in (rows["share"].min(), rows["share"].max())})
        out.append(
            f"{name} adds {'a mode' if one else f'{len(rows)} modes'} at "
            f"{hertz(*rows['natural_freq'])}: its motion relative to the "
            f"structure has {' to '.join(shares)} % of the kinetic energy there, and no measured mode pairs with "
            f"{'it' if one else 'them'}."
        )
    return " ".join(out)
