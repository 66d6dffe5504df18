"""Tables with mistakes that people, spreadsheets and disks make, given to everything that reads a table.

Every outcome must be an answer or an `InputError` of one line. The fast tests try some hundreds.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import random
import shutil
import sys
import tempfile
import time
import traceback
import unittest.mock
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from calib.analyses.sensitivity import selected_by_measures
from calib.analyses.staged import values_found
from calib.analyses.versions import write_versions
from calib.command import cli
from calib.errors.errors import InputError
from calib.measurement.files.csv_format import read_responses_csv
from calib.measurement.files.read import read_modes
from calib.report.figures import Figures
from calib.report.html.study_results import StudyResults
from calib.report.html.summary import page_summary
from calib.report.html.write import sections
from calib.results.results import Results
from calib.study.loading import module_of
from calib.study.study import LoadedStudy

Reader = Callable[[Path], object]
CELLS = (
    *("", " ", "nan", "NaN", "inf", "-inf", "0", "-0", "-1", "2", "7", "1e400", "1e300", "-1e300", "1e-300", "1_000"),
    *("0x10", "1,5", "1.234,5", "12.Mai", "\u22121", "\uff11", "WAHR", "FALSCH", "VRAI", "True", "FALSE", "maybe"),
    *("#NAME?", "#REF!", "=1+1", "'=1+1", '"', '""', '"a', "a\tb", "é", "桥梁", "\u00a0", "None", "null", "[]"),
    *("x" * 300, "a,b", "a;b", "$x$ $", "<b>"),
)
"""What stands in a damaged cell."""


def damaged(text: str, rng: random.Random) -> bytes:
    """A table with one to three mistakes in it."""
    data = text
    for _ in range(rng.choice((1, 1, 2, 3))):
        lines = data.splitlines() or [""]
        at = rng.randrange(len(lines))
        cells = lines[at].split(",")
        column = rng.randrange(len(cells))
        kind = rng.choice(
            ("cell", "cell", "cell", "cell", "swap", "drop row", "double row", "short", "long", "header", "column",
             "german", "quotes", "cut", "byte", "order", "nothing")
        )  # fmt: skip
        if kind == "cell":
            cells[column] = rng.choice(CELLS)
            lines[at] = ",".join(cells)
        elif kind == "swap":
            other = rng.randrange(len(cells))
            cells[column], cells[other] = cells[other], cells[column]
            lines[at] = ",".join(cells)
        elif kind == "drop row":
            del lines[at]
        elif kind == "double row":
            lines.insert(rng.randrange(len(lines) + 1), lines[at])
        elif kind == "short":
            lines[at] = ",".join(cells[:column])
        elif kind == "long":
            lines[at] += "," * rng.choice((1, 2)) + rng.choice(("", "1"))
        elif kind == "header":
            head = lines[0].split(",")
            head[rng.randrange(len(head))] = rng.choice(("", "other", "mode", "value", head[0], "=A1"))
            lines[0] = ",".join(head)
        elif kind == "column":
            lines = [",".join(c for k, c in enumerate(line.split(",")) if k != column) for line in lines]
        elif kind == "german":
            lines = [line.replace(",", ";").replace(".", ",") for line in lines]
        elif kind == "quotes":
            lines[at] = '"' + lines[at] + rng.choice(('"', ""))
        elif kind == "cut":
            joined = "\n".join(lines)
            lines = joined[: rng.randrange(len(joined) + 1)].splitlines()
        elif kind == "order":
            head, rest = lines[:1], lines[1:]
            rng.shuffle(rest)
            lines = head + rest
        data = "\n".join(lines) + "\n"
    out = data.encode("utf-8", "surrogatepass")
    ending = rng.random()
    if ending < 0.05:
        out = b"\xef\xbb\xbf" + out.replace(b"\n", b"\r\n")
    elif ending < 0.08:
        out = data.encode("utf-16")
    elif ending < 0.11:
        out = data.encode("cp1252", "replace")
    elif ending < 0.15 and out:
        at = rng.randrange(len(out))
        out = out[:at] + bytes([rng.randrange(256)]) + out[at + 1 :]
    return out


def outcome(read: Callable[[], object]) -> str:
    """``"read"`` or ``"refused"``; anything else is raised."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        try:
            read()
        except InputError as fault:
            assert "\n" not in str(fault), repr(str(fault))
            return "refused"
    return "read"


TOLD = 0.1
"""Share of trials that go to the page and the pictures."""
MESH = ("mesh_points", "mesh_elements", "model_modes_after", "deflection_after", "shapes_after", "comparison_after")
"""Tables that are drawn together."""


