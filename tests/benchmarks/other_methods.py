"""What other methods answer on a blind measurement, scored like the search for a missing effect.

All see the same measurement, standard deviations as stated, base model and candidates; standard deviations count as
known, so that ``-2 ln L`` is the sum of squares. Parameters keep their priors, whose rows are part of it but not of the
number of data. ``with faults`` means that measurement errors are candidates too, where the search has them;
naming one names no effect.

AICc, BIC
    ``-2 ln L + 2 k + 2 k (k + 1)/(n - k - 1)`` (Hurvich and Tsai 1989) and ``-2 ln L + k ln n`` (Schwarz 1978) of the
    base model and of the base model with each single effect, with k free parameters and n values less the fitted
    factors of shapes. The lowest model is chosen; effects within 2 of it are told beside it (Burnham and Anderson
    2002). The first-order prediction ranks all candidates; the best three and those that the search has fitted are
    refitted by least squares.
OMP, LASSO
    Sparse regression of the residual on the signatures of all candidates, the parameters projected out of both, columns
    of unit length. Orthogonal matching pursuit (Pati et al. 1993) takes in columns as long as the BIC falls. LASSO
    (Tibshirani 1996): the BIC of a least-squares fit of each active set along the path chooses the regularisation.
    One-sided magnitudes are kept to their side.
energy error
    Classical localisation (Ladeveze and others 1994): measured shapes are expanded by the paired modes of the fitted
    base model; the dynamic residual at the measured frequencies becomes displacements through the stiffness; the part
    with the largest energy of these is at fault, and the effect that shares most degrees of freedom with it is named. A
    part on half of the degrees of freedom or more is no place and not among them.
    Only for modes of a model with matrices, and where the goodness of fit is rejected at 1 %.
"""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import scipy.linalg as la
import scipy.sparse as sp
import scipy.sparse.linalg as spla
from rates_outcome import Truth, outcome_of

from calib.correlation.modal.residual import ModalResidual
from calib.errors.errors import EvaluationError, InputError
from calib.execution.stage import silent
from calib.hypotheses.hypotheses import ModelHypotheses
from calib.missing.candidate_fit import CandidateFit
from calib.missing.explanation import Explanation
from calib.missing.hypotheses import Altered, Hypotheses
from calib.missing.joint import JointHypotheses
from calib.missing.refits import Refits
from calib.missing.score import Scores
from calib.missing.settings import Settings
from calib.problem.candidate import Candidate
from calib.problem.joint import JointProblem
from calib.structure.effects.extend import addition_of
from calib.structure.effects.variants import Variants

OURS = "this search"
CODE = hashlib.sha256(Path(__file__).read_bytes()).hexdigest()[:10]
"""Of what answers here; it is no part of the code of the search."""
SUPPORTED = 2.0
"""Difference of a criterion from the lowest up to which a model is told beside the best."""
REFITTED = 3
LEVEL = 0.01
SHRUNK = np.geomspace(1.0, 0.01, 60)
"""Regularisation over the smallest that leaves nothing."""

Criterion = Callable[[float, int, int], float]


def aicc(misfit: float, k: int, n: int) -> float:
    """Of a sum of squares, free parameters and data; infinite where the data are too few."""
    return misfit + 2 * k + 2 * k * (k + 1) / (n - k - 1) if n > k + 1 else math.inf


def bic(misfit: float, k: int, n: int) -> float:
    """Of a sum of squares, free parameters and data."""
    return misfit + k * math.log(n)


CRITERIA: dict[str, Criterion] = {"AICc": aicc, "BIC": bic}


def answers(found: Explanation, hypotheses: Hypotheses, truth: Truth) -> dict[str, Any]:
    """Entries of a row: the answer of each method with its outcome (`rates_outcome.outcome`), code and seconds.

    Nothing that breaks here reaches the row of the search.
    """
    started, out = time.perf_counter(), dict[str, Any]()
    try:
        stands = {name: g.effect.name for g in found.groups for name in g.names}
        true = {stands[name] for name in truth.hidden if name in stands}
        told = {OURS: _Told(found.verdict, found.chosen.names if found.chosen else (), found.credible)}
        for method, answer in (told | _Methods(found, hypotheses).told()).items():
            out[method] = answer.row(stands, true)
    except (EvaluationError, InputError, np.linalg.LinAlgError) as fault:
        return {"methods_error": f"{type(fault).__name__}: {fault}", "methods_code": CODE}
    return {"methods": out, "methods_code": CODE, "methods_seconds": round(time.perf_counter() - started, 2)}


