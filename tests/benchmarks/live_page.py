"""What an engineer waits for with many designs: the live page, and beside it optuna-dashboard with the same designs.

python tests/benchmarks/live_page.py [--designs 10000] [--optuna PYTHON] [--write FILE]

A small study is searched, and random designs are added to its ledger up to that number. A headless Chromium then opens
each page: seconds to the first view that is drawn, to the drawn update after a generation was added, bytes that the
browser received, and the largest memory of the server. Then the study is searched with the page open: processor time
of the server beside that of the search, and how often a writer of the ledger found it locked. `--optuna` names a Python
with optuna-dashboard; without it that page is left out. Wanted at 100,000 designs: first view within 2 s, updates
within 1 s, server below 400 MB and 3 % of the processor time of the search, no wait for a lock above 50 ms.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import re
import shutil
import signal
import socket
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from page import Page

from calib.command.example import write_example
from calib.execution.outcome import Outcome, point_key
from calib.results.ledger import Individual, Ledger

OPTIONS = ["--no-sandbox", "--enable-unsafe-swiftshader", "--disable-background-networking"]
PATIENT = 300_000
"""Milliseconds that a view may take."""
POPULATION = 100
TO_OPTUNA = """
import json, sys, optuna
from optuna.distributions import FloatDistribution
from optuna.trial import create_trial
optuna.logging.set_verbosity(optuna.logging.WARNING)
url, first = sys.argv[1:3]
study = optuna.create_study(storage=url, study_name="designs", load_if_exists=True)
limits = {name: FloatDistribution(0.0, 10.0) for name in json.loads(first)["values"]}
study.add_trials([
    create_trial(value=one["misfit"], params=one["values"], distributions=limits) for one in map(json.loads, sys.stdin)
])
"""
"""Stores designs, one JSON object a line, in Optuna's storage."""


class Designs:
    """A searched study whose ledger grows by random designs."""

    def __init__(self, folder: Path):
        write_example(folder / "building", "modes")
        command = [
            sys.executable,
            "-m",
            "calib",
            "calibrate",
            "building",
            "--quick",
            "--method",
            "genetic",
            "--workers",
            "1",
        ]
        subprocess.run(command, cwd=folder, check=True, capture_output=True)
        home = folder / "results/building"
        (summary,) = home.rglob("summary.json")
        self.run = next(iter(json.loads(summary.read_text())["searches"].values()))
        self.ledger = Ledger.open(home / "ledger.sqlite")
        self.state = self.ledger.searched(self.run)
        history = self.ledger.history(self.run)
        self.generation = int(history["generation"].max())
        self.lowest = float(history["misfit"].min())
        (self.known,) = self.ledger.lookup(self.state, history["key"][:1]).values()
        self.random = np.random.default_rng(1)

    def add(self, count: int) -> list[dict[str, Any]]:
        """One generation of random designs, of which the first is the best so far."""
        values = self.random.uniform(0.5, 2.0, (count, len(self.known.values)))
        factors = self.random.normal(1.0, 0.05, (count, len(self.known.responses)))
        misfits = self.lowest * (1.0 + self.random.exponential(5.0, count))
        misfits[0] = self.lowest = 0.9999 * self.lowest
        points = [dict(zip(self.known.values, map(float, own), strict=True)) for own in values]
        names, before = list(self.known.responses), np.array(list(self.known.responses.values()))
        responses = [dict(zip(names, own, strict=True)) for own in (factors * before).tolist()]
        found = [Outcome(point, "ok", own, "", 0.01) for point, own in zip(points, responses, strict=True)]
        self.ledger.append(self.state, found)
        self.generation += 1
        self.ledger.record(self.run, self.state, self.generation, [
            Individual(point_key(point), "ok", float(misfit)) for point, misfit in zip(points, misfits, strict=True)
        ])  # fmt: skip
        return [{"values": v, "misfit": float(m)} for v, m in zip(points, misfits, strict=True)]


class Received:
    """Bytes that a tab has received, as its browser counts them."""

    def __init__(self, tab: Any):
        self.bytes = 0
        session = tab.context.new_cdp_session(tab)
        session.send("Network.enable")
        session.on("Network.loadingFinished", lambda event: self.add(event["encodedDataLength"]))
        session.on("Network.webSocketFrameReceived", lambda event: self.add(len(event["response"]["payloadData"])))

    def add(self, count: float) -> None:
        """Some more."""
        self.bytes += int(count)


