"""Display of results: sentences and a table, as text and as HTML."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from calib.analyses.compare import ComparisonResult, comparison_at
from calib.analyses.joint_responses import own_values
from calib.api.pairs import reporting
from calib.correlation.modal.comparison import Comparison
from calib.correlation.modal.expansion import By, ExpandedShapes, Orthogonality, expanded_shapes, orthogonality
from calib.errors.errors import InputError
from calib.problem.joint import of_test, prefixed, stacked
from calib.results.answer import LABEL

if TYPE_CHECKING:
    from calib.api.protocols import ProblemLike


class Displayed(ABC):
    """A result that prints as its answer in a few lines and its main table, in a notebook as HTML."""

    @property
    @abstractmethod
    def sentences(self) -> tuple[str, ...]:
        """Findings, the most important first."""

    @property
    @abstractmethod
    def table(self) -> pd.DataFrame:
        """The main table."""

    @property
    def display_table(self) -> pd.DataFrame:
        """The columns of `table` that are printed."""
        return self.table

    @property
    def lines(self) -> Mapping[str, str]:
        """The answer by the labels of its lines, the last of which tells where the rest is; empty without an answer."""
        return {}

    @property
    def warnings(self) -> tuple[str, ...]:
        """Doubts that must not be missed, printed below the answer."""
        return ()

    def __str__(self) -> str:
        words = [f"{label}:".ljust(LABEL) + text for label, text in self.lines.items()] or list(self.sentences)
        table = self.display_table
        told = "\n".join([*words, *self.warnings])
        if not len(table):
            return told
        return f"{told}\n\n{table.to_string(index=False, float_format='%.4g', na_rep='')}"

    def _repr_html_(self) -> str:
        answer = "".join(f"<p><b>{label}:</b> {escape(text)}</p>" for label, text in self.lines.items())
        words = answer or "".join(f"<p>{escape(sentence)}</p>" for sentence in self.sentences)
        words += "".join(f"<p>{escape(sentence)}</p>" for sentence in self.warnings)
        return words + str(self.display_table.to_html(index=False, float_format=lambda v: f"{v:.4g}", na_rep=""))


_MODE_COLUMNS = {
    "mode": "mode", "model_mode": "model mode", "natural_freq_measured": "measured Hz",
    "natural_freq_model": "model Hz", "freq_error": "error", "damping_ratio_measured": "damping",
    "damping_ratio_model": "model damping", "mac": "MAC",
}  # fmt: skip
"""Columns of compared modes that are printed, with their heads."""


@dataclass(frozen=True, eq=False, repr=False)
class Compared(Displayed):
    """Comparison of models and tests at one point.

    Attributes
    ----------
    by_test : mapping from str to ComparisonResult
        By name of the test.

    Examples
    --------
    >>> import calib
    >>> space = calib.ParameterSpace((calib.Parameter("k", 10.0, 5.0, 20.0, "kN/m"),))
    >>> model = calib.FunctionModel("spring", space, lambda v: {"load": 4.0 * v["k"]})
    >>> found = calib.Problem(model, calib.ResponseTest({"load": (50.0, 2.0)})).compare()
    >>> print(found.table.to_string(index=False))
    response  measured  model  error  error_in_std
        load      50.0   40.0   -0.2          -5.0
    """

    by_test: Mapping[str, ComparisonResult]

    @property
    def sentences(self) -> tuple[str, ...]:
        """Where each model fails, and doubtful pairs, sensors or units."""
        return prefixed({name: (*answer.sentences, *_remarks(answer)) for name, answer in self.by_test.items()})

    @property
    def table(self) -> pd.DataFrame:
        """One row per measured mode or response, with a column ``test`` where there are several."""
        tables = {name: answer.table for name, answer in self.by_test.items()}
        return stacked(tables) if len(tables) > 1 else next(iter(tables.values()))

    @property
    def display_table(self) -> pd.DataFrame:
        """Of modes the frequencies, damping ratios and MAC of each pair, as far as they are known."""
        table = self.table
        if "natural_freq_model" not in table:
            return table
        kept = [name for name in ("test", *_MODE_COLUMNS) if name in table and table[name].notna().any()]
        return table[kept].rename(columns=_MODE_COLUMNS)

    @property
    def lines(self) -> Mapping[str, str]:
        """The answer by the labels of its lines, of several tests test by test, and where the rest is."""
        several, out = len(self.by_test) > 1, dict[str, str]()
        for name, answer in self.by_test.items():
            for label, text in answer.answer.labelled.items():
                before = f"{out[label]} " if label in out else ""
                out[label] = before + (of_test(name, text) if several else text)
        return {**out, "Evidence": ".sentences, .table; all in .by_test"}

    @property
    def warnings(self) -> tuple[str, ...]:
        """Doubtful units, pairs and sensors."""
        return prefixed({
            name: [*answer.warnings, *(f"Check this sensor: {f.sentence}" for f in answer.sensor_findings)]
            for name, answer in self.by_test.items()
        })  # fmt: skip

    def orthogonality(self, test: str = "", by: By | None = None) -> Orthogonality:
        """Mass-orthogonality of the measured shapes, to the model's and among themselves.

        Parameters
        ----------
        test : str
            Name of the test, where there are several.
        by : {"static", "SEREP"}, optional
            Expansion behind the mass matrix at the sensors; by default static where that exists.

        Returns
        -------
        Orthogonality
            With ``cross_table()``, ``self_table()`` and a ``sentence``.

        Raises
        ------
        InputError, EvaluationError
            Where shapes or matrices are missing, or the shapes cannot be expanded.
        """
        return orthogonality(self._modes(test), by)

    def expanded(self, test: str = "", by: By = "SEREP", modes: Sequence[int] = ()) -> ExpandedShapes:
        """Measured shapes at all degrees of freedom of the model.

        Parameters
        ----------
        test : str
            Name of the test, where there are several.
        by : {"SEREP", "static"}
        modes : sequence of int
            Model modes for SEREP, counted from 1; by default the paired ones.

        Returns
        -------
        ExpandedShapes
            With ``shapes`` (n_dof, n_modes), the ``residual`` of each at the sensors, and a ``table()`` of the mesh.

        Raises
        ------
        InputError, EvaluationError
            As `orthogonality`.
        """
        return expanded_shapes(self._modes(test), by, modes)

    def _modes(self, test: str) -> Comparison:
        """The comparison of the modes of one test; InputError where there is no such."""
        if not test and len(self.by_test) == 1:
            (test,) = self.by_test
        if test not in self.by_test:
            what = f"there is no test {test!r}" if test else f"there are {len(self.by_test)} tests"
            raise InputError(what, place="comparison", remedy=f"name one of them: {', '.join(self.by_test)}")
        found = self.by_test[test].comparison
        if found is None:
            raise InputError("it has no modes", place=f"test {test}", remedy="name a test of modes")
        return found

    def __repr__(self) -> str:
        return f"Compared({', '.join(f'{name}: {len(answer.table)} rows' for name, answer in self.by_test.items())})"


def compared(problem: ProblemLike, values: Mapping[str, float] | None) -> Compared:
    """See `calib.api.problem.Problem.compare`; ``values`` of all parameters, by default the nominal ones."""
    study = problem.study()
    with reporting("compare", False):
        return Compared({
            one.experiment.name: comparison_at(
                one, one.model.space.values if values is None else own_values(one, values)
            )
            for one in study.studies
        })  # fmt: skip


@dataclass(frozen=True, eq=False, repr=False)
class AnalysisResult(Displayed):
    """Result of a study's analysis: sentences and their main table.

    Attributes
    ----------
    words : tuple of str
        The sentences.
    rows : DataFrame
        The table.
    folder : Path
        Folder of all tables and figures.
    of : object
        The full result, such as a `calib.analyses.calibrate.Calibration`; of several tests by themselves by test.
    """

    words: tuple[str, ...]
    rows: pd.DataFrame
    folder: Path
    of: Any

    @property
    def lines(self) -> Mapping[str, str]:
        """As the command prints them."""
        return {} if isinstance(self.of, Mapping) else {**self.of.answer.labelled, "Results": str(self.folder)}

    @property
    def sentences(self) -> tuple[str, ...]:
        """Findings, the most important first."""
        return self.words

    @property
    def table(self) -> pd.DataFrame:
        """The main table."""
        return self.rows

    def __repr__(self) -> str:
        return f"AnalysisResult({len(self.rows)} rows in {self.folder})"


def _remarks(answer: ComparisonResult) -> list[str]:
    """Suspicious sensors, and the mean error of scalar responses."""
    out = [finding.sentence for finding in answer.sensor_findings]
    if answer.frfs is not None:
        out += [answer.answer.found, answer.answer.sure]
    elif answer.comparison is None:
        out.append(f"The mean absolute error is {100 * answer.mean_freq_error:.2f} %.")
    return out
