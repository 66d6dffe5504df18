"""The hypotheses of a study: its effects, the local changes of its model, and a reduced basis that holds them all."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from calib.correlation.problem import ModalProblem
from calib.correlation.residual import ModalResidual
from calib.effect import Effect
from calib.errors import InputError, ToleranceError
from calib.measurement.modal import MeasuredModes
from calib.questions.hypotheses import ModelHypotheses
from calib.questions.reduction import Wanted, reduction_of, training, worthwhile
from calib.results import Results
from calib.space import ParameterSpace
from calib.structure.atoms import Atom, atoms
from calib.structure.basis import Basis
from calib.structure.effect_basis import effect_basis
from calib.structure.extend import extend
from calib.structure.model import StructuralModel
from calib.structure.variants import Variants
from calib.study import Study
from calib.written import is_own


def local_changes(
    model: StructuralModel, measured: Sequence[MeasuredModes], values: Mapping[str, float], of: str = ""
) -> tuple[Atom, ...]:
    """Local changes of a model with matrices: of its parts, and at every sensor of some tests of it.

    Parameters
    ----------
    model : StructuralModel
    measured : sequence of MeasuredModes
        What fits see, test by test.
    values : mapping
        Reference values; see `calib.structure.atoms.atoms`.
    of : str
        Names the model where others beside it have changes of the same names.
    """
    placed = {s.name: s for modes in measured for s in modes.sensors if s.point is not None}
    lowest = min(float(modes.natural_freq.min()) for modes in measured)
    return atoms(model, list(placed.values()), values, lowest, of)


def modal_hypotheses(
    study: Study,
    results: Results,
    progress: Callable[[str], None] = lambda words: None,
    local: tuple[Atom, ...] | None = None,
) -> tuple[ModelHypotheses[ModalResidual], tuple[Atom, ...]]:
    """Hypotheses of a study whose model has modes, and its local changes; by default those of its own test.

    A basis trained before is taken from the results' folder.
    """
    problem = study.problem
    assert isinstance(problem, ModalProblem) and isinstance(problem.model, StructuralModel)
    model = problem.model
    if local is None:
        local = local_changes(model, [problem.measured], study.search_space.values)
    effects, plain = study.candidates, tuple(a.effect for a in local)
    basis = None
    if worthwhile(study):
        progress("reduced basis for the effects")

        def search_basis() -> Basis:
            found = reduction_of(study, results)  # a search has trained it, or will need it
            assert found is not None
            return found.basis

        with training(study):
            space, wanted = study.search_space, Wanted.of(study)
            with contextlib.suppress(ToleranceError):  # then the full model is asked, and `ModalSide` says so
                basis = kept_basis(model, space, effects, plain, wanted, results.path, search_basis)
    variants = Variants(model, effects, plain, basis)
    return ModelHypotheses(ModalResidual(problem), variants, study.search_space.without(study.condition)), local


def kept_basis(
    model: StructuralModel,
    space: ParameterSpace,
    effects: Sequence[Effect],
    local: Sequence[Effect],
    wanted: Wanted,
    folder: Path,
    plain: Callable[[], Basis] | None = None,
) -> Basis:
    """A basis that holds effects and local changes of a model, from a folder; trained and kept there if it has none.

    The folder keeps one. ``plain`` gives a basis of the model alone; by default one is trained. EvaluationError when
    the model cannot be solved somewhere.
    """
    digest = hashlib.sha256(extend(model, [*effects, *local]).fingerprint.encode())
    digest.update(repr([(e.name, e.parameters, e.grid) for e in effects]).encode())
    digest.update(repr((wanted.count, wanted.freq_max, wanted.tolerance, wanted.seed)).encode())
    digest.update(repr(space.parameters).encode())
    path = folder / f"basis_effects_{digest.hexdigest()[:16]}.npz"
    if path.exists():
        with suppress(InputError):
            return Basis.load(path)
    basis = effect_basis(model, plain() if plain else wanted.trained(model, space), space, effects, local, wanted.seed)
    for old in folder.glob("basis_effects_*.npz"):
        if is_own(old):
            old.unlink(missing_ok=True)
    basis.save(path)
    return basis