def hypotheses_of(found: Explanation) -> Hypotheses:
    """Those that a decision was made on, of one test or of several."""
    problem: Any = found.base.fit.fit_problem
    problem = problem.inner if isinstance(problem, Altered) else problem
    if isinstance(problem, JointProblem):
        parts: Any = problem.parts
        return JointHypotheses({test: part.hypotheses for test, part in parts.items()})
    hypotheses: Hypotheses = problem.hypotheses
    return hypotheses


class _Told:
    """A verdict, the best names and all names that are told."""

    def __init__(self, verdict: str, best: Sequence[str] = (), credible: Sequence[str] = ()) -> None:
        self.verdict, self.best, self.credible = verdict, list(best), list(credible)

    def row(self, stands: dict[str, str], true: set[str]) -> dict[str, Any]:
        """With the outcome by the rule of `rates_outcome.outcome_of`; a collinear effect stands for its group."""
        own = {"verdict": self.verdict, "best": self.best, "credible": self.credible, "outcome": self.verdict}
        if self.verdict in ("effect", "indistinguishable", "two_effects", "several_effects"):
            named, best = {stands[n] for n in self.credible}, [stands[n] for n in self.best]
            own["outcome"] = outcome_of(self.verdict, named, best, true)
        return own


def asserted(names: Sequence[str], effects: set[str]) -> _Told:
    """Effects that are all said to be there, the strongest first; measurement errors are no names."""
    own = [name for name in names if name in effects]
    verdicts = {0: "measurement" if names else "nothing_detectable", 1: "effect", 2: "two_effects"}
    return _Told(verdicts.get(len(own), "several_effects"), own[:1], own)


