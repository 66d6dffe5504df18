"""Modes of an imported model beside those that its code has computed: only these prove an import."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pandas as pd

from calib.api.display import compared
from calib.api.entries.entry import count
from calib.correlation.modal.subspaces import close_groups
from calib.errors.errors import EvaluationError
from calib.experiment import ModalTest
from calib.measurement.modal import DIRECTIONS, MeasuredModes
from calib.structure.model import StructuralModel
from calib.structure.modes import Modes

FREQ_AGREES, MAC_AGREES = 1e-4, 0.9999
"""Within these an imported model has the modes that its code printed, with the digits that codes print."""
CLOSE = 1e-3
"""Relative distance of frequencies below which shapes are compared as the motions that they span together."""
_NODES = 100
"""Nodes at which shapes are compared with those of the code."""


def against(
    model: StructuralModel, own: MeasuredModes, modes: Modes, table: pd.DataFrame
) -> tuple[pd.DataFrame, tuple[str, ...], tuple[str, ...]]:
    """The table with the code's own modes, and whether the model has them."""
    known = {label: k for k, label in enumerate(model.labels)}
    moved = np.diff(model.dofs.expansion.indptr) > 0
    index = {s: 6 * known[s.node] + DIRECTIONS.index(s.direction) for s in own.sensors if s.node in known}
    seen = [s for s, k in index.items() if moved[k]]
    nodes = list(dict.fromkeys(s.node for s in seen))
    picked = set(nodes[:: len(nodes) // _NODES + 1])
    used = [k for k, s in enumerate(own.sensors) if s in index and moved[index[s]] and s.node in picked]
    first = slice(0, min(len(table), own.n_modes))
    sensors = tuple(replace(own.sensors[k], point=None) for k in used)
    cut = replace(
        own, names=own.names[first], natural_freq=own.natural_freq[first], damped_freq=own.damped_freq[first],
        freq_std=own.freq_std[first], damping_ratio=own.damping_ratio[first], damping_std=own.damping_std[first],
        sensors=sensors, shapes=own.shapes[used][:, first], shape_std=own.shape_std[used][:, first],
    )  # fmt: skip
    notes = tuple(own.notes)
    if not sensors:
        notes += (
            "The code's shapes have no node of the model, so that frequencies are compared in ascending order. Of "
            "CalculiX ask for OUTPUT=2D in the first step of the deck.",
        )
    from calib.api.problem import Problem

    try:
        found = compared(Problem(model, ModalTest(cut, mode_count=len(modes.natural_freq))), None).table
    except EvaluationError as fault:
        return table, notes, (f"The code's own modes could not be compared: {fault}.",)
    at = [index[own.sensors[k]] for k in used]
    paired = _paired(found, modes, cut, np.asarray(model.dofs.expansion[at] @ modes.shapes))
    out = table.join(paired[["code_freq", "mac"]], on="mode")
    out.insert(len(table.columns) + 1, "freq_error", out["freq"] / out["code_freq"] - 1)
    lost = len(cut.names) - int(out["code_freq"].notna().sum())
    remedy = "Do modes and matrices come from one model, with the same supports and loads?"
    if lost == len(cut.names):
        return table, notes, (f"None of the {len(cut.names)} modes of the code is one of the imported model. {remedy}",)
    worst, least = out["freq_error"].abs().max(), out["mac"].min()
    mac = f", and MAC is at least {least:.5f}" if np.isfinite(least) else ""
    words = f"Frequencies differ from those of the code by at most {worst:.1e}{mac}"
    if lost or worst > FREQ_AGREES or least < MAC_AGREES:
        more = f"; {count(lost, 'mode')} of the code without a partner" if lost else ""
        apart = np.abs(table["freq"].to_numpy()[:, None] / cut.natural_freq - 1).min(axis=0).max()
        if apart < FREQ_AGREES:
            words = f"Frequencies are those of the code within {apart:.1e}{mac}"
            remedy = (
                "So the matrices are right, and shapes differ at nodes: does the code print them in global directions? "
                "Where beams and shells became solids, a node may move otherwise than the mean of its layers."
            )
        return out, notes, (f"{words}{more}. {remedy}",)
    which = "modes" if np.isfinite(least) else "frequencies"
    return out, (*notes, f"{words}: the imported model has the code's own {which}."), ()


def _paired(found: pd.DataFrame, modes: Modes, code: MeasuredModes, shapes: np.ndarray) -> pd.DataFrame:
    """``code_freq`` (Hz) and ``mac`` by the number of the model mode; close modes in their order, as one motion.

    ``found`` has the pairs, ``shapes`` are those of the model at the code's sensors, (n_sensors, n_modes).
    """
    freq = np.asarray(modes.natural_freq)
    known = found.dropna(subset=["model_mode"])
    of = dict(zip(known["mode"], known["model_mode"], strict=True))
    rows: dict[int, tuple[float, float]] = {}
    for group in modes_together(freq):
        own = [i for i, name in enumerate(code.names) if of.get(name, 0) - 1 in group]
        for j, i in zip(group, own, strict=False):
            rows[j + 1] = float(code.natural_freq[i]), span_mac(code.shapes[:, i], shapes[:, list(group)])
    return pd.DataFrame.from_dict(rows, orient="index", columns=["code_freq", "mac"])


def modes_together(freq: np.ndarray) -> list[tuple[int, ...]]:
    """Groups of modes within `CLOSE` of each other, and each other mode alone; ``freq`` (n,) in Hz, ascending."""
    close = close_groups(freq, freq, np.full(len(freq), CLOSE / math.sqrt(2.0)), 1.0)
    return [*close, *((j,) for j in sorted({*range(len(freq))}.difference(*close)))]


def span_mac(shape: np.ndarray, others: np.ndarray) -> float:
    """MAC of a shape (n_sensors,) with the motions that others (n_sensors, n) span; NaN without sensors.

    Not corrected for their number, as `calib.correlation.modal.subspaces.subspace_mac` is: both are of one model.
    """
    if not len(shape):
        return float("nan")
    part = others @ np.linalg.lstsq(others, shape, rcond=None)[0]
    return float(np.vdot(part, part).real / np.vdot(shape, shape).real)
