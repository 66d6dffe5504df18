"""A frozen set of vectors that the shapes of a model are composed of, whatever its parameters."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd

from calib.errors import InputError
from calib.space import ParameterSpace
from calib.written import replacing

_FORMAT = "calib reduced basis 1"
_ARRAYS = ("vectors", "reference", "lower", "upper", "samples", "checks")
CHECK_COLUMNS = ("round", "size", "indicator", "error")


@dataclass(frozen=True, eq=False)
class Basis:
    """Vectors for a reduced model, with everything that went into choosing them. All arrays are read-only.

    Attributes
    ----------
    vectors : ndarray (n_dof, size)
        Orthonormal in ``K_ref + offset M_ref``, the matrices at the reference values without selected terms.
    model_fingerprint : str
        Of the full model.
    names : tuple of str
        All parameters of the model, the columns of the arrays below; each in its own unit.
    reference, lower, upper : ndarray (n_names,)
        Values of the inner product, and the limits the basis was trained within (equal where a parameter was fixed).
    offset : float
        1/s^2; 0 unless the model has rigid-body motions.
    count : int
        Number of modes it was trained for.
    freq_max, damping_max : float
        Only modes below this natural frequency in Hz and this damping ratio had to meet the tolerance.
    tolerance : float
        Relative eigenvalue error aimed at.
    samples : ndarray (n_samples, n_names)
        Points whose full-order modes are in the basis.
    checks : ndarray (n_checks, 4)
        Every fresh point looked at in training: round, size of the basis, largest error indicator there, and largest
        error of eigenvalue or shape against the full model where that was solved too (else NaN; infinite for a missed
        mode).
    seed, version : int
        The version counts up whenever vectors are added.
    """

    vectors: np.ndarray
    model_fingerprint: str
    names: tuple[str, ...]
    reference: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    offset: float
    count: int
    freq_max: float
    damping_max: float
    tolerance: float
    samples: np.ndarray
    checks: np.ndarray
    seed: int
    version: int = 1

    def __post_init__(self) -> None:
        for name in _ARRAYS:
            array = np.array(getattr(self, name), dtype=float)
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @property
    def size(self) -> int:
        """Number of vectors."""
        return self.vectors.shape[1]

    @property
    def reference_values(self) -> dict[str, float]:
        """Parameter values of the inner product, each in its own unit."""
        return dict(zip(self.names, self.reference.tolist(), strict=True))

    @cached_property
    def digest(self) -> str:
        """Hash over the vectors and everything else."""
        out = hashlib.sha256(self._header().encode())
        for name in _ARRAYS:
            out.update(np.ascontiguousarray(getattr(self, name)).tobytes())
        return out.hexdigest()[:16]

    def table(self) -> pd.DataFrame:
        """The fresh points looked at in training: columns ``round, size, indicator, error`` as in `checks`."""
        table = pd.DataFrame(self.checks, columns=list(CHECK_COLUMNS))
        return table.astype({"round": int, "size": int})

    def covers(self, space: ParameterSpace) -> bool:
        """Whether a space lies within the limits that the basis was trained within."""
        low, high = dict(zip(self.names, self.lower, strict=True)), dict(zip(self.names, self.upper, strict=True))
        if set(space.names) != set(self.names):
            return False
        free = set(space.free_names)
        for p in space.parameters:
            slack = 1e-9 * max(abs(low[p.name]), abs(high[p.name]))
            ends = (p.lower, p.upper) if p.name in free else (p.value, p.value)
            if not (low[p.name] - slack <= ends[0] and ends[1] <= high[p.name] + slack):
                return False
        return True

    def carried(self, space: ParameterSpace, n_dof: int) -> Basis:
        """The same for an extension of the model, whose own degrees of freedom and parameters come first.

        Parameters
        ----------
        space : ParameterSpace
            Of the extension; its further parameters are free within their limits.
        n_dof : int
            Of the extension; its further degrees of freedom stand for themselves.
        """
        more = n_dof - len(self.vectors)
        vectors = np.zeros((n_dof, self.size + more))
        vectors[: n_dof - more, : self.size] = self.vectors
        vectors[n_dof - more :, self.size :] = np.eye(more)
        own = space.parameters[len(self.names) :]

        def wider(array: np.ndarray, ends: list[float]) -> np.ndarray:
            return np.hstack([array, np.broadcast_to(ends, (*array.shape[:-1], len(own)))])

        return replace(
            self,
            vectors=vectors,
            names=space.names,
            reference=wider(self.reference, [p.value for p in own]),
            lower=wider(self.lower, [p.lower for p in own]),
            upper=wider(self.upper, [p.upper for p in own]),
            samples=wider(self.samples, [p.value for p in own]),
            count=self.count + more,
        )

    # -- files ---------------------------------------------------------------------------------------------------------

    def _header(self) -> str:
        plain = {
            "format": _FORMAT,
            "model_fingerprint": self.model_fingerprint,
            "names": list(self.names),
            "offset": self.offset,
            "count": self.count,
            "freq_max": self.freq_max,
            "damping_max": self.damping_max,
            "tolerance": self.tolerance,
            "seed": self.seed,
            "version": self.version,
        }
        return json.dumps(plain, sort_keys=True)

    def save(self, path: Path) -> None:
        """Write one ``.npz`` file, whole or not at all."""
        try:
            with replacing(path) as draft, draft.open("wb") as file:
                np.savez(
                    file,
                    header=np.array(self._header()),
                    digest=np.array(self.digest),
                    **{name: getattr(self, name) for name in _ARRAYS},
                )
        except OSError as fault:
            raise InputError(f"the reduced basis cannot be written ({fault})", place=path) from None

    @staticmethod
    def load(path: Path) -> Basis:
        """Read what `save` wrote; InputError for a file that is missing, damaged or of another kind."""
        remedy = "delete it and train anew"
        try:
            with np.load(path, allow_pickle=False) as file:
                stored = {name: file[name] for name in (*_ARRAYS, "header", "digest")}
            header = json.loads(str(stored["header"]))
            if header.pop("format") != _FORMAT:
                raise InputError("it is no reduced basis of this version", place=path, remedy=remedy)
            header["names"] = tuple(header["names"])
            basis = Basis(**{name: stored[name] for name in _ARRAYS}, **header)
        except FileNotFoundError:
            raise InputError("there is no such file", place=path) from None
        except InputError:
            raise
        except Exception as fault:  # a damaged archive raises what its zip, zlib, json or numpy layer happens to
            words = f"it is not a readable reduced basis ({type(fault).__name__}: {fault})"
            raise InputError(words, place=path, remedy=remedy) from None
        if basis.digest != str(stored["digest"]):
            raise InputError("the reduced basis is damaged: its digest differs", place=path, remedy=remedy)
        return basis
