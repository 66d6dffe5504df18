"""Keys of ``study.toml`` about what was measured: files, nuisances, held-out data, pairing, several tests."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ValidationInfo,
    field_validator,
    model_validator,
)

from calib.measurement.accuracy import Accuracy, Claim, frf_claim

Pair = tuple[float, float]
Seed = Annotated[int, Field(ge=0, lt=2**31)]
LONGEST_NAME = 255
"""Bytes in the name of a file or folder that the common file systems allow."""


def possible_path(text: str) -> str:
    """A path that file systems accept; ValueError for any other."""
    if "\0" in text:
        raise ValueError("a path cannot hold a zero character")
    longest = max((len(part.encode("utf-8", "replace")) for part in re.split(r"[/\\]", text)), default=0)
    if longest > LONGEST_NAME or len(text) > 4000:
        raise ValueError(f"a name of {longest} bytes in the path is too long: {LONGEST_NAME} are possible")
    return text


PathText = Annotated[str, AfterValidator(possible_path)]
Share = Annotated[float, Field(ge=0, le=1)]
DesignName = Annotated[str, Field(pattern=r"^design [1-9][0-9]{0,17}$")]
"""An evaluated design by its number in the ledger."""
RUNS = ".csv"
"""Suffix of a table of runs, by which it is told from a function."""
MODEL = r"^([^:]+:[A-Za-z_]\w*|.+\.csv)$"
"""Names a function that returns a model, ``"file.py:function"`` in the study's folder or ``"package.module:function"``,
or a table of runs."""
GENERIC = "generic"
"""In place of a library: effects composed of the model's own parts, joints, supports and points."""
LIBRARY = r"^(generic|[^:]+:[A-Za-z_]\w*)$"
"""Names a function that returns a library of effects, or `GENERIC`."""
LibraryText = Annotated[PathText, Field(pattern=LIBRARY)]
NAME = r"^[A-Za-z0-9_-]+$"
"""Name of a case or a test, which names files."""


class WrongBelow(ValueError):
    """A wrong value below the section or list that is checked; ``keys`` lead there."""

    def __init__(self, words: str, *keys: int | str):
        super().__init__(words)
        self.keys = keys


class Section(BaseModel):
    """A section of ``study.toml``: unknown keys are refused."""

    # Text below a field is its description in the JSON schema, in editors and in the documents. `schema` reads it:
    # pydantic's own option parses these files each time they are imported.
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)


class NuisanceSettings(Section):
    """``nuisances``: errors of a test of FRFs that a fit may find, each with its prior; none by default."""

    gain: float | None = Field(default=None, gt=0, le=100)
    """Standard deviation of the gain of every channel, %."""
    phase: float | None = Field(default=None, gt=0, le=180)
    """Standard deviation of the phase of every channel, degrees."""
    delay: float | None = Field(default=None, gt=0, le=1)
    """Standard deviation of the delay of every channel, s."""
    place: float | None = Field(default=None, gt=0, le=1e3)
    """Standard deviation of each coordinate of every transducer, mm; 0.45 of the radius within which they are right."""
    accelerometer: float | None = Field(default=None, gt=0, le=1e3)
    """Mass of the accelerometer at every node with a response, kg; its standard deviation is a tenth of it."""
    stinger: float | None = Field(default=None, gt=0, le=1e12)
    """Standard deviation of the stiffness of the exciter's stinger at every reference, N/m."""
    resonance: float | None = Field(default=None, gt=0, le=5)
    """Standard deviation of what the model is off by at the peak of every resonance, % of the modulus."""


