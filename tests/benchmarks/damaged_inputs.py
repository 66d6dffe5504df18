"""Damaged copies of valid files of all formats that calib reads, given to their readers.

    python tests/benchmarks/damaged_inputs.py [20000] [--formats NAME ...] [--first 0]

Each copy has one to three damages: a byte, a line, a number or a part of the file is changed, cut, doubled or lost, or
a member of a workbook's archive. Every outcome must be a measurement or an `InputError` of one line: no traceback, no
warning, nothing printed, no hang, and no death of the process. Trials run in child processes, so that one that dies is
counted and the rest goes on. The same number gives the same damage. The process in
which calib reads a MATLAB file is here a copy of this one, without the half second that a new one takes.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import pickle
import random
import signal
import sys
import tempfile
import traceback
import warnings
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import h5py
import numpy as np
import pyuff
from scipy.io import savemat

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from calib.errors.errors import InputError
from calib.execution.worker import EndedError
from calib.measurement.files import matlab
from calib.measurement.files.csv_format import read_responses_csv
from calib.measurement.files.read import read_modes
from calib.measurement.files.read_frf import read_frfs
from calib.measurement.files.read_records import read_records
from calib.measurement.files.uff import write_uff
from calib.measurement.files.uff_frf_write import write_uff_frfs
from calib.measurement.modal import Sensor
from tests.template import ambient_chain, frf_chain

BATCH = 250
"""Trials of a child process."""
LONGEST = 30
"""Seconds of processor time after which a trial counts as hanging."""
ENTRIES = (
    *("", " ", "nan", "NaN", "inf", "-inf", "0", "-0", "-1", "2", "1e400", "1e300", "-1e-300", "1_000", "0x10", "1,5"),
    *("\u22121", "\uff11", "#REF!", "=1+1", '"', "é", "None", "    -1", "    58", "  2414", "1.0D+02", "9" * 40),
)
CSV = {
    "modes.csv": "mode,freq,freq_kind,freq_std,damping,damping_std\na,8,damped,0.4,0.06,0.01\nb,12.5,natural,,,\n",
    "shapes.csv": "mode,node,direction,re,im,std\na,1,y,2,0,0.2\na,2,-y,1,0,0.1\nb,1,y,-1,0,\nb,2,5,1,1,\n",
    "sensors.csv": "node,x,y,z,on\n1,0,0,0.5,frame\n2,1,0,0.5,\n",
    "responses.csv": "response,value,std,repeat\nload,10.5,0.1,1\nload,10.7,0.1,2\nfreq,3.2,0.01,1\nfreq,3.3,0.01,2\n",
}


@dataclass(frozen=True)
class Format:
    """A valid file of one format, and who reads it."""

    path: Path
    read: Callable[[], object]

    @cached_property
    def whole(self) -> bytes:
        """What is in the file before it is damaged."""
        return self.path.read_bytes()

    def restore(self) -> None:
        """Write the file as it was."""
        self.path.write_bytes(self.whole)


def formats(folder: Path) -> dict[str, Format]:
    """Write a valid small file of every format; its reader reads them from where they lie."""
    places = {name: folder / name for name in CSV}
    for name, text in CSV.items():
        places[name].write_text(text)
    rng = np.random.default_rng(0)
    sensors = [Sensor(n, d, (float(n), 0.0, 0.5)) for n in (1, 2, 3) for d in ("y", "z")]
    shapes = rng.normal(size=(6, 2)) + 1j * rng.normal(size=(6, 2))
    modes = folder / "modes.uff"
    write_uff(
        modes, names=("a", "b"), natural_freq=np.array([8.0, 12.0]), damping_ratio=np.array([0.02, 0.01]),
        sensors=sensors, shapes=shapes,
    )  # fmt: skip
    frfs = frf_chain.measured(1, responses=(1, 2), references=(1,))
    found = {
        "modes.uff": Format(modes, lambda: read_modes(modes)),
        "responses.csv": Format(places["responses.csv"], lambda: read_responses_csv(places["responses.csv"])),
    }
    for name in ("modes.csv", "shapes.csv", "sensors.csv"):
        found[name] = Format(places[name], lambda: read_modes(
            places["modes.csv"], shapes=places["shapes.csv"], sensors=places["sensors.csv"]
        ))  # fmt: skip
    for form in ("double", "single", "binary"):
        path = folder / f"frf_{form}.uff"
        write_uff_frfs(path, frfs, form=form)  # type: ignore[arg-type]
        found[path.name] = Format(path, lambda path=path: read_frfs(path))
    freq, values = frfs.freq, frfs.values[:, :, 0].astype(complex)
    names = ["1x/1x", "2x/1x"]
    tables = {
        "frf_long.csv": ["response,reference,freq,re,im"]
        + [f"{name[:2]},{name[3:]},{f:.9g},{v.real:.9g},{v.imag:.9g}"
           for name, column in zip(names, values.T, strict=True) for f, v in zip(freq, column, strict=True)],
        "frf_wide.csv": [",".join(["freq", *(f"{name} {part}" for name in names for part in ("re", "im"))])]
        + [",".join(f"{x:.9g}" for x in (f, *np.column_stack([row.real, row.imag]).ravel()))
           for f, row in zip(freq, values, strict=True)],
    }  # fmt: skip
    for name, lines in tables.items():
        (folder / name).write_text("# unit: (m/s2)/N\n" + "\n".join(lines) + "\n")
        found[name] = Format(folder / name, lambda path=folder / name: read_frfs(path))
    texts = [folder / f"function_{k}.txt" for k in (1, 2)]
    for path, column in zip(texts, values.T, strict=True):
        np.savetxt(path, np.column_stack([freq, column.real, column.imag]))
    found["function.txt"] = Format(texts[0], lambda: read_frfs(texts, channels=names, unit="(m/s2)/N"))
    book = folder / "frf.xlsx"
    if write_workbook(book, tables["frf_wide.csv"]):
        found["frf.xlsx"] = Format(book, lambda: read_frfs(book, unit="(m/s2)/N"))
    variables = {"f": freq, "H": values.T}
    for path, write in ((folder / "frf.mat", savemat), (folder / "frf_7_3.mat", write_matlab_hdf5)):
        write(path, variables)
        found[path.name] = Format(path, lambda path=path: read_frfs(
            path, channels=names, unit="(m/s2)/N", variables={"freq": "f", "frf": "H"}
        ))  # fmt: skip
    accelerations = ambient_chain.accelerations(ambient_chain.chain(), 1024, 1)
    record = ambient_chain.write_csv(folder / "record.csv", accelerations)
    found["record.csv"] = Format(record, lambda: read_records(record))
    sets = folder / "record.uff"
    channels = [ambient_chain.uff_set(k + 1, column) for k, column in enumerate(accelerations.T)]
    pyuff.UFF(str(sets)).write_sets(channels, mode="overwrite")
    found["record.uff"] = Format(sets, lambda: read_records(sets, unit="m/s2"))
    return found


def write_workbook(path: Path, lines: Sequence[str]) -> bool:
    """Write lines of a table as a sheet; whether openpyxl is there."""
    try:
        import openpyxl
    except ImportError:
        return False
    book = openpyxl.Workbook()
    for k, line in enumerate(lines):
        book.active.append([cell if not k else float(cell) for cell in line.split(",")])
    book.save(path)
    return True


def write_matlab_hdf5(path: Path, variables: Mapping[str, np.ndarray]) -> None:
    """Write variables as MATLAB does in version 7.3."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in variables.items():
            array = np.atleast_2d(value).T
            parts = [array.real, array.imag]
            file[name] = np.rec.fromarrays(parts, names="real,imag") if np.iscomplexobj(array) else array
    head = b"MATLAB 7.3 MAT-file".ljust(116) + bytes(8) + b"\0\2IM"
    path.write_bytes(head + path.read_bytes()[len(head) :])


