"""Looks at an HDF5 file before this process opens it: a crash, a hang or a flood of memory happens to another one.

A file with a seal of this user's is as it was when psmpc closed it, so only what it is made of is looked at. Any other
file, cut off by a kill, changed by another program or of another origin, is read as a whole in a process of its own.
"""

import atexit
import json
import os
import subprocess
import sys
from functools import cache, lru_cache
from pathlib import Path
from threading import Lock, Timer
from time import monotonic

import h5py

import psmpc_cli
from psmpc_cli.logs.probe import seconds
from psmpc_cli.logs.seal import Seal, seal_of
from psmpc_cli.logs.structure import RefusedError, ensure_plain

REMEMBERED = 512
"""Files that are not looked at twice while they do not change."""

PATIENCE = 3.0
"""How much longer a file may take than the computing for it does: the machine may be busy."""

TRIES = 5
"""How often a file is looked at that is being written meanwhile, and may be half done at any moment."""

START_LIMIT = 60.0
"""How long the process may take to start [s]."""

START = "import json, sys; sys.path[:] = json.loads(sys.argv[1]); from psmpc_cli.logs.probe import main; main()"

SURROUNDINGS = {"HDF5_PLUGIN_PRELOAD": "::", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
"""No plug-ins, whatever path to them is set; no threads."""


def ensure_readable(path: Path) -> None:
    """Make sure that this process can read a file.

    Raises:
        RefusedError: It cannot; the message is what was found.
        OSError, RuntimeError, ValueError, KeyError: It is damaged.
    """
    for tries_left in reversed(range(TRIES)):
        state = _state(path)
        try:
            _look_at(os.path.abspath(path), *state)
        except RefusedError:
            if not tries_left or _state(path) == state:
                raise
        else:
            return


def _state(path: Path) -> tuple[int, ...]:
    """Return what shows that a file has changed."""
    status = path.stat()
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns


@lru_cache(REMEMBERED)
def _look_at(path: str, *identity: int) -> None:
    """Look at a file once for every state it is in."""
    state = seal_of(Path(path))
    if state is Seal.BROKEN:
        raise RefusedError("an HDF5 file that is cut off or damaged (it has changed since it was closed)")
    if state is Seal.OWN:
        with h5py.File(path, "r", locking=False) as file:
            ensure_plain(file, file.id.get_filesize())
    elif (wrong := _worker().ask(path)) is not None:
        raise RefusedError(wrong)


class Worker:
    """A process that reads files, started when it is first asked and again after a crash."""

    def __init__(self, program: str = START, patience: float = PATIENCE) -> None:
        self._program, self._patience = program, patience
        self._process: subprocess.Popen[str] | None = None
        self._owner = os.getpid()
        self._lock = Lock()

    def ask(self, path: str) -> str | None:
        """Return what is wrong with a file, None if nothing is."""
        with self._lock:
            if self._owner != os.getpid():  # forked since: the process answers another one
                self._process, self._owner = None, os.getpid()
            fresh, began = self._process is None, monotonic()
            answer = self._ask(path)
            if answer is None and not fresh and monotonic() - began < 1:  # the files before may have done the harm
                answer = self._ask(path)
        return "an HDF5 file that is cut off or damaged (HDF5 crashed or hung on it)" if answer is None else answer[0]

    def close(self) -> None:
        """End the process."""
        if self._process is not None and self._owner == os.getpid():
            self._process.kill()
            self._process.communicate()
            self._process = None

    def _ask(self, path: str) -> tuple[str | None] | None:
        """Return the answer of the process; None if it gave none, which is its end."""
        if self._process is None:
            self._process = _started(self._program)
            _said(self._process, "", START_LIMIT)
        limit = self._patience * seconds(os.path.getsize(path))
        try:
            line = _said(self._process, json.dumps(path) + "\n", limit)
        except KeyboardInterrupt:  # its answer must not be taken for the next one
            self.close()
            raise
        if not line.endswith("\n"):
            self.close()
            return None
        return (json.loads(line),)


def _said(process: "subprocess.Popen[str]", asked: str, limit: float) -> str:
    """Return the next line the process says after it was asked; nothing if it ends, or is ended after a while [s]."""
    if process.stdin is None or process.stdout is None:
        return ""
    timer = Timer(limit, process.kill)
    timer.start()
    try:
        process.stdin.write(asked)
        process.stdin.flush()
        return process.stdout.readline()
    except OSError:
        return ""
    finally:
        timer.cancel()


def _started(program: str) -> "subprocess.Popen[str]":
    """Start the process: with the modules of this one, and without what a user's Python does at its start."""
    root = str(Path(psmpc_cli.__file__).resolve().parents[1])
    return subprocess.Popen(
        [sys.executable, "-S", "-E", "-c", program, json.dumps([root, *filter(None, sys.path)])],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env={**os.environ, **SURROUNDINGS},
        text=True,
        start_new_session=True,
    )


@cache
def _worker() -> Worker:
    """Return the process of this one."""
    worker = Worker()
    atexit.register(worker.close)
    return worker
