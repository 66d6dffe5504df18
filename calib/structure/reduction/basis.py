"""Reduced basis: a fixed set of vectors that spans mode shapes or FRFs over the parameter space."""

from __future__ import annotations

import hashlib
import json
import weakref
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from calib.errors.errors import InputError
from calib.problem.space import ParameterSpace
from calib.results.written import replacing

if TYPE_CHECKING:
    import pandas as pd

_FORMAT = "calib reduced basis 3"
_ARRAYS = ("vectors", "reference", "lower", "upper", "samples", "checks")
CHECK_COLUMNS = ("round", "size", "indicator", "error")
_ROOM = 16
"""Degrees of freedom of effects for which the vectors are stored with room."""


class _Room:
    """The vectors of bases that have the same ones, with room for degrees of freedom of effects."""

    def __init__(self, first: Basis) -> None:
        self.wide: np.ndarray | None = None
        self.shared = weakref.WeakSet([first])


@dataclass(frozen=True, eq=False)
class Basis:
    """Vectors of a reduced model, with the settings and samples they were trained on. All arrays are read-only.

    Attributes
    ----------
    vectors : ndarray (n_dof, size)
        Orthonormal in ``K_ref + offset M_ref``, the matrices at the reference values without selected terms.
    model_fingerprint : str
        Of the full model.
    names : tuple of str
        All parameters of the model, the columns of the arrays below; each in its own unit.
    reference, lower, upper : ndarray (n_names,)
        Reference values of the inner product, and limits of training (equal where a parameter was fixed).
    offset : float
        1/s^2; 0 unless the model has rigid-body motions.
    count : int
        Number of modes it was trained for; 0 for FRFs.
    freq_max, damping_max : float
        Modes above this natural frequency in Hz or this damping ratio are exempt from the tolerance; of FRFs the
        highest line, and no limit.
    tolerance : float
        Target relative eigenvalue error; of FRFs the largest error in units of the standard deviation.
    samples : ndarray (n_samples, n_names)
        Points whose full-order solutions are in the basis.
    checks : ndarray (n_checks, 4)
        Every validation point of the training: round, size of the basis, largest error indicator there, and largest
        error against the full model where it was solved too (else NaN): of eigenvalue or shape (infinite for a missed
        mode), or of an FRF in units of the standard deviation.
    request : str
        Hash of the FRFs it was trained for; empty for modes.
    seed, version : int
        The version is incremented whenever vectors are added.
    key : str
        Hash of everything that it depends on, under which it is kept; empty where it is not.
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
    request: str = ""
    key: str = ""

    def __post_init__(self) -> None:
        for name in _ARRAYS:
            array = np.asarray(getattr(self, name), dtype=float)
            if array.flags.writeable:  # what another basis holds is shared, not copied: it may be hundreds of megabytes
                array = array.copy()
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
            out.update(np.ascontiguousarray(getattr(self, name)).ravel().data)
        return out.hexdigest()[:16]

    def table(self) -> pd.DataFrame:
        """Validation points of the training: columns ``round, size, indicator, error`` as in `checks`."""
        import pandas as pd

        table = pd.DataFrame(self.checks, columns=list(CHECK_COLUMNS))
        return table.astype({"round": int, "size": int})

    def covers(self, space: ParameterSpace) -> bool:
        """Whether a space lies within the training limits."""
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

    def _with_room(self, more: int) -> np.ndarray:
        """The vectors with one for each further degree of freedom, at least ``more`` of them.

        What is carried to one model or another is a part of the same array, not a copy.
        """
        room = self._room
        if room.wide is None or room.wide.shape[1] < self.size + more:
            wider = max(more, _ROOM)
            wide = np.zeros((len(self.vectors) + wider, self.size + wider))
            wide[: len(self.vectors), : self.size] = self.vectors
            wide[len(self.vectors) :, self.size :] = np.eye(wider)
            wide.setflags(write=False)
            room.wide, own = wide, wide[: len(self.vectors), : self.size]
            for one in list(room.shared):  # the vectors are not kept a second time
                object.__setattr__(one, "vectors", own)
        return room.wide

    @cached_property
    def _room(self) -> _Room:
        return _Room(self)

    def _share(self, room: _Room) -> None:
        self.__dict__["_room"] = room
        room.shared.add(self)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_room"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        for name in _ARRAYS:
            state[name].setflags(write=False)

    def carried(self, space: ParameterSpace, n_dof: int) -> Basis:
        """The basis of an extended model, which lists the degrees of freedom and parameters of the base model first.

        Parameters
        ----------
        space : ParameterSpace
            Of the extended model; added parameters are free within their limits.
        n_dof : int
            Of the extended model; each added degree of freedom becomes a vector.
        """
        more = n_dof - len(self.vectors)
        vectors = self._with_room(more)[:n_dof, : self.size + more] if more else self.vectors
        own = space.parameters[len(self.names) :]

        def wider(array: np.ndarray, ends: list[float]) -> np.ndarray:
            return np.hstack([array, np.broadcast_to(ends, (*array.shape[:-1], len(own)))])

        out = replace(
            self,
            vectors=vectors,
            names=space.names,
            reference=wider(self.reference, [p.value for p in own]),
            lower=wider(self.lower, [p.lower for p in own]),
            upper=wider(self.upper, [p.upper for p in own]),
            samples=wider(self.samples, [p.value for p in own]),
            count=self.count + more,
        )
        if not more:
            out._share(self._room)
        return out

    # -- files ---------------------------------------------------------------------------------------------------------

    def _header(self) -> str:
        fields = {
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
            "request": self.request,
            "key": self.key,
        }
        return json.dumps(fields, sort_keys=True)

    def save(self, path: Path) -> None:
        """Write one ``.npz`` file, atomically."""
        try:
            with replacing(path) as draft:
                self.write(draft)
        except OSError as fault:
            raise InputError(f"the reduced basis cannot be written ({fault})", place=path) from None

    def write(self, path: Path) -> None:
        """Write one ``.npz`` file; OSError when it cannot be written."""
        with path.open("wb") as file:
            np.savez(
                file,
                header=np.array(self._header()),
                digest=np.array(self.digest),
                **{name: getattr(self, name) for name in _ARRAYS},
            )

    @staticmethod
    def load(path: Path) -> Basis:
        """Read a file written by `save`; InputError when it is missing, damaged or of another kind."""
        remedy = "delete it and train again"
        try:
            with np.load(path, allow_pickle=False) as file:
                stored = {name: file[name] for name in (*_ARRAYS, "header", "digest")}
            header = json.loads(str(stored["header"]))
            if header.pop("format") != _FORMAT:
                raise InputError("it is not a reduced basis of this version", place=path, remedy=remedy)
            header["names"] = tuple(header["names"])
            basis = Basis(**{name: stored[name] for name in _ARRAYS}, **header)
        except FileNotFoundError:
            raise InputError("there is no such file", place=path) from None
        except InputError:
            raise
        except Exception as fault:  # a damaged archive raises errors of the zip, zlib, json or numpy layer
            words = f"it is not a readable reduced basis ({type(fault).__name__}: {fault})"
            raise InputError(words, place=path, remedy=remedy) from None
        if basis.digest != str(stored["digest"]):
            raise InputError("the reduced basis is damaged: its digest differs", place=path, remedy=remedy)
        return basis
