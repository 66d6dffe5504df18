"""A Dask cluster on this machine: its scheduler and workers live in and below a process of their own."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
from collections.abc import Callable

from calib.errors.errors import InputError
from calib.execution.interrupt import PATIENCE
from calib.execution.temporary import TemporaryFolder
from calib.execution.worker import THREAD_VARIABLES

_RUN = "from calib.execution.local_cluster import run_cluster; run_cluster()"


def started(workers: int) -> tuple[str, Callable[[], None]]:
    """Start a scheduler and its workers.

    They end when this process does, however that happens, and Ctrl-C does not reach them. A script that calls this
    needs no guarded main part: no worker runs it again.

    Parameters
    ----------
    workers : int
        With one thread each.

    Returns
    -------
    str
        Address of the scheduler.
    callable
        Ends it, and its workers.

    Raises
    ------
    InputError
        Where it cannot be started.
    """
    environment = os.environ | dict.fromkeys(THREAD_VARIABLES, "1") | {"PYTHONPATH": os.pathsep.join(sys.path)}
    process = subprocess.Popen(
        [sys.executable, "-c", _RUN, str(workers)], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL, env=environment, start_new_session=sys.platform != "win32", text=True,
    )  # fmt: skip
    assert process.stdin is not None and process.stdout is not None
    asking, answering = process.stdin, process.stdout

    def end() -> None:
        asking.close()
        answering.close()
        try:
            process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    try:
        address = answering.readline().strip()
    except BaseException:  # KeyboardInterrupt too
        end()
        raise
    if not address:
        end()
        raise InputError("no cluster can be started on this machine", place="executor")
    return address, end


def run_cluster() -> None:
    """Run a scheduler and its workers until the input ends; the address is written to the output."""
    import dask
    from distributed import LocalCluster

    with TemporaryFolder() as folder:
        dask.config.set({"distributed.worker.daemon": False, "temporary-directory": str(folder)})
        cluster = LocalCluster(
            n_workers=int(sys.argv[1]), threads_per_worker=1, memory_limit=0, dashboard_address=None,
            silence_logs=logging.CRITICAL,
        )  # fmt: skip
        print(cluster.scheduler_address, flush=True)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what models print: nobody would read it
        sys.stdin.read()
    os._exit(0)  # workers end with it, at once
