"""What is known about the parameters of a fit beside their standard deviations, and what follows for its responses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from calib.api.display import Displayed
from calib.api.entries.entry import Entry

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from calib.analyses.intervals import Intervals
    from calib.analyses.pareto import Pareto
    from calib.analyses.robustness import Robustness


@dataclass(frozen=True, eq=False, repr=False)
class FitIntervals(Displayed):
    """Intervals of the parameters of a fit.

    Attributes
    ----------
    of : Intervals
        All results: ``profiles``, ``curves``, and ``sampled``, the samples of the posterior.
    """

    of: Intervals

    @property
    def sentences(self) -> tuple[str, ...]:
        """One for each parameter, then on samples, and what all rests on."""
        return self.of.sentences

    @property
    def lines(self) -> Mapping[str, str]:
        """The answer by the labels of its lines, and where the rest is."""
        return {**self.of.answer.labelled, "Evidence": ".sentences, .table, .of.curves, .of.sampled; .figure() draws"}

    @property
    def table(self) -> pd.DataFrame:
        """A row for each parameter; see `calib.inference.profile_likelihood.profile_table`."""
        return self.of.table

    @property
    def entries(self) -> Sequence[Entry]:
        """What the command prints below the answer."""
        from calib.api.entries.calibrated import interval_entries

        return interval_entries(self.of)

    def figure(self) -> Figure:
        """Draw the profiles."""
        from calib.report.profiles import profiles_figure
        from calib.report.style import style

        with style():
            return profiles_figure(self.of.curves, self.of.table)


@dataclass(frozen=True, eq=False, repr=False)
class FitRobustness(Displayed):
    """Responses of a fit over what is known of its parameters.

    Attributes
    ----------
    of : Robustness
        All results: ``table``, and ``samples``, parameters and responses of each.
    """

    of: Robustness

    @property
    def sentences(self) -> tuple[str, ...]:
        """One for each response with limits, and what all rests on."""
        return self.of.sentences

    @property
    def lines(self) -> Mapping[str, str]:
        """The answer by the labels of its lines, and where the rest is."""
        return {**self.of.answer.labelled, "Evidence": ".sentences, .table, .of.samples; .figure() draws"}

    @property
    def table(self) -> pd.DataFrame:
        """A row for each response; see `calib.analyses.robustness.Robustness`."""
        return self.of.table

    @property
    def entries(self) -> Sequence[Entry]:
        """What the command prints below the answer."""
        from calib.api.entries.calibrated import robustness_entries

        return robustness_entries(self.of)

    def figure(self) -> Figure:
        """Draw the histograms."""
        from calib.report.robustness import robustness_figure
        from calib.report.style import style

        with style():
            return robustness_figure(self.of.table, self.of.samples)


@dataclass(frozen=True, eq=False, repr=False)
class FitPareto(Displayed):
    """Two groups of responses of a fit, weighed against each other.

    Attributes
    ----------
    of : Pareto
        All results: ``table``, ``front``, and ``objectives``, the two groups.
    """

    of: Pareto

    @property
    def sentences(self) -> tuple[str, ...]:
        """On the search, the knee, the best design by the weights of the objective, and the fit."""
        return self.of.sentences

    @property
    def lines(self) -> Mapping[str, str]:
        """The answer by the labels of its lines, and where the rest is."""
        return {**self.of.answer.labelled, "Evidence": ".sentences, .table, .of.objectives; .figure() draws"}

    @property
    def table(self) -> pd.DataFrame:
        """A row for each design of the front, then the fit; see `calib.analyses.pareto.Pareto`."""
        return self.of.table

    @property
    def entries(self) -> Sequence[Entry]:
        """What the command prints below the answer."""
        from calib.api.entries.calibrated import pareto_entries

        return pareto_entries(self.of)

    def figure(self, ax: Axes | None = None) -> Axes:
        """Draw the front."""
        from calib.report.pareto import draw_pareto
        from calib.report.style import style

        with style():
            return draw_pareto(self.of.table, self.of.objectives, ax)
