"""Modes of a model, real or complex, and eigenvalues excluded from them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

EigenvalueKind = Literal["zero", "spin", "overdamped"]


@dataclass(frozen=True)
class ExcludedEigenvalue:
    """An eigenvalue that is not a vibration mode and is never paired.

    Attributes
    ----------
    kind : {"zero", "spin", "overdamped"}
        Rigid-body motion or mechanism, rotation of a part about its own axis, or real eigenvalue of an overdamped pair,
        which decays without oscillation.
    eigenvalue : complex
        lambda in rad/s.
    """

    kind: EigenvalueKind
    eigenvalue: complex


@dataclass(frozen=True)
class Modes:
    """Vibration modes in ascending natural frequency.

    Attributes
    ----------
    natural_freq, damped_freq : ndarray (n_modes,)
        Hz, ``|lambda|/2pi`` and ``Im(lambda)/2pi``.
    damping_ratio : ndarray (n_modes,)
        ``-Re(lambda)/|lambda|``.
    shapes : ndarray (n_dof, n_modes)
        Real, mass-normalised, for an undamped model; complex for a damped one (displacement part of the state vector,
        ``psi^T (2 lambda M + C) psi = 1``).
    excluded : tuple of ExcludedEigenvalue
    groups : tuple of tuple of int
        Modes that were turned inside the subspace that they span, where single directions mean nothing.
    """

    natural_freq: np.ndarray
    damped_freq: np.ndarray
    damping_ratio: np.ndarray
    shapes: np.ndarray
    excluded: tuple[ExcludedEigenvalue, ...] = ()
    groups: tuple[tuple[int, ...], ...] = ()

    @property
    def n_modes(self) -> int:
        """Number of vibration modes."""
        return len(self.natural_freq)

    def subset(self, index: Sequence[int] | np.ndarray) -> Modes:
        """Some of the modes, in the order of the indices; the excluded eigenvalues stay."""
        index = np.asarray(index, dtype=int)
        place = {int(j): k for k, j in enumerate(index)}
        groups = (tuple(place[j] for j in group if j in place) for group in self.groups)
        return Modes(
            self.natural_freq[index], self.damped_freq[index], self.damping_ratio[index], self.shapes[:, index],
            self.excluded, tuple(group for group in groups if len(group) > 1),
        )  # fmt: skip

    @property
    def is_complex(self) -> bool:
        """Whether the shapes are complex."""
        return np.iscomplexobj(self.shapes)
