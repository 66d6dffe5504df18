"""Display of results: sentences and a table, as text and as HTML."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from calib.analyses.answers import FIT, UNFITTED
from calib.api.entries.entry import Entry, Words, html_of, lines_of
from calib.api.pairs import reporting
from calib.errors.errors import InputError
from calib.problem.joint import of_test, prefixed, stacked
from calib.results.answer import LABEL, Answer

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

    from calib.analyses.compare import ComparisonResult
    from calib.api.protocols import ProblemLike
    from calib.correlation.modal.comparison import Comparison
    from calib.correlation.modal.expansion import By, ExpandedShapes, Orthogonality
    from calib.study.study import LoadedStudy


_ALL = ".entries has all"
"""Where further rows and warnings are."""


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
    def lines(self) -> Mapping[str, str]:
        """The answer by the labels of its lines, the last of which tells where the rest is; empty without an answer."""
        return {}

    @property
    def entries(self) -> Sequence[Entry]:
        """Warnings, tables and paragraphs that the command prints below the answer too; empty where it has none."""
        return ()

    def __str__(self) -> str:
        words = [f"{label}:".ljust(LABEL) + text for label, text in self.lines.items()] or list(self.sentences)
        below = [line for line, _ in lines_of(self.entries, False, _ALL)] or self._table_lines()
        return "\n".join([*words, *below])

    def _repr_html_(self) -> str:
        answer = "".join(f"<p><b>{label}:</b> {escape(text)}</p>" for label, text in self.lines.items())
        words = answer or "".join(f"<p>{escape(sentence)}</p>" for sentence in self.sentences)
        if self.entries:
            return words + html_of(self.entries, _ALL)
        return words + str(self.table.to_html(index=False, float_format=lambda v: f"{v:.4g}", na_rep=""))

    def _table_lines(self) -> list[str]:
        table = self.table
        return ["", table.to_string(index=False, float_format="%.4g", na_rep="")] if len(table) else []


@dataclass(frozen=True, eq=False, repr=False)
class Compared(Displayed):
    """Comparison of models and tests at one point.

    Attributes
    ----------
    by_test : mapping from str to ComparisonResult
        By name of the test.
    studies : mapping from str to LoadedStudy
        The tests with their models, likewise.
    notes : tuple of str
        How computed modes were read, and how measured nodes were placed on them; see `calib.compare_modes`.

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
    studies: Mapping[str, LoadedStudy]
    notes: tuple[str, ...] = ()

    @property
    def sentences(self) -> tuple[str, ...]:
        """Where each model fails, doubtful pairs, sensors or units, and how the files were read."""
        found = prefixed({name: (*answer.sentences, *_remarks(answer)) for name, answer in self.by_test.items()})
        return (*found, *self.notes)

    @property
    def table(self) -> pd.DataFrame:
        """One row per measured mode or response, with a column ``test`` where there are several."""
        tables = {name: answer.table for name, answer in self.by_test.items()}
        return stacked(tables) if len(tables) > 1 else next(iter(tables.values()))

    @property
    def undamped(self) -> pd.DataFrame:
        """Frequencies of stiffness and mass alone beside damped ones; see `calib.correlation.modal.undamped`.

        Raises
        ------
        InputError
            For models without matrices, and for tests of other data than modes.
        """
        tables = {name: one.undamped for name, one in self.by_test.items()}
        known = {name: table for name, table in tables.items() if table is not None}
        if not known:
            what = "undamped frequencies are those of a model with matrices and of a test by modes"
            raise InputError(what, place="comparison", remedy="compare measured modes with such a model")
        return stacked(known) if len(tables) > 1 else next(iter(known.values()))

    @property
    def lines(self) -> Mapping[str, str]:
        """The answer by the labels of its lines, of several tests test by test, and where the rest is."""
        several, out = len(self.by_test) > 1, dict[str, str]()
        for name in self.by_test:
            for label, text in self.answer_of(name).labelled.items():
                before = f"{out[label]} " if label in out else ""
                out[label] = before + (of_test(name, text) if several else text)
        drawn = f"; .figure(name) draws {', '.join(self.figures)}" if self.figures else ""
        return {**out, "Evidence": f".sentences, .table; all in .by_test{drawn}"}

    def answer_of(self, test: str) -> Answer:
        """The answer of one test; of a model without parameters none recommends a fit."""
        answer = self.by_test[test].answer
        unfitted = answer.then == FIT and not self.studies[test].model.space.free
        return replace(answer, then=UNFITTED, command="") if unfitted else answer

    @property
    def entries(self) -> tuple[Entry, ...]:
        """What the command prints below the answer, test by test."""
        from calib.api.entries.compared import compared_entries

        found = entries_by_test(
            {name: compared_entries(self.studies[name], answer) for name, answer in self.by_test.items()}
        )
        return (*found, *(Words(note, "always") for note in self.notes))

    @property
    def figures(self) -> tuple[str, ...]:
        """Names of the figures that it can draw."""
        from calib.api.page import comparison_figures

        return comparison_figures(self)

    def figure(self, name: str, ax: Axes | None = None, *, test: str = "") -> Axes:
        """Draw one figure of the comparison of modes.

        Parameters
        ----------
        name : str
            ``frequency_errors``, ``mac``, ``mac_matrix``, ``comac``, ``cross_orthogonality`` or ``self_orthogonality``.
        ax : Axes, optional
            Axes to draw on; a new figure by default.
        test : str
            Name of the test, where there are several.

        Raises
        ------
        InputError
            For an unknown figure or test, and where the data for it were not measured.
        """
        from calib.api.page import draw_comparison_figure

        chosen = self._chosen(test)
        return draw_comparison_figure(self.by_test[chosen], name, f"test {chosen}", ax)

    def report(self, path: str | Path) -> tuple[Path, ...]:
        """Write the comparison as an HTML page with its figures; several tests are told in one. Returns the file."""
        from calib.api.page import write_comparison_page

        return (write_comparison_page(self, Path(path)),)

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
        from calib.correlation.modal.expansion import orthogonality

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
        from calib.correlation.modal.expansion import expanded_shapes

        return expanded_shapes(self._modes(test), by, modes)

    def _chosen(self, test: str) -> str:
        """The name of a test, or of the only one; InputError for an unknown one, or none of several."""
        if not test and len(self.by_test) == 1:
            (test,) = self.by_test
        if test not in self.by_test:
            what = f"there is no test {test!r}" if test else f"there are {len(self.by_test)} tests"
            raise InputError(what, place="comparison", remedy=f"name one of them: {', '.join(self.by_test)}")
        return test

    def _modes(self, test: str) -> Comparison:
        """The comparison of the modes of one test; InputError where there is no such."""
        chosen = self._chosen(test)
        found = self.by_test[chosen].comparison
        if found is None:
            raise InputError("it has no modes", place=f"test {chosen}", remedy="name a test of modes")
        return found

    def __repr__(self) -> str:
        return f"Compared({', '.join(f'{name}: {len(answer.table)} rows' for name, answer in self.by_test.items())})"