class _Methods:
    """All methods on one measurement."""

    def __init__(self, found: Explanation, hypotheses: Hypotheses) -> None:
        self.found, self.h = found, hypotheses
        self.fits = Refits(hypotheses, Settings(budget=math.inf), 1.0, silent)
        same, known = found.noise_scale == 1, found.base_adequacy
        self.base = found.base if same else self.fits.candidate_fit((), found.base.fit.values)
        effects = [e for e in hypotheses.effects if e.name in known.named.owners]
        self.effects = {e.name for e in effects}
        self.named = known.named if same else self.fits.scores(self.base.fit, effects)
        faults, kept = tuple(hypotheses.faults), known.faults if same else None
        self.faults = (kept or self.fits.scores(self.base.fit, faults)) if faults else None
        self.n = len(hypotheses.rows) - sum(hypotheses.fitted_factors.values())
        self.fitted: dict[str, CandidateFit] = {}
        for one in (*found.singles, *found.faults) if same else ():
            self.fitted.setdefault(one.names[0], one)

    def told(self) -> dict[str, _Told]:
        """By name of the method."""
        out: dict[str, _Told] = {}
        families: dict[str, tuple[Scores, ...]] = {"": (self.named,)}
        if self.faults is not None:
            families[" with faults"] = (self.named, self.faults)
        for suffix, scores in families.items():
            out |= {f"{name}{suffix}": self.lowest(of, scores) for name, of in CRITERIA.items()}
            unit, z = np.hstack([s.unit for s in scores]), np.concatenate([s.z for s in scores])
            signed = np.concatenate([s.signed for s in scores])
            owners = [name for s in scores for name in s.owners]
            for name, method in (("OMP", pursuit), ("LASSO", lasso)):
                chosen = dict.fromkeys(owners[k] for k in method(unit.T @ unit, z, signed, self.n))
                out[f"{name}{suffix}"] = asserted(list(chosen), self.effects)
        worst = self.energy_error()
        return out if worst is None else out | {"energy error": worst}

    # -- information criteria ------------------------------------------------------------------------------------------

    def lowest(self, criterion: Criterion, families: Sequence[Scores]) -> _Told:
        """The model with the lowest value, and the effects that have about as low a one."""
        drop = {n: max(float(s.magnitude[s.best(n)]), 0.0) ** 2 for s in families for n in dict.fromkeys(s.owners)}
        free = len(self.base.fit.fit_problem.space.free)
        whole, misfit = {n: free + len(self.fits.by_name[n].parameters) for n in drop}, self.base.fit.misfit

        def predicted(name: str) -> float:
            return criterion(misfit - drop[name], whole[name], self.n)

        values = {"": criterion(misfit, free, self.n)}
        for name in sorted(drop, key=predicted)[:REFITTED]:
            self.fit(name, next(s for s in families if name in s.owners))
        values |= {n: criterion(t.fit.misfit, whole[n], self.n) for n, t in self.fitted.items() if n in drop}
        best = min(values, key=lambda name: values[name])
        if best not in self.effects:
            return _Told("measurement" if best else "nothing_detectable")
        near = [n for n in sorted(values, key=lambda n: values[n]) if values[n] <= values[best] + SUPPORTED]
        near = [n for n in near if n in self.effects]
        stands = {name: g.effect.name for g in self.found.groups for name in g.names}
        alone = len({stands[n] for n in near}) == 1
        return _Told("effect" if alone else "indistinguishable", (best,), near)

    def fit(self, name: str, scores: Scores) -> None:
        """Fit one candidate unless the search has; from the starts of the search."""
        if name not in self.fitted:
            one = self.fits.best_of((name,), self.fits.starts(self.base.fit, scores, name), self.base)
            if one is not None:
                self.fitted[name] = one

    # -- localisation --------------------------------------------------------------------------------------------------

    def energy_error(self) -> _Told | None:
        """The effect at the part with the largest energy of the residual; None where the method does not apply."""
        h = self.h
        if not (isinstance(h, ModelHypotheses) and isinstance(h.pair, ModalResidual)):
            return None
        if not (isinstance(h.variants, Variants) and h.pair.problem.measured.has_shapes):
            return None
        if self.found.base_adequacy.p_fit > LEVEL:
            return _Told("nothing_detectable")
        reached = _reached(h.variants)
        half = h.variants.model.n_dof / 2
        parts = [p for p in h.perturbations if p.part and len(reached[p.name]) < half]
        if not parts:
            return None
        energies = residual_energies(h, self.base.fit.values, parts)
        worst = reached[max(energies, key=lambda name: energies[name])]
        shared = {n: len(reached[n] & worst) / max(len(reached[n] | worst), 1) for n in self.effects}
        most = max(shared.values(), default=0.0)
        names = sorted(n for n, share in shared.items() if share >= most * (1 - 1e-9))
        if most == 0:
            return _Told("none_explains")
        return _Told("effect" if len(names) == 1 else "indistinguishable", names[:1], names)


def pursuit(gram: np.ndarray, z: np.ndarray, signed: np.ndarray, n: int) -> list[int]:
    """Columns of orthogonal matching pursuit, in the order of their choice.

    Parameters
    ----------
    gram : ndarray (m, m)
        Products of unit columns; 0 on the diagonal for one that changes nothing.
    z : ndarray (m,)
        Products of columns and residual.
    signed : ndarray (m,), bool
        Whether a negative coefficient is allowed.
    n : int
        Number of data.
    """
    chosen: list[int] = []
    explained = 0.0
    while len(chosen) < len(z):
        left = z - gram[:, chosen] @ _coefficients(gram, z, chosen)
        size = np.where(signed, np.abs(left), left)
        size[chosen] = -np.inf
        k = int(np.argmax(size))
        if size[k] <= 0:
            break
        more = _explained(gram, z, [*chosen, k])
        if more - explained <= math.log(n):
            break
        chosen, explained = [*chosen, k], more
    return chosen


def lasso(gram: np.ndarray, z: np.ndarray, signed: np.ndarray, n: int) -> list[int]:
    """Columns of the LASSO, the largest coefficient first; see `pursuit`."""
    size = np.where(signed, np.abs(z), z)
    if not len(z) or size.max() <= 0:
        return []
    best, least, beta, seen = [], 0.0, np.zeros(len(z)), set[tuple[int, ...]]()
    diagonal = np.maximum(np.diag(gram), 1e-12)
    for part in SHRUNK:
        beta = _descended(gram, z, signed, beta, float(part * size.max()), diagonal)
        active = [int(k) for k in np.argsort(-np.abs(beta), kind="stable") if beta[k] != 0]
        if tuple(sorted(active)) in seen:
            continue
        seen.add(tuple(sorted(active)))
        value = len(active) * math.log(n) - _explained(gram, z, active)
        if value < least:
            best, least = active, value
    return best


