"""Measured modes that look like one mode which the analysis found twice."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from calib.correlation.modal.comparison import Comparison
from calib.correlation.rules import RULES
from calib.measurement.mac import mac


class FoundTwice(NamedTuple):
    """Two measured modes that are hardly two.

    Attributes
    ----------
    first, second : str
        Measured modes.
    apart : float
        Difference of their natural frequencies, over their mean.
    mac : float
        MAC of their shapes.
    """

    first: str
    second: str
    apart: float
    mac: float

    @property
    def check(self) -> str:
        """What to check."""
        return f"modes {self.first} and {self.second}, which look like one mode found twice"

    @property
    def sentence(self) -> str:
        """The doubt in words, with what it rests on and the remedy."""
        return (
            f"Modes {self.first} and {self.second} look like one mode that the analysis found twice: they are "
            f"{100 * self.apart:.2g} % apart with a MAC of {self.mac:.3f}, and the model has one mode of that shape "
            "only. Leave out one of them."
        )


def found_twice(comparison: Comparison) -> tuple[FoundTwice, ...]:
    """Pairs of measured modes of nearly one frequency and one shape, of which the model has one mode only.

    A small mass on a spring splits a mode into two of one shape as well, but by the root of its mass over that of the
    mode (Den Hartog 1956): within `CompareRules.twice_near` it weighs less than a ten-thousandth. No pair is told where
    the model has several modes of that shape up to `CompareRules.far_error` away, and where the shape of another
    measured mode looks the same too: then the sensors do not tell modes apart.

    Parameters
    ----------
    comparison : Comparison
        Of a model at any values with measured modes; without shapes nothing is told.
    """
    measured = comparison.measured
    if not measured.has_shapes or len(measured.names) < 2:
        return ()
    freq, between = measured.natural_freq, mac(measured.shapes, measured.shapes)
    near = abs(comparison.modes.natural_freq / freq[:, None] - 1.0) < RULES.far_error
    alike = near & (np.nan_to_num(comparison.mac) > RULES.twice_like)
    out = []
    for i, j in itertools.combinations(np.argsort(freq, kind="stable").tolist(), 2):
        apart = float(abs(freq[j] - freq[i]) / (0.5 * (freq[i] + freq[j])))
        same = apart < RULES.twice_near and between[i, j] > RULES.twice_mac
        others = np.delete(np.nan_to_num(between), [i, j], axis=1)[[i, j]]
        if same and int((alike[i] | alike[j]).sum()) == 1 and not (others > RULES.twice_like).any():
            out.append(FoundTwice(measured.names[i], measured.names[j], apart, float(between[i, j])))
    return tuple(out)