def copied(function: Callable[..., object], *given: object) -> object:
    """What `calib.execution.worker.apart` returns or raises, from a copy of this process."""
    reading, writing = os.pipe()
    child = os.fork()
    if not child:
        try:
            answer = function(*given)
        except Exception as fault:
            answer = fault
        with os.fdopen(writing, "wb") as out:
            out.write(pickle.dumps(answer))
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading, "rb") as told:
        content = told.read()
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if code:
        ended.append(code)
        raise EndedError(f"signal {-code}")
    answer = pickle.loads(content)
    if isinstance(answer, Exception):
        raise answer
    return answer


ended: list[int] = []
"""Signals that ended a copy."""


def damaged(data: bytes, draw: random.Random) -> bytes:
    """A copy with one to three damages."""
    for _ in range(draw.choice((1, 1, 2, 3))):
        archive = zipfile.is_zipfile(io.BytesIO(data))
        kinds = ["byte", "byte", "cut", "lost", "doubled", "zeros", "inserted"]
        kinds += ["member"] * 7 if archive else ["line", "lines exchanged", "number", "number", "entry", "spaces"]
        data = _damage(data, draw.choice(kinds), draw)
    return data


def _damage(data: bytes, kind: str, draw: random.Random) -> bytes:
    at = draw.randrange(len(data) + 1)
    end = min(len(data), at + draw.choice((1, 2, 8, 80, 400)))
    if kind == "byte":
        return data[:at] + bytes([draw.randrange(256)]) + data[at + 1 :]
    if kind == "cut":
        return data[:at]
    if kind in ("lost", "doubled", "zeros"):
        return data[:at] + {"lost": b"", "doubled": data[at:end] * 2, "zeros": bytes(end - at)}[kind] + data[end:]
    if kind == "inserted":
        return data[:at] + draw.randbytes(draw.choice((1, 2, 8))) + data[at:]
    if kind == "member":
        return _with_member(data, draw)
    lines = data.split(b"\n")
    line, other = draw.randrange(len(lines)), draw.randrange(len(lines))
    words = lines[line].replace(b",", b" , ").split(b" ")
    word = draw.randrange(len(words))
    if kind == "line":
        lines[line : line + 1] = draw.choice(([], [lines[line]] * 2, [b""], [lines[other]]))
    elif kind == "lines exchanged":
        lines[line], lines[other] = lines[other], lines[line]
    elif kind == "spaces":
        lines[line] = draw.choice((b" " + lines[line], lines[line][1:], lines[line].replace(b" ", b"\t")))
    else:
        number = str(draw.choice((0, -1, 7, 1e300, -1e-300, 10**12, draw.uniform(-9, 9)))).encode()
        words[word] = number if kind == "number" else draw.choice(ENTRIES).encode()
        lines[line] = b" ".join(words).replace(b" , ", b",")
    return b"\n".join(lines)


