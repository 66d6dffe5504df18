"""Designs of candidate measurements from columns of random numbers."""

import math
from dataclasses import replace

import numpy as np
from hypothesis import strategies as st

from calib.missing.competing import BayesFactor, CandidateMeasurement
from calib.missing.recommendation import HELD_OUT, ExperimentalDesign, Linearisation, recommendation

P, M, MORE = 3, 4, 6


def sentence_of(*given):
    """The recommendation in words; empty without one. Its short form names the same measurements."""
    found = recommendation(*given)
    if found is None:
        return ""
    table = given[0]
    names = [name.removesuffix(HELD_OUT) for name in table["measurement"].unique()]
    named = [name for name in names if name in found.short]
    assert all(name in found.sentence for name in named) and (named or "No measurement" in found.short)
    return found.sentence


TWICE = CandidateMeasurement("twice the repeats", "repeats", scale=1 / math.sqrt(2))
SENSOR = CandidateMeasurement("a sensor on the roof", "sensor", rows=np.arange(20) >= 20 - MORE)


def design(seed=0, prior=1.0, measurements=(TWICE, SENSOR), scale=1.0):
    rng = np.random.default_rng(seed)
    n = 20
    prior_sd = prior * rng.uniform(0.5, 2.0, P)
    slope, columns = scale * rng.standard_normal((n, P)), rng.standard_normal((n, M))
    linearisation = Linearisation(tuple(f"P{k}" for k in range(P)), prior_sd, slope, columns)
    return ExperimentalDesign(
        tuple(f"E{k}" for k in range(M)), np.arange(n) < n - MORE, tuple(measurements), (linearisation,)
    )


def with_columns(p, columns):
    return replace(p, linearisations=(replace(p.linearisations[0], columns=columns),))


def projected(p, measurement=None):
    """Signatures after projection, by plain least squares."""
    (linearisation,) = p.linearisations
    rows = p.measured if measurement is None or measurement.rows is None else p.measured | measurement.rows
    scale = 1.0 if measurement is None else measurement.scale
    known = {} if measurement is None else measurement.prior_sd
    sd = [min(s, known.get(n, np.inf)) for n, s in zip(linearisation.names, linearisation.prior_sd, strict=True)]
    a = np.vstack([linearisation.slope[rows] / scale, np.diag(1 / np.array(sd))])
    c = np.vstack([linearisation.columns[rows] / scale, np.zeros((P, M))])
    return c - a @ np.linalg.lstsq(a, c, rcond=None)[0]


def sizes(p, measurement=None):
    return p.sizes(measurement)[0]


measurements = st.sampled_from(
    [
        None,
        TWICE,
        SENSOR,
        CandidateMeasurement("a bench test", "bench", prior_sd={"P1": 0.05}),
        CandidateMeasurement("all at once", "bench", rows=SENSOR.rows, scale=0.7, prior_sd={"P0": 0.1, "P2": 0.01}),
    ]
)


class Told:
    """Competing models with a given Bayes factor."""

    names = ("E0", "E1")

    def __init__(self, bayes_factor):
        self.bayes_factor = lambda measurement: bayes_factor[measurement.name]


def apart(roof=5.0, twice=0.5):
    bayes_factor = {
        SENSOR.name: BayesFactor(roof, roof - 2, roof + 2, 0.9),
        TWICE.name: BayesFactor(twice, -1.0, 2.0, 0.1),
    }
    return replace(design(), competing=Told(bayes_factor))
