"""Comparison of model and measurement at one point: frequencies, MAC, CoMAC, shapes, ranked deviations."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from calib.correlation.modal.pairing import Pairing
from calib.correlation.rules import RULES
from calib.correlation.standard_deviations import StandardDeviations, dof_behind, known_std
from calib.measurement.mac import align, comac, is_real, most_real, noise_mac, relative_motion
from calib.measurement.modal import MeasuredModes
from calib.structure.modal_model import ModalModel
from calib.structure.modes import Modes

if TYPE_CHECKING:
    import pandas as pd

_MOTION = ["u", "v", "w"]
UNTESTED = "No standard deviation is stated, so deviations are not tested."

_Row = tuple[str, str, float, float, float, str]

BEYOND = "beyond measurement uncertainty"
WITHIN = "within measurement uncertainty"
UNKNOWN = "standard deviation unknown"
UNPAIRED = "not paired"


@dataclass(frozen=True, eq=False)
class Comparison:
    """Modes of a model, paired with measured modes.

    Attributes
    ----------
    model : ModalModel
    measured : MeasuredModes
    values : mapping from str to float
        Parameter values of the model, each in its own unit.
    modes : Modes
        All model modes that were solved.
    pairing : Pairing
    mac, emac : ndarray (n_measured, n_model)
        NaN without measured shapes.
    sensor_shapes : ndarray (n_sensors, n_model)
        Motion of every model mode at the sensors.
    faults : mapping from str to float
        Faults of the measurement that a residual includes, with their magnitudes; the comparison itself has none.
    mesh_error : float
        Multiple of the change to a finer mesh that a residual includes; the comparison itself has none.
    """

    model: ModalModel
    measured: MeasuredModes
    values: Mapping[str, float]
    modes: Modes
    pairing: Pairing
    mac: np.ndarray
    emac: np.ndarray
    sensor_shapes: np.ndarray
    faults: Mapping[str, float] = field(default_factory=dict)
    mesh_error: float = 0.0

    @cached_property
    def std(self) -> StandardDeviations:
        """Standard deviations that scale all deviations here, those of the residual; NaN where unknown."""
        return known_std(self.measured)

    # -- arrays over the measured modes ------------------------------------------------------------------------------

    def paired(self, column: np.ndarray) -> np.ndarray:
        """A quantity of the model modes (n_model,) by measured mode (n_measured,), NaN where unpaired."""
        index = self.pairing.model_index
        return np.where(index >= 0, np.asarray(column)[index], np.nan)

    @property
    def freq_error(self) -> np.ndarray:
        """(model - measured)/measured natural frequency, (n_measured,), a signed fraction; NaN where unpaired."""
        return self.paired(self.modes.natural_freq) / self.measured.natural_freq - 1.0

    @property
    def far(self) -> tuple[str, ...]:
        """Measured modes with a large frequency error (`RULES.far_error`): wrong pairs or units, or a poor model."""
        return tuple(self._names(np.flatnonzero(np.abs(np.nan_to_num(self.freq_error)) > RULES.far_error)))

    @property
    def lost(self) -> tuple[str, ...]:
        """Measured modes without shapes whose tracked model mode has left the solved modes."""
        return tuple(self.measured.names[i] for i in self.pairing.lost)

    @property
    def crossings(self) -> tuple[tuple[str, str], ...]:
        """Paired measured modes adjacent in ascending frequency whose model modes are in reverse order."""
        names, index = self.measured.names, self.pairing.model_index
        return tuple((names[i], names[k]) for i, k in pairwise(self._ascending()) if index[i] > index[k])

    @property
    def shifts(self) -> tuple[tuple[int, str, int], ...]:
        """Changes in the offset between model and measured mode numbers, both counted from 1 in ascending order.

        Number and name of the measured mode and number of its model mode, for the first pair with each new offset.
        """
        freq, index = self.measured.natural_freq, self.pairing.model_index
        rank = {int(i): k for k, i in enumerate(np.argsort(freq, kind="stable"), start=1)}
        out, before = [], 0
        for i in self._ascending():
            number = int(index[i]) + 1
            if number - rank[i] != before:
                out.append((rank[i], self.measured.names[i], number))
                before = number - rank[i]
        return tuple(out)

    def _ascending(self) -> list[int]:
        """Paired measured modes in ascending frequency."""
        paired = self.pairing.paired
        return paired[np.argsort(self.measured.natural_freq[paired], kind="stable")].tolist()

    @property
    def factors(self) -> np.ndarray:
        """Complex factor that scales each paired model shape to the measured one, (n_measured,); NaN where unpaired.

        Least squares over the measured sensors; without shapes, the largest translation of the model becomes 1.
        """
        out = np.full(self.measured.n_modes, complex(np.nan, np.nan))
        for i in self.pairing.paired:
            j = self.pairing.model_index[i]
            if self.measured.has_shapes and np.any(np.isfinite(self.measured.shapes[:, i])):
                out[i] = align(self.measured.shapes[:, i], self.sensor_shapes[:, j])
            else:
                motion = self.model.displacement(self.modes.shapes[:, [j]]).ravel()
                out[i] = align(np.ones(1), motion[[np.argmax(np.abs(motion))]])
        return out

    @cached_property
    def turns(self) -> np.ndarray:
        """Factors of modulus 1 that turn every measured shape to its most real phase, (n_measured,); 1 without shapes.

        What is drawn is the real part: in another phase it would be little but noise. The largest entry is positive.
        """
        out = np.ones(self.measured.n_modes, dtype=complex)
        for i, shape in enumerate(self.measured.shapes.T if self.measured.has_shapes else ()):
            if np.nanmax(np.abs(shape), initial=0.0) > 0:
                k = int(np.nanargmax(np.abs(shape)))
                turned = most_real(shape)[k]
                out[i] = np.sign(turned.real or 1.0) * turned / shape[k]
        return out

    @property
    def aligned_shapes(self) -> np.ndarray:
        """Model shapes at the sensors, scaled and phase-aligned to the measured ones, (n_sensors, n_measured)."""
        out = np.full(self.measured.shapes.shape, complex(np.nan, np.nan))
        pairs, factors = self.pairing.paired, self.factors
        out[:, pairs] = self.sensor_shapes[:, self.pairing.model_index[pairs]] * factors[pairs]
        return out

    def noise_mac(self) -> np.ndarray:
        """Expected MAC of a correctly specified model given the noise, (n_measured,); NaN where unknown."""
        return noise_mac(self.measured.shapes, self.std.shape)

    # -- tables ------------------------------------------------------------------------------------------------------

    def comparison_table(self) -> pd.DataFrame:
        """One row per measured mode: frequencies in Hz, damping ratios, MAC and EMAC; NaN where unpaired or undamped.

        ``model_mode`` is the number of the paired model mode, from 1, missing where there is none; ``freq_error`` is
        (natural model - natural measured)/natural measured, a signed fraction.
        """
        import pandas as pd

        nothing = np.full(self.modes.n_modes, np.nan)  # an undamped model says nothing of damping
        return pd.DataFrame(
            {
                "mode": list(self.measured.names),
                "model_mode": pd.array(self.pairing.model_index + 1, dtype="Int64"),
                "natural_freq_measured": self.measured.natural_freq,
                "natural_freq_model": self.paired(self.modes.natural_freq),
                "damped_freq_measured": self.measured.damped_freq,
                "damped_freq_model": self.paired(self.modes.damped_freq),
                "freq_error": self.freq_error,
                "damping_ratio_measured": self.measured.damping_ratio,
                "damping_ratio_model": self.paired(self.modes.damping_ratio if self.model.dissipates else nothing),
                "mac": self.pairing.mac,
                "emac": self.pairing.emac,
                "margin": self.pairing.margin,
            }
        ).assign(model_mode=lambda table: table["model_mode"].where(self.pairing.model_index >= 0))

    def mac_table(self) -> pd.DataFrame:
        """MAC of every measured mode (rows, named in column ``mode``) with every model mode, as ``1 (10.83 Hz)``."""
        import pandas as pd

        columns = [f"{j} ({freq:.2f} Hz)" for j, freq in enumerate(self.modes.natural_freq, start=1)]
        table = pd.DataFrame(self.mac, columns=columns)
        table.insert(0, "mode", list(self.measured.names))
        return table

    def comac_table(self) -> pd.DataFrame:
        """CoMAC of every sensor over the paired modes, worst first, with its coordinates in metres.

        ``motion`` tells how much the sensor moves: its measured amplitude over the largest one of the mode, rms over
        the paired modes. Noise alone makes the CoMAC of a sensor low that hardly moves.
        """
        pairs = self.pairing.paired
        shapes = self.measured.shapes[:, pairs]
        value = comac(shapes, self.sensor_shapes[:, self.pairing.model_index[pairs]])
        table = self._sensor_columns().assign(comac=value, motion=relative_motion(shapes))
        return table.sort_values("comac", kind="stable", ignore_index=True)

    def shapes_table(self) -> pd.DataFrame:
        """One row per mode and sensor: measured shape in its most real phase, and the model's, aligned to it."""
        import pandas as pd

        measured, aligned = self.measured.shapes * self.turns, self.aligned_shapes * self.turns
        sensors = self._sensor_columns()
        parts = []
        for i, name in enumerate(self.measured.names):
            part = sensors.assign(
                measured_re=measured[:, i].real,
                measured_im=measured[:, i].imag,
                model_re=aligned[:, i].real,
                model_im=aligned[:, i].imag,
            )
            part.insert(0, "mode", name)
            parts.append(part)
        return pd.concat(parts, ignore_index=True)

    def deflection_table(self, mode: str = "") -> pd.DataFrame:
        """One row per paired mode, or for one alone, and point of the mesh: its motion over the measured shape.

        ``u, v, w`` are the real part of the paired model shape in the scale and phase of `shapes_table`; ``point`` is
        its number in the mesh, from 0.
        """
        import pandas as pd

        factors, parts = self.factors * self.turns, [pd.DataFrame(columns=["mode", "point", *_MOTION])]
        for i in self.pairing.paired:
            if mode and self.measured.names[i] != mode:
                continue
            shape = self.modes.shapes[:, [self.pairing.model_index[i]]]
            motion = np.real(self.model.displacement(shape)[:, :, 0] * factors[i])
            part = pd.DataFrame(motion, columns=_MOTION).rename_axis("point").reset_index()
            part.insert(0, "mode", self.measured.names[i])
            parts.append(part)
        return pd.concat(parts[1:] or parts, ignore_index=True)

    def _sensor_columns(self) -> pd.DataFrame:
        import pandas as pd

        sensors = self.measured.sensors
        place = np.array([s.point or (np.nan,) * 3 for s in sensors], dtype=float).reshape(-1, 3)
        return pd.DataFrame(
            {
                "sensor": [s.name for s in sensors],
                "node": [s.node for s in sensors],
                "direction": [s.direction for s in sensors],
                **dict(zip("xyz", place.T, strict=True)),
            }
        )

    # -- where it fails ----------------------------------------------------------------------------------------------

    def where_it_fails(self) -> pd.DataFrame:
        """Every comparison in standard deviations, worst first.

        The standard deviations are those of the residual of a fit, see `calib.correlation.standard_deviations.std_for`:
        of the mean over the repeats, pooled where they are few, with systematic errors added.

        Columns ``kind, what, value, in_std, limit, verdict``. Unpaired modes come first, comparisons of unknown
        standard deviation last. ``value`` and ``in_std`` for each kind:

        - frequency: signed frequency error; ``|ln(model/measured)|`` over the relative standard deviation.
        - damping: ``ln(model/measured)`` of the damping ratio; its absolute value over the relative standard deviation.
          Omitted for an undamped model.
        - shape: MAC; square root of 1 - MAC over its expectation from the noise.
        - sensor: CoMAC; root mean square over the paired modes of the residual after alignment, over its own standard
        deviation.

        A correctly specified model gives about 1 everywhere. The verdict compares ``in_std`` with ``limit``, its 95 %
        quantile (square root of an F variate with the degrees of freedom of the comparison and of the repeats behind
        its standard deviation), so about one comparison in twenty exceeds it by chance.
        """
        import pandas as pd

        rows = self._unpaired_rows() + self._frequency_rows() + self._damping_rows()
        if self.measured.has_shapes:
            rows += self._shape_rows() + self._sensor_rows()
        table = pd.DataFrame(rows, columns=["kind", "what", "value", "in_std", "limit", "verdict"])
        rank = np.where(table["verdict"] == UNPAIRED, np.inf, table["in_std"])
        order = np.lexsort((np.arange(len(table)), table["verdict"] != UNPAIRED, -rank))
        return table.iloc[order].reset_index(drop=True)

    def sentence(self) -> str:
        """Summary of `where_it_fails` in words."""
        return " ".join(self.summary())

    def summary(self) -> tuple[str, str]:
        """How well the model agrees with the measurement, and whether the deviations exceed its uncertainty."""
        table = self.where_it_fails()
        lost = table.loc[table["verdict"] == UNPAIRED, "what"].tolist()
        n = self.measured.n_modes
        words = [f"{n - len(lost)} of {n} measured modes are paired" + (f"; not {', '.join(lost)}." if lost else ".")]
        if len(lost) < n:
            words.append(f"The mean absolute frequency error is {100 * np.nanmean(np.abs(self.freq_error)):.2f} %.")
        allowed, found = self.noise_mac(), self.pairing.mac
        both = np.isfinite(allowed) & np.isfinite(found)
        if both.any():
            mean, limit = found[both].mean(), allowed[both].mean()
            words.append(f"The mean MAC is {mean:.3f}; noise alone limits it to {limit:.3f}.")
        tested = table[table["verdict"].isin([BEYOND, WITHIN])]
        if tested.empty:
            why = "No mode is paired, so deviations are not tested." if len(lost) == n else UNTESTED
            return " ".join(words), why
        count = int((tested["verdict"] == BEYOND).sum())
        beyond = f"{count} of {len(tested)} comparisons exceed their measurement uncertainty"
        by_chance = f"{(1 - RULES.level) * len(tested):.1f} are expected by chance"
        worst = tested.iloc[0]
        size = f"{worst['in_std']:.1f} times its standard deviation"
        return " ".join(words), f"{beyond}; {by_chance}. The worst is the {worst['kind']} of {worst['what']}, {size}."

    def _limit(self, kind: str, dof: np.ndarray | float) -> np.ndarray:
        """Quantile `RULES.level` of ``in_std`` for a correctly specified model."""
        from scipy import special

        dof = np.maximum(dof, 1e-9)
        behind = dof_behind(self.measured, "shape" if kind == "sensor" else kind, dof)
        return np.sqrt(special.fdtri(dof, np.minimum(behind, 1e9), RULES.level))

    def _rows(
        self, kind: str, what: list[str], value: np.ndarray, in_std: np.ndarray, dof: np.ndarray | float = 1.0
    ) -> list[_Row]:
        limit = np.broadcast_to(self._limit(kind, dof), in_std.shape)
        verdicts = np.where(np.isnan(in_std), UNKNOWN, np.where(in_std > limit, BEYOND, WITHIN))
        rows = zip(what, value, in_std, limit, verdicts, strict=True)
        return [(kind, w, float(v), float(s), float(most), str(t)) for w, v, s, most, t in rows]

    def _names(self, which: np.ndarray) -> list[str]:
        return [self.measured.names[i] for i in which]

    def _unpaired_rows(self) -> list[_Row]:
        kind = "shape" if self.measured.has_shapes else "frequency"
        names = self._names(self.pairing.unpaired_measured)
        return [(kind, name, math.nan, math.nan, math.nan, UNPAIRED) for name in names]

    def _frequency_rows(self) -> list[_Row]:
        i = self.pairing.paired
        error = self.freq_error[i]
        size = np.abs(np.log1p(error))
        return self._rows("frequency", self._names(i), error, _over(size, self.std.freq[i]))

    def _damping_rows(self) -> list[_Row]:
        i = self.pairing.paired
        i = i[self.measured.damping_ratio[i] > 0]  # NaN is unknown, 0 marks an undamped file
        if not len(i) or not np.any(self.modes.damping_ratio):
            return []
        measured, model = self.measured.damping_ratio[i], self.paired(self.modes.damping_ratio)[i]
        error = np.log(np.maximum(model, 0.0) / measured, out=np.full(len(i), -np.inf), where=model > 0)
        return self._rows("damping", self._names(i), error, _over(np.abs(error), self.std.damping[i]))

    def _shape_rows(self) -> list[_Row]:
        i = self.pairing.paired
        shapes, std = self.measured.shapes[:, i], self.std.shape[:, i]
        variance = np.where(np.isnan(shapes), 0.0, std**2)
        with np.errstate(invalid="ignore", divide="ignore"):
            # Effective number of sensors, weighted by noise variance.
            effective = np.sum(variance, axis=0) ** 2 / np.sum(variance**2, axis=0)
        dof = np.where(is_real(shapes), 1.0, 2.0) * (effective - 1.0)
        found = np.sqrt(_over(1.0 - self.pairing.mac[i], 1.0 - self.noise_mac()[i]))
        return self._rows("shape", self._names(i), self.pairing.mac[i], found, np.nan_to_num(dof, nan=1.0))

    def _sensor_rows(self) -> list[_Row]:
        i = self.pairing.paired
        shapes, model, std = self.measured.shapes[:, i], self.aligned_shapes[:, i], self.std.shape[:, i]
        real = is_real(shapes)
        turn = np.exp(-0.5j * np.angle(np.nansum(shapes**2, axis=0)))
        residual = (shapes - model) * np.where(real, turn, 1.0)
        power = np.where(real, residual.real**2, np.abs(residual) ** 2)
        # The alignment absorbs the noise of a sensor in proportion to that sensor's share of the shape.
        known = np.where(np.isnan(shapes), np.nan, np.abs(model) ** 2)
        total = np.nansum(known, axis=0)
        share = _over(known, np.broadcast_to(total, known.shape))
        expected = np.where(real, 1.0, 2.0) * std**2 * (1.0 - share)
        ratio = _over(power, np.where(expected > 1e-9 * std**2, expected, np.nan))
        counted = np.isfinite(ratio)
        parts = np.sum(counted, axis=1)
        mean = _over(np.sum(np.where(counted, ratio, 0.0), axis=1), parts.astype(float))
        dof = np.sum(counted * np.where(real, 1.0, 2.0), axis=1)
        value = comac(shapes, self.sensor_shapes[:, self.pairing.model_index[i]])
        names = [s.name for s in self.measured.sensors]
        return self._rows("sensor", names, value, np.sqrt(mean), np.maximum(dof, 1))


def _over(top: np.ndarray, bottom: np.ndarray) -> np.ndarray:
    """Quotient with NaN where the divisor is zero or unknown."""
    return np.divide(top, bottom, out=np.full(np.shape(top), np.nan), where=bottom > 0)
