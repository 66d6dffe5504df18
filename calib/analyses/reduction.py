"""Model reduction for searches: a basis is trained once, frozen, and checked at would-be best points."""

from __future__ import annotations

import contextlib
import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from calib.analyses.provenance.recorded import ledger_keys_of_modes
from calib.correlation.basis import BasisRequirements, Reducible, is_large
from calib.correlation.frf.problem import FRFProblem
from calib.correlation.modal.problem import ModalProblem
from calib.errors.errors import EvaluationError, InputError, ToleranceError
from calib.execution.evaluate import Evaluator
from calib.execution.outcome import Outcome
from calib.execution.stage import Progress, silent
from calib.results.ledger import Ledger
from calib.results.results import Results
from calib.structure.model import StructuralModel
from calib.structure.reduction.basis import Basis
from calib.structure.reduction.cache import kept_basis
from calib.structure.reduction.growth import Target
from calib.structure.reduction.reduced import ReducedModel
from calib.structure.reduction.refinement import modes_near
from calib.structure.reduction.training import basis_at, enrich_basis
from calib.study.study import LoadedStudy

FIRST_ORDER = 10.0
"""Factor on the tolerance: the error of MAC is of first order, that of frequencies of second."""


@dataclass(frozen=True, eq=False)
class Reduction(ABC):
    """The reduced problem of a study during a search.

    Attributes
    ----------
    full, problem : ModalProblem or FRFProblem
        The problem at full order, and on the basis.
    whole : StructuralModel
        The model at full order.
    target : Target
        What the basis represents.
    basis : Basis
        Frozen.
    path : Path or None
        File of the basis, for worker processes; None for a study in memory.
    """

    full: Any
    problem: Any
    whole: StructuralModel
    target: Target
    basis: Basis
    path: Path | None

    @staticmethod
    def on(problem: Reducible, target: Target, basis: Basis, path: Path | None) -> Reduction:
        """The reduction of a problem to a basis in a file, of the kind of the problem."""
        whole = problem.reducible
        assert whole is not None
        return _OF_PROBLEM[type(problem)](problem, problem.reduced(basis), whole, target, basis, path)

    def certifier(self, ledger: Ledger) -> Callable[[Outcome], Outcome]:
        """Callback of `calib.inference.cases.run_case` that checks every would-be best point.

        Where the error indicator exceeds the tolerance of the basis, the point is solved at full order.
        """
        exact = Evaluator(lambda: self.full.evaluate)

        def certify(outcome: Outcome) -> Outcome:
            if self.error_at(outcome.values) <= self.basis.tolerance:
                return outcome
            return ledger.evaluate(self.full.fingerprint, [outcome.values], exact)[0]

        return certify

    @abstractmethod
    def error_at(self, values: Mapping[str, float]) -> float:
        """Estimated error of the reduced responses at a point, in the unit of the basis's tolerance."""

    @abstractmethod
    def misses_at(self, values: Mapping[str, float]) -> bool:
        """Whether reduced and full responses at a point differ by more than the tolerance."""

    def covering(self, points: Sequence[Mapping[str, float]]) -> Reduction:
        """The same with the basis enriched, in memory, at points where its error indicator exceeds its tolerance.

        Points at which the model cannot be solved are left out.
        """
        enriched = self
        for point in points:
            with contextlib.suppress(EvaluationError):
                if enriched.error_at(point) > self.basis.tolerance:
                    basis = enrich_basis(self.whole, enriched.basis, [point], self.target, verified=0)
                    enriched = Reduction.on(self.full, self.target, basis, None)
        return enriched

    def after_case(self, values: Mapping[str, float], home: Results | None) -> Reduction:
        """The same reduction, or one with an enriched basis when this one misses its tolerance at a case's optimum."""
        if not self.misses_at(values):
            return self
        basis = enrich_basis(self.whole, self.basis, [values], self.target)
        path = None if home is None else _file(home, basis.version)
        if path is not None:
            basis.save(path)
        return Reduction.on(self.full, self.target, basis, path)