class Bench:
    """Studies of which everything was asked, all their tables, and whoever reads each.

    Parameters
    ----------
    folder : Path
        Empty; damaged copies lie in it.
    answered : tuple of (study, results)
        Folders of studies, and those with their answers.
    """

    def __init__(self, folder: Path, *answered: tuple[Path, Path]):
        self.folder = folder
        self.told: list[tuple[Path, Reader]] = []
        self.read: list[tuple[Path, Reader]] = []
        for study, home in answered:
            self._add(study, home)

    def _add(self, study: Path, home: Path) -> None:
        loaded = LoadedStudy.load(study)
        given = loaded.settings.measurement
        choosing = replace(loaded, settings=loaded.settings.model_copy(update={"selection": "from sensitivity"}))
        back: dict[str, Reader] = {
            "parameters": lambda folder: values_found(loaded, folder.parent),
            "selection": lambda folder: selected_by_measures(choosing, Results(folder)),
            "errors": lambda folder: write_versions(loaded, folder.parent),
        }
        for table in sorted(home.glob("*.csv")):
            self.told += [(table, _told), (table, partial(_drawn, table.stem))]
            if table.stem in back:
                self.read += [(table, back[table.stem])] * 8
        if given.responses:
            self.read += [(study / given.responses, lambda folder: read_responses_csv(folder / given.responses))] * 8

        def modes(folder: Path) -> object:
            files, shapes = ([folder / name for name in names] for names in (given.files, given.shapes))
            return read_modes(files, shapes=shapes, sensors=folder / given.sensors)

        for name in filter(None, (*given.files, *given.shapes, given.sensors)):
            self.read += [(study / name, modes)] * 8

    def damage(self, number: int, seed: int = 1) -> tuple[str, str]:
        """The outcome of one damaged table, and which it was."""
        rng = random.Random(f"{seed}/{number}")
        # Telling and drawing take a hundred times as long as reading.
        table, reader = rng.choice(self.told if rng.random() < TOLD else self.read)
        home = table.parent
        work = self.folder / "work" / home.parent.name / home.name
        if not work.exists():
            shutil.copytree(home, work)
        copy, whole = work / table.name, table.read_bytes()
        content = damaged(whole.decode(), rng)
        try:
            copy.write_bytes(content)
            return outcome(lambda: reader(work)), f"{home.name}/{table.name}"
        except BaseException:
            (self.folder / f"failed-{number}-{table.name}").write_bytes(content)
            raise
        finally:
            copy.write_bytes(whole)


def _told(folder: Path) -> object:
    """Everything that stands on the page."""
    answers = StudyResults(folder, "Damaged", True)
    return page_summary(answers), sections(answers)


def _drawn(stem: str, folder: Path) -> object:
    """The figures of one table alone, or of those that are drawn together."""
    alone = folder.parent / f"{folder.name}-alone"
    shutil.rmtree(alone, ignore_errors=True)
    alone.mkdir()
    for name in [*(MESH if stem in MESH else (stem,)), "summary"]:
        for file in folder.glob(f"{name}.*"):
            if file.suffix != ".png":
                shutil.copy(file, alone)
    return Figures(alone, "Damaged", True).save()


def answer(folder: Path, study: Path, *questions: str) -> tuple[Path, Path]:
    """Ask a copy of a study, without pictures; its folder and that of the answers."""
    copy = Path(shutil.copytree(study, folder / "studies" / study.name))
    silent = unittest.mock.patch.object(Figures, "save", return_value=[])
    with contextlib.redirect_stdout(io.StringIO()), silent:
        for question in questions:
            assert cli.execute([question, str(copy), "--results", str(folder / "results")]) == 0
    return copy, folder / "results" / study.name


def main() -> int:
    """Try as many tables as the command line says; print outcomes and every traceback."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("count", nargs="?", type=int, default=10_000, help="tables (default 10000)")
    count = arguments.parse_args().count
    root = Path(__file__).resolve().parents[2]
    counts: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        mast = module_of(root / "tests/template/mast_effects.py").write_study(folder / "made" / "mast", {"guy": 9000.0})
        chain = root / "studies/five_mass_chain"
        everything = ("compare", "sensitivity", "calibrate", "explain")
        bench = Bench(folder, answer(folder, mast, *everything), answer(folder, chain, "compare", "explain"))
        for number in range(count):
            try:
                counts[bench.damage(number)[0]] += 1
            except Exception:
                counts["traceback"] += 1
                print(f"--- {number}\n{traceback.format_exc(limit=-4)}", flush=True)
            if number % 100 == 99:
                print(f"{number + 1} after {time.process_time():.0f} s: {dict(counts)}", flush=True)
    print(f"{count} tables: {dict(counts)}")
    return int(counts["traceback"] > 0)


if __name__ == "__main__":
    sys.exit(main())
