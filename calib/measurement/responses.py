"""Measured scalar responses: single numbers, each the mean over the repeats that hold it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from calib.errors.arguments import path as path_of
from calib.errors.errors import InputError
from calib.measurement.accuracy import widened
from calib.measurement.alignment import mean_and_std
from calib.measurement.disagreements import Disagreement, Pooling, value_disagreements
from calib.measurement.files.csv_format import ONE, read_response_units, read_responses_csv
from calib.measurement.modal import Sensor
from calib.problem import degrees_of_freedom
from calib.problem.degrees_of_freedom import dof_each, widened_by
from calib.results.in_short import Short, aligned_lines


@dataclass(frozen=True)
class MeasuredResponses(Short):
    """Scalar responses with the standard deviations of their means.

    Attributes
    ----------
    targets : mapping from response name to (value, standard deviation or None)
        Each in the response's own unit; None where it is unknown.
    counts : mapping from response name to int
        Repeats behind each; empty for a table that does not say.
    disagreements : tuple of Disagreement
    notes : tuple of str
    shares : mapping from response name to float
        Part of the variance of each that repeats show, the rest being claimed; 1 for a response without an entry.
    claimed : str
        The claimed accuracy in words; empty without.
    units : mapping from response name to str
        Unit of each that has one, as text.
    """

    targets: Mapping[str, tuple[float, float | None]]
    counts: Mapping[str, int]
    disagreements: tuple[Disagreement, ...] = ()
    notes: tuple[str, ...] = ()
    shares: Mapping[str, float] = field(default_factory=dict)
    claimed: str = ""
    units: Mapping[str, str] = field(default_factory=dict)

    def __str__(self) -> str:
        """A short table: values with their standard deviations."""
        rows = [("response", "value", "std", "unit")[: 4 if self.units else 3]]
        rows += [
            (name, f"{value:.6g}", "" if std is None else f"{std:.2g}", self.units.get(name, ""))[: len(rows[0])]
            for name, (value, std) in self.targets.items()
        ]
        return "\n".join([f"{len(self.targets)} responses", *aligned_lines(rows)])

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        """Empty: scalar responses have no place."""
        return ()

    @property
    def sensor_std(self) -> np.ndarray:
        """Empty, (0,)."""
        return np.zeros(0)

    @property
    def content(self) -> list[tuple[str, tuple[float, float | None]]]:
        """All values with their standard deviations, as a digest of the measurement takes them."""
        return sorted(self.targets.items())

    @property
    def repeats(self) -> int | None:
        """Fewest repeats of any response that has at least two; None where repeats are unknown."""
        return min((n for n in self.counts.values() if n > 1), default=None)

    @property
    def pooled_repeats(self) -> float | None:
        """Equivalent number of repeats with standard deviations pooled over the responses of a kind; see `pooled`."""
        fewest = self.repeats
        if fewest is None or fewest < degrees_of_freedom.RULES.pool_below:
            return fewest
        return 1.0 + dof_each(fewest - 1.0)

    def pooled(self, kinds: Mapping[str, str]) -> MeasuredResponses:
        """The same with the relative standard deviations of few repeats pooled over the responses of each kind.

        With fewer than ten repeats the standard deviation of one response is too uncertain to weight it by. Each
        response gets the pooled relative standard deviation of one repeat over the root of its own number of repeats,
        also if its repeats are equal. A value smaller than its own standard deviation has no relative one and stays as
        it is, as does one that is in a single repeat. From ten repeats on each response keeps its own, widened by
        `calib.problem.degrees_of_freedom.widened_by`.

        Parameters
        ----------
        kinds : mapping from response name to kind
            See `response_kinds`.
        """
        if self.repeats is None:
            return self
        if self.repeats >= degrees_of_freedom.RULES.pool_below:
            return replace(self, targets={name: self._widened(name) for name in self.targets})
        square: dict[str, list[tuple[float, float]]] = {}
        repeated = [n for n in self.targets if self.counts[n] > 1 and _relative(self, n) < 1.0]
        for name in repeated:
            if (relative := _relative(self, name)) > 0:
                square.setdefault(kinds[name], []).append((relative**2, self.counts[name] - 1.0))
        targets = dict(self.targets)
        for name in repeated:
            if kinds[name] in square:
                each, dof = zip(*square[kinds[name]], strict=True)
                value = targets[name][0]
                targets[name] = (
                    value,
                    abs(value) * float(np.sqrt(np.average(each, weights=dof) / self.counts[name])),
                )
        return replace(self, targets=targets)

    def _widened(self, name: str) -> tuple[float, float | None]:
        value, std = self.targets[name]
        if std is None or self.counts[name] < degrees_of_freedom.RULES.pool_below:
            return value, std  # one line only: the standard deviation is that of the file
        return value, std * float(widened_by(self.counts[name] - 1.0))

    def claiming(
        self, kinds: Mapping[str, str], accuracy: str | float | Mapping[str, str | float] | None
    ) -> MeasuredResponses:
        """The same with a claimed accuracy added to the standard deviations, see `calib.measurement.accuracy.widened`.

        `shares` becomes the part of each variance that repeats show: 0 for a response in one repeat only, or of unknown
        standard deviation.
        """
        targets, shares = widened(self.targets, kinds, accuracy), {}
        for name, (_, std) in self.targets.items():
            total, repeated = targets[name][1], self.counts.get(name, 2) > 1
            shares[name] = 0.0 if std is None or total is None or not repeated else (std / total) ** 2
        return replace(self, targets=targets, shares=shares, claimed=_words(accuracy))

    def prepared(self, accuracy: str | float | Mapping[str, str | float] | None) -> MeasuredResponses:
        """The same with few repeats pooled and a claimed accuracy added; see `pooled` and `claiming`."""
        kinds = response_kinds(self.targets)
        return self.pooled(kinds).claiming(kinds, accuracy)


def response_kinds(names: Iterable[str]) -> dict[str, str]:
    """Kind of each scalar response: its name up to the first underscore where several share it, else ``response``."""
    names = tuple(names)
    heads = {name: name.split("_", 1)[0] for name in names if "_" in name}
    shared = Counter(heads.values())
    kinds = {name: head for name, head in heads.items() if head and shared[head] > 1}
    return {name: kinds.get(name, "response") for name in names}


def read_responses(path: str | Path, pooling: Pooling = "robust") -> MeasuredResponses:
    r"""Read scalar responses from a table, see `calib.measurement.files.csv_format.read_responses_csv`.

    With a column ``repeat`` each response is the mean over the repeats that hold it, and its standard deviation is that
    of one repeat over the root of their number; a response that is in one repeat only keeps the standard deviation of
    its line.

    Parameters
    ----------
    path : str or Path
    pooling : {"robust", "plain"}
        Whether a value that disagrees with the other repeats is left out of mean and standard deviation, or only
        reported.

    Raises
    ------
    InputError
        With file, line and column, for anything that is not such a table.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import calib
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     table = Path(folder, "measured.csv")
    ...     _ = table.write_text("\n".join(["response,value,std", "stiffness,182,4", "f1,5.03,"]))
    ...     measured = calib.read_responses(table)
    >>> measured.targets
    {'stiffness': (182.0, 4.0), 'f1': (5.03, None)}
    """
    path = path_of(path, "measured responses")
    if pooling not in ("robust", "plain"):
        raise InputError(f"pooling is {pooling!r}", place=path, remedy="write 'robust' or 'plain'")
    tables, units = read_responses_csv(path), read_response_units(path)
    if ONE in tables:
        return MeasuredResponses(tables[ONE], {}, units=units)
    names = list(dict.fromkeys(name for table in tables.values() for name in table))
    values = np.array([[table[n][0] if n in table else np.nan for n in names] for table in tables.values()])
    labels = [f"{path.name}, repeat {label}" for label in tables]
    held = np.isfinite(values).sum(axis=0)
    notes = [
        f"response {name} is in {n} of {len(tables)} repeats: mean and standard deviation are over those that hold it"
        for name, n in zip(names, held.tolist(), strict=True)
        if n < len(tables)
    ]
    given = {n: [table[n][1] for table in tables.values() if n in table] for n in names}
    if any(std is not None for n in names if len(given[n]) > 1 for std in given[n]):
        notes.append(f"standard deviations are computed from the {len(tables)} repeats; those in the file are not used")
    found = value_disagreements(
        "response", labels, names, values, pooling == "robust", list(response_kinds(names).values())
    )
    for one in found:
        if one.left_out:
            values[one.index[0], one.index[2]] = np.nan
    mean, std = mean_and_std(values)
    counts = np.isfinite(values).sum(axis=0)
    targets: dict[str, tuple[float, float | None]] = {}
    for k, name in enumerate(names):
        # equal values are rounding and give no standard deviation
        own = float(std[k]) if std[k] > 0 else None
        targets[name] = (float(mean[k]), given[name][0] if len(given[name]) == 1 else own)
    counted = dict(zip(names, counts.tolist(), strict=True))
    return MeasuredResponses(targets, counted, tuple(found), tuple(notes), units=units)


def _relative(measured: MeasuredResponses, name: str) -> float:
    """Standard deviation of one repeat of a response over its value; 0 where the repeats are equal."""
    value, std = measured.targets[name]
    return (std or 0.0) * float(np.sqrt(measured.counts[name])) / abs(value) if value else float("inf")


def _words(given: str | float | Mapping[str, str | float] | None) -> str:
    """A claimed accuracy of scalar responses in words; empty without."""
    if given is None:
        return ""
    if isinstance(given, Mapping):
        return ", ".join(f"{value} of {name}" for name, value in given.items())
    return f"{given} of every value"