@dataclass(frozen=True, eq=False)
class ModalReduction(Reduction):
    """The same against measured modes.

    Attributes
    ----------
    full, problem : ModalProblem
    """

    full: ModalProblem
    problem: ModalProblem

    @property
    def _reduced(self) -> ReducedModel:
        reduced: Any = self.problem.model
        return reduced

    def error_at(self, values: Mapping[str, float]) -> float:
        """Largest error indicator of the paired modes."""
        found = self.problem.compare(values)
        chosen = found.pairing.model_index[found.pairing.paired]
        return float(np.max(self._reduced.indicator(found.values, found.modes.subset(chosen)), initial=0.0))

    def misses_at(self, values: Mapping[str, float]) -> bool:
        """See `Reduction`; by `FIRST_ORDER` times as much, relative in frequency, absolute in MAC.

        Full modes are refined where a count confirms their number.
        """
        refined = modes_near(self._reduced, values, self.full.mode_count, 0.1 * self.basis.tolerance)
        mine, truth = self.problem.evaluate(values), self.full.responses(self.full.compare(values, refined))
        parts = [0.0]
        for mode in self.problem.measured.names:
            freq, mac = f"natural_freq_{mode}", f"mac_{mode}"
            if np.isnan(mine[freq]) != np.isnan(truth[freq]):
                return True
            parts += [abs(mine[freq] / truth[freq] - 1), abs(mine[mac] - truth[mac])]
        return float(np.nanmax(parts)) > FIRST_ORDER * self.basis.tolerance


@dataclass(frozen=True, eq=False)
class FRFReduction(Reduction):
    """The same against measured FRFs, with what loads the model in their test.

    Attributes
    ----------
    full, problem : FRFProblem
    """

    full: FRFProblem
    problem: FRFProblem

    def error_at(self, values: Mapping[str, float]) -> float:
        """Largest estimated error of an FRF."""
        return self.target.estimate(self._loaded, values)

    def misses_at(self, values: Mapping[str, float]) -> bool:
        """See `Reduction`."""
        return self.target.error(self._loaded, values) > self.basis.tolerance

    @property
    def _loaded(self) -> ReducedModel:
        loaded: Any = self.problem.loaded_model
        return loaded


_OF_PROBLEM: Mapping[type, type[Reduction]] = {ModalProblem: ModalReduction, FRFProblem: FRFReduction}


def reduction_of(study: LoadedStudy, home: Results | None, progress: Progress = silent) -> Reduction | None:
    """The basis of a study's search, kept or trained; None where full order is fast enough.

    A study in memory has no ``home``; its basis is kept in the cache alone.

    Raises
    ------
    ToleranceError
        When a basis misses its tolerance; this is stored, so that training is not repeated.
    InputError
        When the model cannot be solved at some training point.
    """
    problem: Any = study.problem
    model, settings = study.problem.reducible, study.settings.reduction
    if model is None or not worthwhile(study):
        return None
    path = None if home is None else _file(home, 1)
    wanted = BasisRequirements.of(problem, settings.tolerance, settings.seed)
    key = wanted.key(model, study.search_space)
    if home is not None:
        _raise_known(home, key)
    with training(study):
        try:
            basis = kept_basis(path, key, lambda: wanted.trained(model, study.search_space, progress))
        except ToleranceError as fault:
            if home is not None:
                home.write_json(_UNREACHED, {"asked": key, "problem": fault.problem})
            raise
    return Reduction.on(problem, wanted.target, basis, path)


def is_followed(study: LoadedStudy) -> bool:
    """Whether least squares lead to the fits of a study: then a basis serves that grows where they end.

    It is modes that are compared, and no parameter is an integer, whose values lie apart.
    """
    return isinstance(study.problem, ModalProblem) and not any(p.integer for p in study.search_space.free)


