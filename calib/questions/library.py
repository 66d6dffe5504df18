"""The hypotheses of a study: its effects, the local changes of its model, and a reduced basis that holds them all."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.correlation.problem import ModalProblem
from calib.correlation.scatter import Floors
from calib.effect import Effect
from calib.errors import EvaluationError, InputError
from calib.questions.hypotheses import ModalHypotheses
from calib.questions.reduction import WORTHWHILE_DOFS
from calib.results import Results
from calib.space import ParameterSpace
from calib.structure.atoms import Atom, atoms
from calib.structure.basis import Basis
from calib.structure.effect_basis import effect_basis
from calib.structure.extend import extend
from calib.structure.model import StructuralModel
from calib.structure.training import train_basis
from calib.structure.variants import Variants
from calib.study import Study


def modal_hypotheses(
    study: Study, results: Results, progress: Callable[[str], None] = lambda words: None
) -> tuple[ModalHypotheses, tuple[Atom, ...]]:
    """Hypotheses of a study whose model has modes, and its local changes.

    A basis trained before is taken from the results' folder.
    """
    problem = study.problem
    assert isinstance(problem, ModalProblem) and isinstance(problem.model, StructuralModel)
    model, measured = problem.model, problem.measured
    placed = [s for s in measured.sensors if s.point is not None]
    local = atoms(model, placed, study.search_space.values, float(measured.natural_freq.min()))
    effects, plain = study.candidates, tuple(a.effect for a in local)
    basis = None
    if study.settings.reduction.use and model.n_dof >= WORTHWHILE_DOFS:
        progress("reduced basis for the effects")
        freq_max = problem.freq_window[1] if problem.freq_window else float(np.inf)
        wanted = Wanted(problem.mode_count, freq_max, study.settings.reduction.tolerance, study.settings.reduction.seed)
        try:
            basis = kept_basis(model, study.search_space, effects, plain, wanted, results.path)
        except EvaluationError as fault:
            raise InputError(
                f"no reduced basis can be trained: {fault}", place=study.file,
                remedy="check the model over the search limits, or set use = false under [reduction]",
            ) from None  # fmt: skip
    variants = Variants(model, effects, plain, basis)
    return ModalHypotheses(problem, variants, study.search_space, Floors()), local


@dataclass(frozen=True)
class Wanted:
    """What a basis must represent, and how well; see `calib.structure.training.train_basis`."""

    count: int
    freq_max: float
    tolerance: float
    seed: int


def kept_basis(
    model: StructuralModel,
    space: ParameterSpace,
    effects: Sequence[Effect],
    local: Sequence[Effect],
    wanted: Wanted,
    folder: Path,
) -> Basis:
    """A basis that holds effects and local changes of a model, from a folder; trained and kept there if it has none.

    The folder keeps one; EvaluationError when the model cannot be solved somewhere.
    """
    digest = hashlib.sha256(extend(model, [*effects, *local]).fingerprint.encode())
    digest.update(repr([(e.name, e.parameters, e.grid) for e in effects]).encode())
    digest.update(repr((wanted.count, wanted.freq_max, wanted.tolerance, wanted.seed)).encode())
    digest.update(repr(space.parameters).encode())
    path = folder / f"basis_effects_{digest.hexdigest()[:16]}.npz"
    if path.exists():
        try:
            return Basis.load(path)
        except InputError:
            path.unlink(missing_ok=True)
    basis = train_basis(
        model, space, wanted.count, seed=wanted.seed, freq_max=wanted.freq_max, tolerance=wanted.tolerance
    )
    basis = effect_basis(model, basis, space, effects, local, wanted.seed)
    for old in folder.glob("basis_effects_*.npz"):
        old.unlink(missing_ok=True)
    basis.save(path)
    return basis