@contextlib.contextmanager
def served(command: list[str], folder: Path, address: Callable[[subprocess.Popen[str]], str]) -> Iterator[Any]:
    """A server, with its address."""
    server = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        yield server, address(server)
    finally:
        server.terminate()
        server.wait()


def printed(server: subprocess.Popen[str]) -> str:
    """The address that a server prints."""
    assert server.stdout is not None
    found = re.search(r"http://\S+", server.stdout.readline())
    assert found is not None, "the server has not begun"
    return found[0]


def answering(port: int) -> Callable[[subprocess.Popen[str]], str]:
    """The address of a server once it answers."""

    def wait(server: subprocess.Popen[str]) -> str:
        while server.poll() is None:
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1.0):
                return f"http://127.0.0.1:{port}/dashboard/studies/1"
            time.sleep(0.2)
        raise SystemExit("optuna-dashboard has ended")

    return wait


def megabytes(server: subprocess.Popen[str]) -> str:
    """Largest memory of a server."""
    with contextlib.suppress(OSError):
        found = re.search(r"VmHWM:\s+(\d+)", Path(f"/proc/{server.pid}/status").read_text())
        return f"{int(found[1]) / 1024:.0f}" if found else "unknown"
    return "unknown"


def measured(tab: Any, act: Callable[[], object], drawn: Callable[[], object], received: Received) -> tuple[str, str]:
    """Seconds from an act to a drawn page, and kilobytes received meanwhile."""
    before, began = received.bytes, time.perf_counter()
    act()
    drawn()
    seconds = time.perf_counter() - began
    tab.wait_for_timeout(200)  # counts of what is drawn follow
    return f"{seconds:.2f}", f"{(received.bytes - before) / 1000:.0f}"


def of_calib(browser: Any, folder: Path, designs: Designs) -> list[list[str]]:
    """Search and designs in the live page."""
    command = [sys.executable, "-m", "calib", "open", "building", "--no-browser"]
    with served(command, folder, printed) as (server, address):
        tab = browser.new_page(viewport={"width": 1440, "height": 900})
        tab.set_default_timeout(PATIENT)
        received = Received(tab)

        def generation() -> None:
            tab.get_by_role("cell", name=str(designs.generation), exact=True).wait_for()

        tab.goto(address)
        tab.locator("#side a").first.wait_for()
        place = tab.url.split("#")[1].split("/")[1]
        first = measured(
            tab, lambda: (tab.goto("about:blank"), tab.goto(f"{address}#/{place}/search")), generation, received
        )
        added = measured(tab, lambda: designs.add(POPULATION), generation, received)
        table = tab.locator("#table tbody tr").first
        cloud = measured(
            tab, lambda: tab.get_by_role("link", name="Designs", exact=True).click(), table.wait_for, received
        )
        rows = [["first view: curves of the search", *first], ["update after a generation", *added],
                ["view of all designs: axes, cloud, correlations, table", *cloud]]  # fmt: skip
        rows = [["calib open", *row, megabytes(server)] for row in rows]
        tab.close()
    return rows


