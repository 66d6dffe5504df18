"""Measured and model FRFs at one point: assurance and error of every function and of every line."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from calib.measurement.frf import MeasuredFRFs, MeasuredFunction
from calib.structure.modal_model import ModalModel

if TYPE_CHECKING:
    import pandas as pd


def assurance(measured: np.ndarray, model: np.ndarray) -> float:
    """``|x^H y|^2 / ((x^H x)(y^H y))`` of two complex vectors, between 0 and 1; 0 where one of them is zero.

    Over the lines of one function it is the frequency response assurance criterion (FRAC; Heylen and Lammens 1996),
    over all functions of one line an entry on the diagonal of the frequency domain assurance criterion (FDAC; Pascual,
    Golinval and Razeto 1997).
    """
    size = float(np.vdot(measured, measured).real * np.vdot(model, model).real)
    return float(np.abs(np.vdot(measured, model)) ** 2 / size) if size > 0 else 0.0


def frac_and_amplitude(measured: MeasuredFRFs, model: np.ndarray) -> np.ndarray:
    """FRAC of every measured function, and the norm of the model's over that of the measured one, (2, n_functions).

    ``model`` is (n_freq, n_responses, n_references), complex.
    """
    pairs = [(measured.values[function.index], model[function.index]) for function in measured.functions]
    amplitudes = [np.linalg.norm(own) / np.linalg.norm(test) for test, own in pairs]
    return np.array([[assurance(test, own) for test, own in pairs], amplitudes])


@dataclass(frozen=True, eq=False)
class FRFComparison:
    """FRFs of a model beside the measured ones.

    Attributes
    ----------
    measured : MeasuredFRFs
    model : ndarray (n_freq, n_responses, n_references), complex
    std : ndarray (n_freq, n_responses, n_references)
        Standard deviation of the real and of the imaginary part each.
    structure : ModalModel
        The model whose FRFs they are.
    """

    measured: MeasuredFRFs
    model: np.ndarray
    std: np.ndarray
    structure: ModalModel

    def functions_table(self) -> pd.DataFrame:
        """One row per function: ``response, reference, unit, lines, frac, amplitude, error, in_std``.

        ``frac`` is their `assurance` over the lines; ``amplitude`` the norm of the model's function over that of the
        measured one; ``error`` the norm of their difference over that of the measured one; ``in_std`` the root mean
        square of the difference in standard deviations, 1 for a right model.
        """
        import pandas as pd

        rows = []
        criteria = zip(self.measured.functions, *frac_and_amplitude(self.measured, self.model), strict=True)
        for function, frac, amplitude in criteria:
            test, model, std = self._at(function)
            error, in_std = float(np.linalg.norm(test - model) / np.linalg.norm(test)), _rms((test - model) / std)
            unit = self.measured.unit(function.response, function.reference)
            ends = (function.response.name, function.reference.name, unit, len(test))
            rows.append((*ends, frac, amplitude, error, in_std))
        return pd.DataFrame(
            rows, columns=["response", "reference", "unit", "lines", "frac", "amplitude", "error", "in_std"]
        )

    def lines_table(self) -> pd.DataFrame:
        """One row per line: ``freq`` (Hz), ``assurance``, ``amplitude``, ``in_std``, over all functions of the line.

        ``assurance`` is that of all functions at that line, NaN for a single one: it tells where along the frequency
        axis the deflections differ; ``amplitude`` and ``in_std`` as in `functions_table`.
        """
        import pandas as pd

        rows = []
        for k, freq in enumerate(self.measured.freq):
            known = np.isfinite(self.measured.values[k])
            if not known.any():
                continue
            test, model = self.measured.values[k][known], self.model[k][known]
            alike = assurance(test, model) if len(test) > 1 else np.nan
            amplitude = float(np.linalg.norm(model) / np.linalg.norm(test))
            rows.append((float(freq), alike, amplitude, _rms((test - model) / self.std[k][known])))
        return pd.DataFrame(rows, columns=["freq", "assurance", "amplitude", "in_std"])

    def overlay_table(self) -> pd.DataFrame:
        """One row per measured entry: ``response, reference, freq``, both functions (``_re, _im``) and ``std``."""
        import pandas as pd

        parts = []
        for function in self.measured.functions:
            test, model, std = self._at(function)
            columns = {
                "response": function.response.name,
                "reference": function.reference.name,
                "freq": self.measured.freq[function.lines],
                "measured_re": test.real,
                "measured_im": test.imag,
                "model_re": model.real,
                "model_im": model.imag,
                "std": std,
            }
            parts.append(pd.DataFrame(columns))
        return pd.concat(parts, ignore_index=True)

    def _at(self, function: MeasuredFunction) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Measured and model values of one function, and the standard deviation, (n_lines,) each."""
        at = function.index
        return self.measured.values[at], self.model[at], self.std[at]


def _rms(scaled: np.ndarray) -> float:
    """Root mean square of real and imaginary parts."""
    return float(np.sqrt(np.mean(np.abs(scaled) ** 2) / 2))