class MeasurementSettings(Section):
    """``[measurement]``: files, relative to the study's folder."""

    kind: Literal["modes", "frf"] = "modes"
    """What ``files`` hold: measured modes or frequency response functions."""
    files: tuple[PathText, ...] = ()
    """Measured modes or FRFs: universal files (``.uff``, ``.unv``), CSV tables, workbooks (``.xlsx``) or MATLAB files
    (``.mat``), one file a repeat."""
    shapes: tuple[PathText, ...] = ()
    """CSV tables of mode shapes beside ``files`` that are CSV; leave out when only frequencies were measured."""
    sensors: PathText | None = None
    """CSV table of the measured nodes: ``node, x, y, z`` in m, ``on``."""
    quantity: Literal["receptance", "mobility", "accelerance"] | None = None
    """What FRFs are, where their files do not state it."""
    unit: str | None = None
    """Unit of FRFs of translations under forces, such as ``"(m/s2)/N"`` or ``"g/N"``, where their files do not
    state it."""
    channels: tuple[str, ...] = ()
    """Response and reference of each FRF, such as ``"12z/3z"``, in the order of the file, or of the files of one
    function each, where these do not name them; of modes in MATLAB files the sensor, such as ``"12z"``, of each row of
    their shapes."""
    variables: dict[str, str] = {}
    """What MATLAB files and workbooks call what they hold. Of FRFs the variables ``freq``, ``frf`` and ``coherence``,
    or the ``sheet``; of modes the variables or columns ``freq`` (or ``damped_freq``), ``freq_std``, ``damping``,
    ``damping_std``, the variable or sheet of the ``shapes``, and in workbooks ``sheet``, ``mode``, ``repeat``."""
    length_unit: Literal["m", "cm", "mm", "um", "in", "ft"] | None = None
    """Unit of places in universal files that do not state it (dataset 164); by default m."""
    node_limit: float | None = Field(default=None, gt=0, le=1e4)
    """Largest distance of a measured node from the model node nearest to it, m; by default from the size of the model
    and the distance between its nodes."""
    band: Pair | None = None
    """Lines of FRFs that are used, from and to, Hz; by default all."""
    lines: Literal["all", "resonances"] = "all"
    """Whether all lines of FRFs are used, or those near resonances, which carry most of what they tell."""
    nuisances: NuisanceSettings = NuisanceSettings()
    """Errors of a test of FRFs that a fit may find."""
    estimator: Literal["H1", "H2", "Hv"] = "H1"
    """How FRFs are estimated from hammer records."""
    averages: int | None = Field(default=None, ge=1, le=1_000_000)
    """Averages behind each FRF of a single file, whose coherence then gives the standard deviations."""
    responses: PathText | None = None
    """CSV table of scalar responses, of a model with modes such as ``freq_1``, ``damping_1``; instead of ``files``."""
    mode_names: tuple[str, ...] | None = None
    """Names of the measured modes in the order of the files, where these give none."""
    repeats: int | None = Field(default=None, ge=1, le=1_000_000)
    """Number of repeats behind the standard deviations that a table states."""
    std_of: Literal["mean", "repeat"] = "mean"
    """Whether a stated standard deviation is that of the mean or of one repeat."""
    pooling: Literal["robust", "plain"] = "robust"
    """Whether outliers among the repeats are excluded (``"robust"``) or only reported (``"plain"``)."""
    accuracy: str | float | dict[str, str | float] | None = None
    """Claimed accuracy beside the repeatability: a share such as ``"1 %"``, or by kind or response a share or a
    number in the unit of the value."""
    set_ups: dict[str, tuple[str, ...]] = {}
    """Sensors of measured modes that were scaled together, by the name of their set-up."""
    corrected: dict[str, float] = {}
    """Faults of measured modes that are taken out on reading, as an explanation names them, such as
    ``{ "gain of sensor 12y" = -0.1 }``; the files stay as they are."""
    synthetic: bool = False
    """Whether the measurement is computed; every figure then says so."""

    @field_validator("accuracy")
    @classmethod
    def _claim(
        cls, value: str | float | dict[str, str | float] | None, info: ValidationInfo
    ) -> str | float | dict[str, str | float] | None:
        claims = value.values() if isinstance(value, dict) else () if value is None else (value,)
        for claim in claims:
            Claim.of(claim)
        if info.data.get("kind") == "frf":
            frf_claim(value)
        elif info.data.get("files"):
            Accuracy.of(value)
        elif value is not None and not isinstance(value, dict | str):
            raise ValueError("one accuracy for all responses is a share such as '1 %'; give numbers by response")
        return value

    @model_validator(mode="after")
    def _one_kind(self) -> MeasurementSettings:
        if bool(self.files) == bool(self.responses) and self.model_fields_set:
            raise ValueError("name either measured modes (files = [...]) or scalar responses (responses = '...')")
        return self


class HeldOutSettings(Section):
    """``[held_out]``: measured data that no fit uses."""

    modes: tuple[str, ...] = ()
    """Measured modes that no fit uses."""
    sensors: tuple[str, ...] = ()
    """Measured sensors, such as ``101y``, that no fit uses; of FRFs the responses."""
    references: tuple[str, ...] = ()
    """References of FRFs, such as ``12z``, that no fit uses."""
    bands: tuple[Pair, ...] = ()
    """Bands ``[low, high]`` of FRFs that no fit uses, Hz."""
    responses: tuple[str, ...] = ()
    """Scalar responses that no fit uses."""


class PairingSettings(Section):
    """``[pairing]``: how measured and model modes are paired."""

    mode_count: int | None = Field(default=None, ge=1, le=1_000_000)
    """Model modes that are solved; by default twice as many as were measured."""
    threshold: Share = 0.3
    """Least EMAC of a pair."""
    freq_window: Pair | None = None
    """Model modes outside are never paired; Hz."""
    clusters: dict[str, tuple[str, ...]] = {}
    """For each measured mode the groups of degrees of freedom that carry its strain energy."""
    override: dict[str, int] = {}
    """Number of the model mode, from 1, that a measured mode is paired with whatever its EMAC."""

    @field_validator("freq_window")
    @classmethod
    def _ordered(cls, window: Pair | None) -> Pair | None:
        if window is not None and not 0 <= window[0] < window[1]:
            raise ValueError(f"the window {list(window)} is not [lower, upper] in Hz")
        return window


class TestSettings(MeasurementSettings):
    """``[[tests]]``: measurements under one condition; files as under ``[measurement]``."""

    __test__ = False  # no test of pytest's

    name: str = Field(pattern=NAME, max_length=100)
    """Label of the results of this test; they go to ``<study>.<name>``."""
    set: dict[str, float] = {}
    """Values of parameters under this test only, each in its own unit."""
    held_out: HeldOutSettings = HeldOutSettings()
    """Data of this test that no fit uses."""
    pairing: PairingSettings = PairingSettings()
    """How its modes are paired."""
    model: PathText | None = Field(default=None, pattern=MODEL)
    """Another model for this test."""
    model_options: dict[str, Any] | None = None
    """Other options of the model."""
    effects: LibraryText | None = None
    """Library of effects of that other model."""
