"""Plausible sizes and limits of changes of a model's parts, and when a mode of a changed model is the same one."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ModelRules:
    """Constants of changed models; `record.json` holds those of a result.

    Attributes
    ----------
    relative : float
        Plausible relative change of a part.
    less : float
        Smallest relative change of a part: to a tenth.
    more : float
        The largest: to ten times.
    damper_less : float
        Smallest relative change of a damper: it may fail, but the model needs its springs and masses.
    local : float
        Plausible stiffness of a grounded spring, over the local stiffness at the reference values.
    heavy : float
        Plausible added mass, over the mass of the model that moves in that direction.
    added_most : float
        Largest spring or mass at a sensor, over the plausible one.
    lossy : float
        Plausible loss factor of a part at the middle of the measured band.
    lagging : float
        Plausible lag of a damper on its mount, over that at which it has half of its damping at the middle of the
        measured band.
    mount_grid : tuple of float
        Magnitudes, over the plausible one, at which the signature of a damper mount is taken.
    soft : float
        Plausible flexibility in series with a support, over that of the support.
    same_joint : float
        Distance of springs between the same bodies that count as one joint, over the size of the model.
    further_places : int
        Most places between sensors at which a composed mass may be.
    further_apart : float
        Their least distance from others, over the size of the model.
    free_flat : float
        Distance from a line or plane, over that from its point, from which a node lies off the beam or surface on which
        the place of a mass is free.
    free_wider : float
        Distance of the nodes from which the motion there is interpolated, over that of the places.
    free_nodes : int
        Most of these nodes.
    free_degrees : tuple of int
        Largest degrees of the polynomial along a beam and on a surface.
    free_unturned : int
        The same where no rotations are known.
    free_spare : tuple of float
        Least number of known motions along a beam and on a surface, over that of coefficients that they determine.
    beam_ends : int
        Most ends of beams, those nearest to sensors, that composed effects soften.
    neighbours : int
        Nearest sensors of the same direction to which a sensor may be joined in a composed effect.
    hung_points : int
        Natural frequencies at which the signature of a hung mass is taken.
    hung_ratio : float
        Damping ratio of a hung mass on a fixed base: that of rubber mounts.
    successor : float
        MAC below which a mode has no successor at another point: it has left the solved modes. Where two modes veer,
        the MAC over a step is at least a half.
    smooth : float
        MAC below which a successor is a different mixture of modes: it gives a frequency derivative, but no shape's.
    halvings : int
        Number of times a path with apparent crossings is halved where modes without shapes are tracked.
    null_pivot : float
        Pivot of stiffness and mass, scaled to a diagonal of 1, above which no motion without either is looked for.
    null_force : float
        Force on such a motion, over that of its entries without their signs, below which it has none: exports have 13
        digits.
    crossed : float
        Largest 1 - MAC of a crossing accepted at once, over that of the weakest coupling the shortest step resolves.
    """

    relative: float = 0.3
    less: float = -0.9
    more: float = 9.0
    damper_less: float = -1.0
    local: float = 0.1
    heavy: float = 0.01
    added_most: float = 20.0
    lossy: float = 0.1
    lagging: float = 0.5
    mount_grid: tuple[float, ...] = (0.5, 2.0)
    soft: float = 5.0
    same_joint: float = 0.1
    further_places: int = 12
    further_apart: float = 0.1
    free_flat: float = 0.1
    free_wider: float = 1.6
    free_nodes: int = 40
    free_degrees: tuple[int, int] = (8, 6)
    free_unturned: int = 3
    free_spare: tuple[float, float] = (1.0, 1.5)
    beam_ends: int = 60
    neighbours: int = 3
    hung_points: int = 7
    hung_ratio: float = 0.03
    successor: float = 0.3
    smooth: float = 0.9
    halvings: int = 5
    crossed: float = 0.25
    null_pivot: float = 1e-6
    null_force: float = 1e-12


RULES = ModelRules()
"""Constants in force."""
