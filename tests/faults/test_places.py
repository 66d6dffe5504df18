"""Results that cannot be written, disks that are full, files that are damaged, studies edited meanwhile."""

import contextlib
import json
import os
import shutil
import sqlite3
import subprocess
import tempfile
from contextlib import contextmanager
from pathlib import Path

import pytest

from calib.command import cli
from calib.results.results import OWNER, Results
from calib.study.study import LoadedStudy

FOLDER = Path("results/mast")
LEDGER = FOLDER / "ledger.sqlite"
NOBODY = 65534


@pytest.fixture(autouse=True)
def no_figures(monkeypatch):
    monkeypatch.setattr("calib.report.figures.Figures.save", lambda *given: [])


@pytest.fixture
def told(capsys, one_sentence):
    """The complaint of a command that must end with code 2."""

    def complaint(*arguments: str) -> str:
        capsys.readouterr()
        assert cli.execute(list(arguments)) == 2
        text = capsys.readouterr().err
        assert one_sentence(text) and "Traceback" not in text and not Path("calib-error.log").exists()
        return text

    return complaint


def files(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in folder.iterdir() if not p.name.startswith("ledger.sqlite-")}


# -- what may not be written -------------------------------------------------------------------------------------------


@pytest.fixture
def shared(monkeypatch):
    """A current directory that an unprivileged user reaches; permissions do not bind root."""
    folder = Path(tempfile.mkdtemp(prefix="calib-faults-"))
    folder.chmod(0o755)
    monkeypatch.chdir(folder)
    yield folder
    for path in folder.rglob("*"):
        if path.is_dir():
            path.chmod(0o755)
    shutil.rmtree(folder)


@pytest.fixture
def weak():
    """An unprivileged user, to whom permissions apply."""
    return NOBODY if os.geteuid() == 0 else None


@pytest.fixture
def prepared(shared: Path, calibrated, weak) -> dict[str, bytes]:
    """Results of a study after one analysis, owned by the unprivileged user."""
    home = calibrated[0]
    shutil.copytree(home / "mast", "mast")
    shutil.copytree(home / "results", "results")
    (FOLDER / OWNER).unlink()  # it names a place that the weak user cannot see
    for path in (Path("results"), *Path("results").rglob("*")):
        if weak is not None:
            os.chown(path, weak, weak)
    shared.chmod(0o777)
    text = Path("mast/study.toml").read_text()
    Path("mast/study.toml").write_text(text.replace("seed = 2", "seed = 3"))
    return files(FOLDER)


@pytest.mark.slow
def test_a_folder_that_may_not_be_written(prepared, runner, weak, one_sentence):
    FOLDER.chmod(0o555)
    run = runner.fork("calibrate", "mast", "--workers", "1", user=weak)
    assert run.wait() == 2 and one_sentence(run.err) and "cannot be written" in run.err
    assert files(FOLDER) == prepared
    FOLDER.chmod(0o755)
    run = runner.fork("calibrate", "mast", "--workers", "1", user=weak)
    assert run.wait() == 0, run.err


@pytest.mark.slow
def test_a_ledger_that_may_not_be_written(prepared, runner, weak, one_sentence):
    LEDGER.chmod(0o444)
    run = runner.fork("calibrate", "mast", "--workers", "1", user=weak)
    assert run.wait() == 2 and one_sentence(run.err) and "ledger.sqlite: it cannot be written" in run.err
    assert files(FOLDER)["ledger.sqlite"] == prepared["ledger.sqlite"]
    assert files(FOLDER)["parameters.csv"] == prepared["parameters.csv"]
    LEDGER.chmod(0o644)
    run = runner.fork("calibrate", "mast", "--workers", "1", user=weak)
    assert run.wait() == 0, run.err


@pytest.mark.medium
def test_results_of_a_study_whose_folder_may_not_be_read(prepared, shared, runner, weak, one_sentence):
    closed = shared / "closed/mast"
    closed.mkdir(parents=True)
    closed.parent.chmod(0o000)
    (FOLDER / OWNER).write_text(json.dumps({"study": f"{closed}/study.toml", "from_here": ""}))
    (FOLDER / OWNER).chmod(0o644)
    run = runner.fork("compare", "mast", user=weak)
    assert run.wait() == 2 and one_sentence(run.err) and f"{closed}/study.toml" in run.err
    assert {name: content for name, content in files(FOLDER).items() if name != OWNER} == prepared


