"""Kills commands at random moments, injects errors of disk and memory, starts them again, and compares what they leave.

A resumed command must end with the tables, the evaluations and the written study of one that was never disturbed, to
the byte, and leave no process, no draft and no temporary folder behind. Ctrl-C ends the bench with the counts so far.

Records hold the digest of calib's own code, so that results differ where somebody edits it while the bench runs; the
bench then says so. Run it in a clone that nobody edits.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import itertools
import json
import os
import random
import shutil
import signal
import sqlite3
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from calib.command.example import write_example
from calib.results import written
from calib.results.ledger.database import Database
from calib.results.results import Results
from tests.faults.conftest import Run, Runner, ledger_rows, shrink, without_seconds
from tests.template.mast_effects import write_study

COMMANDS = {
    "sensitivity": ("sensitivity", "mast", "--workers", "2"),
    "calibrate": ("calibrate", "mast", "--workers", "2"),
    "explain": ("explain", "guyed", "--workers", "2"),
    "propose": ("propose", "guyed", "--rank", "1"),
    "report": ("report", "mast"),
}
SIGNALS = {"SIGKILL": signal.SIGKILL, "SIGTERM": signal.SIGTERM, "Ctrl-C": signal.SIGINT}
ERRORS: dict[str, Callable[[], BaseException]] = {
    "no space": lambda: OSError(28, "No space left on device"),
    "disk error": lambda: sqlite3.OperationalError("disk I/O error"),
    "no memory": MemoryError,
}
LONGEST = 3600.0
"""Seconds that a command may take on a busy machine before it counts as hanging."""
LONGEST_END = 120.0
"""Seconds after the end of a command within which every process of it has ended, on a busy machine."""
_AT_ERRORS = (1, 2, 5, 10, 20, 40, 80)
"""Of so many writes, one fails."""


def main() -> None:
    """Run the bench; exit code 1 where a resumed command ends otherwise, or something is left behind."""
    given = argparse.ArgumentParser(description=__doc__)
    given.add_argument("kills", type=int, nargs="?", default=100)
    given.add_argument("--seed", type=int, default=0)
    asked = given.parse_args()
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        sys.exit(bench(Path(folder), asked.kills, random.Random(asked.seed)))


def bench(home: Path, kills: int, draw: random.Random) -> int:
    """Prepare what is to be killed, kill it, and print the counts; the number of wrong ends."""
    temporary = home / "tmp"
    temporary.mkdir()
    os.environ["TMPDIR"] = tempfile.tempdir = str(temporary)
    runner = Runner(home / "said")
    prepare(runner)
    whole, seconds = undisturbed(runner)
    counts: Counter[tuple[str, str]] = Counter()
    code, wrong = own_code(), []
    with contextlib.suppress(KeyboardInterrupt):
        for number in range(kills):
            verb, ended, faults = one_kill(runner, number, draw, whole, seconds, temporary)
            counts[verb, ended] += 1
            wrong += [number] * bool(faults)
    ends = sorted({ended for _, ended in counts})
    print(f"{'':12s}" + "".join(f"{end:>12s}" for end in ends))
    for verb in COMMANDS:
        print(f"{verb:12s}" + "".join(f"{counts[verb, end]:12d}" for end in ends))
    done = sum(counts.values())
    print(f"{done} disturbed commands, {done - len(wrong)} resumed as if nothing had happened")
    if own_code() != code:
        print("calib's own code was edited while the bench ran: records differ, and the counts do not hold")
    return int(bool(wrong) or own_code() != code)


def own_code() -> str:
    """Digest of calib's own files."""
    files = sorted((ROOT / "calib").rglob("*.py"))
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


def one_kill(
    runner: Runner,
    number: int,
    draw: random.Random,
    whole: dict[str, dict[str, Any]],
    seconds: dict[str, float],
    temporary: Path,
) -> tuple[str, str, list[str]]:
    """Disturb one command and run it again: its verb, how it ended, and what is wrong then, which is printed."""
    verb = list(COMMANDS)[number % len(COMMANDS)]
    how = draw.choice([*SIGNALS, *ERRORS])
    begin(verb)
    ended = disturbed(runner, verb, how, draw, seconds[verb])
    again = runner.fork(*COMMANDS[verb], draw=verb == "report")
    faults = []
    if again.wait(LONGEST) != 0:
        faults.append(f"the resumed command ended with {again.code}: {again.err}")
    elif different := differences(left(), whole[verb]):
        faults.append(f"differs: {', '.join(different)}")
    faults += remains(temporary, runner)
    for fault in faults:
        print(f"{number}: {verb}, {how}: {fault}", flush=True)
    return verb, ended, faults


def prepare(runner: Runner) -> None:
    """Two studies: the example, and a mast whose library lacks the effect that it lacks, explained once."""
    write_example(Path("mast"))
    shrink(Path("mast"))
    write_study(Path("guyed"), {"guy": 9000.0})
    effects = Path("guyed/effects.py")
    lines = effects.read_text().splitlines(keepends=True)
    effects.write_text("".join(line for line in lines if not line.strip().startswith('_one("guy"')))
    for command in (COMMANDS["calibrate"], COMMANDS["explain"]):
        run = runner.fork(*command)
        assert run.wait(LONGEST) == 0, run.err
    shutil.move("results", "prepared")


