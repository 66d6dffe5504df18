"""Measured modes from files: UFF/UNV or CSV, one file a repeat."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from glob import glob
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from calib.errors.arguments import integer, names, objects
from calib.errors.arguments import path as path_of
from calib.errors.errors import InputError
from calib.measurement.disagreements import Pooling
from calib.measurement.files.csv_format import (
    ONE,
    modes_of_rows,
    read_modes_csv,
    read_sensor_table,
    read_shapes_csv,
    shapes_of_rows,
)
from calib.measurement.files.frf_columns import MATLAB, WORKBOOKS
from calib.measurement.files.uff import drop_unmeasured, in_global_axes, read_uff
from calib.measurement.frf_units import parse_length_unit
from calib.measurement.modal import MeasuredModes
from calib.measurement.places import Point, common_points
from calib.measurement.repeats import Repeat, ShapeSet, StdOf, combine_repeats
from calib.measurement.sensors import place_sensors

if TYPE_CHECKING:
    from calib.measurement.files.mapped_modes import MappedModes

Named = str | Path | Sequence[str | Path]
"""Files by their paths or by patterns."""
UFF_SUFFIXES = (".uff", ".unv", ".uf")
MAPPED = (*MATLAB, *WORKBOOKS)
"""Suffixes of files whose content the user names."""
TEXT_SUFFIXES = (".txt", ".asc", ".dat", ".tsv", ".prn")
"""Text files of one function each."""


def read_modes(
    files: Named,
    *,
    shapes: Named = (),
    sensors: str | Path | None = None,
    repeats: int | None = None,
    std_of: StdOf = "mean",
    mode_names: Sequence[str] | None = None,
    pooling: Pooling = "robust",
    length_unit: str | None = None,
    channels: Sequence[str] = (),
    variables: Mapping[str, str] | None = None,
    synthetic: bool = False,
) -> MeasuredModes:
    """Read measured modes; each file is one repeat, or a table with a column ``repeat`` holds them all.

    Parameters
    ----------
    files : path, pattern such as ``"measured/*.uff"``, or sequence of them
        Files that match a pattern are sorted by name. Universal files (``.uff``, ``.unv``, ``.uf``; see
        `calib.measurement.files.uff.read_uff`) or modes tables (``.csv``; see
        `calib.measurement.files.csv_format.read_modes_csv`), MATLAB files (``.mat``) or workbooks (``.xlsx``), one kind
        only.
    shapes : path, pattern or sequence of them
        Shape tables beside modes tables: none, a single one, or one a repeat.
    sensors : path, optional
        Table of node places in metres; it takes precedence over places in universal files.
    repeats : int, optional
        Number of repeats behind a single file, from 1.
    std_of : {"mean", "repeat"}
        Whether standard deviations in a single file are those of the mean or of one repeat; the latter are divided by
        ``sqrt(repeats)``.
    mode_names : sequence of str, optional
        Names of the modes in the order of the first file; files that name their modes are still matched by their own.
    pooling : {"robust", "plain"}
        Whether values that disagree with the other repeats are left out of mean and standard deviation, or only
        reported.
    length_unit : str, optional
        Of places (and of the lengths of shapes) in universal files without dataset 164, such as ``mm``; by default m.
    channels : sequence of str, optional
        Sensors, such as ``12z`` or ``12-z``, in the order of the rows of a MATLAB file's shapes.
    variables : mapping from str to str, optional
        Of a MATLAB file the names of its variables, such as ``{"freq": "f", "damping": "zeta", "shapes": "Phi"}``; of a
        workbook those of its columns, and perhaps the ``sheet`` and the one of the ``shapes``; see
        `calib.measurement.files.mapped_modes.read_mapped_modes`.
    synthetic : bool
        True when no structure was measured.

    Raises
    ------
    InputError
        With the file, and where possible line and column, for files that cannot be read as repeats of the same modes.

    Examples
    --------
    Tables of modes, shapes and places of the example study, a mast:

    >>> import tempfile
    >>> from pathlib import Path
    >>> import calib
    >>> from calib.command.example import write_example
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     mast = write_example(Path(folder, "mast"))[0].parent
    ...     modes = calib.read_modes(
    ...         mast / "modes.csv", shapes=mast / "shapes.csv", sensors=mast / "sensors.csv", synthetic=True
    ...     )
    >>> modes.names
    ('B1x', 'B1z', 'B2x', 'B2z')
    >>> modes.shapes.shape
    (8, 4)
    """
    paths, shape_paths = found_files(files), found_files(shapes)
    sensor_table = None if sensors is None else path_of(sensors, "sensors")
    repeats = None if repeats is None else integer(repeats, 0, "repeats")
    if pooling not in ("robust", "plain"):
        raise InputError(f"pooling is {pooling!r}", place="measurement", remedy="write 'robust' or 'plain'")
    channels = names(channels, "channels")
    is_uff = _check_arguments(paths, shape_paths, repeats, std_of, mapped=bool(channels or variables))
    if length_unit is not None and not is_uff:
        words = f"length_unit ({length_unit}) is that of universal files"
        raise InputError(words, place=paths[0], remedy="leave it out, and give places of nodes in m")
    points: Mapping[int, Point] | None = None
    read: list[Repeat]
    table = read_sensor_table(sensor_table) if sensor_table is not None else {}
    if is_uff:
        universal = [read_uff(path, parse_length_unit(length_unit)) for path in paths]
        alive = drop_unmeasured([u.repeat for u in universal])
        read = [in_global_axes(one, u.nodes) for one, u in zip(alive, universal, strict=True)]
        points = common_points([(u.repeat.source, u.points) for u in universal], table)
    else:
        read = _tables(paths, shape_paths, variables or {}, channels)
        if repeats is not None and len(read) > 1 and repeats != len(read):
            raise InputError(
                f"the number of repeats is given as {repeats}, but the tables hold {len(read)}",
                place=paths[0],
                remedy="leave it out",
            )
    combined = combine_repeats(read, std_of=std_of, count=repeats, mode_names=mode_names, pooling=pooling)
    placed = place_sensors(combined.sensors, points, table, paths[0], sensor_table)
    damping = combined.damping_ratio
    n_repeats = len(read) if len(read) > 1 else (repeats or 1)
    return MeasuredModes(
        names=combined.names,
        natural_freq=combined.natural_freq,
        damped_freq=combined.natural_freq * np.sqrt(1.0 - np.nan_to_num(damping) ** 2),
        freq_std=combined.freq_std,
        damping_ratio=damping,
        damping_std=combined.damping_std,
        sensors=placed.sensors,
        shapes=combined.shapes,
        shape_std=combined.shape_std,
        n_repeats=n_repeats,
        synthetic=synthetic,
        source=", ".join(map(str, (*paths, *shape_paths))),
        notes=(*placed.notes, *combined.notes),
        freq_count=_varied(combined.freq_count, n_repeats),
        damping_count=_varied(combined.damping_count, n_repeats),
        shape_count=_varied(combined.shape_count, n_repeats),
        disagreements=combined.disagreements,
        misplaced=placed.misplaced,
    )


def found_files(given: Named) -> list[Path]:
    """Files that are named, or that match a pattern; a name that is neither is kept for the error message."""
    out: list[Path] = []
    each: tuple[str | Path, ...] = objects(given, (str, Path), "measurement")
    for one in each:
        named = Path(one)
        out += [named] if named.exists() else sorted(Path(name) for name in glob(str(one))) or [named]
    return out


def _tables(
    paths: Sequence[Path], shapes: Sequence[Path], variables: Mapping[str, str], channels: Sequence[str]
) -> list[Repeat]:
    """Repeats from modes tables, one each or all in one, with the shapes that go with them."""
    mapped: dict[Path, MappedModes] = {}
    if any(path.suffix.lower() in MAPPED for path in paths):
        from calib.measurement.files.mapped_modes import read_mapped_modes  # most measurements have tables of calib

        mapped = {path: read_mapped_modes(path, variables, channels) for path in paths}
    tables = [modes_of_rows(path, mapped[path].modes) if path in mapped else read_modes_csv(path) for path in paths]
    for path, table in zip(paths, tables, strict=True):
        if len(tables) > 1 and ONE not in table:
            raise InputError(
                "it has a column 'repeat', but other files are given beside it",
                place=path,
                remedy="give every repeat its own file, or all of them in one table",
            )
    read = [
        replace(repeat, named=path not in mapped or mapped[path].named)
        for path, table in zip(paths, tables, strict=True)
        for repeat in table.values()
    ]

    def shapes_in(path: Path, own: Mapping[str, Sequence[str]], left_out: Iterable[str] = ()) -> dict[str, ShapeSet]:
        rows = mapped[path].shapes if path in mapped else None
        return read_shapes_csv(path, own, left_out) if rows is None else shapes_of_rows(path, rows, own, left_out)

    shapes = [*shapes, *(path for path, one in mapped.items() if one.shapes)]
    labels = list(tables[0])
    names = {label: repeat.names for label, repeat in tables[0].items()}
    if len(tables) > 1 or ONE in tables[0]:
        for k, path in enumerate(shapes):
            # a single table of shapes belongs to the mean; it is attached to the first repeat
            at = paths.index(path) if path in mapped else k
            read[at] = replace(read[at], shape_set=shapes_in(path, {ONE: read[at].names}, read[at].left_out)[ONE])
        return read
    left_out = {name for repeat in read for name in repeat.left_out}
    everything = tuple(dict.fromkeys(name for own in names.values() for name in own))
    for path in shapes:
        for label, own_set in shapes_in(path, {ONE: everything, **names}, left_out).items():
            k = labels.index(label) if label != ONE else _complete(path, read, own_set, everything)
            if label == ONE:
                order = [everything.index(name) for name in read[k].names]
                own_set = replace(own_set, shapes=own_set.shapes[:, order], std=own_set.std[:, order])
            read[k] = replace(read[k], shape_set=own_set)
    return read


def _complete(path: Path, read: Sequence[Repeat], shapes: ShapeSet, names: Sequence[str]) -> int:
    """Index of the first repeat that holds all modes for which shapes of the mean are given."""
    given = {name for k, name in enumerate(names) if np.isfinite(shapes.shapes[:, k]).any()}
    for k, repeat in enumerate(read):
        if given <= set(repeat.names):
            return k
    raise InputError(
        "no repeat holds all the modes of these shapes", place=path, remedy="give shapes with a column 'repeat'"
    )


def _varied(count: np.ndarray, n_repeats: int) -> np.ndarray | None:
    """Counts if some value rests on fewer repeats than there are, else None."""
    return count if np.any((count > 0) & (count != n_repeats)) else None


def require_files(paths: Sequence[Path], shapes: Sequence[Path] = (), also: Sequence[str] = ()) -> bool:
    """InputError unless the files exist, differ and are of one kind; returns whether they are universal files.

    ``also`` are suffixes of text files that count as tables.
    """
    if not paths:
        raise InputError("no measurement file is given", place="measurement", remedy="name at least one")
    for path in (*paths, *shapes):
        if not path.is_file():
            raise InputError("there is no such file", place=path, remedy="check the path")
    given = (*paths, *shapes)
    twice = next((path for k, path in enumerate(given) if path.resolve() in [p.resolve() for p in given[:k]]), None)
    if twice is not None:
        raise InputError("the file is given twice", place=twice, remedy="name every repeat once")
    for path in paths:
        if path.suffix.lower() not in (*UFF_SUFFIXES, ".csv", *also):
            remedy = f"give {', '.join((*UFF_SUFFIXES, *also))} or .csv"
            raise InputError(f"unknown kind of file {path.suffix!r}", place=path, remedy=remedy)
    kinds = {path.suffix.lower() in UFF_SUFFIXES for path in paths}
    if len(kinds) > 1:
        raise InputError("universal files and CSV are mixed", place=paths[0], remedy="give all repeats in one format")
    return kinds.pop()


def require_no_copies(paths: Sequence[Path]) -> None:
    """InputError for a file that has the content of an earlier one under another name."""
    content: dict[bytes, Path] = {}
    for path in paths:
        earlier = content.setdefault(hashlib.sha256(path.read_bytes()).digest(), path)
        if earlier != path:
            words = f"it has the content of {earlier}: a copy is no repeat"
            raise InputError(words, place=path, remedy="leave it out")


def _check_arguments(
    paths: Sequence[Path], shapes: Sequence[Path], repeats: int | None, std_of: str, mapped: bool
) -> bool:
    """Check the arguments; returns whether the files are universal files."""
    is_uff = require_files(paths, shapes, MAPPED)
    kinds = {path.suffix.lower() in MAPPED for path in paths}
    if len(kinds) > 1 or (shapes and kinds == {True}):
        words = "tables are mixed with workbooks or MATLAB files"
        raise InputError(words, place=[*shapes, *paths][0], remedy="give modes and shapes of all repeats in one format")
    if mapped and kinds != {True}:
        words = "channels or variables are named, but these belong to MATLAB files and workbooks of modes"
        raise InputError(words, place=paths[0], remedy="leave them out")
    if shapes and is_uff:
        raise InputError("shape files belong to CSV only", place=shapes[0], remedy="universal files carry their shapes")
    for path in shapes:
        if path.suffix.lower() != ".csv":
            raise InputError(f"unknown kind of shape file {path.suffix!r}", place=path, remedy="give .csv")
    if len(shapes) not in (0, 1, len(paths)):
        raise InputError(
            f"{len(shapes)} shape files for {len(paths)} repeats", place=shapes[0], remedy="give one, or one a repeat"
        )
    if std_of not in ("mean", "repeat"):
        raise InputError(f"std_of is {std_of!r}", place=paths[0], remedy="write 'mean' or 'repeat'")
    if repeats is not None and (repeats < 1 or (len(paths) > 1 and repeats != len(paths))):
        raise InputError(
            f"the number of repeats is given as {repeats}, but {len(paths)} file(s) are",
            place=paths[0],
            remedy="leave it out, or give the number behind a single file",
        )
    require_no_copies(paths)
    return is_uff
