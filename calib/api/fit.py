"""Fit: the solution of a problem, with what the data determine."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic

from calib.analyses.fit_statistics import FitStatistics
from calib.api.display import Compared, Shown
from calib.api.explained import Explained, explained
from calib.api.page import draw, write_pages
from calib.api.protocols import Effects, Finer, P
from calib.api.responses import own
from calib.api.search import Searched
from calib.errors.arguments import path as path_of
from calib.inference.agreement import Agreement, agreement_sentences

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, eq=False, repr=False)
class Fit(Shown, Generic[P]):
    """A fitted problem with the covariance and identifiability of its parameters.

    Attributes
    ----------
    problem : Problem
        Its free parameters are the fitted ones.
    statistics : FitStatistics
    search : Searched or None
        The genetic searches before least squares; None without.

    Examples
    --------
    The natural frequency, here squared, determines the ratio of stiffness to mass, not both:

    >>> import calib
    >>> space = calib.ParameterSpace((
    ...     calib.Parameter("k", 3.0, 1.0, 9.0, "kN/m"), calib.Parameter("m", 1.0, 0.1, 5.0, "kg"),
    ... ))
    >>> model = calib.FunctionModel("oscillator", space, lambda v: {"w2": 1e3 * v["k"] / v["m"]})
    >>> problem = calib.Problem(model, calib.ResponseTest({"w2": (4000.0, 40.0)}))
    >>> problem.calibrate(["k"]).parameters["identified"].to_dict()
    {'k': True}
    >>> problem.calibrate().parameters["identified"].to_dict()
    {'k': False, 'm': False}
    """

    problem: P
    statistics: FitStatistics
    search: Searched | None = None

    @property
    def values(self) -> dict[str, float]:
        """All parameters, each in its own unit."""
        return self.statistics.values

    @cached_property
    def agreement(self) -> Agreement | None:
        """Whether starts that fit equally well ended in one solution; None for fewer than two of them."""
        return self.statistics.agreement(self.problem.space)

    @cached_property
    def parameters(self) -> Any:
        """One row per fitted parameter: value, standard deviation, and whether the data determine it.

        Columns as in `calib.inference.verdicts.parameter_verdicts`; the index is the parameter.
        """
        differing = self.agreement.differing if self.agreement else {}
        return self.statistics.verdicts(self.problem.space, {}, differing).set_index("parameter")

    @property
    def table(self) -> Any:
        """The main columns of `parameters`."""
        shown = ["value", "unit", "std", "identified", "on_limit", "confounded_with"]
        return self.parameters[shown].reset_index()

    @property
    def std_by_test(self) -> Any:
        """What each of several tests alone would determine; see `calib.inference.std_by_test.std_by_test`.

        ``parameter, unit, test, std, prior_sd``, with rows of ``all tests``; empty for one test.
        """
        return self.statistics.by_test

    @property
    def sentences(self) -> tuple[str, ...]:
        """Goodness of fit, identifiability of each parameter, and whether starts and searches agree."""
        each = (f"{name}: {sentence}" for name, sentence in self.parameters["sentence"].items())
        ends = agreement_sentences(self.agreement, self.search.agreement if self.search else None)
        failed = (self.search.why_failed,) if self.search and self.search.why_failed else ()
        return (self.statistics.sentence, *each, *ends, *failed)

    def __repr__(self) -> str:
        known = int(self.parameters["identified"].fillna(False).astype(bool).sum())
        return f"Fit({len(self.parameters)} parameters, {known} identified; p = {self.statistics.p_fit:.2g})"

    @cached_property
    def errors(self) -> Any:
        """Errors on fitted, left-one-out and held-out data, in standard deviations, test by test.

        ``test, group, rows, rms, expected, p, unpaired``; ``expected`` is the rms of a correctly specified model.
        """
        import pandas as pd

        parts = []
        for model, test in self.problem.pairs:
            values = own(model, test, self.values)
            parts.append(test.errors(model, values, self.statistics).assign(test=test.name))
        return pd.concat(parts, ignore_index=True)[["test", "group", "rows", "rms", "expected", "p", "unpaired"]]

    def compare(self) -> Compared:
        """Models against tests at the fitted values."""
        return self.problem.compare(self.values)

    def explain(
        self, effects: Effects = (), *, seed: int = 1, progress: bool = True, fixed_sd: str | None = None,
        finer: Finer = None, mesh_sd: float | None = None,
    ) -> Explained[P]:  # fmt: skip
        """See `calib.Problem.explain`."""
        return explained(self.problem, effects, seed, progress, fixed_sd, finer, mesh_sd)

    def figure(self, name: str, ax: Axes | None = None, *, test: str = "") -> Axes:
        """Draw one figure of the fit.

        Parameters
        ----------
        name : str
            ``frequency_errors``, ``mac``, ``comac`` (before and after the fit), ``mac_matrix``,
            ``cross_orthogonality``, ``self_orthogonality`` (after it) or ``parameters``.
        ax : Axes, optional
            Axes to draw on; a new figure by default.
        test : str
            Name of the test, where there are several.

        Raises
        ------
        InputError
            For an unknown figure or test, and where the data for it were not measured.
        """
        return draw(self, name, test, ax)

    def report(self, path: str | Path) -> tuple[Path, ...]:
        """Write an HTML report of the fit that opens offline; for several tests one file each, with the test's name.

        Raises
        ------
        InputError
            Where it cannot be written.
        """
        return write_pages(self, path_of(path, "report"))