def begin(verb: str) -> None:
    """The results before a command: none, or those that it needs."""
    shutil.rmtree("results", ignore_errors=True)
    if verb in ("propose", "report"):
        shutil.copytree("prepared", "results")


def undisturbed(runner: Runner) -> tuple[dict[str, dict[str, Any]], dict[str, float]]:
    """What each command leaves, and its seconds."""
    whole, seconds = {}, {}
    for verb, command in COMMANDS.items():
        begin(verb)
        began = time.monotonic()
        run = runner.fork(*command, draw=verb == "report")
        assert run.wait(LONGEST) == 0, run.err
        whole[verb], seconds[verb] = left(), time.monotonic() - began
    return whole, seconds


def disturbed(runner: Runner, verb: str, how: str, draw: random.Random, seconds: float) -> str:
    """Run a command and disturb it; how it ended."""
    if how in SIGNALS:
        run = runner.fork(*COMMANDS[verb], draw=verb == "report")
        if run.wait(draw.uniform(0.0, seconds)) is None:
            run.send(SIGNALS[how], everybody=how != "SIGKILL")
        run.wait(LONGEST)
        stopped = {"SIGKILL": -signal.SIGKILL}.get(how, 130)
        return "got through" if run.code == 0 else how if run.code == stopped else f"code {run.code}"
    at = draw.choice(_AT_ERRORS)
    run = runner.fork(*COMMANDS[verb], draw=verb == "report", prepare=lambda: fail(at, ERRORS[how]))
    run.wait(LONGEST)
    return "got through" if run.code == 0 else how if run.code in (1, 2) else f"code {run.code}"


def fail(at: int, error: Callable[[], BaseException]) -> None:
    """From now on one write of this process fails: to the ledger, or of a file of results."""
    numbers = itertools.count(1)

    def failing(write: Callable[..., Any]) -> Callable[..., Any]:
        def act(*given: Any, **more: Any) -> Any:
            if next(numbers) == at:
                raise error()
            return write(*given, **more)

        return act

    written._add = failing(written._add)
    execute = Database.execute

    def watched(self: Database, statement: str, *given: Any) -> Any:
        writes = statement.lstrip().startswith(("INSERT", "COMMIT"))
        return failing(execute)(self, statement, *given) if writes else execute(self, statement, *given)

    Database.execute = watched  # type: ignore[method-assign]


def left() -> dict[str, Any]:
    """Tables, records, studies and evaluations below the folder of results, without times."""
    found: dict[str, Any] = {}
    for path in sorted(Path("results").rglob("*")):
        name = path.as_posix()
        if path.suffix in (".csv", ".py", ".toml"):
            found[name] = path.read_bytes()
        elif path.suffix == ".json":
            found[name] = without_times(json.loads(path.read_text()))
        elif path.suffix == ".sqlite":
            found[name] = ledger_rows(path)
        elif path.suffix in (".html", ".png"):
            found[name] = True
    return found


def without_times(value: Any) -> Any:
    """A record without when it was made and how long that took."""
    value = without_seconds(value)
    if isinstance(value, dict):
        return {key: without_times(one) for key, one in value.items() if key != "when"}
    return [without_times(one) for one in value] if isinstance(value, list) else value


def differences(found: dict[str, Any], whole: dict[str, Any]) -> list[str]:
    """Names of the files that differ or are there on one side only, of records with the keys that differ."""
    return [
        name + _keys(found.get(name), whole.get(name))
        for name in sorted({*found, *whole})
        if found.get(name) != whole.get(name)
    ]


def _keys(found: Any, whole: Any) -> str:
    """Path to the first value that differs, and both values."""
    if isinstance(found, dict) and isinstance(whole, dict):
        key = next(key for key in sorted({*found, *whole}) if found.get(key) != whole.get(key))
        return f", {key}{_keys(found.get(key), whole.get(key))}"
    return "" if isinstance(found, bytes | tuple) else f": {str(found)[:60]} for {str(whole)[:60]}"


def remains(temporary: Path, runner: Runner) -> list[str]:
    """What was left behind, in words: processes, temporary folders, and drafts that no later command would clear."""
    found = [f"process {words}" for run in runner.runs[-2:] if not run.nobody_left(LONGEST_END) for words in who(run)]
    found += [f"temporary folder {path.name}" for path in temporary.glob("calib_*")]
    for draft in Path("results").rglob(f".*{written.DRAFT}"):
        os.utime(draft, (0, 0))
    for study in Path("results").glob("*/"):
        Results.at(Path("results"), study.name)
    return found + [f"draft {path}" for path in Path("results").rglob(f".*{written.DRAFT}")]


def who(run: Run) -> list[str]:
    """Processes of a command that are still there: state and command line."""
    found = []
    for pid in run.family():
        with contextlib.suppress(OSError):
            state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
            line = Path(f"/proc/{pid}/cmdline").read_text().replace("\0", " ")
            found.append(f"{pid} ({state}) of {run.pid}, which ended with {run.code}: {line[:200]}")
    return found


if __name__ == "__main__":
    main()
