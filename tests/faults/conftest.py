"""The whole command on a small study, in processes that can be stopped, and the files of a run."""

import contextlib
import json
import os
import pickle
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing import resource_tracker
from pathlib import Path

import pytest

from calib.__main__ import main
from calib.command.example import write_example
from calib.errors.errors import InputError
from calib.errors.place import Place
from calib.execution.evaluate import Evaluator
from calib.report.figures import Figures
from calib.study.study import LoadedStudy
from tests.template import plain as template

ROOT = Path(__file__).resolve().parents[2]
ASKED = """
[calibration]
population = 6
generations = 3
cases = [{ name = "A1", seed = 1 }, { name = "A2", seed = 2 }]
"""


def shrink(study: Path, population: int = 8, generations: int = 6) -> Path:
    text = (study / "study.toml").read_text()
    text = text.replace('method = "auto"', 'method = "genetic"')  # a search asks for many points, which stop well
    text = text.replace("population = 30", f"population = {population}")
    text = text.replace("generations = 60", f"generations = {generations}").replace("samples = 200", "samples = 12")
    (study / "study.toml").write_text(text)
    return study


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def mast(here):
    """The example study, small, as ``mast`` in the current directory."""
    write_example(Path("mast"))
    return shrink(Path("mast"))


@pytest.fixture
def plain(here):
    """Makes a study ``plain`` whose model is the given source of a function ``answer(values)``."""

    def make(function: str, asked: str = ASKED) -> Path:
        return template.write(Path("plain"), function, asked, y=(3.0, 0.1), z=(1.0, 0.1))

    return make


# -- processes ---------------------------------------------------------------------------------------------------------


class Run:
    """A command in a session of its own, as a foreground job of a terminal is."""

    def __init__(self, pid: int, folder: Path):
        self.pid, self.folder, self.code = pid, folder, None

    def poll(self) -> int | None:
        if self.code is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            self.code = os.waitstatus_to_exitcode(status) if pid else None
        return self.code

    def wait(self, seconds: float = 240.0) -> int | None:
        """Exit code, or None while it runs."""
        until = time.monotonic() + seconds
        while self.poll() is None and time.monotonic() < until:
            time.sleep(0.002)
        return self.code

    def until(self, condition, seconds: float = 240.0, ended: int | None = None) -> None:
        """Wait for a condition; the run may have ended with the code ``ended`` before."""
        until = time.monotonic() + seconds
        while not condition():
            assert self.poll() in (None, ended), f"ended with {self.code}: {self.err}"
            assert time.monotonic() < until
            time.sleep(0.002)

    def send(self, sign: int, everybody: bool = False) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.pid, sign) if everybody else os.kill(self.pid, sign)

    @property
    def out(self) -> str:
        return (self.folder / "out").read_text()

    @property
    def err(self) -> str:
        return (self.folder / "err").read_text()

    def family(self) -> list[int]:
        """Processes of the session that have not ended."""
        found = []
        for stat in Path("/proc").glob("[0-9]*/stat"):
            with contextlib.suppress(OSError):
                state, _, _, session = stat.read_text().rsplit(")", 1)[1].split()[:4]
                if int(session) == self.pid and state != "Z":
                    found.append(int(stat.parent.name))
        return found

    def nobody_left(self, seconds: float = 20.0) -> bool:
        until = time.monotonic() + seconds
        while self.family() and time.monotonic() < until:
            time.sleep(0.01)
        return not self.family()


@pytest.fixture
def late_only_where(monkeypatch):
    """Makes evaluators abandon those late points alone that hang, however busy the machine is.

    The fixture is a function that takes the test of a point's values.
    """
    begin, late = Evaluator._round, Evaluator._late

    def begun(evaluator, points, *given):
        evaluator.points = points
        return begin(evaluator, points, *given)

    def set_up(hangs):
        def hanging(evaluator):
            return {k: seconds for k, seconds in late(evaluator).items() if hangs(evaluator.points[k])}

        monkeypatch.setattr(Evaluator, "_round", begun)
        monkeypatch.setattr(Evaluator, "_late", hanging)

    return set_up


