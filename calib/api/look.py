"""A first look at measured files, which needs no model: what they hold, and what is odd in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from calib.api.display import Displayed
from calib.api.entries.entry import Entry, Rows, Warned, Words, count, decimals
from calib.errors.arguments import path as path_of
from calib.errors.errors import InputError
from calib.measurement.doubts import doubts_of
from calib.measurement.files.csv_frf import read_frfs_csv
from calib.measurement.files.csv_record import header_of, is_time
from calib.measurement.files.frf_columns import MATLAB, VARIABLES
from calib.measurement.files.read import UFF_SUFFIXES, Named, found_files, read_modes
from calib.measurement.files.read_frf import read_frfs
from calib.measurement.files.read_records import has_force, read_records
from calib.measurement.files.uff_blocks import read_blocks
from calib.measurement.files.uff_frf import read_uff_frfs
from calib.measurement.files.uff_record import FORCE, TIME_RESPONSE, function_types
from calib.measurement.frf import MeasuredFRFs, Quantity
from calib.measurement.modal import MeasuredModes, Sensor
from calib.measurement.places import Doubt
from calib.measurement.record import MeasuredRecord
from calib.modal_analysis import first_look as seen
from calib.modal_analysis.rules import RULES
from calib.results.results import Results

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MODES, _FRFS, _RECORDS, _SHAPES, _SENSORS = "modes", "FRFs", "records", "shapes", "places"


@dataclass(frozen=True, eq=False, repr=False)
class Look(Displayed):
    """What measured files hold.

    Attributes
    ----------
    modes : MeasuredModes or None
    frfs : MeasuredFRFs or None
    records : tuple of MeasuredRecord
    tables : mapping from str to DataFrame
        ``modes``, ``auto_mac``, ``comac_repeats``, ``functions``, ``indicators``, ``coherences``, ``channels``,
        ``spectra``, ``nodes``, of those that there are; see `calib.modal_analysis.first_look`.
    files : mapping from str to tuple of Path
        By what they hold.
    """

    modes: MeasuredModes | None = None
    frfs: MeasuredFRFs | None = None
    records: tuple[MeasuredRecord, ...] = ()
    tables: Mapping[str, pd.DataFrame] = field(default_factory=dict)
    files: Mapping[str, tuple[Path, ...]] = field(default_factory=dict)

    @property
    def table(self) -> pd.DataFrame:
        """One row a mode, function or channel, named in column ``what``, with all columns of these tables."""
        main = [name for name in ("modes", "functions", "channels") if name in self.tables]
        names = {"modes": "mode", "functions": "function", "channels": "sensor"}
        parts = [self.tables[name].rename(columns={names[name]: "what"}).assign(kind=names[name]) for name in main]
        whole = pd.concat(parts, ignore_index=True)
        return whole[["kind", "what", *(name for name in whole.columns if name not in ("kind", "what"))]]

    @property
    def synthetic(self) -> bool:
        """Whether everything is marked as synthetic."""
        return any(one.synthetic for one in (self.modes, self.frfs, *self.records) if one is not None)

    @property
    def sentences(self) -> tuple[str, ...]:
        """What is in the files, one sentence a kind, then what to check."""
        out = [*_of_modes(self), *_of_frfs(self), *_of_records(self)]
        nodes = self.tables["nodes"]
        placed = int(nodes["x"].notna().sum())
        if len(nodes):
            size = np.ptp(nodes[["x", "y", "z"]].dropna().to_numpy(), axis=0) if placed else np.zeros(3)
            extent = " by ".join(f"{own:.3g}" for own in size)
            out.append(
                f"Geometry: {count(len(nodes), 'node')}, {placed or 'none'} with coordinates"
                + (f", {extent} m along x, y, z." if placed else ".")
            )
        return tuple(out)

    @property
    def doubts(self) -> tuple[str, ...]:
        """What is to be checked before the data are used."""
        found = [words for one in (self.modes, self.frfs, *self.records) if one is not None for words in doubts_of(one)]
        repeats = () if self.modes is None else self.modes.disagreements
        return (*dict.fromkeys(found), *(f"Check this repeat: {one.sentence}." for one in repeats), *_odd(self.tables))

    @property
    def notes(self) -> tuple[str, ...]:
        """How the files were read."""
        every = (self.modes, self.frfs, *self.records)
        notes = [note for one in every if one is not None for note in one.notes if not isinstance(note, Doubt)]
        return tuple(dict.fromkeys(notes))

    @property
    def entries(self) -> tuple[Entry, ...]:
        """What the command prints."""
        out: list[Entry] = [Words(words, "always") for words in self.sentences]
        out += [Warned(words) for words in self.doubts]
        out += [Words(f"Note: {note}.", "always") for note in self.notes]
        return (*out, *_rows(self.tables))

    def __str__(self) -> str:
        return "\n".join([*self.sentences, *self.doubts, *self._table_lines()])

    def figure(self) -> Figure:
        """One picture of everything."""
        from calib.report.first_look import first_look_figure
        from calib.report.style import add_heading, style

        with style():
            figure = first_look_figure(self.tables)
            every = [path.name for paths in self.files.values() for path in paths]
            more = f" and {len(every) - 3} more" if len(every) > 3 else ""
            add_heading(figure, f"First look: {', '.join(every[:3])}{more}", self.synthetic)
            return figure

    def save(self, folder: str | Path) -> tuple[Path, ...]:
        """Write ``look.png`` and ``look.csv``, the picture and the table, into a folder; returns their paths."""
        from calib.report.style import save, style

        into = path_of(folder, "folder")
        results = Results.at(into.parent, into.name)
        with style():
            return (results.write_table("look", self.table), *save(self.figure(), into / "look"))


def look(
    files: Named,
    *,
    sensors: str | Path | None = None,
    quantity: Quantity | None = None,
    unit: str | None = None,
    averages: int | None = None,
    channels: Sequence[str] = (),
    variables: Mapping[str, str] | None = None,
    length_unit: str | None = None,
    synthetic: bool = False,
) -> Look:
    """Look at measured files without any model: what they hold, units, geometry, auto-MAC, complexity, coherence.

    Parameters
    ----------
    files : path, pattern or sequence of them
        Universal files and tables of modes (with their shapes), FRFs, records, and places of nodes, in any order; what
        each holds is told by its content. Files of one kind are repeats. Hammer records are seen as their FRFs.
    sensors, quantity, unit, averages, channels, variables, length_unit, synthetic
        As in `calib.read_modes`, `calib.read_frfs` and `calib.read_records`. The names in ``variables`` tell whether a
        MATLAB file or a workbook holds modes or FRFs.

    Returns
    -------
    Look
        Prints as its answer; ``.table``, ``.tables``, ``.figure()`` and ``.save(folder)``.

    Raises
    ------
    InputError
        For files that cannot be read, or that hold nothing measured.

    Examples
    --------
    The example study, a mast:

    >>> import tempfile
    >>> from pathlib import Path
    >>> import calib
    >>> from calib.command.example import write_example
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     mast = write_example(Path(folder, "mast"))[0].parent
    ...     found = calib.look([mast / "modes.csv", mast / "shapes.csv", mast / "sensors.csv"])
    >>> found.tables["auto_mac"].round(2)["B1z"].tolist()
    [0.0, 1.0, 0.0, 0.02]
    """
    by_kind: dict[str, list[Path]] = {}
    for path in found_files(files):
        for kind in _kinds(path, variables or {}):
            by_kind.setdefault(kind, []).append(path)
    places = [*([] if sensors is None else [path_of(sensors, "sensors")]), *by_kind.get(_SENSORS, ())]
    if len(places) > 1:
        raise InputError("a second table of places is given", place=places[1], remedy="give one")
    table = places[0] if places else None
    if not {_MODES, _FRFS, _RECORDS} & set(by_kind):
        where = next((path for paths in by_kind.values() for path in paths), "files")
        raise InputError("no modes, FRFs or records are given", place=where, remedy="name the file that holds them")
    _require_used(by_kind, {"quantity": quantity, "averages": averages, "unit": unit, "length_unit": length_unit})
    modes: MeasuredModes | None = None
    frfs: MeasuredFRFs | None = None
    records: tuple[MeasuredRecord, ...] = ()
    tables: dict[str, pd.DataFrame] = {}
    if paths := by_kind.get(_MODES):
        shapes = by_kind.get(_SHAPES, [])
        modes = read_modes(
            paths, shapes=shapes, sensors=table, length_unit=length_unit, channels=channels, variables=variables,
            synthetic=synthetic,
        )  # fmt: skip
        tables["modes"] = seen.modes_seen(modes)
        if modes.has_shapes:
            tables["auto_mac"] = seen.auto_mac(modes)
        if len(paths) > 1 and modes.has_shapes and len(shapes) in (0, len(paths)):
            alone = [
                read_modes(
                    path, shapes=shapes[k : k + 1], length_unit=length_unit, channels=channels, variables=variables
                )
                for k, path in enumerate(paths)
            ]
            tables["comac_repeats"] = seen.repeats_comac(alone)
    if paths := by_kind.get(_FRFS):
        frfs = read_frfs(
            paths, quantity=quantity, unit=unit, sensors=table, averages=averages, channels=channels,
            variables=variables, length_unit=length_unit, synthetic=synthetic,
        )  # fmt: skip
        coherence = seen.coherences(frfs) if frfs.n_repeats > 1 else _coherence(paths, frfs, quantity, unit, channels)
        tables["functions"] = seen.functions_seen(frfs, coherence)
        tables["indicators"] = seen.indicators(frfs)
        if coherence:
            tables["coherences"] = pd.DataFrame({"freq": frfs.freq, **coherence})
    if paths := by_kind.get(_RECORDS):
        records = read_records(paths, unit=unit, sensors=table, length_unit=length_unit, synthetic=synthetic)
        tables["channels"], tables["spectra"] = seen.channels_seen(records), seen.spectra(records)
    every: list[Sensor] = [
        *(modes.sensors if modes is not None else ()),
        *((*frfs.responses, *frfs.references) if frfs is not None else ()),
        *(sensor for record in records[:1] for sensor in record.sensors),
    ]
    tables["nodes"] = seen.nodes_seen(every)
    return Look(modes, frfs, records, tables, {kind: tuple(own) for kind, own in by_kind.items()})


def _require_used(by_kind: Mapping[str, Sequence[Path]], given: Mapping[str, object]) -> None:
    """InputError for a statement about files of which there are none."""
    universal = any(path.suffix.lower() in UFF_SUFFIXES for paths in by_kind.values() for path in paths)
    kinds = {"quantity": {_FRFS}, "averages": {_FRFS}, "unit": {_FRFS, _RECORDS}}
    for name, value in given.items():
        if value is not None and not (kinds[name] & set(by_kind) if name in kinds else universal):
            held = " or ".join(sorted(kinds[name])) if name in kinds else "universal files (tables are in metres)"
            raise InputError(f"it is that of {held}, of which none are given", place=name, remedy="leave it out")


def _coherence(
    paths: Sequence[Path], frfs: MeasuredFRFs, quantity: Quantity | None, unit: str | None, channels: Sequence[str]
) -> dict[str, np.ndarray]:
    """Coherence of every function of single files that have it, by its name, on the lines of the FRFs."""
    out: dict[str, np.ndarray] = {}
    for path in paths:
        is_uff = path.suffix.lower() in UFF_SUFFIXES
        if not (is_uff or path.suffix.lower() == ".csv") or has_force(path):
            continue
        read = read_uff_frfs(path, quantity, unit, None, channels) if is_uff else None
        repeat = read or read_frfs_csv(path, quantity, unit, channels)
        for ((node, direction), (other, towards)), own in repeat.coherence.items():
            known = np.interp(frfs.freq, repeat.freq, own, left=np.nan, right=np.nan)
            name = f"{node}{direction}/{other}{towards}"
            out[name] = np.fmin(known, out.get(name, np.inf))  # of a function in several set-ups the lowest
    return out


def _kinds(path: Path, variables: Mapping[str, str]) -> list[str]:
    """What a file holds; a universal file may hold several things. FRFs stand for hammer records too."""
    if not path.is_file():
        raise InputError("there is no such file", place=path, remedy="check the path")
    if path.suffix.lower() in UFF_SUFFIXES:
        kinds = {block.kind for block in read_blocks(path)}
        types = function_types(path) if 58 in kinds else set()
        held = [_MODES] * bool(kinds & {55, 2414}) + [_RECORDS] * (TIME_RESPONSE in types and FORCE not in types)
        held += [_FRFS] * bool(types - {TIME_RESPONSE})
        if not held:
            words = f"it holds no modes, FRFs or records, only datasets {', '.join(map(str, sorted(kinds)))}"
            raise InputError(words, place=path, remedy="export what was measured")
        return held
    if path.suffix.lower() in MATLAB and not variables:
        remedy = (
            "name them: --variables freq=f,damping=zeta,shapes=Phi of modes, --variables freq=f,frf=H of FRFs "
            "(variables = in Python)"
        )
        raise InputError("its variables are not named", place=path, remedy=remedy)
    if path.suffix.lower() != ".csv":
        return [_MODES if set(variables) - {"sheet", *VARIABLES} else _FRFS]
    header = set(header_of(path)[0])
    if {"node", "x", "y", "z"} <= header:
        return [_SENSORS]
    if "mode" in header:
        return [_SHAPES if "node" in header else _MODES]
    return [_RECORDS if any(map(is_time, header)) and not has_force(path) else _FRFS]


def _of_modes(one: Look) -> list[str]:
    if one.modes is None:
        return []
    modes = one.modes
    repeats = f", {modes.n_repeats} repeats" if modes.n_repeats > 1 else ""
    shapes = f" at {count(len(modes.sensors), 'sensor')}" if modes.has_shapes else ", without shapes"
    damping = modes.damping_ratio[np.isfinite(modes.damping_ratio)]
    words = f", damping {100 * damping.min():.3g} to {100 * damping.max():.3g} %" if len(damping) else ""
    low, high = modes.natural_freq.min(), modes.natural_freq.max()
    return [f"Modes: {modes.n_modes}{shapes}{repeats}; {low:.4g} to {high:.4g} Hz{words}."]


def _of_frfs(one: Look) -> list[str]:
    if one.frfs is None:
        return []
    frfs = one.frfs
    step = np.diff(frfs.freq)
    even = np.allclose(step, step[:1], rtol=1e-2)
    line = f", {step.min():.4g}{'' if even else f' to {step.max():.4g}'} Hz apart" if len(step) else ""
    peaks = frfs.resonances()
    at = ", ".join(f"{peak.freq:.4g}" for peak in peaks[:12]) + (", ..." if len(peaks) > 12 else "")
    return [
        f"FRFs: {len(frfs.functions)} of {count(len(frfs.responses), 'response')} and "
        f"{count(len(frfs.references), 'reference')}, {frfs.quantity} in "
        f"{frfs.unit(frfs.responses[0], frfs.references[0])}; {len(frfs.freq)} lines from {frfs.freq[0]:.4g} to "
        f"{frfs.freq[-1]:.4g} Hz{line}{f'; {frfs.n_repeats} repeats' if frfs.n_repeats > 1 else ''}.",
        f"Resonances: {len(peaks)}" + (f", at {at} Hz." if peaks else "."),
    ]


def _of_records(one: Look) -> list[str]:
    if not one.records:
        return []
    first = one.records[0]
    seconds = sum(len(record.values) / record.rate for record in one.records)
    motion = f"{first.motion} in {first.unit}" if first.motion else "motion not stated"
    return [
        f"Records: {len(one.records)} of {count(len(first.sensors), 'channel')}, {motion}; {first.rate:.6g} samples a "
        f"second, {seconds:.4g} s in all."
    ]


def _odd(tables: Mapping[str, pd.DataFrame]) -> list[str]:
    """What is odd in the tables: alike shapes, complex shapes, repeats that disagree, poor coherence, clipping."""
    out = []
    if (modes := tables.get("modes")) is not None:
        alike = modes[modes["mac"] > RULES.look_alike]
        pairs = dict.fromkeys(frozenset((r["mode"], r["like"])) for r in alike.to_dict("records"))
        if pairs:
            said = "; ".join(" and ".join(sorted(pair)) for pair in pairs)
            out.append(
                f"Modes with nearly one shape at these sensors (MAC above {RULES.look_alike:g}): {said}. The sensors "
                "do not tell them apart, or one mode was found twice."
            )
        odd = modes[modes["mpc"] < RULES.look_complex]
        if len(odd):
            said = ", ".join(
                f"{r['mode']} (MPC {r['mpc']:.2f}, MPD {r['mpd']:.0f} degrees)" for r in odd.to_dict("records")
            )
            out.append(f"Complex shapes: {said}. Check phases of channels, close modes and local damping.")
    if (functions := tables.get("functions")) is not None:
        poor = functions[functions["coherence_least"] < RULES.look_coherence].sort_values("coherence_least")
        if len(poor):
            said = ", ".join(f"{r['function']} ({r['coherence_least']:.2f})" for r in poor.head(6).to_dict("records"))
            more = f" and {len(poor) - 6} more" if len(poor) > 6 else ""
            out.append(f"Low coherence at a resonance: {said}{more}.")
    if (channels := tables.get("channels")) is not None:
        held = channels["sensor"][channels["held"] > RULES.look_held]
        if len(held):
            out.append(f"Channels that are clipped or held: {', '.join(dict.fromkeys(held))}.")
    return out


def _rows(tables: Mapping[str, pd.DataFrame]) -> list[Rows]:
    out = []
    if "modes" in tables:
        rows = [
            (
                r["mode"], decimals(r["freq"], 3), decimals(r["freq_std"], 4), decimals(100 * r["damping"], 3),
                decimals(r["mpc"], 3), decimals(r["mpd"], 1), r["like"], decimals(r["mac"], 3),
            )
            for r in tables["modes"].to_dict("records")
        ]  # fmt: skip
        heads = ("mode", "Hz", "std Hz", "damping %", "MPC", "MPD deg", "most like", "MAC")
        out.append(Rows.of("", heads, rows, ("most like",), most=40))
    if "functions" in tables:
        rows = [
            (
                r["function"], str(r["lines"]), f"{r['freq_min']:.4g}", f"{r['freq_max']:.4g}", f"{r['peak_freq']:.5g}",
                f"{r['peak']:.3g}", decimals(r["coherence"], 3), decimals(r["coherence_least"], 3),
            )
            for r in tables["functions"].to_dict("records")
        ]  # fmt: skip
        heads = ("FRF", "lines", "from Hz", "to Hz", "peak at Hz", "peak", "coherence", "at resonances")
        out.append(Rows.of("", heads, rows, most=40))
    if "channels" in tables:
        levels = [
            (r["sensor"], str(r["record"]), f"{r['rms']:.3g}", f"{r['peak']:.3g}", decimals(r["crest"], 1))
            for r in tables["channels"].to_dict("records")
        ]
        out.append(Rows.of("", ("channel", "record", "rms", "peak", "crest"), levels, most=40))
    return out
