"""Constants of what the analyses conclude from their tables, and of what they imagine to be measured or wrong."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class AnalysisRules:
    """Constants of the analyses themselves; `record.json` holds those of a result.

    Attributes
    ----------
    off : float
        Standard deviations beyond which a scalar response counts as off, and all FRFs together do.
    fallen : float
        Ratio of two errors below which the second counts as reduced: less hardly shows in the two printed decimals.
    unsettled : float
        Difference between calibrated and explained magnitude, in standard deviations, above which one has not
        converged.
    within : float
        p-value of a correctly specified model above which an error counts as noise.
    own_mode : float
        Share of the kinetic energy above which a mode is an effect's own. The shares of one degree of freedom in all
        modes of an undamped model add up to 1, so that it has at most one such mode.
    mesh_score : float
        Largest score that the discretisation error may cause.
    mesh_fits : int
        Fits after each of which the mesh and a finer one are compared; the first has no error of the mesh, which biases
        it.
    basis_error : float
        Largest difference of whitened residuals on the reduced basis from full order, in standard deviations.
    misread : float
        Plausible measurement error of a part of a function's results: of its scale, or of its offset over its mean
        size.
    bench : float
        Relative standard deviation of a parameter after a bench test of its part.
    together : int
        Sensors in one candidate measurement.
    sensor_places : int
        Candidate locations of a further sensor of modes, in three directions each.
    more_modes : int
        Candidate modes beyond those measured.
    held_out_near : float
        Relative distance in frequency within which a model mode is identified with a held-out one.
    overdamped : float
        Damping ratio above which a test does not identify a mode.
    alike : float
        MAC with the mode of the fit above which a mode counts as the same in an imagined measurement. Two modes that
        mix in equal parts have a MAC of 0.5, and a test could name neither.
    frf_places : int
        Candidate locations of a further response sensor of FRFs, in three directions each.
    frf_forces : int
        Candidate further references, each at a response sensor that is there.
    """

    off: float = 2.0
    fallen: float = 0.98
    unsettled: float = 2.0
    within: float = 0.05
    own_mode: float = 0.5
    mesh_score: float = 1.0
    mesh_fits: int = 2
    basis_error: float = 0.05
    misread: float = 0.1
    bench: float = 0.03
    together: int = 4
    sensor_places: int = 40
    more_modes: int = 3
    held_out_near: float = 0.1
    overdamped: float = 0.9
    alike: float = 0.6
    frf_places: int = 12
    frf_forces: int = 6


RULES = AnalysisRules()
"""Constants in force."""
