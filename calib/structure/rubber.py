"""Effects of rubber and joints: parts of a model that relax, or dissipate by a loss factor.

Any model with named parts of stiffness, or named matrices, can lack them. They are in no library of a model unless it
lists them: each further candidate raises the evidence that a name takes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial

import numpy as np

from calib.errors.arguments import parts_once
from calib.problem.effect import Effect
from calib.problem.space import Parameter
from calib.structure.relaxation import band_of, lossy_parts, relaxing_parts

_MOST_LOSS = 0.6
"""Largest loss factor; there it is constant within a fifth over a band of two decades."""


def structural_damping(
    name: str, of: str, parts: Sequence[str], band: tuple[float, float], plausible: float = 0.1
) -> Effect:  # fmt: skip
    """The effect that parts dissipate by a loss factor that does not depend on frequency (hysteretic damping).

    Its magnitude is the loss factor eta: a mode whose strain energy is all in these parts gains a damping ratio of
    about eta/2.

    Parameters
    ----------
    name : str
        Of the effect and its magnitude.
    of : str
        The parts in words, such as ``the primary springs``.
    parts : sequence of str
        Their names in the model.
    band : (float, float)
        Of the test, Hz; see `calib.structure.relaxation.ConstantLoss`.
    plausible : float
        Large but plausible loss factor: 0.02 for bolted steel, 0.1 for natural rubber, 0.3 for a lossy one.

    Examples
    --------
    >>> from calib.structure.rubber import structural_damping
    >>> effect = structural_damping("block_loss", "the rubber blocks", ["blocks"], band=(4.0, 40.0))
    >>> effect.in_words, effect.plausible
    ('structural damping of the rubber blocks', 0.1)
    """
    parts, band = parts_once(parts, name), band_of(band, f"effect {name}, band")
    return Effect(
        name=name,
        title=f"Structural damping of {of}",
        phrase=f"structural damping of {of}",
        lacks=f"The stiffness of {of} has no loss of its own.",
        look_for=f"Rubber, bolted or layered joints in {of}: the loss factor by the supplier or a test of one.",
        magnitude=Parameter(
            name, 0.0, 0.0, _MOST_LOSS, "-", prior_sd=plausible,
            description=f"loss factor of {of}, the same at all frequencies",
        ),
        build=partial(lossy_parts, parts=parts, loss_factor=name, band=band),
        grid=({name: plausible},),
    )  # fmt: skip


def relaxing_rubber(
    name: str, of: str, parts: Sequence[str], corner: tuple[float, float], plausible: float = 0.3
) -> Effect:  # fmt: skip
    """The effect that parts relax: stiffer when moved quickly than slowly, and lossy between.

    Its magnitude is the additional stiffness for quick motion over the slow one; the nuisance parameter ``<name>_freq``
    is the corner frequency; see `calib.structure.relaxation.relaxing_parts`.

    Parameters
    ----------
    name, of, parts
        As in `structural_damping`.
    corner : (float, float)
        Limits of the corner frequency, Hz: about the band of the test.
    plausible : float
        Large but plausible magnitude.

    Examples
    --------
    >>> from calib.structure.rubber import relaxing_rubber
    >>> effect = relaxing_rubber("soft_block", "the rubber blocks", ["blocks"], corner=(2.0, 50.0))
    >>> effect.names
    ('soft_block', 'soft_block_freq')
    """
    parts, (low, high) = parts_once(parts, name), band_of(corner, f"effect {name}, corner")
    freq = f"{name}_freq"
    middle = math.sqrt(low * high)
    return Effect(
        name=name,
        title=f"Relaxing rubber in {of}",
        phrase=f"rubber that relaxes in {of}",
        lacks=f"The stiffness of {of} is the same at all frequencies.",
        look_for=f"Rubber in {of}: dynamic over static stiffness from the supplier; creep after loading.",
        magnitude=Parameter(
            name, 0.0, 0.0, 20 * plausible, "-", prior_sd=plausible,
            description=f"stiffness that {of} gain when moved quickly, over that when moved slowly",
        ),
        build=partial(relaxing_parts, parts=parts, share=name, corner_freq=freq),
        nuisance=(
            Parameter(
                freq, middle, low, high, "Hz", prior_sd=middle,
                description="frequency at which the damper is as stiff as the spring in series with it",
            ),
        ),
        grid=tuple({name: plausible, freq: f} for f in np.geomspace(low, high, 5)[1:-1].tolist()),
    )  # fmt: skip
