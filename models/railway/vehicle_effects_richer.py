"""Richer members of the vehicle's effects: uneven mounts and unknown inertia, seats that sway, air in a pipe."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np
import scipy.sparse as sp

from calib import Effect, Parameter, StructuralModel
from calib.structure import GRAVITY, Addition, Grown, Monomial, Term, maxwell_branches

UNEVEN, LIGHTER = 0.3, (0.6, 1.6)
"""Plausible unevenness of mounts, and rotary inertia over that of a uniform box, where a search starts."""

GROWN_AIR = 1e3
"""Added stiffness in N/m at which the air of a surging spring has half of its mass: far below any that matters."""


def uneven_unit(
    listed: Mapping[str, str], name: str, magnitude: Parameter, shared: tuple[Parameter, ...],
    build: Callable[..., Addition],
) -> Effect:  # fmt: skip
    """A unit on elastic mounts that are stiffer at one end than at the other, its rotary inertia its own.

    The listed effect is a uniform box on equal mounts. Real units carry transformers at one end, and mounts age.

    Parameters
    ----------
    listed : mapping from str to str
        Attributes ``title``, ``phrase``, ``lacks`` and ``look_for`` of the listed effect.
    name : str
        Of the effect.
    magnitude : Parameter
        Of the listed effect.
    shared : tuple of Parameter
        Its nuisance parameters.
    build : callable
        From a model, with the names of the magnitude, of the factor on the rotary inertia and of the unevenness.
    """
    inertia, uneven = f"{name}_inertia", f"{name}_uneven"
    own = {p.name: p.value for p in shared}
    return Effect(
        name=name,
        title=f"{listed['title']}, its mounts uneven",
        phrase=f"{listed['phrase']}, its mounts uneven",
        lacks=listed["lacks"],
        look_for=f"{listed['look_for']} Mounts of two kinds, or a heavy end.",
        magnitude=replace(magnitude, name=name),
        build=partial(build, name=name, inertia=inertia, uneven=uneven),
        nuisance=(
            *shared,
            Parameter(
                inertia, 1.0, 0.3, 3.0, "-", prior_sd=0.4,
                description="its moments of inertia over those of a uniform box of its size",
            ),
            Parameter(
                uneven, 0.0, -0.8, 0.8, "-", prior_sd=UNEVEN,
                description="gain of the stiffness of its front mounts over the mean, and loss of its rear ones",
            ),
        ),
        grid=tuple(
            {name: 1.7, **own, inertia: size, uneven: u} for u in (UNEVEN, -UNEVEN) for size in LIGHTER
        ),
    )  # fmt: skip


def swaying_seats(
    magnitude: Parameter, damping_ratio: float, build: Callable[..., Addition]
) -> Effect:  # fmt: skip
    """Passenger seats that also sway across the car, with a damping ratio of their own.

    Parameters
    ----------
    magnitude : Parameter
        Of the listed effect.
    damping_ratio : float
        Of the listed effect.
    build : callable
        From a model, with the names of magnitude, lateral over vertical natural frequency, and damping ratio.
    """
    name, sideways, ratio = "swaying_seats", "swaying_seats_sideways", "swaying_seats_ratio"
    return Effect(
        name=name,
        title="Passenger seats bounce and sway on the floor",
        phrase="passenger seats that bounce and sway on the floor",
        lacks="The seats move rigidly with the floor.",
        look_for="Light seat frames on few fixings: push a seat down and aside, let go and watch it.",
        magnitude=replace(magnitude, name=name),
        build=partial(build, name=name, sideways=sideways, ratio=ratio),
        nuisance=(
            Parameter(
                sideways, 1.0, 0.3, 10.0, "-", prior_sd=1.0,
                description="lateral over vertical natural frequency of a seat on the floor",
            ),
            Parameter(
                ratio, damping_ratio, 0.01, 0.3, "-", prior_sd=0.05, description="damping ratio of a seat on the floor"
            ),
        ),
        grid=tuple({name: 0.5, sideways: side, ratio: damping_ratio} for side in (0.5, 1.0, 2.0)),
    )  # fmt: skip


def loosened_two_ways(
    upright: np.ndarray, sideways: np.ndarray, sag: str, freq_ratio: str, damping_ratio: str
) -> Addition:  # fmt: skip
    """As `loosened_masses` in two directions, sideways at a multiple of the upright frequency.

    Parameters
    ----------
    upright, sideways : ndarray (n_rows, n_dof)
        Motions of the masses, times the root of the mass.
    sag, freq_ratio, damping_ratio : str
        Names of the parameters: static deflection, lateral over upright natural frequency, damping ratio of both.
    """
    n, count = upright.shape[1], len(upright) + len(sideways)
    root, first = 1 / math.sqrt(GRAVITY), 0
    terms: dict[str, list[Term]] = {"stiffness": [], "damping": [], "mass": []}
    for name, rows, power in (("upright", upright, 0.0), ("sideways", sideways, -1.0)):
        here = np.zeros(count)
        here[first : first + len(rows)] = 1.0
        own = sp.csr_array(sp.block_diag([sp.csr_array((n, n)), sp.diags_array(here)]))
        cross = np.zeros((count, n))
        cross[first : first + len(rows)] = rows
        upper = sp.hstack([sp.csr_array((n, n)), sp.csr_array(cross.T)])
        coupling = sp.csr_array(sp.vstack([upper, sp.hstack([sp.csr_array(cross), sp.csr_array((count, count))])]))
        slower = ((freq_ratio, power),) if power else ()
        twice = ((freq_ratio, 2 * power),) if power else ()
        terms["stiffness"].append(Term(f"{sag}: springs {name}", own))
        terms["damping"].append(
            Term(f"{sag}: dampers {name}", own, Monomial(2 * root, ((damping_ratio, 1.0), (sag, 0.5), *slower)))
        )
        terms["mass"] += [
            Term(f"{sag}: coupling {name}", coupling, Monomial(root, ((sag, 0.5), *slower))),
            Term(f"{sag}: own {name}", own, Monomial(1 / GRAVITY, ((sag, 1.0), *twice))),
        ]
        first += len(rows)
    return Addition(tuple(terms["stiffness"]), tuple(terms["damping"]), tuple(terms["mass"]), n_added=count)


def surging_spring(listed: Effect, rows: Callable[[StructuralModel], list[np.ndarray]]) -> Effect:
    """Air springs whose reservoir is joined by a pipe, in which the air surges (Berg 1999).

    Parameters
    ----------
    listed : Effect
        Air springs with an orifice; the stiffness and corner frequency mean the same.
    rows : callable
        Elongations of the air springs of a model.
    """
    name, surge = "surging_air_spring", "surging_air_spring_surge"
    (corner,) = listed.nuisance
    return Effect(
        name=name,
        title="Air springs with reservoirs behind pipes",
        phrase="air springs with reservoirs behind pipes, beside the secondary springs",
        lacks=listed.lacks,
        look_for="Air bellows with a reservoir behind a long pipe: its length and bore.",
        magnitude=replace(listed.magnitude, name=name),
        build=partial(_surging, rows=rows, name=name, corner=corner.name, surge=surge),
        nuisance=(
            corner,
            Parameter(
                surge, 12.0, 2.0, 200.0, "Hz", prior_sd=12.0,
                description="frequency at which the air in the pipe resonates with the stiffness added",
            ),
        ),
        grid=tuple({name: 150.0, corner.name: f, surge: s} for f in (0.4, 1.5, 5.0) for s in (4.0, 12.0)),
    )  # fmt: skip


def _surging(
    model: StructuralModel, rows: Callable[[StructuralModel], list[np.ndarray]], name: str, corner: str, surge: str
) -> Addition:
    """The stroke g of a Maxwell element with the mass of the air: ``g + g'/(2 pi f) + g''/(2 pi s)^2`` balances it.

    The air grows with the stiffness, see `GROWN_AIR`: without stiffness it has no mode beside those of the base model.
    """
    elongations = rows(model)
    branches = maxwell_branches(elongations, name, corner)
    own = np.concatenate([np.zeros(model.n_dof), np.ones(len(elongations))])
    diagonal = sp.csr_array(sp.diags_array(own))
    diagonal.eliminate_zeros()
    mass = Grown(Monomial((2 * math.pi) ** -2, ((surge, -2.0),)), name, GROWN_AIR)
    air = Term(f"{name}: air in the pipes", diagonal, mass)
    return Addition(branches.stiffness, branches.damping, (air,), n_added=branches.n_added)
