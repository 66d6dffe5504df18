"""Objectives of a search: one misfit from named responses."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import pandas as pd

from calib.errors.errors import InputError


class Objective(Protocol):
    """Named responses in, a misfit to be minimised out."""

    @property
    def identity(self) -> str:
        """Text that identifies the objective: it differs whenever the misfit of some responses could."""
        ...

    @property
    def targets(self) -> Mapping[str, float]:
        """Measured values whose relative errors are weighed, by name of the response."""
        ...

    @property
    def weights(self) -> Mapping[str, float]:
        """Weight of each response in the misfit."""
        ...

    def terms(self, responses: Mapping[str, float]) -> dict[str, float]:
        """Error of each response, 0 for agreement, as a fraction: the misfit is their weighted sum."""
        ...

    def __call__(self, responses: Mapping[str, float]) -> float:
        """Misfit, 0 for full agreement; not finite when undefined."""
        ...


def weighted(objective: Objective, responses: Mapping[str, float]) -> float:
    """The misfit of some responses: the weighted sum of their errors."""
    weights, total = objective.weights, 0.0
    for name, error in objective.terms(responses).items():  # `sum` rounds otherwise from Python 3.12 on
        total += weights[name] * error
    return total


def _response(responses: Mapping[str, float], name: str) -> float:
    if name not in responses:
        given = ", ".join(responses) or "nothing"
        raise InputError(f"the model gives no response {name!r}", place="objective", remedy=f"it gives {given}")
    return float(responses[name])


@dataclass(frozen=True)
class FrequencyMacObjective:
    """Relative frequency errors and MAC deficits, summed over the measured modes.

    ``a * sum |f_model - f_meas| / f_meas + b * sum |1 - MAC|``, the form described by Ribeiro et al. (2013), who take
    a = b = 1. An unpaired mode (NaN frequency) counts as a frequency error of 1 (100 %) and a MAC of 0; a paired mode
    with a NaN MAC counts as a MAC of 0.

    Attributes
    ----------
    modes : tuple of str
        The responses used are ``natural_freq_<mode>`` and ``mac_<mode>``.
    natural_freq : mapping from mode to float
        Measured natural frequencies, Hz.
    weight_freq, weight_mac : float
        a and b.
    use_mac : bool
        False for a measurement without shapes.

    Raises
    ------
    InputError
        For no modes, a frequency that is missing or not positive, a negative weight, or no positive weight.
    """

    modes: tuple[str, ...]
    natural_freq: Mapping[str, float]
    weight_freq: float = 1.0
    weight_mac: float = 1.0
    use_mac: bool = True

    def __post_init__(self) -> None:
        if not self.modes:
            raise InputError("there is no mode to compare", place="objective", remedy="measure or keep at least one")
        for mode in self.modes:
            freq = self.natural_freq.get(mode)
            if freq is None or not (math.isfinite(freq) and freq > 0):
                raise InputError(
                    f"the measured frequency of mode {mode!r} is {freq}", place="objective", remedy="give it in Hz"
                )
        for label, weight in (("weight_freq", self.weight_freq), ("weight_mac", self.weight_mac)):
            if not (math.isfinite(weight) and weight >= 0):
                raise InputError(f"{label} is {weight}", place="objective", remedy="give a number of at least 0")
        if self.weight_freq + (self.weight_mac if self.use_mac else 0.0) == 0:
            without = "" if self.use_mac else " and no shapes were measured"
            raise InputError(
                f"the weight of frequencies is 0{without}", place="objective", remedy="give frequencies or MAC a weight"
            )

    @property
    def identity(self) -> str:
        """Text that identifies the objective: it differs whenever the misfit of some responses could."""
        freq = ",".join(f"{mode}={float(self.natural_freq[mode])!r}" for mode in self.modes)
        weight_mac = float(self.weight_mac) if self.use_mac else 0.0
        return f"frequency-mac a={float(self.weight_freq)!r} b={weight_mac!r} {freq}"

    @property
    def weights(self) -> dict[str, float]:
        """Weight of each response in the misfit."""
        each = {"natural_freq": self.weight_freq, **({"mac": self.weight_mac} if self.use_mac else {})}
        return {f"{kind}_{mode}": weight for mode in self.modes for kind, weight in each.items()}

    def terms(self, responses: Mapping[str, float]) -> dict[str, float]:
        """Relative frequency error and MAC deficit of each mode; InputError when a response is missing."""
        out = {}
        for mode in self.modes:
            measured = float(self.natural_freq[mode])
            model = _response(responses, f"natural_freq_{mode}")
            paired = not math.isnan(model)
            out[f"natural_freq_{mode}"] = abs(model - measured) / measured if paired else 1.0
            if self.use_mac:
                mac = _response(responses, f"mac_{mode}")
                out[f"mac_{mode}"] = abs(1.0 - mac) if paired and not math.isnan(mac) else 1.0
        return out

    def __call__(self, responses: Mapping[str, float]) -> float:
        """Misfit of named responses; InputError when one is missing."""
        return weighted(self, responses)

    @property
    def targets(self) -> dict[str, float]:
        """Measured natural frequencies (Hz), by name of the response."""
        return {f"natural_freq_{mode}": float(self.natural_freq[mode]) for mode in self.modes}

    def errors(self, responses: Mapping[str, float]) -> pd.DataFrame:
        """What the misfit is of, mode by mode; InputError when a response is missing.

        Returns
        -------
        DataFrame
            ``what`` (mode), ``measured, model`` (Hz), ``error`` (signed fraction), ``mac``; NaN where unpaired.
        """
        model = [_response(responses, f"natural_freq_{mode}") for mode in self.modes]
        mac = [_response(responses, f"mac_{mode}") if self.use_mac else math.nan for mode in self.modes]
        return _errors(self.modes, [float(self.natural_freq[mode]) for mode in self.modes], model, mac)


@dataclass(frozen=True)
class JointObjective:
    """Sum of the objectives of several tests.

    Attributes
    ----------
    objectives : mapping from str to Objective
        By name of the test; of a response ``x`` of test ``t`` the joint name is ``t: x``.
    """

    objectives: Mapping[str, Objective]

    @property
    def targets(self) -> dict[str, float]:
        """Those of every test, by joint name."""
        return {f"{test}: {name}": v for test, one in self.objectives.items() for name, v in one.targets.items()}

    @property
    def identity(self) -> str:
        """Text that identifies the objective: it differs whenever the misfit of some responses could."""
        return "; ".join(f"{test}: {objective.identity}" for test, objective in self.objectives.items())

    @property
    def weights(self) -> dict[str, float]:
        """Weight of each response in the misfit, by joint name."""
        return {f"{test}: {name}": v for test, one in self.objectives.items() for name, v in one.weights.items()}

    def terms(self, responses: Mapping[str, float]) -> dict[str, float]:
        """Error of each response of every test, by joint name; InputError when one is missing."""
        return {
            f"{test}: {name}": error
            for test, one in self.objectives.items()
            for name, error in one.terms(_of_test(test, responses)).items()
        }

    def __call__(self, responses: Mapping[str, float]) -> float:
        """Misfit of named responses; InputError when one is missing."""
        total = 0.0
        for test, one in self.objectives.items():
            total += one(_of_test(test, responses))
        return total


def _of_test(test: str, responses: Mapping[str, float]) -> dict[str, float]:
    """The responses of one of several tests, by their own names."""
    label = f"{test}: "
    return {name.removeprefix(label): value for name, value in responses.items() if name.startswith(label)}


@dataclass(frozen=True)
class ResponseObjective:
    """Relative errors of scalar responses, ``sum |r - t| / |t|``; infinite when a response is NaN.

    Attributes
    ----------
    targets : mapping from response name to float
        Measured values.

    Raises
    ------
    InputError
        For no target, or one that is 0 or not finite: its relative error is undefined.
    """

    targets: Mapping[str, float]

    def __post_init__(self) -> None:
        if not self.targets:
            raise InputError("there is no target to compare", place="objective", remedy="measure at least one response")
        for name, target in self.targets.items():
            if not math.isfinite(target) or target == 0:
                raise InputError(
                    f"the target of {name!r} is {target}, so a relative error is undefined",
                    place="objective",
                    remedy="hold it out, or measure it from another zero",
                )

    @property
    def identity(self) -> str:
        """Text that identifies the objective: it differs whenever the misfit of some responses could."""
        return "responses " + ",".join(f"{name}={float(self.targets[name])!r}" for name in sorted(self.targets))

    @property
    def weights(self) -> dict[str, float]:
        """1 for each response."""
        return dict.fromkeys(self.targets, 1.0)

    def terms(self, responses: Mapping[str, float]) -> dict[str, float]:
        """Relative error of each response, infinite where it is NaN; InputError when one is missing."""
        found = {name: _response(responses, name) for name in self.targets}
        return {
            name: math.inf if math.isnan(found[name]) else abs(found[name] - target) / abs(target)
            for name, target in self.targets.items()
        }

    def __call__(self, responses: Mapping[str, float]) -> float:
        """Misfit of named responses; InputError when one is missing."""
        return weighted(self, responses)

    def errors(self, responses: Mapping[str, float]) -> pd.DataFrame:
        """What the misfit is of, response by response; columns as those of `FrequencyMacObjective.errors`.

        ``measured`` and ``model`` are in the unit of the response; there is no ``mac``.
        """
        model = [_response(responses, name) for name in self.targets]
        return _errors(list(self.targets), list(self.targets.values()), model, [math.nan] * len(model))


def _errors(
    what: Sequence[str], measured: Sequence[float], model: Sequence[float], mac: Sequence[float]
) -> pd.DataFrame:
    table = pd.DataFrame({"what": list(what), "measured": measured, "model": model})
    table["error"] = (table["model"] - table["measured"]) / table["measured"].abs()
    return table.assign(mac=mac)
