"""A Dask cluster on this machine's loopback, for tests: a scheduler and workers in processes of their own."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path

import psmpc_cli

LOOPBACK = "127.0.0.1"


class DaskCluster:
    """A scheduler and what has been started beside it; it lets a call end one worker, and no second one."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._started: list[subprocess.Popen[bytes]] = []
        self._file = folder / "scheduler.json"
        self.scheduler = self._start("scheduler", "--port", "0", "--scheduler-file", str(self._file))

    @cached_property
    def address(self) -> str:
        """Where the scheduler is, once it is there."""
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline:
            try:
                return str(json.loads(self._file.read_text())["address"])
            except (FileNotFoundError, json.JSONDecodeError):
                time.sleep(0.05)
        raise AssertionError("no scheduler came up")

    def add(self, *arguments: str) -> None:
        """Start workers."""
        self._start("worker", self.address, *arguments)

    def _start(self, *arguments: str) -> subprocess.Popen[bytes]:
        local = ("--host", LOOPBACK, "--dashboard-address", f"{LOOPBACK}:0")
        settings = {
            "PYTHONPATH": str(Path(psmpc_cli.__file__).parents[1]),
            "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1",
            "DASK_TEMPORARY_DIRECTORY": str(self._folder),
        }
        with (self._folder / "said").open("ab") as said:
            process = subprocess.Popen(
                [sys.executable, "-m", "dask", *arguments, *local],
                env={**os.environ, **settings},
                stdout=said,
                stderr=said,
            )
        self._started.append(process)
        return process

    def stop(self) -> None:
        """End what has been started, workers first."""
        for process in reversed(self._started):
            process.terminate()
            try:
                process.wait(timeout=10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


@contextmanager
def dask_cluster(folder: Path) -> Iterator[DaskCluster]:
    """Give a scheduler without workers."""
    cluster = DaskCluster(folder)
    try:
        yield cluster
    finally:
        cluster.stop()
