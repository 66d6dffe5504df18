"""Keys of ``study.toml`` on fits and searches, with type, default and validation."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, field_validator

from calib.study.measurement_settings import NAME, DesignName, PathText, Section, Seed, Share, WrongBelow


class CaseSettings(Section):
    """``[[calibration.cases]]``: one run of the search from its own initial population."""

    name: str = Field(pattern=NAME, max_length=100)
    """Label of the case."""
    seed: Seed
    """Seed of its initial population."""


class ReductionSettings(Section):
    """``[reduction]``: fits and searches on a reduced basis; reported results are always solved at full order."""

    use: bool = True
    """Whether searches of large models use a reduced basis."""
    tolerance: float = Field(default=1e-5, gt=0, lt=0.1)
    """Relative error of an eigenvalue up to which the basis counts as trained; FRFs may be off by 0.05 standard
    deviations."""
    seed: Seed = 1
    """Seed of the points that train the basis."""


class CalibrationSettings(Section):
    """``[calibration]``: genetic searches from independent populations, and least squares after them."""

    method: Literal["auto", "genetic", "gauss-newton", "cmcf"] = "auto"
    """Least squares from random starts until they agree, else a genetic search too, at once where integer parameters
    have more than 25 combinations; genetic search followed by least squares; least squares alone from several starts;
    or of FRFs the linear cross-model equations alone (Li and Hong 2012), with which least squares on FRFs begin too."""
    refine: bool = True
    """Whether least squares follow a search."""
    starts: int = Field(default=6, ge=1, le=10_000)
    """Starts of ``gauss-newton``; on FRFs more where the fit from these is rejected."""
    time_limit: float = Field(default=3600.0, gt=0, le=1e7)
    """Longest time of one evaluation of a function of your own, s."""
    weight_freq: float = Field(default=1.0, ge=0, le=1e12)
    """Weight of the frequency errors in the objective of the search."""
    weight_mac: float = Field(default=1.0, ge=0, le=1e12)
    """Weight of 1 - MAC in the objective of the search."""
    population: int = Field(default=30, ge=4, le=100_000)
    """Individuals of a generation."""
    generations: int = Field(default=250, ge=2, le=1_000_000)
    """Generations of a search."""
    crossover: Share = 0.5
    """Probability of crossover."""
    mutation: Share = 0.15
    """Probability that a parameter mutates."""
    sigma_start: float = Field(default=0.10, gt=0, le=1)
    """Standard deviation of a mutation in the first generation, over the range of the parameter."""
    sigma_end: float = Field(default=0.01, gt=0, le=1)
    """The same in the last generation."""
    freq_kind: Literal["natural", "damped"] = "natural"
    """Which frequencies the table and the figure of all measured modes hold: ``|lambda|/2pi``, as the mean errors and
    the fit, or ``Im lambda/2pi``."""
    begin_at: dict[str, float] | DesignName = Field(default_factory=dict)
    """A further start of least squares, besides the end of each search: parameters in their own units, or an evaluated
    design by its number, ``"design 4711"``."""
    start_population: PathText | tuple[DesignName, ...] | tuple[dict[str, float], ...] = ()
    """First individuals of every search, before sampled ones: a CSV with a column for each searched parameter and a
    design a row, or evaluated designs, ``["design 12", "design 4711"]``, or their values."""
    varies: tuple[str, ...] = ()
    """Parameters with a value of their own in each of three or more tests, such as specimens, whose mean and spread are
    estimated after the fit."""
    cases: tuple[CaseSettings, ...] = Field(default=(CaseSettings(name="C1", seed=1),), min_length=1)
    """Independent searches; agreement between them is reported for each parameter."""

    @property
    def begin_values(self) -> dict[str, float]:
        """Values of ``begin_at``; none for a design, whose values the ledger has."""
        return {} if isinstance(self.begin_at, str) else self.begin_at

    @property
    def start_file(self) -> str:
        """The file of ``start_population``; empty where it is none."""
        return self.start_population if isinstance(self.start_population, str) else ""

    @field_validator("cases")
    @classmethod
    def _distinct(cls, cases: tuple[CaseSettings, ...]) -> tuple[CaseSettings, ...]:
        names = [case.name for case in cases]
        for k, name in enumerate(names):
            if name in names[:k]:
                raise WrongBelow(f"two cases are named {name!r}", k, "name")
        return cases


class ParetoSettings(Section):
    """``[pareto]``: search for the trade-off between two groups of responses."""

    objectives: dict[str, tuple[str, ...]] = {}
    """The two groups by name, each a list of responses in which ``*`` stands for any text: ``{ low =
    ["natural_freq_1*", "mac_1*"], high = ["natural_freq_2*"] }``. By default frequencies against MAC."""
    population: int = Field(default=40, ge=4, le=100_000)
    """Individuals of a generation; ``crossover``, ``mutation`` and ``sigma`` are those of ``[calibration]``."""
    generations: int = Field(default=50, ge=2, le=1_000_000)
    """Generations of the search."""
    seed: Seed = 1
    """Seed of the initial population."""

    @field_validator("objectives")
    @classmethod
    def _two(cls, objectives: dict[str, tuple[str, ...]]) -> dict[str, tuple[str, ...]]:
        if objectives and len(objectives) != 2:
            raise ValueError(f"{len(objectives)} groups of responses are named, and a front is of two")
        for name, responses in objectives.items():
            if not responses:
                raise WrongBelow(f"group {name!r} names no response", name)
        return objectives
