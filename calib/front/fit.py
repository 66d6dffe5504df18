"""Fit: a problem solved."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic

from calib.front.asked import Effects, P
from calib.front.explained import Explained, explained
from calib.front.page import draw, write_pages
from calib.front.responses import own
from calib.front.search import Searched
from calib.front.shown import Compared, Shown
from calib.given import path as path_of
from calib.questions.judge import Judgement

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, eq=False, repr=False)
class Fit(Shown, Generic[P]):
    """A problem solved, and what is known of its parameters there.

    Attributes
    ----------
    problem : Problem
        With the fitted parameters free.
    judgement : Judgement
    search : Searched or None
        The genetic searches that led here; None without one.
    """

    problem: P
    judgement: Judgement
    search: Searched | None = None

    @property
    def values(self) -> dict[str, float]:
        """All parameters, each in its own unit."""
        return self.judgement.values

    @cached_property
    def parameters(self) -> Any:
        """One row a fitted parameter: value, standard deviation, and whether the data determine it.

        Columns as of `calib.inference.verdicts.parameter_verdicts`; the index is the parameter.
        """
        return self.judgement.verdicts(self.problem.space, {}).set_index("parameter")

    @property
    def table(self) -> Any:
        """What is shown of the parameters."""
        shown = ["value", "unit", "std", "identified", "on_bound", "confounded_with"]
        return self.parameters[shown].reset_index()

    @property
    def sentences(self) -> tuple[str, ...]:
        """Whether the model fits, what is known of each parameter, and whether searches agree."""
        each = (f"{name}: {told}" for name, told in self.parameters["sentence"].items())
        return (self.judgement.sentence, *each, *(self.search.sentences if self.search else ()))

    def __repr__(self) -> str:
        known = int(self.parameters["identified"].fillna(False).astype(bool).sum())
        return f"Fit({len(self.parameters)} parameters, {known} identified; p = {self.judgement.p_fit:.2g})"

    @cached_property
    def errors(self) -> Any:
        """Errors on data used, left out in turn and held out, in units of the scatter, test by test.

        ``test, group, rows, rms, expected, p, unpaired``; ``expected`` is what a right model would show.
        """
        import pandas as pd

        parts = []
        for model, test in self.problem.pairs:
            parts.append(test.errors(model, own(model, test, self.values)).assign(test=test.name))
        return pd.concat(parts, ignore_index=True)[["test", "group", "rows", "rms", "expected", "p", "unpaired"]]

    def compare(self) -> Compared:
        """Models against tests at the fitted values."""
        return self.problem.compare(self.values)

    def explain(self, effects: Effects = (), *, seed: int = 1) -> Explained[P]:
        """See `calib.Problem.explain`."""
        return explained(self.problem, effects, seed)

    def figure(self, name: str, ax: Axes | None = None, *, test: str = "") -> Axes:
        """Draw one figure of the fit.

        Parameters
        ----------
        name : str
            ``frequency_errors``, ``mac``, ``mac_matrix``, ``comac`` (before and after the fit) or ``parameters``.
        ax : Axes, optional
            Where it is drawn; a figure of its own by default.
        test : str
            Whose modes are drawn, where there are several tests.

        Raises
        ------
        InputError
            For an unknown figure or test, and where nothing was measured that it shows.
        """
        return draw(self, name, test, ax)

    def report(self, path: str | Path) -> tuple[Path, ...]:
        """Write a page that tells the fit and opens anywhere, offline; of several tests one each, with its name.

        Raises
        ------
        InputError
            Where it cannot be written.
        """
        return write_pages(self, path_of(path, "report"))