@pytest.mark.medium
def test_results_replaced_by_a_file(mast, told):
    assert cli.execute(["compare", "mast"]) == 0
    shutil.rmtree(FOLDER)
    FOLDER.write_text("a file")
    for verb in ("compare", "sensitivity", "calibrate", "run"):
        assert "cannot be written" in told(verb, "mast")
    assert FOLDER.read_text() == "a file"


@pytest.mark.slow
def test_results_replaced_by_a_file_while_running(mast, told, monkeypatch):
    @contextmanager
    def progress(verb):
        def at_generation(stage, done=0, total=0, best=0):
            if done == 3 and not Path("moved").exists():
                FOLDER.rename("moved")
                FOLDER.write_text("a file")

        yield at_generation

    monkeypatch.setattr("calib.api.progress.bars", progress)
    said = told("calibrate", "mast", "--workers", "1")
    assert "cannot be written" in said or "cannot be deleted" in said
    assert FOLDER.read_text() == "a file"
    FOLDER.unlink()
    assert cli.execute(["calibrate", "mast", "--workers", "1"]) == 0


# -- full disks --------------------------------------------------------------------------------------------------------


@pytest.fixture
def small_disk(mast):
    """A small file system at ``results``."""
    Path("results").mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", str(Path("results").resolve())]
    try:
        subprocess.run(command, check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError) as fault:
        pytest.skip(f"no file system can be mounted here: {fault}")
    disk = Path("results").resolve()
    yield disk
    subprocess.run(["umount", str(disk)], check=True, capture_output=True)


def room(disk: Path) -> int:
    found = os.statvfs(disk)
    return found.f_bavail * found.f_frsize


@pytest.fixture
def answered_there(small_disk, calibrated) -> Path:
    """That file system with the results of the example study."""
    shutil.copytree(calibrated[0] / "results", small_disk, dirs_exist_ok=True)
    return small_disk


def fill(disk: Path, leave: int) -> Path:
    ballast = disk / "ballast"
    ballast.write_bytes(b"\0" * (room(disk) - leave))
    return ballast


@pytest.mark.slow
@pytest.mark.parametrize("kilobytes", [80, *(pytest.param(size, marks=pytest.mark.slow) for size in (0, 400))])
def test_a_full_disk(mast, small_disk, runner, left, drafts, kilobytes, whole, one_sentence):
    check_full_disk(small_disk, runner, left, drafts, kilobytes, whole[0], False, one_sentence)


@pytest.mark.slow
@pytest.mark.parametrize(
    "kilobytes", [10, 330, *(pytest.param(size, marks=pytest.mark.whole) for size in (90, 170, 250, 410, 490, 570))]
)
def test_a_full_disk_at_any_moment(mast, small_disk, runner, left, drafts, kilobytes, one_sentence):
    run = runner.fork("calibrate", "mast", "--workers", "1", "--results", "whole", draw=True)
    assert run.wait() == 0
    check_full_disk(small_disk, runner, left, drafts, kilobytes, left(Path("whole/mast")), True, one_sentence)


def check_full_disk(disk, runner, left, drafts, kilobytes, whole, draw, one_sentence):
    ballast = fill(disk, 1024 * kilobytes)
    run = runner.fork("calibrate", "mast", "--workers", "1", draw=draw)
    assert run.wait() == 2, (run.code, run.err)
    assert one_sentence(run.err), run.err
    assert "disk is full" in run.err or "No space left" in run.err
    print(f"{kilobytes} kB left: {run.err}")
    assert drafts(disk) == [] and not Path("calib-error.log").exists()
    for table in disk.rglob("*.csv"):
        assert table.read_bytes() == whole.tables[table.name]
    ballast.unlink()
    again = runner.fork("calibrate", "mast", "--workers", "1", draw=draw)
    assert again.wait() == 0, again.err
    assert left(FOLDER) == whole


@pytest.mark.slow
def test_a_disk_too_full_for_a_figure(answered_there, runner, one_sentence):
    before = files(FOLDER)
    fill(answered_there, 100_000)
    run = runner.fork("report", "mast", draw=True)
    assert (
        run.wait() == 2
        and one_sentence(run.err)
        and "a figure or the report cannot be written (No space left" in run.err
    )
    after = files(FOLDER)
    before.pop("figures.sha256", None)  # not all of them are there now
    assert {n: b for n, b in after.items() if not n.endswith(".png")} == before
    assert all(b.endswith(b"IEND\xaeB`\x82") for n, b in after.items() if n.endswith(".png"))