def while_searching(browser: Any, folder: Path, designs: Designs, seconds: float) -> list[list[str]]:
    """Processor time of the page's server beside that of a search, and refused locks of the ledger meanwhile."""
    file = folder / "building/study.toml"
    file.write_text(file.read_text().replace("generations = 60", "generations = 100000"))
    command = [sys.executable, "-m", "calib", "open", "building", "--no-browser"]
    searching = [sys.executable, "-m", "calib", "calibrate", "building", "--method", "genetic", "--workers", "1"]
    with served(command, folder, printed) as (server, address):
        tab = browser.new_page(viewport={"width": 1440, "height": 900})
        tab.set_default_timeout(PATIENT)
        tab.goto(address)
        tab.get_by_role("link", name="Search", exact=True).click()
        tab.locator("#view .panel").first.wait_for()
        search = subprocess.Popen(searching, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        tab.locator("#running").wait_for()
        tab.wait_for_timeout(5000)  # it reads the study
        before = [processor_time(one.pid) for one in (server, search)]
        tab.wait_for_timeout(1000 * seconds)
        spent = [processor_time(one.pid) - old for one, old in zip((server, search), before, strict=True)]
        search.send_signal(signal.SIGINT)
        search.wait()
        tab.wait_for_timeout(2000)
        tried, refused, longest = locked(folder / "results/building/ledger.sqlite", lambda: designs.add(1), seconds)
        tab.close()
    share = 100 * spent[0] / spent[1]
    return [
        ["processor time of search and server", f"{spent[1]:.1f} s, {spent[0]:.2f} s: {share:.1f} %"],
        ["locks asked for and refused while the page reads", f"{tried}, {refused}: longest wait {longest:.0f} ms"],
    ]


def processor_time(pid: int) -> float:
    """Seconds that a process, its threads and its ended children have computed."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")


def locked(ledger: Path, change: Callable[[], object], seconds: float) -> tuple[int, int, float]:
    """Attempts to lock a ledger for writing, those that were refused at once, and the longest row of these, ms.

    The ledger changes now and then, so that the page reads it anew.
    """
    tried = refused = 0
    longest, free, until, due = 0.0, time.perf_counter(), time.perf_counter() + seconds, 0.0
    with contextlib.closing(sqlite3.connect(ledger, timeout=0, isolation_level=None)) as writer:
        while (now := time.perf_counter()) < until:
            if now > due:
                change()
                free = time.perf_counter()
                due = free + 0.3
            tried += 1
            try:
                writer.execute("BEGIN IMMEDIATE")
                writer.execute("ROLLBACK")
                free = time.perf_counter()
            except sqlite3.OperationalError:
                refused += 1
                longest = max(longest, time.perf_counter() - free)
            time.sleep(0.001)
    return tried, refused, 1000 * longest


def of_optuna(
    browser: Any, folder: Path, python: str, designs: Designs, known: list[dict[str, Any]]
) -> list[list[str]]:
    """The same designs in optuna-dashboard."""
    url = f"sqlite:///{folder / 'optuna.db'}"

    def stored(some: list[dict[str, Any]]) -> None:
        lines = "\n".join(map(json.dumps, some))
        subprocess.run([python, "-c", TO_OPTUNA, url, json.dumps(some[0])], input=lines, text=True, check=True)

    stored(known)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    program = shutil.which("optuna-dashboard", path=str(Path(python).parent)) or "optuna-dashboard"
    with served([program, url, "--port", str(port)], folder, answering(port)) as (server, address):
        tab = browser.new_page(viewport={"width": 1440, "height": 900})
        tab.set_default_timeout(PATIENT)
        received = Received(tab)
        last: list[dict[str, Any]] = []

        def best() -> None:
            tab.get_by_text(f"{designs.lowest:.4g}"[:6]).first.wait_for()
            tab.locator(".main-svg").first.wait_for()

        def add() -> None:
            last.extend(designs.add(1))
            stored(last)

        first = measured(tab, lambda: tab.goto(address), best, received)
        added = measured(tab, add, best, received)
        rows = [["first view: history of the objective", *first], ["update after a trial", *added]]
        rows = [["optuna-dashboard", *row, megabytes(server)] for row in rows]
        tab.close()
    return rows


def main() -> None:
    """Make the designs, then open both pages."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--designs", type=int, default=10_000)
    parser.add_argument("--optuna", default=sys.executable, metavar="PYTHON", help="one that has optuna-dashboard")
    parser.add_argument("--seconds", type=float, default=30.0, help="of the search beside the page")
    parser.add_argument("--write", type=Path)
    given = parser.parse_args()
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    try:
        from playwright.sync_api import sync_playwright
    except ModuleNotFoundError:
        raise SystemExit("left out: playwright is not installed") from None
    if browser is None:
        raise SystemExit("left out: there is no Chromium")
    out, known = Page(given.write), list[dict[str, Any]]()
    out.begin(f"{given.designs} designs in a page")
    with tempfile.TemporaryDirectory() as place, sync_playwright() as driver:
        folder = Path(place)
        designs = Designs(folder)
        while len(known) < given.designs:
            known += designs.add(min(POPULATION, given.designs - len(known)))
        opened = driver.chromium.launch(executable_path=browser, args=OPTIONS)
        rows = of_calib(opened, folder, designs)
        beside = while_searching(opened, folder, designs, given.seconds)
        lacks = subprocess.run(
            [given.optuna, "-c", "import optuna_dashboard"], capture_output=True, check=False
        ).returncode
        if not lacks:
            rows += of_optuna(opened, folder, given.optuna, designs, known)
        opened.close()
    out.table(["page", "what", "seconds", "kB received", "server, MB"], rows)
    out.table(["beside a search", "found"], beside)
    if lacks:
        out.say(f"optuna-dashboard is left out: {given.optuna} does not have it.")


if __name__ == "__main__":
    main()