def compared(problem: ProblemLike, values: Mapping[str, float] | None) -> Compared:
    """See `calib.api.problem.Problem.compare`; ``values`` of all parameters, by default the nominal ones."""
    from calib.analyses.compare import comparison_at
    from calib.analyses.joint_responses import own_values

    studies = {one.experiment.name: one for one in problem.study().studies}
    with reporting("compare", False):
        found = {
            name: comparison_at(one, one.model.space.values if values is None else own_values(one, values))
            for name, one in studies.items()
        }
    return Compared(found, studies)


@dataclass(frozen=True, eq=False, repr=False)
class FolderResult(Displayed):
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
    printed : tuple of Entry
        The entries.
    """

    words: tuple[str, ...]
    rows: pd.DataFrame
    folder: Path
    of: Any
    printed: tuple[Entry, ...]

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

    @property
    def entries(self) -> tuple[Entry, ...]:
        """What the command prints below the answer."""
        return self.printed

    def __repr__(self) -> str:
        return f"FolderResult({len(self.rows)} rows in {self.folder})"


def entries_by_test(entries: Mapping[str, Sequence[Entry]]) -> tuple[Entry, ...]:
    """Entries of every test, of several below its name."""
    if len(entries) == 1:
        return tuple(next(iter(entries.values())))
    return tuple(e for test, own in entries.items() for e in (Words(f"\nTest {test}", when="always"), *own))


def _remarks(answer: ComparisonResult) -> list[str]:
    """Suspicious sensors, and the mean error of scalar responses."""
    out = [finding.sentence for finding in answer.sensor_findings]
    if answer.frfs is not None:
        out += [answer.answer.found, answer.answer.sure]
    elif answer.comparison is None:
        out.append(f"The mean absolute error is {100 * answer.mean_freq_error:.2f} %.")
    return out
