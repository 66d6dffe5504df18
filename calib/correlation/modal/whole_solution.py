"""A fitted model beside the whole measurement, of which it was fitted to a part."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.correlation.modal.comparison import Comparison
from calib.correlation.modal.problem import ModalProblem
from calib.correlation.modal.residual import ModalResidual
from calib.correlation.standard_deviations import Floors
from calib.errors.errors import InputError
from calib.structure.eigenproblem.derivatives import ModeDerivatives
from calib.structure.modes import Modes

_SAME = 1e-4
"""Relative difference up to which shapes of two solutions of one model are the same but for rounding."""


@dataclass(frozen=True, eq=False)
class WholeSolution:
    """A fitted model beside the whole measurement, with the derivatives of all its modes at all its sensors.

    Attributes
    ----------
    found : Comparison
        Used modes keep their partners from the used data.
    slopes : ModeDerivatives
        Of the modes that have a partner.
    """

    found: Comparison
    slopes: ModeDerivatives

    @staticmethod
    def of(
        fitted: ModalProblem, whole: ModalProblem, values: Mapping[str, float], names: Sequence[str],
        floors: Floors, pool: bool | None = None, solved: Modes | None = None,
    ) -> WholeSolution:  # fmt: skip
        """At fitted values; arguments and errors are those of `held_out_errors`."""
        used_data(fitted, whole)
        found = _joined(fitted, whole, values, solved)
        return WholeSolution(found, ModalResidual(whole, floors, pool).derivatives(found, names))

    def derivatives_of_used(self, residual: ModalResidual, used: Comparison) -> ModeDerivatives | None:
        """Derivatives of the used data and their comparison, as `ModalResidual.derivatives` gives them.

        Both comparisons have the same modes but for their signs. None where they have not: modes of nearly equal
        frequency are turned to what was measured, which differs.
        """
        columns = {int(j): k for k, j in enumerate(_partners(self.found))}
        partners = [int(j) for j in _partners(used)]
        signs = _signs(used.modes, self.found.modes, partners)
        if signs is None or not columns.keys() >= set(partners):
            return None
        sensors = [sensor.name for sensor in self.found.measured.sensors]
        rows = [sensors.index(s.name) for s in residual.problem.measured.sensors] if residual.n_fitted_factors else []
        found = self.slopes.of([columns[j] for j in partners], rows)
        return replace(found, shapes=found.shapes * signs)


def _partners(found: Comparison) -> np.ndarray:
    """Model modes of the measured modes that have one."""
    return found.pairing.model_index[found.pairing.paired]


def _signs(one: Modes, other: Modes, which: Sequence[int]) -> np.ndarray | None:
    """Signs by which shapes of two solutions differ, (len(which),); None where more than the sign differs."""
    turned = {j for group in (*one.groups, *other.groups) for j in group}
    if turned.intersection(which):
        return None
    shapes, others = one.shapes[:, which], other.shapes[:, which]
    signs = np.where(np.real(np.sum(shapes.conj() * others, axis=0)) < 0, -1.0, 1.0)
    differ = np.linalg.norm(signs * others - shapes, axis=0) > _SAME * np.linalg.norm(shapes, axis=0)
    return None if differ.any() else signs


def used_data(fitted: ModalProblem, whole: ModalProblem) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of used modes and sensors."""
    modes, sensors = fitted.measured.names, tuple(s.name for s in fitted.measured.sensors)
    foreign = [m for m in modes if m not in whole.measured.names]
    known = {s.name for s in whole.measured.sensors}
    foreign += [s for s in sensors if s not in known]
    if foreign:
        raise InputError(f"{', '.join(foreign)} is used but not part of the whole measurement", place="validation data")
    return modes, sensors


def _joined(fitted: ModalProblem, whole: ModalProblem, values: Mapping[str, float], solved: Modes | None) -> Comparison:
    """Comparison with the whole measurement, with used modes paired by the used data alone."""
    used = fitted.compare(values, solved)
    own = used.pairing
    partner = dict(zip(fitted.measured.names, own.model_index.tolist(), strict=True))
    lost = [mode for mode, j in partner.items() if j < 0]
    taken = {mode: j + 1 for mode, j in partner.items() if j >= 0}
    free = {m: k for m, k in whole.override.items() if m not in partner and k not in taken.values()}
    # An unpaired used mode must not take the partner of a held-out mode.
    joined = replace(
        whole,
        measured=whole.measured.without(modes=lost),
        mode_clusters={m: c for m, c in whole.mode_clusters.items() if m not in lost},
        mode_count=max(fitted.mode_count, whole.mode_count),
        override={**taken, **free},
    )
    found = joined.compare(values, used.modes)
    if not lost:
        return found
    place = [whole.measured.names.index(mode) for mode in found.measured.names]

    def widened(column: np.ndarray, fill: float) -> np.ndarray:
        out = np.full((whole.measured.n_modes, *column.shape[1:]), fill, dtype=column.dtype)
        out[place] = column
        return out

    pairing = found.pairing
    return replace(
        found,
        measured=whole.measured,
        pairing=replace(
            pairing,
            model_index=widened(pairing.model_index, -1),
            mac=widened(pairing.mac, np.nan),
            emac=widened(pairing.emac, np.nan),
            margin=widened(pairing.margin, np.nan),
        ),
        mac=widened(found.mac, np.nan),
        emac=widened(found.emac, np.nan),
    )
