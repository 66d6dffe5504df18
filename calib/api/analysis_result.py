"""What an analysis about a fit or about samples found: its answer, its table, what is printed, and its figure."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

from calib.api.display import Displayed
from calib.api.entries.entry import Entry
from calib.errors.errors import InputError

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from calib.analyses.intervals import Intervals
    from calib.analyses.pareto import Pareto
    from calib.analyses.refine import Refined
    from calib.analyses.robustness import Robustness
    from calib.results.answer import Answer


class _Analysis(Protocol):
    """What is asked of all results of an analysis."""

    @property
    def answer(self) -> Answer: ...
    @property
    def sentences(self) -> tuple[str, ...]: ...
    @property
    def table(self) -> pd.DataFrame: ...


A = TypeVar("A", bound=_Analysis)


@dataclass(frozen=True, eq=False, repr=False)
class AnalysisResult(Displayed, Generic[A]):
    """Results of one analysis: intervals, robustness or the Pareto front of a fit, or new runs.

    Attributes
    ----------
    of : Intervals, Robustness, Pareto or Refined
        All results.
    evidence : str
        Where the rest is.
    told : callable
        What the command prints below the answer.
    drawn : callable or None
        Draws the figure; takes the results, and Axes where it has one panel.
    """

    of: A
    evidence: str
    told: Callable[[A], Sequence[Entry]]
    drawn: Callable[..., Any] | None = None

    @property
    def sentences(self) -> tuple[str, ...]:
        """Findings, and what they rest on."""
        return self.of.sentences

    @property
    def lines(self) -> Mapping[str, str]:
        """The answer by the labels of its lines, and where the rest is."""
        return {**self.of.answer.labelled, "Evidence": self.evidence}

    @property
    def table(self) -> pd.DataFrame:
        """The main table: a row for each parameter, response or design; see the class of `of`."""
        return self.of.table

    @property
    def entries(self) -> Sequence[Entry]:
        """What the command prints below the answer."""
        return self.told(self.of)

    def figure(self, *axes: Axes) -> Any:
        """Draw the results, of one panel on Axes if they are given; InputError for new runs, which have no figure."""
        from calib.report.style import style

        if self.drawn is None:
            raise InputError("these results have no figure", place="figure", remedy="draw the metamodels with .draw()")
        with style():
            return self.drawn(self.of, *axes)


def interval_result(of: Intervals) -> AnalysisResult[Intervals]:
    """Intervals of the parameters; ``of`` has ``profiles``, ``curves`` and ``sampled``, samples of the posterior."""
    from calib.api.entries.calibrated import interval_entries

    rest = ".sentences, .table, .of.curves, .of.sampled; .figure() draws"
    return AnalysisResult(of, rest, interval_entries, _profiles)


def robustness_result(of: Robustness) -> AnalysisResult[Robustness]:
    """Responses over what is known of the parameters; ``of`` has ``samples``, parameters and responses of each."""
    from calib.api.entries.calibrated import robustness_entries

    return AnalysisResult(of, ".sentences, .table, .of.samples; .figure() draws", robustness_entries, _histograms)


def pareto_result(of: Pareto) -> AnalysisResult[Pareto]:
    """Two groups of responses weighed against each other; ``of`` has ``front`` and ``objectives``, the groups."""
    from calib.api.entries.calibrated import pareto_entries

    return AnalysisResult(of, ".sentences, .table, .of.objectives; .figure() draws", pareto_entries, _front)


def refined_result(of: Refined) -> AnalysisResult[Refined]:
    """New runs; ``of`` has ``runs`` and ``prognosis``, the metamodels with them."""
    from calib.api.entries.compared import refined_entries

    return AnalysisResult(of, ".table, .of.runs, .of.prognosis", refined_entries)


def _profiles(of: Intervals) -> Figure:
    from calib.report.profiles import profiles_figure

    return profiles_figure(of.curves, of.table)


def _histograms(of: Robustness) -> Figure:
    from calib.report.robustness import robustness_figure

    return robustness_figure(of.table, of.samples)


def _front(of: Pareto, ax: Axes | None = None) -> Axes:
    from calib.report.pareto import draw_pareto

    return draw_pareto(of.table, of.objectives, ax)
