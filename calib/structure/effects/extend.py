"""Extension of a structural model by effects: added terms, parameters and degrees of freedom."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from calib.errors.errors import InputError
from calib.errors.own_code import defined_at, raised_at
from calib.problem.effect import Effect
from calib.problem.space import ParameterSpace
from calib.structure.affine import AffineMatrix, SelectedTerm, Term
from calib.structure.effects.products import following
from calib.structure.geometry import DofMap, Locator
from calib.structure.model import Assumption, StructuralModel
from calib.structure.pattern import padded


@dataclass(frozen=True)
class Addition:
    """Terms and degrees of freedom that one effect adds to a model.

    Matrices and vectors are over the model's ``n_dof`` degrees of freedom followed by ``n_added`` of the effect's own.
    At magnitude 0 every coefficient that reaches the model's own degrees of freedom is 0; added degrees of freedom are
    then decoupled and keep a stiffness, so that the eigenproblem stays regular.

    Attributes
    ----------
    stiffness, damping, mass : tuple of Term
    selected : tuple of SelectedTerm
        Stiffness at positions selected by discrete parameters.
    n_added : int
    assumptions : tuple of Assumption
    """

    stiffness: tuple[Term, ...] = ()
    damping: tuple[Term, ...] = ()
    mass: tuple[Term, ...] = ()
    selected: tuple[SelectedTerm, ...] = ()
    n_added: int = 0
    assumptions: tuple[Assumption, ...] = ()

    def digest(self) -> str:
        """Hash over every term and vector."""
        out = hashlib.sha256(str(self.n_added).encode())
        for kind in ("stiffness", "damping", "mass"):
            for term in getattr(self, kind):
                matrix = sp.csr_array(term.matrix)
                out.update(repr((kind, term.name, term.coefficient, matrix.shape)).encode())
                for array in (matrix.indptr, matrix.indices):  # as 64 bits, whatever they take in memory
                    out.update(np.ascontiguousarray(array, dtype=np.int64).data)
                out.update(np.ascontiguousarray(matrix.data).data)
        for one in self.selected:
            out.update(repr((one.name, one.coefficient, one.selectors, sorted(one.vectors))).encode())
            for key in sorted(one.vectors):
                out.update(np.ascontiguousarray(one.vectors[key], dtype=float).data)
        return out.hexdigest()


def extend(model: StructuralModel, effects: Sequence[Effect], leading: bool = False) -> StructuralModel:
    """The model with effects, their magnitudes and nuisance parameters after its own parameters.

    Every effect is built from the base model, so that results do not depend on their order. Where one adds shares of a
    part's stiffness that another changes, the shares follow the change. With ``leading`` the terms of the model stay
    over its own degrees of freedom (`AffineMatrix.leading`): of a large model with many parts it is a small part of the
    memory, enough where the model is reduced.

    Raises
    ------
    InputError
        When an effect is in the model already, or its addition does not fit the model.
    """
    for effect in effects:
        effect.require_new(model.space, model.name)
    additions = [(effect, addition_of(model, effect)) for effect in effects]
    total = model.n_dof + sum(a.n_added for _, a in additions)
    placed, first = [], model.n_dof
    for _, addition in additions:
        placed.append(_Placed(model.n_dof, first, total, addition))
        first += addition.n_added
    base = _Placed(model.n_dof, model.n_dof, total, Addition())

    def matrix(kind: str) -> AffineMatrix:
        own: AffineMatrix = getattr(model, kind)
        terms = list(own.terms) if leading else [base.term(t) for t in own.terms]
        terms += [p.term(t) for p in placed for t in getattr(p.addition, kind)]
        if kind == "stiffness":
            terms = list(following(terms))
        selected = [base.selected(t) for t in own.selected]
        if kind == "stiffness":
            selected += [p.selected(t) for p in placed for t in p.addition.selected]
        return AffineMatrix(total, tuple(terms), tuple(selected), leading)

    more = total - model.n_dof
    parameters = model.space.parameters + tuple(p for effect in effects for p in effect.parameters)
    dofs = DofMap(
        sp.csr_array(sp.hstack([model.dofs.expansion, sp.csr_array((model.dofs.expansion.shape[0], more))])),
        np.concatenate([model.dofs.node, np.full(more, -1)]),
        np.concatenate([model.dofs.direction, np.zeros(more, dtype=int)]),
    )
    return replace(
        model,
        space=ParameterSpace(parameters, model.space.constraints),
        stiffness=matrix("stiffness"),
        damping=matrix("damping"),
        mass=matrix("mass"),
        dofs=dofs,
        locator=_WiderLocator(model.locator, more) if more else model.locator,
        assumptions=model.assumptions + tuple(a for _, addition in additions for a in addition.assumptions),
        parts=model.parts if leading else tuple(replace(one, matrix=base.wider(one.matrix)) for one in model.parts),
    )


def addition_of(model: StructuralModel, effect: Effect) -> Addition:
    """The addition of an effect to a model, built once; InputError when it does not fit."""
    known, addition = model.additions.get(id(effect), (None, None))
    if known is effect:
        return addition
    place = f"effect {effect.name}"
    try:
        addition = effect.build(model)
    except InputError as fault:
        where = place if fault.place is None else f"{place}, {fault.place}"
        at = fault.at or raised_at(fault)
        raise InputError(fault.problem, place=where, remedy=fault.remedy, at=at) from None
    try:
        _require_fitting(model, addition, place)
    except InputError as fault:
        raise fault.with_line(defined_at(effect.build)) from None
    model.additions[id(effect)] = effect, addition  # the effect is kept, so that no other one takes its number
    return addition


def _require_fitting(model: StructuralModel, addition: Addition, place: str) -> None:
    if not isinstance(addition, Addition):
        raise InputError(f"it builds {type(addition).__name__}", place=place, remedy="return an Addition")
    n = model.n_dof + addition.n_added
    for term in (*addition.stiffness, *addition.damping, *addition.mass):
        if term.matrix.shape != (n, n):
            raise InputError(
                f"its term {term.name!r} is {term.matrix.shape}, not ({n}, {n})", place=place,
                remedy="give matrices over the model's degrees of freedom and those it adds",
            )  # fmt: skip
    for selected in addition.selected:
        for b in selected.vectors.values():
            if b.shape != (n,):
                words = f"a vector of {selected.name!r} is {b.shape}, not ({n},)"
                raise InputError(words, place=place, remedy="give it the same length")


@dataclass(frozen=True)
class _Placed:
    """Position of the degrees of freedom of one addition among all."""

    own: int
    first: int
    total: int
    addition: Addition

    def index(self, at: np.ndarray) -> np.ndarray:
        return np.where(at < self.own, at, at - self.own + self.first)

    def wider(self, matrix: sp.csr_array) -> sp.csr_array:
        if self.first == self.own:  # its degrees of freedom follow at once
            return padded(matrix, self.total)
        coo = sp.coo_array(matrix)
        where = (self.index(coo.row), self.index(coo.col))
        return sp.csr_array(sp.coo_array((coo.data, where), shape=(self.total, self.total)))

    def term(self, term: Term) -> Term:
        return replace(term, matrix=self.wider(term.matrix))

    def selected(self, term: SelectedTerm) -> SelectedTerm:
        vectors = {}
        for key, b in term.vectors.items():
            vectors[key] = np.zeros(self.total)
            vectors[key][self.index(np.arange(len(b)))] = b
        return replace(term, vectors=vectors)


@dataclass(frozen=True)
class _WiderLocator:
    """Locator of the base model over the degrees of freedom of an extended one."""

    inner: Locator
    more: int

    def row(self, point: Sequence[float], direction: int, on: str | None = None) -> tuple[np.ndarray, float]:
        """See `calib.structure.model.Locator`."""
        row, distance = self.inner.row(point, direction, on)
        return np.concatenate([row, np.zeros(self.more)]), distance
