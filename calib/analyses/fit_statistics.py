"""Fit statistics of a study: goodness of fit, identifiability, predictions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import pandas as pd

from calib.analyses.uncertain import mesh_changes
from calib.analyses.uncertainty import assumed_words, in_one
from calib.errors.errors import InputError
from calib.experiment.test import ForwardProblem
from calib.inference.agreement import Agreement, agreement
from calib.inference.between import Between
from calib.inference.cases import CaseResult
from calib.inference.considered import At, Fittable, Nearby, changes_by_held, considered_table
from calib.inference.constraints import Hold, holds, multipliers
from calib.inference.freed import beside_data, freed, unabsorbed
from calib.inference.gauss_newton import FitResult
from calib.inference.identify import Identifiability, identify, posterior, prediction_interval, with_held
from calib.inference.joint_part import COLUMNS, JointPart, joint_parts, std_by_test
from calib.inference.linear_estimate import LinearEstimate, Tested
from calib.inference.region import active_limits
from calib.inference.rules import RULES
from calib.inference.verdicts import integer_std, parameter_verdicts
from calib.missing.goodness import goodness, misfit_factor, overall
from calib.missing.rules import RULES as MISSING
from calib.missing.suspect import suspects_table
from calib.problem.degrees_of_freedom import RULES as DOF
from calib.problem.degrees_of_freedom import effective_dof
from calib.problem.joint import JointProblem
from calib.problem.prior import Prior
from calib.problem.problem import Counts, PairProblem
from calib.problem.space import ParameterSpace
from calib.results.ledger import Ledger
from calib.study.several import AnyStudy

Profiles: TypeAlias = Mapping[str, tuple[np.ndarray, np.ndarray]]
FitProblem: TypeAlias = PairProblem[Any] | JointProblem


def fit_problem(
    study: AnyStudy,
    ledger: Ledger | None,
    instead: Mapping[str, ForwardProblem] = MappingProxyType({}),
    counts: Counts | None = None,
) -> FitProblem:
    """The fit problem of a study: its measurements against its models, every solved point in the ledger.

    ``instead`` holds problems that replace the study's own, for example reduced ones, by name of the test; ``counts``
    counts every requested point.
    """
    counts, several = counts or Counts(), len(study.studies) > 1
    parts = {}
    for one in study.studies:
        pair = one.experiment.residual(instead.get(one.test, one.problem))
        space = one.search_space.without(one.condition) if several else one.search_space
        parts[one.test] = PairProblem(pair, space, ledger, counts=counts)
    return JointProblem(parts) if several else next(iter(parts.values()))


@dataclass(frozen=True)
class ObjectiveTerms:
    """Inputs of the fit statistics beside the problem.

    Attributes
    ----------
    alpha : float
        Level of the test of the overall fit.
    held_sd : mapping from str to float
        Standard deviations of held parameters that an earlier study determined; see `identify`.
    assumed : str
        Assumed standard deviations, in words; see `calib.analyses.uncertainty.assumed_words`.
    mesh_sd : float or None
        Standard deviation of the error of the mesh, over the change to a finer one; None for an exact mesh.
    mesh : callable
        That change of the residual at named values; see `calib.analyses.uncertain.mesh_changes`.
    """

    alpha: float = MISSING.suspect
    held_sd: Mapping[str, float] = field(default_factory=dict)
    assumed: str = ""
    mesh_sd: float | None = None
    mesh: Callable[[Mapping[str, float]], np.ndarray] | None = None

    @classmethod
    def of(cls, study: AnyStudy) -> ObjectiveTerms:
        """The terms of a study."""
        stated = study.settings.explain
        known = any(one.has_finer_mesh for one in study.studies)
        if stated.mesh_sd is not None and not known:
            raise InputError(
                "mesh_sd states an error of the mesh, but no finer mesh is known",
                place=study.place("explain", "mesh_sd"),
                remedy="name its model options in finer_options, or leave mesh_sd out",
            )
        mesh = partial(mesh_changes, study, built={}) if known else None
        return cls(stated.alpha, study.held_sd, in_one(study, assumed_words), stated.mesh_sd, mesh)

    def mesh_at(self, values: Mapping[str, float], rows: int) -> np.ndarray:
        """Change of the residual by one standard deviation of the error of each mesh, (n_rows, n_meshes)."""
        if self.mesh is None or self.mesh_sd is None:
            return np.zeros((rows, 0))
        return self.mesh_sd * self.mesh(values)


@dataclass(frozen=True, eq=False)
class FitStatistics:
    """Fit statistics at one set of values.

    Attributes
    ----------
    values : dict
        All parameters, each in its own unit.
    misfit, prior_misfit : float
        Sums of squares of the whitened residual and of the priors; least squares minimise the total.
    dof : float
        Effective degrees of freedom of the residual; see `calib.problem.degrees_of_freedom.effective_dof`.
    p_fit : float
        Probability that a correctly specified model fits as badly; the same test as in an explanation, see
        `calib.missing.goodness.overall`.
    alpha : float
        Level of that test.
    birge : float
        Birge ratio: where the model does not fit, the factor on the standard deviation that brings the worst kind of
        data to its expected misfit (see `calib.missing.goodness.misfit_factor`), else 1. Parameter standard
        deviations, shares and predictions use the scaled standard deviation; unseen directions use the stated one.
    identification : Identification
    profiles : mapping from str to (numbers, misfits)
        Lowest misfit at each tried value of every integer; empty without fits.
    whole : mapping from str to float
        Standard deviations of integer parameters, from these profiles.
    complete : bool
        Whether the fit tried all neighbours of its integers.
    predictions : DataFrame
        ``mode, natural_freq, std, lower, upper``.
    fit : FitResult or None
        The least-squares fit that led here.
    ends : tuple of FitResult
        Fits from all starts, on the same problem; empty without fits.
    suspects : DataFrame
        Data without which the model fits, see `calib.missing.suspect.suspects_table`; empty without a converged fit.
    assumed : str
        Assumed standard deviations that this rests on; see `calib.analyses.uncertainty.assumed_words`.
    by_test : DataFrame
        What each of several tests alone would determine, see `calib.inference.joint_part.std_by_test`; empty for one.
    parts : mapping from str to JointPart
        What the fit says about the parameters of each of several tests, by its name; of one test only where constraints
        count as data.
    active : frozenset of str
        Parameters with an active limit, see `calib.inference.region.active_limits`.
    held_by : mapping from str to Hold
        Limits and constraints that hold parameters, see `calib.inference.constraints.holds`.
    considered : DataFrame
        What held parameters whose values are uncertain add, see `calib.inference.considered.considered_table`.
    considered_misfit : float
        Sum of squares of the data that is left with these parameters free under their priors; it is tested.
    held_squares : float
        Sum of squares that errors of held parameters are expected to add to the residual.
    mesh : str
        What an error of the mesh may change that nobody stated, in words; see `mesh_doubt`.
    between : Between or None
        Parameters with own values in each of several tests; None where the study names none.
    """

    values: dict[str, float]
    misfit: float
    prior_misfit: float
    dof: float
    p_fit: float
    alpha: float
    birge: float
    identification: Identifiability
    profiles: Profiles
    whole: Mapping[str, float]
    complete: bool
    predictions: pd.DataFrame
    fit: FitResult | None
    ends: tuple[FitResult, ...]
    suspects: pd.DataFrame
    assumed: str
    by_test: pd.DataFrame
    parts: Mapping[str, JointPart]
    active: frozenset[str]
    held_by: Mapping[str, Hold]
    considered: pd.DataFrame
    considered_misfit: float
    held_squares: float = 0.0
    mesh: str = ""
    between: Between | None = None

    def verdicts(
        self,
        space: ParameterSpace,
        spread: Mapping[str, float],
        differing: Mapping[str, float] | None = None,
        contradicted: bool = False,
    ) -> pd.DataFrame:
        """One verdict per parameter; see `calib.inference.verdicts.parameter_verdicts`.

        ``contradicted`` tells whether held-out data contradict the fit.
        """
        doubts = {"misfit": self.fits is False, "held_out": contradicted, "few_data": self.dof < DOF.least}
        table = parameter_verdicts(
            space, self.values, self.identification, spread, self.whole, self.fits, self.birge, differing, self.held_by,
            [doubt for doubt, present in doubts.items() if present],
        )  # fmt: skip
        more = " This rests on an assumed standard deviation." if self.assumed else ""
        words = table["sentence"].where(table["std"].isna(), table["sentence"] + more)
        return table.assign(std_from=self.rests_on, sentence=words)

    def part(self, test: str) -> JointPart | None:
        """What the fit says about the parameters of one test; None where its own rows say all."""
        return self.parts.get(test, self.parts.get(""))

    def agreement(self, space: ParameterSpace) -> Agreement | None:
        """Whether the starts whose fits meet the data as well as this one agree; None for fewer than two of them."""
        good = [
            replace(CaseResult.fitted(f"start {k}", end.values, Counts(), pd.DataFrame(), 0.0), misfit=end.data_misfit)
            for k, end in enumerate(self.ends, start=1)
            if end.data_misfit <= self.misfit + RULES.equal
        ]
        return agreement(good, space, level=self.misfit + RULES.equal) if len(good) > 1 else None

    @property
    def figures(self) -> dict[str, object]:
        """Entries of ``summary.json``."""
        return {
            "whitened_misfit": self.misfit,
            "degrees_of_freedom": self.dof,
            "p_fit": self.p_fit,
            "birge": self.birge,
            "std_assumed": self.assumed,
        }

    @property
    def rests_on(self) -> str:
        """Origin of the standard deviation: ``stated`` or ``assumed``."""
        return "assumed" if self.assumed else "stated"

    @property
    def criterion(self) -> float:
        """The sum of squares that least squares minimise: data and priors."""
        return self.misfit + self.prior_misfit

    @property
    def fits(self) -> bool | None:
        """Whether the model fits within the standard deviation; None if it does with too few data to see an error."""
        if self.p_fit <= self.alpha:
            return False
        return True if self.dof >= DOF.least else None

    @property
    def _considered(self) -> str:
        """What is left of the sum of squares where held parameters may be off, in words; empty without them."""
        off = self.considered_misfit < self.misfit
        return f" ({self.considered_misfit:.4g} where held parameters may be off)" if off else ""

    @property
    def sentence(self) -> str:
        """Whether the model fits within the standard deviation, in words."""
        words = (
            f"Sum of squares {self.misfit:.4g} in standard deviations{self._considered}, {max(self.dof, 0.0):.1f} "
            f"effective degrees of freedom, p = {self.p_fit:.2g} for the worst kind of data: "
        )
        if self.fits is None:
            return words + "fewer than two are left, so that the fit cannot show an error of the model."
        rests = f", which is assumed: {self.assumed}" if self.assumed else ""
        if self.fits:
            return words + f"the model fits within the standard deviation{rests}."
        few = "with as many unknowns as data " if self.dof < 1 else ""
        wider = f"parameter uncertainties are computed for {self.birge:.2g} times the standard deviation"
        return (
            words + f"{few}the model does not fit within the standard deviation{rests}; something is missing; {wider}."
        )


def statistics_at(
    problem: FitProblem, terms: ObjectiveTerms, values: Mapping[str, float], near: Near | None = None,
    estimate: LinearEstimate | None = None,
) -> FitStatistics:  # fmt: skip
    """Fit statistics at given values, without a fit; ``estimate`` is what they come from, if known."""
    return statistics_of(problem, terms, problem.space.complete(values), None, {}, True, near=near, estimate=estimate)


class Near(NamedTuple):
    """A reduced problem on which the changes by held parameters are computed.

    Attributes
    ----------
    problem : Fittable
    nearby : callable
        See `calib.inference.considered.changes_by_held`.
    """

    problem: Fittable
    nearby: Nearby


def statistics_of(
    problem: FitProblem,
    terms: ObjectiveTerms,
    values: dict[str, float],
    fit: FitResult | None,
    profiles: Profiles,
    complete: bool,
    ends: tuple[FitResult, ...] = (),
    near: Near | None = None,
    estimate: LinearEstimate | None = None,
) -> FitStatistics:
    """Fit statistics at some values; ``fit`` is the fit that led there, ``ends`` are those from all starts.

    ``near`` serves the changes by held parameters, of which a model of full order would have to be solved many times.
    A linear ``estimate`` has standard deviations of its own, and the model may fit anywhere within them.
    """
    space, held_sd = problem.space, terms.held_sd
    names = tuple(p.name for p in space.free if not p.integer)
    ended = None if fit is None or fit.names != names else (fit.residual, fit.jacobian)
    vector, slope = ended or (problem.residual(values), problem.jacobian(values, names))
    prior_sd = Prior.of(space).widths(values, names)
    constraints = beside_data(space, names, values, slope, held_sd)
    misfit, shift = float(vector @ vector), Prior.of(space).residual(values, names)
    converged = fit is not None and fit.converged
    end = At(names, values, vector, slope, prior_sd, converged)
    own_rows, held = changes_by_held(problem if near is None else near.problem, end, held_sd, near and near.nearby)
    descent = -slope.T @ vector - shift / prior_sd - constraints.slope.T @ constraints.residual
    active = active_limits(space, names, values, multipliers(space, names, values, descent))
    mesh = terms.mesh_at(values, len(vector))
    own_held, own_constraints = held, constraints
    held = np.hstack([held, mesh])
    errors = problem.shared_errors  # unknown to the test of the fit, where they count at each row by itself
    extra = estimate.beyond_least_squares(end, np.hstack([held, errors])) if estimate else vector[:, None][:, :0]
    constraints = constraints.beside(mesh.shape[1])
    tested = Tested(end, np.hstack([own_rows, mesh]), constraints)
    tested = tested if estimate is None else estimate.tested(*tested)
    at, added = freed(space, tested.at, tested.uncertain, held_sd, tested.constraints), unabsorbed(*tested)
    dof = effective_dof(at.slope, at.prior_sd, sum(problem.fitted_factors.values()))
    kinds, modes = goodness(at, problem)
    p_fit, birge = overall(kinds, modes), misfit_factor(kinds, modes, terms.alpha)
    whole = {
        name: integer_std(numbers, misfits / birge**2, space[name].value, space[name].prior_width)
        for name, (numbers, misfits) in profiles.items()
    }
    held = np.hstack([held, birge * extra, errors])
    constraints = constraints.beside(extra.shape[1] + errors.shape[1])
    identification = identify(
        space, names, slope, values=values, held=held, birge=birge, searched=fit is None, constraints=constraints
    )
    rows, changes = np.vstack([slope / birge, constraints.slope]), np.vstack([held / birge, constraints.held])
    alone = posterior(names, rows, prior_sd)
    held_by = holds(
        space, names, values, alone.covariance, descent / birge**2, constraints.constraints, fit is None, held_sd,
        with_held(alone, rows, changes)[: len(names), len(names) :],
    )  # fmt: skip
    predictions = prediction_interval(*problem.frequencies(values, names), identification.posterior.covariance)
    suspected = suspects_table(at, problem, terms.alpha)
    by_test, parts = pd.DataFrame(columns=list(COLUMNS)), dict[str, JointPart]()
    if isinstance(problem, JointProblem):
        by_test = std_by_test(space, names, values, slope, [row.test for row in problem.rows], held, birge, constraints)
    if isinstance(problem, JointProblem) or len(constraints.slope):
        parts = joint_parts(problem, names, vector, slope, prior_sd, shift, own_held, held_sd, own_constraints)
    return FitStatistics(
        values=values, misfit=misfit, prior_misfit=float(shift @ shift + np.sum(constraints.of_priors**2)), dof=dof,
        p_fit=p_fit, alpha=terms.alpha,
        birge=birge, identification=identification, profiles=profiles, whole=whole, complete=complete,
        predictions=predictions, fit=fit, ends=ends, suspects=suspected,
        assumed=terms.assumed, by_test=by_test, parts=parts, active=active, held_by=held_by,
        considered=considered_table(
            space, end, held, held_sd, constraints, birge, terms.mesh_sd, errors.shape[1], extra.shape[1]
        ),
        considered_misfit=float(at.residual @ at.residual),
        held_squares=float(np.sum(added**2)),
    )  # fmt: skip


def mesh_doubt(problem: FitProblem, terms: ObjectiveTerms, found: FitStatistics) -> str:
    """Which estimates a finer mesh would move, in words; empty where it moves none, is unknown, or already counts."""
    if terms.mesh is None or terms.mesh_sd is not None:
        return ""
    try:
        change = terms.mesh(found.values)
    except InputError as fault:
        return f"The error of the mesh is unknown: {fault.problem}."
    names = tuple(p.name for p in problem.space.free if not p.integer)
    slope = problem.jacobian(found.values, names) / found.birge
    own = found.identification.posterior
    shift = np.sqrt(np.sum((own.covariance @ (slope.T @ change / found.birge)) ** 2, axis=1))
    share = np.nan_to_num(shift**2 / (shift**2 + own.std**2))
    moved = [f"{names[k]} by {shift[k] / own.std[k]:.2g}" for k in np.argsort(-share) if share[k] >= RULES.considered]
    if not moved:
        return ""
    return (
        f"A finer mesh would move estimates, in their standard deviations: {', '.join(moved)}. Refine the mesh, or "
        "state how far off it may be (mesh_sd)."
    )
