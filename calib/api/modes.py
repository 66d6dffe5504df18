"""Modes from files of FRFs or time records, written as a measurement that a study can name."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from calib.api.entries.entry import Entry, Rows, Warned, Words, count, decimals
from calib.errors.errors import InputError
from calib.execution.stage import Progress, silent
from calib.measurement.files.read import Named, found_files
from calib.measurement.files.read_frf import FRFReading, frfs_and_repeats
from calib.measurement.files.read_records import hold_records, read_records
from calib.modal_analysis.ambient import modes_from_records
from calib.modal_analysis.identification import Identification, modes_table, sensor_table, shapes_table
from calib.modal_analysis.identify import modes_from_frfs
from calib.results.results import Results


@dataclass(frozen=True, eq=False)
class Written:
    """Identified modes and their files.

    Attributes
    ----------
    found : Identification
    paths : tuple of Path
    """

    found: Identification
    paths: tuple[Path, ...]

    @property
    def keys(self) -> str:
        """The lines of a study.toml that name these files."""
        names = [path.name for path in self.paths]
        lines = ["[measurement]", 'files = ["modes.csv"]', 'shapes = ["shapes.csv"]']
        lines += ['sensors = "sensors.csv"'] * ("sensors.csv" in names)
        lines += [f"repeats = {self.found.modes.n_repeats}"] * (self.found.std_from == "repeats")
        return "\n".join([*lines, *(["synthetic = true"] * self.found.modes.synthetic)])

    @property
    def entries(self) -> list[Entry]:
        """Verdict, modes that count, those refused with the reason, and how a study names the files."""
        found = self.found
        rows = found.fit.to_dict("records")
        accepted, refused = ([row for row in rows if bool(row["refused"]) is wanted] for wanted in (False, True))
        good = not refused and not found.missed
        out: list[Entry] = [Words(found.verdict, "always") if good else Warned(found.verdict)]
        out.append(Rows.of(f"{count(len(accepted), 'mode')}:", _HEADS, map(_row, accepted), most=len(accepted)))
        out.append(Rows.of("Refused:", ("Hz", "damping %", "why"),
                           [(decimals(r["freq"], 3), decimals(100 * r["damping"], 2), r["refused"]) for r in refused],
                           left=("why",), most=len(refused)))  # fmt: skip
        out += [Words(f"\nNote: {note}.", "always") for note in found.modes.notes]
        out += [Words(f"\nIn study.toml, beside these files:\n{self.keys}", "always")]
        return [*out, *(Words(f"Written: {path}", when="verbose") for path in self.paths)]


_HEADS = (
    "mode",
    "Hz",
    "std Hz",
    "damping %",
    "std %",
    "orders",
    "FRAC",
    "residual (std)",
    "one shape",
    "MPC",
    "MPD deg",
)


def _row(row: Mapping[Hashable, Any]) -> tuple[str, ...]:
    return (
        str(row["mode"]), decimals(row["freq"], 4), f"{row['freq_std']:.2g}", decimals(100 * row["damping"], 3),
        f"{100 * row['damping_std']:.2g}", str(row["orders"]), decimals(row["frac"], 4),
        decimals(row["residual_std"], 2), decimals(row["rank_one"], 4), decimals(row["mpc"], 3),
        decimals(row["mpd"], 1),
    )  # fmt: skip


def identify_modes(
    files: Named,
    into: Path,
    how: FRFReading = FRFReading(),  # noqa: B008
    *,
    band: tuple[float, float] | None = None,
    accept: Sequence[float] = (),
    progress: Progress = silent,
) -> Written:
    """Identify modes from files of FRFs, hammer records or records of responses alone, and write them to a folder.

    What the files hold is told by their content; each file, or each hit, is a repeat.

    Writes ``modes.csv``, ``shapes.csv`` and, where places are known, ``sensors.csv``, as `calib.read_modes` reads them;
    ``identified.csv``, ``poles.csv`` and ``synthesised.csv``, the tables of `Identification`; and the stabilisation
    diagram ``stabilisation.png``.

    Parameters
    ----------
    files : path, pattern or sequence of them
    into : Path
        Folder; files that calib wrote there are replaced.
    how : FRFReading
        As for `calib.read_frfs`; of records of responses alone ``unit`` is that of their motion (see
        `calib.measurement.files.read_records.read_records`), and what concerns FRFs is refused.
    band : (float, float), optional
        Lines that are used, Hz; default all above 0. Of records the band in which modes are identified.
    accept : sequence of float
        Natural frequencies, Hz, of refused modes that are kept all the same; ``modes.csv`` tells so in a column
        ``note``.
    progress : Progress
        As of `modes_from_frfs`.

    Raises
    ------
    InputError
        For files that `calib.read_frfs` or `read_records` refuses, and for FRFs or records without a mode; see
        `modes_from_frfs` and `modes_from_records`.
    """
    paths = found_files(files)
    if hold_records(paths):
        for name in ("quantity", "averages", "channels", "variables", "estimator", "exponential_window"):
            if getattr(how, name) != getattr(FRFReading(), name):
                raise InputError(f"{name} is given beside time records", place=paths[0], remedy="leave it out")
        records = read_records(
            paths, unit=how.unit, sensors=how.sensors, length_unit=how.length_unit, synthetic=how.synthetic
        )
        known = modes_from_records(records, band, accept=accept)
        squared = f"({records[0].unit})²/Hz" if records[0].unit else "squared unit a Hz"
        return Written(known, _write(known, squared, into))

    whole, every = frfs_and_repeats(paths, how)
    low, high = band or (whole.lowest_freq, float(whole.freq[-1]))
    frfs, *repeats = (one.in_band(low, high) for one in (whole, *every))
    found = modes_from_frfs(frfs, repeats, accept=accept, progress=progress)
    unit = frfs.unit(frfs.responses[0], frfs.references[0])
    return Written(found, _write(found, unit, into))


def _write(found: Identification, unit: str, into: Path) -> tuple[Path, ...]:
    from calib.report.stabilisation import stabilisation_figure
    from calib.report.style import add_heading, save, style

    folder = Results.at(into.parent, into.name)
    tables = {
        "modes": modes_table(found), "shapes": shapes_table(found.modes), "sensors": sensor_table(found.modes),
        "identified": found.fit, "poles": found.poles, "synthesised": found.curves,
    }  # fmt: skip
    written = [folder.write_table(name, table) for name, table in tables.items() if len(table)]
    if not len(tables["sensors"]):
        folder.remove("sensors.csv")
    with style():
        figure = stabilisation_figure(found.poles, found.curves, found.fit, unit=unit, of=found.of)
        add_heading(figure, "Stabilisation of poles", found.modes.synthetic)
        written += save(figure, into / "stabilisation")
    return tuple(written)