@pytest.mark.medium
def test_a_full_disk_leaves_earlier_results_whole(mast, answered_there, runner, rows, one_sentence):
    before, known = files(FOLDER), rows(LEDGER)
    text = (mast / "study.toml").read_text()
    (mast / "study.toml").write_text(text.replace("seed = 1 }", "seed = 9 }").replace("ions = 6", "ions = 40"))
    ballast = fill(answered_there, 0)
    run = runner.fork("calibrate", "mast", "--workers", "1")
    assert run.wait() == 2 and one_sentence(run.err), run.err
    assert files(FOLDER) == before | {"ledger.sqlite": LEDGER.read_bytes()}
    ballast.unlink()
    assert [set(now) >= set(then) for now, then in zip(rows(LEDGER), known, strict=True)] == [True, True]


# -- damaged files -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda data: b"no database at all, but long enough to be read as one" * 99, "not a ledger"),
        (lambda data: data[: len(data) // 3], "damaged"),
        (lambda data: data[:100] + b"\xff" * 4000 + data[4100:], ""),
        (lambda data: data[:8192] + os.urandom(len(data) - 8192), ""),
    ],
)
def test_a_damaged_ledger(answered, told, damage, words):
    before = files(FOLDER)
    damaged = damage(LEDGER.read_bytes())
    LEDGER.write_bytes(damaged)
    file = answered / "study.toml"
    file.write_text(file.read_text().replace("seed = 2", "seed = 3"))
    assert words in told("calibrate", "mast", "--workers", "1")
    tables = {n: b for n, b in files(FOLDER).items() if n.endswith((".csv", ".json"))}
    assert tables == {n: before[n] for n in tables}


@pytest.mark.slow
def test_without_its_damaged_ledger_a_study_is_evaluated_again(answered, told):
    LEDGER.write_bytes(b"no database at all")
    told("calibrate", "mast", "--workers", "1")
    LEDGER.rename("away.sqlite")
    assert cli.execute(["calibrate", "mast", "--workers", "1"]) == 0


@pytest.mark.slow
def test_damaged_rows_are_evaluated_again(answered, capsys):
    for rubbish in ('{"natural_freq_B1x": 1.0}', b"", b"not eight bytes a number"):
        with contextlib.closing(sqlite3.connect(LEDGER, isolation_level=None)) as database:
            database.execute("DROP TRIGGER IF EXISTS evaluation_stays")
            database.execute("UPDATE evaluation SET responses = ?", (rubbish,))
        assert cli.execute(["calibrate", "mast", "--workers", "1"]) == 0
        assert "of the ledger" in " ".join("".join(capsys.readouterr()).split())


def test_a_ledger_of_a_newer_version(mast, told):
    Results.at(Path("results"), "mast").write_json("answer", {})
    with contextlib.closing(sqlite3.connect(LEDGER)) as database:
        database.execute("CREATE TABLE something_new (x)")
        database.execute("PRAGMA user_version = 99")
    before = LEDGER.read_bytes()
    assert "not a ledger of this version" in told("calibrate", "mast", "--workers", "1")
    assert LEDGER.read_bytes() == before


# -- a study that changes ----------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("value = 2.0", "value = 2.5", ""),  # asks other questions of the same model: this run goes on with its own
        pytest.param("mode_count = 6", "mode_count = 7", "changed while it was running", marks=pytest.mark.slow),
        ('title = "Ex', 'titel = "Ex', "unknown key 'titel'"),
    ],
)
@pytest.mark.parametrize("workers", ["1", pytest.param("2", marks=pytest.mark.slow)])
def test_a_study_edited_while_running(mast, told, monkeypatch, workers, old, new, words):
    load, loaded = LoadedStudy.load, []
    file = mast / "study.toml"

    def edited(path, *taken, **more):
        study = load(path, *taken, **more)
        if not loaded:
            loaded.append(study)
            file.write_text(file.read_text().replace(old, new, 1))
        return study

    monkeypatch.setattr("calib.study.study.LoadedStudy.load", staticmethod(edited))
    if words:
        assert words in told("calibrate", "mast", "--workers", workers)
        assert not Path("results/mast/parameters.csv").exists()
        file.write_text(file.read_text().replace(new, old, 1))
    assert cli.execute(["calibrate", "mast", "--workers", workers]) == 0