def _descended(
    gram: np.ndarray, z: np.ndarray, signed: np.ndarray, beta: np.ndarray, limit: float, diagonal: np.ndarray
) -> np.ndarray:
    """Minimum of ``|r - U b|^2/2 + limit |b|_1`` by coordinate descent (Friedman et al. 2010), from a start."""
    beta = beta.copy()
    for _ in range(200):
        before = beta.copy()
        for k in range(len(z)):
            pull = z[k] - gram[k] @ beta + gram[k, k] * beta[k]
            reduced = max(abs(pull) - limit, 0.0) / diagonal[k] * np.sign(pull)
            beta[k] = reduced if signed[k] or reduced > 0 else 0.0
        if np.abs(beta - before).max() < 1e-3:
            break
    return beta


def _coefficients(gram: np.ndarray, z: np.ndarray, columns: Sequence[int]) -> np.ndarray:
    """Least-squares coefficients of some columns."""
    own = list(columns)
    return la.lstsq(gram[np.ix_(own, own)], z[own])[0] if own else np.zeros(0)


def _explained(gram: np.ndarray, z: np.ndarray, columns: Sequence[int]) -> float:
    """Decrease of the sum of squares by some columns."""
    return float(z[list(columns)] @ _coefficients(gram, z, columns))


def residual_energies(
    h: ModelHypotheses[ModalResidual], values: dict[str, float], parts: Sequence[Candidate]
) -> dict[str, float]:
    """Energy of the displacement residual in each part, over the strain energy of the shape, summed over modes."""
    problem = h.fit_problem(())
    seen = problem.at(values)
    model, measured = problem.pair.problem.model, seen.measured
    stiffness, damping, mass = model.matrices(seen.values)
    paired = seen.pairing.paired
    columns = seen.pairing.model_index[paired]
    shapes, at_sensors = seen.modes.shapes[:, columns], seen.sensor_shapes[:, columns]
    omega = 2 * np.pi * measured.natural_freq[paired]
    ratio = np.nan_to_num(measured.damping_ratio[paired]) if model.is_damped else np.zeros(len(paired))
    poles = omega * (-ratio + 1j * np.sqrt(np.maximum(1 - ratio**2, 0.0)))
    expanded = np.zeros((shapes.shape[0], len(paired)), dtype=complex)
    for k, i in enumerate(paired):
        used = np.isfinite(measured.shapes[:, i])
        expanded[:, k] = shapes @ la.lstsq(at_sensors[used], measured.shapes[used, i])[0]
    force = (mass @ expanded) * poles**2 + stiffness @ expanded
    if model.is_damped:
        force = force + (damping @ expanded) * poles
    moved = _solved(stiffness + omega.min() ** 2 * mass, force)
    scale = np.real(np.einsum("ij,ij->j", expanded.conj(), stiffness @ expanded))
    out = {}
    for part in parts:
        slopes = model.matrix_derivatives(seen.values, part.name)
        energy = sum(
            np.abs(np.einsum("ij,ij->j", moved.conj(), slope @ moved)) * omega**power
            for power, slope in enumerate(slopes)
        )
        out[part.name] = float(np.sum(energy / scale))
    return out


def _solved(matrix: Any, force: np.ndarray) -> np.ndarray:
    if not sp.issparse(matrix):
        return np.asarray(la.solve(matrix, force, assume_a="sym"))
    factor = spla.splu(sp.csc_array(matrix))
    return np.asarray(factor.solve(np.ascontiguousarray(force.real))) + 1j * factor.solve(
        np.ascontiguousarray(force.imag)
    )


@lru_cache(maxsize=4)
def _reached(variants: Variants) -> dict[str, frozenset[int]]:
    """Degrees of freedom of the base model that each effect and each scaled part acts on."""
    model, out = variants.model, {}
    for effect in (*variants.effects, *(p for p in variants.perturbations if p.part)):
        added = addition_of(model, effect)
        dofs = [sp.csr_array(t.matrix).nonzero()[0] for t in (*added.stiffness, *added.damping, *added.mass)]
        dofs += [np.flatnonzero(b) for term in added.selected for b in term.vectors.values()]
        out[effect.name] = frozenset(k for own in dofs for k in np.unique(own).tolist() if k < model.n_dof)
    return out