def _with_member(data: bytes, draw: random.Random) -> bytes:
    """An archive with one damaged member."""
    out = io.BytesIO()
    with (
        warnings.catch_warnings(),
        contextlib.suppress(Exception),
    ):  # of a damaged archive zipfile raises errors of any kind
        warnings.simplefilter("ignore")  # a name may then occur twice
        with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(out, "w") as new:
            names = old.namelist()
            hit = draw.choice(names)
            for name in names:
                content = old.read(name)
                new.writestr(name, damaged(content, draw) if name == hit else content)
        return out.getvalue()
    return data[:-1]


def trial(known: dict[str, Format], number: int) -> str:
    """Outcome of one damaged file: ``read``, ``refused``, ``ended`` where its reader ended, or ``wrong`` with why."""
    draw = random.Random(number)
    name = draw.choice(sorted(known))
    one = known[name]
    one.path.write_bytes(damaged(one.whole, draw))
    out = io.StringIO()
    signal.setitimer(signal.ITIMER_PROF, LONGEST)
    try:
        ended.clear()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out), warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            one.read()
        answer = "read"
    except InputError as fault:
        answer = ("ended" if ended else "refused") if "\n" not in str(fault) else "wrong"
    except BaseException:
        answer = "wrong"
        print(f"--- {number}, {name}\n{traceback.format_exc(limit=-5)}", file=sys.stderr, flush=True)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        one.restore()
    if out.getvalue():
        print(f"--- {number}, {name}, printed: {out.getvalue()[:300]}", file=sys.stderr, flush=True)
        answer = "wrong"
    return f"{name} {answer}"


def trials(known: dict[str, Format], numbers: Sequence[int]) -> Iterator[str]:
    """Outcomes of trials, by child processes; a trial in which one dies is ``died``."""
    left = list(numbers)
    while left:
        reading, writing = os.pipe()
        child = os.fork()
        if not child:
            os.close(reading)
            code = 1
            try:
                with os.fdopen(writing, "w") as out:
                    for number in left[:BATCH]:
                        print(trial(known, number), file=out, flush=True)
                code = 0
            except BaseException:
                traceback.print_exc()
            finally:
                os._exit(code)
        os.close(writing)
        with os.fdopen(reading) as lines:
            done = [line.strip() for line in lines]
        _, status = os.waitpid(child, 0)
        yield from done
        left = left[len(done) :]
        if status != 0:
            name = random.Random(left[0]).choice(sorted(known))
            print(f"--- {left[0]}, {name}: the process died with status {status}", file=sys.stderr, flush=True)
            known[name].restore()
            yield f"{name} died"
            left = left[1:]


def main() -> int:
    """Try as many files as the command line says; print counts by format, and exit with 1 for anything wrong."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("count", nargs="?", type=int, default=20_000)
    arguments.add_argument("--formats", nargs="+", help="names of files, such as frf.xlsx; default all")
    arguments.add_argument("--first", type=int, default=0, help="number of the first trial")
    given = arguments.parse_args()
    counts: Counter[tuple[str, str]] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        known = formats(Path(folder))
        known = {name: one for name, one in known.items() if given.formats is None or name in given.formats}
        matlab.apart = copied  # type: ignore[assignment]
        for one in known.values():
            one.read()  # what is not damaged is read
            assert one.whole
        for outcome in trials(known, range(given.first, given.first + given.count)):
            name, answer = outcome.rsplit(" ", 1)
            counts[name, answer] += 1
    answers = ("read", "refused", "ended", "wrong", "died")
    print(f"{'':16s}" + "".join(f"{answer:>9s}" for answer in answers))
    for name in sorted(known):
        print(f"{name:16s}" + "".join(f"{counts[name, answer]:9d}" for answer in answers))
    totals = {answer: sum(n for (_, own), n in counts.items() if own == answer) for answer in answers}
    print(f"{'all':16s}" + "".join(f"{totals[answer]:9d}" for answer in answers))
    return int(totals["wrong"] + totals["died"] > 0)


if __name__ == "__main__":
    sys.exit(main())
