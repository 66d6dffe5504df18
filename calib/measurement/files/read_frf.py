"""Measured frequency response functions from files: UFF/UNV or CSV, one file a repeat, or hammer records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from calib.errors.arguments import integer, names, number
from calib.errors.arguments import path as path_of
from calib.errors.errors import InputError
from calib.measurement.files.csv_format import read_sensor_table
from calib.measurement.files.csv_frf import read_columns_frfs, read_frfs_csv
from calib.measurement.files.frf_columns import MATLAB, WORKBOOKS
from calib.measurement.files.read import TEXT_SUFFIXES, Named, found_files, require_files, require_no_copies
from calib.measurement.files.read_records import hold_hits, read_record
from calib.measurement.files.uff_frf import read_uff_frfs
from calib.measurement.frf import QUANTITIES, MeasuredFRFs, Quantity
from calib.measurement.frf_repeats import FRFRepeat, combine_frfs
from calib.measurement.frf_setups import combine_setups
from calib.measurement.frf_units import parse_length_unit
from calib.measurement.hammer import Estimator, frfs_of_hits
from calib.measurement.places import common_points
from calib.measurement.sensors import place_sensors


@dataclass(frozen=True)
class FRFReading:
    """How files of FRFs, or hammer records, are read; see `read_frfs`."""

    quantity: Quantity | None = None
    unit: str | None = None
    sensors: str | Path | None = None
    averages: int | None = None
    channels: Sequence[str] = ()
    variables: Mapping[str, str] = field(default_factory=dict)
    length_unit: str | None = None
    estimator: Estimator = "H1"
    exponential_window: float | None = None
    synthetic: bool = False


def read_frfs(
    files: Named,
    *,
    quantity: Quantity | None = None,
    unit: str | None = None,
    sensors: str | Path | None = None,
    averages: int | None = None,
    channels: Sequence[str] = (),
    variables: Mapping[str, str] | None = None,
    length_unit: str | None = None,
    estimator: Estimator = "H1",
    exponential_window: float | None = None,
    synthetic: bool = False,
) -> MeasuredFRFs:
    r"""Read measured frequency response functions; each file is one repeat, or a set-up with functions of its own.

    Set-ups are merged and scaled by the functions that they share; see `calib.measurement.frf_setups.combine_setups`.
    Hammer records, time records with a force, become FRFs; each hit is a repeat, and hits at one place under the same
    sensors are a set-up; see `calib.measurement.hammer.frfs_of_hits`.

    Parameters
    ----------
    files : path, pattern such as ``"measured/*.uff"``, or sequence of them
        Files that match a pattern are sorted by name. Universal files (``.uff``, ``.unv``, ``.uf``; see
        `calib.measurement.files.uff_frf.read_uff_frfs`) or tables (``.csv``; see
        `calib.measurement.files.csv_frf.read_frfs_csv`), one kind only.
    quantity : {"receptance", "mobility", "accelerance"}, optional
        Where the files do not state it.
    unit : str, optional
        Of translations under forces, such as ``(m/s2)/N``, ``g/N`` or ``mm/N``, where the files do not state it; see
        `calib.measurement.frf_units.parse_unit`. What contradicts the files is refused.
    sensors : path, optional
        Table of node places in metres, of responses and references; it takes precedence over places in universal
        files.
    averages : int, optional
        Averages behind each function of a single file, or of each of several set-ups, from 1; with them its coherence
        gives standard deviations.
    channels : sequence of str, optional
        Response and reference of each function, such as ``12z/3z`` or ``12-z/3z``, where the files do not name them: of
        a universal file in the order of its FRFs (its nodes and directions then do not count), of a table with the
        functions side by side (see `calib.measurement.files.frf_columns.read_columns`) in that of its columns, and of
        text files with one function each (``.txt``, ``.asc``, ``.dat``, ...) in that of the files, repeat by repeat.
    variables : mapping from str to str, optional
        Of a MATLAB file (``.mat``) the names of ``freq``, ``frf`` and perhaps ``coherence``, such as ``{"freq": "f",
        "frf": "H"}``; see `calib.measurement.files.frf_columns.arrays_of`. Of a workbook (``.xlsx``), which holds the
        functions side by side, perhaps the ``sheet``.
    length_unit : str, optional
        Of places in universal files without dataset 164, such as ``mm``; by default m.
    estimator : {"H1", "H2", "Hv"}
        Of hammer records.
    exponential_window : float, optional
        Time constant, s, of the exponential window that the analyser applied, of records and FRFs alike: within it a
        window falls by a factor of e. `calib.modes_from_frfs` takes its damping off.
    synthetic : bool
        True when no structure was measured.

    Raises
    ------
    InputError
        With the file, and where possible line and column, for files that cannot be read as repeats of the same
        functions.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import calib
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     table = Path(folder, "hammer.csv")
    ...     lines = "freq,response,reference,re,im", "10,12z,3z,0.2,-0.01", "11,12z,3z,0.3,-0.02"
    ...     _ = table.write_text("\n".join(lines))
    ...     frfs = calib.read_frfs(table, unit="g/N")
    >>> frfs.quantity, [one.name for one in frfs.functions]
    ('accelerance', ['12z/3z'])
    >>> frfs.values.real.round(2).tolist()  # (m/s2)/N
    [[[1.96]], [[2.94]]]
    """
    reading = FRFReading(
        quantity,
        unit,
        sensors,
        averages,
        channels,
        variables or {},
        length_unit,
        estimator,
        exponential_window,
        synthetic,
    )
    return frfs_and_repeats(files, reading)[0]


def frfs_and_repeats(files: Named, how: FRFReading) -> tuple[MeasuredFRFs, tuple[MeasuredFRFs, ...]]:
    """FRFs as `read_frfs` returns them, and each repeat by itself; none of several set-ups, and of a single repeat."""
    paths = found_files(files)
    table_path = None if how.sensors is None else path_of(how.sensors, "sensors")
    averages = None if how.averages is None else integer(how.averages, 1, "averages")
    quantity, unit, window = how.quantity, how.unit, how.exponential_window
    if quantity is not None and quantity not in QUANTITIES:
        raise InputError(f"quantity is {quantity!r}", place="measurement", remedy=f"one of {', '.join(QUANTITIES)}")
    channels = names(how.channels, "channels")
    if window is not None and not number(window, "exponential_window") > 0:
        raise InputError(f"its time constant is {window:g} s", place="exponential_window", remedy="give a positive one")
    is_uff = require_files(paths, also=(*TEXT_SUFFIXES, *MATLAB, *WORKBOOKS))
    groups, hits = _repeats(paths, channels), hold_hits(paths)
    if averages is not None and hits:
        raise InputError("averages are given beside hammer records", place=paths[0], remedy="leave them out")
    if channels and hits:
        remedy = "name its columns: 'force 3z' and 12z; a universal file names its own"
        raise InputError("channels are given beside hammer records", place=paths[0], remedy=remedy)
    if how.estimator != FRFReading.estimator and not hits:
        remedy = "leave it out; it makes FRFs of hammer records"
        raise InputError(f"the estimator {how.estimator} is given beside FRFs", place=paths[0], remedy=remedy)
    require_no_copies(paths)
    table = read_sensor_table(table_path) if table_path is not None else {}
    metres = parse_length_unit(how.length_unit)
    made = frfs_of_hits([read_record(path, unit, metres) for path in paths], quantity, how.estimator) if hits else None
    repeats: Sequence[FRFRepeat] = made.repeats if made else [
        read_uff_frfs(own[0], quantity, unit, metres, channels) if is_uff
        else read_frfs_csv(own[0], quantity, unit, channels) if len(own) == 1 and own[0].suffix.lower() == ".csv"
        else read_columns_frfs(own, channels, quantity, unit, how.variables)
        for own in groups
    ]  # fmt: skip
    found = combine_setups(repeats, averages, how.synthetic)
    if averages is not None and (bare := next((one for one in repeats if not one.coherence), None)):
        raise InputError("averages are given, but it holds no coherence", place=bare.source, remedy="leave them out")
    points = common_points([(one.source, one.points) for one in repeats], table)
    ends = [(s.node, s.direction) for s in (*found.responses, *found.references)]
    placed = place_sensors(ends, points, table, paths[0], table_path)
    count = len(found.responses)
    rate = (made.window_rate if made else 0.0) + (1 / window if window else 0.0)
    whole = replace(
        found,
        responses=placed.sensors[:count],
        references=placed.sensors[count:],
        notes=(*placed.notes, *found.notes),
        misplaced=placed.misplaced,
        window_rate=rate,
    )
    each = repeats if len(repeats) == found.n_repeats > 1 else ()
    return whole, tuple(replace(combine_frfs([one], None, how.synthetic), window_rate=rate) for one in each)


def _repeats(paths: Sequence[Path], channels: Sequence[str]) -> list[list[Path]]:
    """Files by repeat: one each, but for text files of one function each."""
    if not any(path.suffix.lower() in TEXT_SUFFIXES for path in paths):
        return [[path] for path in paths]
    if len(paths) % max(len(channels), 1):
        words = f"{len(paths)} files with one function each are no multiple of the {len(channels)} channels"
        raise InputError(words, place=paths[0], remedy="name the channel of every file of a repeat")
    if not channels:
        raise InputError(
            "a text file does not name its function", place=paths[0],
            remedy="name response and reference of each file: channels = ['12z/3z', ...]",
        )  # fmt: skip
    return [list(paths[k : k + len(channels)]) for k in range(0, len(paths), len(channels))]
