"""Datasets of universal files through pyuff: its faults as InputErrors, and what every file that calib writes holds."""

from __future__ import annotations

import contextlib
import io
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pyuff

from calib.errors.errors import InputError
from calib.measurement.modal import Sensor
from calib.measurement.places import Point
from calib.results.written import whole

SI_UNITS: Mapping[str, Any] = {
    "type": 164, "units_code": 1, "units_description": "SI", "temp_mode": 1, "length": 1.0, "force": 1.0, "temp": 1.0,
    "temp_offset": 273.15,
}  # fmt: skip
"""Dataset 164."""
_LARGEST_NODE = 10**10
"""Node labels have ten digits."""
_DATES = (
    "date_db_created", "time_db_created", "date_db_saved", "time_db_saved", "date_file_written", "time_file_written",
)  # fmt: skip


@contextlib.contextmanager
def pyuff_faults(error: Callable[[str], InputError]) -> Iterator[None]:
    """Run pyuff without its output and raise ``error(words)`` for whatever it raises.

    pyuff signals damage and a full disk alike by exceptions of any kind (Exception, IndexError, TypeError,
    OverflowError, ...), so that nothing narrower can be caught.
    """
    quiet = io.StringIO()
    try:
        with warnings.catch_warnings(), contextlib.redirect_stdout(quiet), contextlib.redirect_stderr(quiet):
            warnings.simplefilter("ignore")
            yield
    except Exception as fault:
        lines = str(fault).strip().splitlines()
        raise error(lines[0].rstrip(".") if lines else type(fault).__name__) from None


def write_sets(
    path: Path, sets: Sequence[Mapping[str, Any]], double: bool = True, mend: Callable[[Path], None] | None = None
) -> None:
    """Write a file whole or not at all.

    Parameters
    ----------
    path : Path
    sets : sequence of mapping
        Datasets as pyuff takes them.
    double : bool
        Whether values of dataset 58 are written as double precision whatever the dataset says.
    mend : callable, optional
        Corrects what pyuff wrote before the file takes its name.

    Raises
    ------
    InputError
        When it cannot be written.
    """
    remedy = "check folder and disk"
    with (
        pyuff_faults(lambda words: InputError(f"it cannot be written ({words})", place=path, remedy=remedy)),
        whole(path) as draft,
    ):
        pyuff.UFF(str(draft)).write_sets([dict(one) for one in sets], mode="overwrite", force_double=double)
        if mend is not None:
            mend(draft)


def header(title: str, description: str) -> dict[str, Any]:
    """Dataset 151 without dates, so that the same data give the same bytes."""
    own = {"type": 151, "model_name": title[:80], "description": description, "db_app": "calib", "program": "calib"}
    return own | dict.fromkeys(_DATES, "")


def points_of_nodes(path: Path, sensors: Iterable[Sensor]) -> dict[int, Point]:
    """Places of the nodes whose sensors have one; InputError for a node at two places or of more than ten digits."""
    points: dict[int, Point] = {}
    for sensor in sensors:
        if not 0 <= sensor.node < _LARGEST_NODE:
            raise InputError(f"node {sensor.node} does not fit ten digits", place=path, remedy="number it anew")
        if sensor.point is not None and points.setdefault(sensor.node, sensor.point) != sensor.point:
            raise InputError(f"node {sensor.node} has two places", place=path, remedy="give it one")
    return points


def nodes(points: Mapping[int, Point]) -> dict[str, Any]:
    """Dataset 15."""
    return {"type": 15, "node_nums": list(points)} | {
        axis: [point[k] for point in points.values()] for k, axis in enumerate("xyz")
    }