class Runner:
    """Starts commands, either as a user does or, without the seconds that the imports take, as a fork."""

    def __init__(self, folder: Path):
        self.folder, self.runs = folder, []

    def _place(self) -> Path:
        place = self.folder / str(len(self.runs))
        place.mkdir(parents=True)
        return place

    def command(self, *arguments: str) -> Run:
        place = self._place()
        environment = os.environ | {"PYTHONPATH": str(ROOT)}
        with (place / "out").open("w") as out, (place / "err").open("w") as err:
            process = subprocess.Popen(
                [sys.executable, "-m", "calib", *arguments],
                stdout=out, stderr=err, env=environment, start_new_session=True,
            )  # fmt: skip
        process.returncode = 0  # `Run` waits for it
        self.runs.append(Run(process.pid, place))
        return self.runs[-1]

    def fork(self, *arguments: str, user: int | None = None, draw: bool = False, prepare=lambda: None) -> Run:
        place = self._place()
        (place / "out").touch(), (place / "err").touch()
        begun, begins = os.pipe()
        pid = os.fork()
        if not pid:
            self._child(place, arguments, user, draw, prepare, begins)
        os.close(begins)
        os.read(begun, 1)  # what the child does before the command is not interrupted
        os.close(begun)
        self.runs.append(Run(pid, place))
        return self.runs[-1]

    def _child(self, place, arguments, user, draw, prepare, begins):
        code = 70
        try:
            os.setsid()
            # What a killed run leaks is its own affair: the test run's tracker would complain about it at the end.
            resource_tracker._resource_tracker._fd = resource_tracker._resource_tracker._pid = None
            for number, name in ((1, "out"), (2, "err")):
                os.dup2(os.open(place / name, os.O_WRONLY), number)
            sys.stdout, sys.stderr = open(1, "w", closefd=False), open(2, "w", closefd=False)
            signal.signal(signal.SIGINT, signal.default_int_handler)
            if user is not None:
                os.setgroups([])
                os.setgid(user)
                os.setuid(user)
            if not draw:
                Figures.save = lambda *given: []
            prepare()
            sys.argv = ["calib", *arguments]
            os.close(begins)
            main()
        except SystemExit as leaving:
            code = leaving.code
        except BaseException:
            traceback.print_exc()
        finally:
            with contextlib.suppress(BaseException):
                sys.stdout.flush(), sys.stderr.flush()
            os._exit(code)


@pytest.fixture
def runner(tmp_path):
    made = Runner(tmp_path / "said")
    yield made
    for run in made.runs:
        if run.poll() is None:
            run.send(signal.SIGKILL)
            run.wait()
        for pid in run.family():
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)


# -- what is left behind -----------------------------------------------------------------------------------------------


def without_seconds(value):
    if isinstance(value, dict):
        return {k: without_seconds(v) for k, v in value.items() if k != "seconds"}
    return value


@dataclass(frozen=True)
class Left:
    """Files of a run in its folder, without times."""

    rows: tuple
    history: tuple
    tables: dict
    summary: dict
    figures: frozenset

    @staticmethod
    def by(folder: Path) -> "Left":
        return Left(
            *ledger_rows(folder / "ledger.sqlite"),
            {p.name: p.read_bytes() for p in folder.glob("*.csv")},
            without_seconds(json.loads((folder / "summary.json").read_text())),
            frozenset(p.name for p in folder.glob("*.png")),
        )


def ledger_rows(path: Path) -> tuple[tuple, tuple]:
    with contextlib.closing(sqlite3.connect(path)) as database:
        assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        return tuple(
            tuple(sorted(database.execute(query).fetchall(), key=repr))
            for query in (
                "SELECT fingerprint, key, attempt, p.names, parameters, r.names, responses, status, error"
                " FROM state JOIN evaluation ON state = state.id"
                " JOIN names p ON parameter_names = p.id JOIN names r ON response_names = r.id",
                "SELECT run, generation, individual, fingerprint, key, status, misfit FROM individuals",
            )
        )