def point_near(study: LoadedStudy, values: Mapping[str, float]) -> dict[str, float]:
    """All parameters of a study's model at named values, the others nominal as far as its condition sets none."""
    space = study.model.space
    there = {**study.search_space.values, **values}
    return space.complete({name: v for name, v in there.items() if name in space and name not in study.condition})


def reduction_noted(
    study: LoadedStudy, home: Results | None, notes: list[str], progress: Progress = silent
) -> Reduction | None:
    """The reduced basis of a study's search; None where it misses its tolerance, which is added to the notes."""
    try:
        return reduction_of(study, home, progress)
    except ToleranceError as fault:
        words = f"Searched at full order: {fault.problem}."
        notes.extend([] if words in notes else [words])
        return None


def reduction_near(study: LoadedStudy, begin: Mapping[str, float] = MappingProxyType({})) -> Reduction | None:
    """A basis about given values, or the nominal ones, for least squares; None where full order is fast enough.

    A fit passes few points, and a trained basis serves all within the limits: this one is not trained, but grows where
    fits end, see `Reduction.covering`.

    Raises
    ------
    InputError
        When the model cannot be solved there.
    """
    problem, settings, space = study.problem, study.settings.reduction, study.search_space
    model = problem.reducible
    if model is None or not isinstance(problem, ModalProblem) or not worthwhile(study):
        return None
    moved = {p.name: 0.5 * (p.upper - p.lower) for p in space.free if not p.integer and p.name in model.space}
    moved |= {name: sd for name, sd in study.held_sd.items() if name in model.space}
    target = replace(problem.basis_target(settings.tolerance), moved=tuple(moved.items()))
    with training(study):
        basis = basis_at(model, space, target, point_near(study, begin))
    return Reduction.on(problem, target, basis, None)


_UNREACHED = "basis_unreached"
"""Name of the file that records a basis that missed its tolerance."""


def _raise_known(home: Results, digest: str) -> None:
    """ToleranceError where the same training failed before."""
    try:
        known = json.loads((home.path / f"{_UNREACHED}.json").read_text("utf-8"))
        same = known["asked"] == digest
    except (OSError, ValueError, KeyError, TypeError):
        return
    if same:
        raise ToleranceError(str(known.get("problem")), place="reduced model")


@contextlib.contextmanager
def training(study: LoadedStudy) -> Iterator[None]:
    """Turn a failed training into an InputError with a remedy."""
    try:
        yield
    except EvaluationError as fault:
        raise InputError(
            f"no reduced basis can be trained: {fault}", place=study.file,
            remedy="check the model over the search limits, or set use = false under [reduction]", at=fault.at,
        ) from None  # fmt: skip


def worthwhile(study: LoadedStudy) -> bool:
    """Whether a study is solved on a reduced basis: requested, and the model is large enough for its modes."""
    problem = study.problem
    count = problem.mode_count if isinstance(problem, ModalProblem) else 0
    return study.settings.reduction.use and problem.reducible is not None and is_large(problem.reducible, count)


def fingerprints(study: LoadedStudy, home: Results | None) -> tuple[str, ...]:
    """Fingerprints under which a ledger stores valid points of a study.

    For responses its own, and those of its reduced problems on the stored bases; for a function of modes also those of
    the modes.
    """
    problem: Any = study.problem
    own, model = [study.problem.fingerprint], study.problem.reducible
    if model is not None and home is not None:
        kept = [_loaded(path) for path in sorted(home.path.glob(_file(home, "*").name))]
        fitting = [b for b in kept if b is not None and b.model_fingerprint == model.fingerprint]
        own += [problem.reduced(basis).fingerprint for basis in fitting]
    return (*own, *ledger_keys_of_modes(problem, study.library_digest))


def _file(home: Results, version: int | str) -> Path:
    return home.path / f"basis_v{version}.npz"


def _loaded(path: Path) -> Basis | None:
    """A stored basis; None where it cannot be read, so that it is trained again."""
    try:
        return Basis.load(path)
    except InputError:
        return None
