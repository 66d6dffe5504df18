"""Measured shapes on the whole model, and their mass-orthogonality: among themselves and to the shapes of the model.

Cross-orthogonality ``|psi^T M_TAM phi|`` of a measured shape psi and a model shape phi at the sensors, both scaled to
unit modal mass, weighs every sensor by the mass that moves with it, where the MAC counts sensors alike. The usual
reading (NASA-STD-5002): at least `RULES.orthogonal_kept` for pairs, at most `RULES.orthogonal_leak` for all others,
also among the measured shapes.

Mass-orthogonality holds for undamped modes. So shapes are turned to the phase with the largest real part, which alone
is used: damping that is not proportional changes it in second order only.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import pandas as pd
import scipy.sparse as sp

from calib.correlation.modal.comparison import Comparison
from calib.correlation.rules import RULES
from calib.errors.errors import EvaluationError, InputError
from calib.measurement.mac import is_real, most_real
from calib.structure.expansion import Expansion, serep_expansion, static_expansion
from calib.structure.model import StructuralModel

By = Literal["static", "SEREP"]
WAYS: tuple[By, ...] = ("static", "SEREP")
"""Expansions; see `calib.structure.expansion`."""

_PLACE = "expansion of the measured shapes"


@dataclass(frozen=True, eq=False)
class ExpandedShapes:
    """Measured shapes at all degrees of freedom of a model.

    Attributes
    ----------
    comparison : Comparison
    by : {"static", "SEREP"}
    shapes : ndarray (n_dof, n_measured), complex
        In the scale and phase of the measured shapes; NaN for a mode that cannot be expanded.
    residual : ndarray (n_measured,)
        ``|y - S T y|/|y|`` over the sensors of each mode: the share that the model's shapes do not explain; about 0
        for the static expansion, which keeps the sensors' values.
    refused : mapping from str to str
        Modes that cannot be expanded, with the reason in one sentence.
    """

    comparison: Comparison
    by: By
    shapes: np.ndarray
    residual: np.ndarray
    refused: Mapping[str, str]

    def __repr__(self) -> str:
        return f"ExpandedShapes({self.shapes.shape[1]} modes at {self.shapes.shape[0]} degrees of freedom, {self.by})"

    def table(self) -> pd.DataFrame:
        """One row per mode and point of the mesh: real part of its motion, as in `Comparison.deflection_table`.

        Columns ``mode, point, u, v, w``; modes that cannot be expanded are omitted.
        """
        found, motion = self.comparison, ["u", "v", "w"]
        parts = [pd.DataFrame(columns=["mode", "point", *motion])]
        for i, name in enumerate(found.measured.names):
            if name not in self.refused:
                moved = np.real(found.model.displacement(self.shapes[:, [i]] * found.turns[i])[:, :, 0])
                part = pd.DataFrame(moved, columns=motion).rename_axis("point").reset_index()
                part.insert(0, "mode", name)
                parts.append(part)
        return pd.concat(parts[1:] or parts, ignore_index=True)


def deflections(found: Comparison, like: Comparison) -> pd.DataFrame:
    """`Comparison.deflection_table`, each mode with the sign that its shape has in a comparison with other sensors.

    The largest entry of a measured shape decides its sign, and may be at a sensor that one of the two lacks.
    """
    theirs = {sensor.name: k for k, sensor in enumerate(like.measured.sensors)}
    rows = [k for k, sensor in enumerate(found.measured.sensors) if sensor.name in theirs]
    same, signs = [theirs[found.measured.sensors[k].name] for k in rows], dict[str, float]()
    for i, name in enumerate(found.measured.names):
        if name in like.measured.names and rows:
            j = like.measured.names.index(name)
            own = found.measured.shapes[rows, i] * found.turns[i]
            there = like.measured.shapes[same, j] * like.turns[j]
            signs[name] = -1.0 if np.nansum(np.real(own * np.conj(there))) < 0 else 1.0
    table, motion = found.deflection_table(), ["u", "v", "w"]
    table[motion] = table[motion].mul(table["mode"].map(signs).astype(float).fillna(1.0), axis=0)
    return table


@dataclass(frozen=True, eq=False)
class Orthogonality:
    """Mass-orthogonality of measured shapes with the test-analysis mass matrix of a model.

    Attributes
    ----------
    names : tuple of str
        Measured modes, length n_measured.
    model_modes : ndarray (n_paired,), int
        Indices of the paired model modes, in the order of the measured ones.
    model_freq : ndarray (n_paired,)
        Their natural frequencies, Hz.
    pairs : ndarray (n_measured,), int
        Model mode of every measured mode; -1 where unpaired.
    by : {"static", "SEREP"}
        Expansion behind the mass matrix.
    cross : ndarray (n_measured, n_paired)
        Moduli, 0 to 1; NaN for a mode that cannot be expanded.
    own : ndarray (n_measured, n_measured)
        Likewise, of the measured shapes among themselves; 1 on the diagonal.
    imaginary : ndarray (n_measured,)
        Norm of the imaginary part, which is left out, over that of the shape.
    tam_error : ndarray (n_measured,)
        ``|phi - T S phi|/|phi|`` of the paired model mode in the norm of the mass matrix: how wrong the reduction to
        the sensors is in this mode, whatever was measured. NaN where unpaired.
    refused : mapping from str to str
        Modes that cannot be expanded, with the reason.
    instead : str
        Why the expansion is not the static one, where that was to be preferred.
    """

    names: tuple[str, ...]
    model_modes: np.ndarray
    model_freq: np.ndarray
    pairs: np.ndarray
    by: By
    cross: np.ndarray
    own: np.ndarray
    imaginary: np.ndarray
    tam_error: np.ndarray
    refused: Mapping[str, str]
    instead: str = ""

    def __repr__(self) -> str:
        return f"Orthogonality({self.cross.shape[0]} measured modes, {self.cross.shape[1]} model modes, {self.by})"

    def cross_table(self) -> pd.DataFrame:
        """Cross-orthogonality: columns ``mode, model_mode`` (the pair), and one for each paired model mode."""
        heads = [f"{j + 1} ({f:.2f} Hz)" for j, f in zip(self.model_modes, self.model_freq, strict=True)]
        table = pd.DataFrame(self.cross, columns=heads)
        table.insert(0, "mode", list(self.names))
        table.insert(1, "model_mode", pd.Series(self.pairs + 1, dtype="Int64").where(self.pairs >= 0))
        return table

    def self_table(self) -> pd.DataFrame:
        """Self-orthogonality: column ``mode`` and one for each measured mode."""
        table = pd.DataFrame(self.own, columns=list(self.names))
        table.insert(0, "mode", list(self.names))
        return table

    def modes_table(self, residual: np.ndarray) -> pd.DataFrame:
        """One row per measured mode: how far its expansion and the mass matrix can be trusted.

        Columns ``mode, residual, imaginary, reduction, tam_error, reason``; the residual is that of `ExpandedShapes`.
        """
        return pd.DataFrame(
            {
                "mode": list(self.names),
                "residual": residual,
                "imaginary": self.imaginary,
                "reduction": self.by,
                "tam_error": self.tam_error,
                "reason": [self.refused.get(name, self.instead) for name in self.names],
            }
        )

    @property
    def sentence(self) -> str:
        """How many entries pass the usual reading."""
        paired = self.pairs[:, None] == self.model_modes
        cross, own = np.round(self.cross, 2), np.round(self.own, 2)
        pairs, others = paired & np.isfinite(cross), ~paired & np.isfinite(cross)
        upper = np.triu(np.isfinite(own), 1)
        kept, leak = RULES.orthogonal_kept, RULES.orthogonal_leak
        words = (
            f"Cross-orthogonality ({self.by} reduction): {np.sum(cross[pairs] >= kept)} of {pairs.sum()} pairs "
            f"reach {kept}, and {np.sum(cross[others] > leak)} of {others.sum()} other entries exceed {leak}."
        )
        if not upper.any():
            return words
        i, j = np.unravel_index(np.argmax(np.where(upper, self.own, -1.0)), self.own.shape)
        return (
            f"{words} Among the measured shapes {np.sum(own[upper] > leak)} of {upper.sum()} entries exceed "
            f"{leak}; the largest is {self.own[i, j]:.2f} ({self.names[i]}, {self.names[j]})."
        )


def expanded_shapes(found: Comparison, by: By = "SEREP", modes: Sequence[int] = ()) -> ExpandedShapes:
    """Expand the measured shapes of a comparison to all degrees of freedom of its model.

    Parameters
    ----------
    found : Comparison
    by : {"static", "SEREP"}
    modes : sequence of int
        Model modes for SEREP, counted from 1; by default the paired ones. More modes fit the sensors better and follow
        their noise more. A shape that was identified as real is expanded by the real parts of the model's shapes, as
        in the MAC.

    Raises
    ------
    InputError
        When the model has no matrices, no shapes were measured, a mode is not among those solved, or no measured mode
        can be expanded.
    EvaluationError
        When none can since a part of the model moves without strain while the sensors are held.
    """
    basis = _Basis.of(found, by, modes)
    measured = found.measured.shapes
    shapes = np.full((found.modes.shapes.shape[0], measured.shape[1]), complex(np.nan, np.nan))
    residual = np.full(measured.shape[1], np.nan)
    refused: dict[str, str] = {}
    for columns, known, expansion in basis.groups(found, is_real(measured), refused):
        y = measured[np.ix_(known, columns)]
        shapes[:, columns], residual[columns] = expansion.expand(y), expansion.residual(y)
    return ExpandedShapes(found, by, shapes, residual, refused)


def orthogonality(found: Comparison, by: By | None = None) -> Orthogonality:
    """Cross- and self-orthogonality of the measured shapes of a comparison.

    Parameters
    ----------
    found : Comparison
    by : {"static", "SEREP"}, optional
        By default static, which does not take for granted the shapes that it is to check; SEREP with the paired modes
        where sensors repeat each other or a part without a sensor is free.

    Raises
    ------
    InputError, EvaluationError
        As `expanded_shapes`, and where no mode is paired.
    """
    if by is None:
        try:
            return orthogonality(found, "static")
        except (InputError, EvaluationError) as fault:
            return replace(orthogonality(found, "SEREP"), instead=str(fault))
    basis = _Basis.of(found, by, ())
    pairs = found.pairing.model_index
    chosen = pairs[pairs >= 0]
    if not len(chosen):
        raise InputError("no measured mode is paired", place=_PLACE, remedy="correct the pairing first")
    mass = basis.model.matrices(found.values)[2]
    phi = _real(found.modes.shapes[:, chosen])
    phi = phi / _norm(phi, mass)
    measured = found.measured.shapes
    real = _real(measured)
    n = measured.shape[1]
    shapes = np.full((len(phi), n), np.nan)
    cross, error = np.full((n, len(chosen)), np.nan), np.full(n, np.nan)
    refused: dict[str, str] = {}
    for columns, known, expansion in basis.groups(found, np.ones(n, dtype=bool), refused):
        x = expansion.expand(real[np.ix_(known, columns)])
        size = _norm(x, mass)
        shapes[:, columns] = x = x / np.where(size > 0, size, 1.0)
        reduced = expansion.expand(expansion.rows @ phi)
        cross[columns] = np.abs((mass @ x).T @ reduced) / _norm(reduced, mass)
        wrong = _norm(reduced - phi, mass)
        for i in columns:
            if pairs[i] >= 0:
                error[i] = wrong[np.flatnonzero(chosen == pairs[i])[0]]
    lost = [found.measured.names.index(name) for name in refused]
    whole = np.where(np.isnan(shapes), 0.0, shapes)
    own = np.abs(whole.T @ (mass @ whole))
    own[lost], own[:, lost] = np.nan, np.nan
    return Orthogonality(
        found.measured.names, chosen, found.modes.natural_freq[chosen], pairs, by, cross, own, _imaginary(measured),
        error, refused,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Basis:
    """What expands shapes at some of the sensors."""

    model: StructuralModel
    rows: np.ndarray
    build: Callable[[np.ndarray, bool], Expansion]

    @classmethod
    def of(cls, found: Comparison, by: By, modes: Sequence[int]) -> _Basis:
        model, measured = found.model, found.measured
        if by not in WAYS:
            raise InputError(f"the expansion is {by!r}", place=_PLACE, remedy=f"choose {' or '.join(WAYS)}")
        if not isinstance(model, StructuralModel):
            raise InputError(f"the model {model.name} has no matrices", place=_PLACE, remedy="give a StructuralModel")
        if not measured.has_shapes:
            raise InputError("no shapes were measured", place=_PLACE, remedy="compare frequencies alone")
        rows = model.sensor_rows(measured.sensors)
        names = [s.name for s in measured.sensors]
        if by == "static":
            stiffness, _, mass = model.matrices(found.values)
            return cls(
                model, rows,
                lambda known, _: static_expansion(stiffness, mass, rows[known], [names[k] for k in known]),
            )  # fmt: skip
        paired = found.pairing.model_index[found.pairing.paired]
        numbers = [j + 1 for j in sorted(paired.tolist())] if not len(modes) else list(modes)
        wrong = [j for j in numbers if not 1 <= j <= found.modes.n_modes]
        if wrong or len(set(numbers)) < len(numbers):
            raise InputError(
                f"the model modes are {numbers}", place=_PLACE,
                remedy=f"give different numbers from 1 to {found.modes.n_modes}",
            )  # fmt: skip
        shapes = found.modes.shapes[:, np.array(numbers, dtype=int) - 1]
        real = _real(shapes)
        return cls(model, rows, lambda known, as_real: serep_expansion(rows[known], real if as_real else shapes))

    def groups(
        self, found: Comparison, as_real: np.ndarray, refused: dict[str, str]
    ) -> Iterator[tuple[np.ndarray, np.ndarray, Expansion]]:
        """Measured modes with the same known sensors, these, and their expansion; adds to ``refused``.

        Raises what refuses every mode.
        """
        known = ~np.isnan(found.measured.shapes)
        keys = [(bool(real), column.tobytes()) for real, column in zip(as_real, known.T, strict=True)]
        fault: InputError | EvaluationError | None = None
        for key in dict.fromkeys(keys):
            columns = np.array([i for i, own in enumerate(keys) if own == key])
            sensors = np.flatnonzero(known[:, columns[0]])
            try:
                expansion = self.build(sensors, key[0])
            except (InputError, EvaluationError) as wrong:
                fault = wrong
                refused.update({found.measured.names[i]: str(wrong) for i in columns})
                continue
            yield columns, sensors, expansion
        if fault is not None and len(refused) == found.measured.n_modes:
            raise fault


def _real(shapes: np.ndarray) -> np.ndarray:
    """Real parts of columns in their most real phase; NaN stay NaN."""
    if not np.iscomplexobj(shapes):
        return shapes
    return np.column_stack([most_real(column).real for column in shapes.T])


def _imaginary(shapes: np.ndarray) -> np.ndarray:
    """Norm of the imaginary part in the most real phase over that of the column."""
    turned = np.column_stack([most_real(column) for column in shapes.T])
    size = np.sqrt(np.nansum(np.abs(turned) ** 2, axis=0))
    left = np.sqrt(np.nansum(turned.imag**2, axis=0))
    return np.divide(left, size, out=np.zeros_like(left), where=size > 0)


def _norm(shapes: np.ndarray, mass: sp.csc_array) -> np.ndarray:
    """Square root of the modal mass of real shapes."""
    return np.sqrt(np.maximum(np.einsum("ij,ij->j", shapes, mass @ shapes), 0.0))