@pytest.fixture(scope="session")
def calibrated(tmp_path_factory) -> tuple[Path, float]:
    """Folder of an undisturbed ``calib calibrate mast --workers 1``, without figures; its seconds."""
    folder = tmp_path_factory.mktemp("whole")
    with contextlib.chdir(folder):
        write_example(Path("mast"))
        shrink(Path("mast"))
        began = time.monotonic()
        run = Runner(folder / "said").fork("calibrate", "mast", "--workers", "1")
        assert run.wait() == 0, run.err
    return folder, time.monotonic() - began


@pytest.fixture(scope="session")
def whole(calibrated) -> tuple[Left, float]:
    """What that leaves, and its seconds."""
    folder, seconds = calibrated
    found = Left.by(folder / "results/mast")
    assert {row[5] for row in found.history} == {"solved", "reused"}
    return found, seconds


@pytest.fixture
def answered(calibrated, mast) -> Path:
    """The example study with the same results, all of which may be changed."""
    shutil.copytree(calibrated[0] / "results", "results")
    return mast


def unfinished(folder: Path) -> list[str]:
    """Unfinished drafts."""
    return [p.name for p in folder.rglob(".*") if p.is_file()]


@pytest.fixture
def left():
    return Left.by


@pytest.fixture
def drafts():
    return unfinished


@pytest.fixture
def rows():
    return ledger_rows


# -- mistakes in the user's files --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Expected:
    """Where the mistake was put."""

    file: Path
    line: int
    text: str
    column: int | None
    marked: str


class Mistakes:
    """Puts mistakes into files and compares the places of errors with theirs.

    The wrong text stands between ⟦ and ⟧, which are taken out of the file; ⟦⟧ marks a line of which no column is known.
    """

    @staticmethod
    def put(file: Path, *changes: tuple[str, str]) -> Expected:
        """Make the changes of a file and return the marked place."""
        text = file.read_text("utf-8")
        for old, new in changes:
            assert old in text, old
            text = text.replace(old, new, 1)
        return Mistakes.marked(file, text)

    @staticmethod
    def marked(file: Path, text: str) -> Expected:
        """Write a file without its marks and return the marked place."""
        before, _, rest = text.partition("⟦")
        wrong, _, after = rest.partition("⟧")
        clean = before + wrong + after
        file.write_text(clean, "utf-8")
        line = before.count("\n") + 1
        own = clean.split("\n")[line - 1].rstrip()
        return Expected(file, line, own, len(before) - before.rfind("\n") if wrong else None, wrong)

    @staticmethod
    def check(at: Place | None, expected: Expected) -> None:
        """The place of an error is the marked one."""
        assert at is not None
        assert Path(at.file).resolve() == expected.file.resolve()
        assert (at.line, at.text.rstrip()) == (expected.line, expected.text)
        if expected.column is None:
            assert at.column is None
        else:
            assert at.column == expected.column
            assert at.text[at.column - 1 : at.column - 1 + at.length] == expected.marked

    @staticmethod
    def refused(folder: Path, act: Callable[[Path], object] = LoadedStudy.load) -> InputError:
        """The error of an action, which is the same after the way from another process."""
        with pytest.raises(InputError) as caught:
            act(folder)
        fault = caught.value
        copy = pickle.loads(pickle.dumps(fault))  # as on the way from a worker process
        assert (copy.at, copy.sentence, str(copy)) == (fault.at, fault.sentence, str(fault))
        assert copy.__notes__ == fault.__notes__ and len(fault.__notes__) == 1 + bool(fault.table)
        return fault


@pytest.fixture(scope="session")
def mistakes() -> type[Mistakes]:
    return Mistakes
