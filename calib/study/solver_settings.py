"""Keys of ``[model]``, a solver that is started for every evaluation, and of ``[compute]``, who evaluates."""

from __future__ import annotations

import shlex
from typing import Any, Literal

from pydantic import Field, field_validator

from calib.study.measurement_settings import Pair, PathText, Section

EXECUTOR = r"^(processes|dask(://[^\s/]+:\d+)?)$"
"""Who evaluates points, as a study names it."""


class ComputeSettings(Section):
    """``[compute]``: who evaluates the points of samples, searches and derivatives; results are the same."""

    executor: str = Field(default="processes", pattern=EXECUTOR)
    """``"processes"`` on this machine; ``"dask"``, a Dask cluster that is started on this machine, or
    ``"dask://HOST:PORT"``, one that runs already, in a trusted network. ``--executor`` overrides it."""


class SolverParameterSettings(Section):
    """``[model.parameters.NAME]``: a parameter of the decks, where it stands as ``{{ NAME }}``."""

    value: float
    """Nominal value, in the unit of the deck."""
    limits: Pair
    """Lower and upper limit."""
    unit: str = "-"
    """Unit of the deck, such as MPa."""
    prior_sd: float | None = Field(default=None, gt=0)
    """Standard deviation of the prior; by default that of a uniform distribution between the limits."""
    integer: bool = False
    """Whether it takes integers only."""
    powers: tuple[int, ...] = (1,)
    """Powers that occur in the matrices, for ``calib import``: ``[-1, 1, 2, 3]`` for a thickness; 0 always does."""

    @field_validator("powers")
    @classmethod
    def _once(cls, powers: tuple[int, ...]) -> tuple[int, ...]:
        own = [one for one in powers if one != 0]
        if not own or len(set(own)) != len(own) or max(map(abs, own)) > 6:
            raise ValueError("give different powers from -6 to 6, such as [-1, 1, 2, 3]")
        return tuple(own)


class SolverSettings(Section):
    """``[model]``: a solver that is started for every evaluation, in a private folder."""

    command: str = Field(min_length=1)
    """Program and arguments, such as ``"ccx -i job"``; no shell reads it."""
    template: tuple[PathText, ...] = Field(min_length=1)
    """Decks with ``{{ NAME }}`` where values of parameters belong; the deck is named like its template, without
    ``.j2``."""
    files: tuple[PathText, ...] = ()
    """Files that are copied beside the decks."""
    modes: PathText = ""
    """File with modes that the command writes, of any kind that ``calib compare --modes`` reads."""
    shapes: PathText = ""
    """Table of shapes beside modes in a table."""
    responses: PathText = ""
    """Table ``response, value`` that the command writes, instead of modes."""
    matrices: tuple[PathText, ...] = ()
    """Files with matrices that it writes where the template's variable ``matrices`` is true, for ``calib import``."""
    units: Literal["m-kg-N", "mm-t-N", "mm-kg-mN", "in-lbf", "in-kip", "ft-lbf"] = "m-kg-N"
    """Unit system of the matrices and of coordinates."""
    coordinates: PathText = ""
    """File in the folder with places of nodes, where neither modes nor decks have them."""
    sensors: tuple[str, ...] = ()
    """Motions by which modes are followed, such as ``"12z"``; by default those of the measured shapes."""
    n_modes: int = Field(default=10, ge=1, le=10_000)
    """Modes that the command computes, without rigid-body modes."""
    damped: bool = False
    """Whether their damping ratios are compared."""
    step: float = Field(default=2e-3, gt=0, le=0.1)
    """Half step of a difference, over the range of a parameter; codes print six or seven digits."""
    parameters: dict[str, SolverParameterSettings] = Field(min_length=1)
    """Parameters of the decks."""

    @field_validator("template", "files", "matrices", "sensors", mode="before")
    @classmethod
    def _listed(cls, given: Any) -> Any:
        return (given,) if isinstance(given, str) else given

    @property
    def inputs(self) -> tuple[str, ...]:
        """Files of the study that decide on a run: templates, files beside them, a program that is not installed."""
        from calib.execution.process import is_beside  # few studies have a solver

        try:
            program = shlex.split(self.command)[:1]
        except ValueError:  # told where the model is made
            program = []
        return (*self.template, *self.files, *filter(is_beside, program))
