"""The runner of studies: cells computed in parallel, and a results file that is filled in and resumed.

A study is a task, the keys that each cell changes in it, and a measure: a function from the run of a cell to a row of
named values. Sweeps and Monte Carlo studies are instances. The results are labelled arrays, which xarray opens.
"""

import json
import logging
import os
import re
import signal
import time
import warnings
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from itertools import islice
from multiprocessing import resource_tracker
from pathlib import Path
from pkgutil import resolve_name
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

import numpy as np
from joblib import Parallel, delayed, parallel_config
from joblib.externals.loky.backend import resource_tracker as loky_resource_tracker
from joblib.externals.loky.process_executor import TerminatedWorkerError

from psmpc_cli import __version__
from psmpc_cli.errors import InputError, RunError, SpecError
from psmpc_cli.logs.results import Quantity, Results, ResultsWriter, create_results, read_results
from psmpc_cli.logs.run import Run
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.document import describe
from psmpc_cli.specs.load import Task, parse_task
from psmpc_cli.specs.messages import dotted, quoted, shortened
from psmpc_cli.studies.measures import Row

logger = logging.getLogger(__name__)

Item = TypeVar("Item")
Result = TypeVar("Result")

LOST = "its process was killed each time it was computed, perhaps for lack of memory"
"""Failure of a cell that was lost."""

PATIENCE = 2
"""Passes in a row that may end with a killed process and no result before cells are computed one at a time."""

WAITING = 0
"""Status of a cell that has not been computed."""

CONNECTING = 10
"""Time within which a Dask scheduler answers and has a worker [s]."""

NAMED_KEYS = 3
"""Keys that a message about another task names."""


@dataclass(frozen=True)
class Progress:
    """How far a study has come.

    Attributes:
        runs: Runs that are needed for the cells that waited.
        ended: Runs that have ended.
        failed: Cells that failed.
        elapsed: Time since the study began [s].
    """

    runs: int
    ended: int
    failed: int
    elapsed: float


Watch = Callable[[Progress], None]


def ignore(progress: Progress) -> None:
    """Watch a study without doing anything."""


@dataclass(frozen=True)
class CellOutcome:
    """What a run of a cell led to.

    Attributes:
        row: Its values.
        failure: Why it failed; empty if it did not.
        wall_time: Time from the task's text to the row [s].
    """

    row: Row
    failure: str
    wall_time: float


@dataclass(frozen=True, eq=False)
class Study:
    """A study and the arrays of its results file.

    Attributes:
        kind: Kind of the results file.
        task: The task.
        cells: The keys that each cell changes in the task, each `path=value`.
        shape: Shape of the arrays, whose elements in C order are the cells.
        coordinates: The coordinates, and what is known of the cells before they run.
        arrays: Status, texts and everything else that is filled in, with the values that mean "not yet".
        measure: The row of a run and why it failed, empty if it did not. Pickles.
        entry: Completes the row of an outcome by the status and what goes with it, given the cell and that whose run it
            shares.
        again: Status codes of cells that a resumed study computes.
        identity: What the file of a study to resume has in common with this one, by its name for a user.
        attributes: Further attributes of the file.
        stop: Index of the stage at whose end the runs stop; None for the end of the task.
        origins: For each cell the one whose run it shares (cells,), itself if none.
    """

    kind: str
    task: Task
    cells: Sequence[tuple[str, ...]]
    shape: tuple[int, ...]
    coordinates: Sequence[Quantity]
    arrays: Sequence[Quantity]
    measure: Callable[[Run], tuple[Row, str]]
    entry: Callable[[CellOutcome, int, int], Row]
    again: tuple[int, ...]
    identity: Mapping[str, str | int | float]
    attributes: Mapping[str, str | int | float]
    stop: int | None
    origins: np.ndarray

    @property
    def quantities(self) -> list[Quantity]:
        """All arrays of the results file with nothing computed."""
        spent = Quantity("wall_time", (), np.array(0.0), "s", f"wall time spent on the {self.name}")
        return [*self.coordinates, *self.arrays, spent]

    @property
    def name(self) -> str:
        """What a message calls it."""
        return "sweep" if self.kind == "sweep" else "study"


def run_study(
    study: Study,
    path: Path | None = None,
    jobs: int | None = None,
    dask: str | None = None,
    force: bool = False,
    resume: bool = False,
    watch: Watch = ignore,
) -> Results:
    """Compute all cells of a study that wait in its file, and read the results.

    A cell whose run fails or whose process is killed is marked so; the others go on.

    Args:
        study: The study.
        path: Its file; None for none that stays.
        jobs: Processes on this machine; by default one for each core.
        dask: Address of the scheduler of a Dask cluster to compute on.
        force: Whether an existing file is overwritten.
        resume: Whether the cells that wait in an existing file are computed; those that failed are computed again.
        watch: Called with the progress at the beginning and after every run.

    Raises:
        InputError: The file exists, cannot be written, or holds another study; or there is no such cluster.
        RunError: The file cannot be written any further, or the cluster is gone.
    """
    if path is None:
        with TemporaryDirectory(prefix="psmpc-study-") as folder:
            return run_study(study, Path(folder) / "results.h5", jobs, dask, watch=watch)
    if resume:
        before = _resumed(study, path)
        status, spent = before["status"].ravel(), float(before["wall_time"])
    else:
        create_file(study, path, force)
        status, spent = np.full(len(study.cells), WAITING), 0.0
    needed = np.unique(study.origins[np.isin(status, (WAITING, *study.again))])
    began, progress = time.monotonic(), Progress(len(needed), 0, 0, 0.0)
    watch(progress)
    run = partial(_run_cell, study.task, study.measure, study.stop)
    with ResultsWriter(path) as writer:
        for number, found in compute(run, [study.cells[cell] for cell in needed], jobs, dask):
            outcome = CellOutcome({}, LOST, np.nan) if found is None else found
            alike = np.flatnonzero(study.origins == needed[number])
            for cell in alike:
                index = tuple(map(int, np.unravel_index(cell, study.shape)))
                writer.write(index, study.entry(outcome, int(cell), int(needed[number])))
            elapsed = time.monotonic() - began
            writer.write((), {"wall_time": spent + elapsed})
            failed = progress.failed + len(alike) * bool(outcome.failure)
            progress = Progress(len(needed), progress.ended + 1, failed, elapsed)
            watch(progress)
    return read_results(path, study.kind)


def _run_cell(
    task: Task, measure: Callable[[Run], tuple[Row, str]], stop: int | None, changes: tuple[str, ...]
) -> CellOutcome:
    """Run a cell and measure it; an error is its outcome, so that it ends nothing."""
    began = time.perf_counter()
    try:
        row, failure = measure(simulate(changed(task, changes), until=stop))
    except Exception as error:
        logger.exception("a cell failed")
        row, failure = {}, f"{type(error).__name__}: {error}"
    return CellOutcome(row, failure, time.perf_counter() - began)


def changed(task: Task, changes: Sequence[str]) -> Task:
    """Return a task with keys changed.

    Raises:
        SpecError: The changes do not fit the task.
    """
    return parse_task(task.task_yaml, task.robot_yaml, task.spec.name, changes)


def create_file(study: Study, path: Path, force: bool = False) -> None:
    """Write the results file of a study whose cells all wait.

    Raises:
        InputError: The file exists already or cannot be written.
    """
    created = datetime.now(UTC).isoformat(timespec="seconds")
    task = {"task_name": study.task.spec.name, "task_yaml": study.task.task_yaml, "robot_yaml": study.task.robot_yaml}
    attributes = {**_identity(study), "created": created, **task, **study.attributes}
    create_results(path, study.kind, attributes, study.quantities, force)


def _identity(study: Study) -> dict[str, str | int | float]:
    return {"psmpc_version": __version__, "digest": study.task.digest, **study.identity}


def _resumed(study: Study, path: Path) -> Results:
    """Read the results to resume; where the study has more cells now, write a file with room for them.

    Raises:
        InputError: There is no file, or it holds another study.
        LogError: It cannot be read.
    """
    if not path.exists():
        raise InputError(f"--resume: found no file {path}, expected a {study.name} that was stopped; omit --resume")
    results = read_results(path, study.kind)
    for name, wanted in _identity(study).items():
        found = results.attributes.get(name)
        if found != wanted:
            plainly = f"found {name.replace('_', ' ')} {found}, this one has {wanted}"
            difference = differing_keys(results, study.task) if name == "digest" else plainly
            raise InputError(
                f"--resume: {path} holds another {study.name}: {difference}; give the same task and options, or choose "
                "another file with -o"
            )
    (cells, *_), (found_cells, *_) = study.shape, results["status"].shape
    if found_cells > cells:
        raise InputError(f"--resume: {path} has {found_cells} runs, found {cells}, expected at least as many")
    if found_cells < cells:
        part = path.with_name(f".{path.name}.longer")
        attributes = {name: value for name, value in results.attributes.items() if isinstance(value, str | int | float)}
        create_results(part, study.kind, attributes, [_extended(new, results) for new in study.quantities], True)
        part.replace(path)
        results = read_results(path, study.kind)
    return results


def _extended(new: Quantity, results: Results) -> Quantity:
    """Return an array that is as long as the new one and begins with the old one."""
    old = results[new.name]
    return replace(new, values=np.concatenate([old, new.values[len(old) :]]) if old.ndim else old)


def differing_keys(results: Results, task: Task) -> str:
    """Say in which keys the task in a results file differs from another one: the name, or the first few keys."""
    name = str(results.attributes.get("task_name", ""))
    if name != task.spec.name:
        return f"found the task {quoted(name)}, this one is {quoted(task.spec.name)}"
    task_yaml, robot_yaml = (str(results.attributes.get(key, "")) for key in ("task_yaml", "robot_yaml"))
    try:
        found = parse_task(task_yaml, robot_yaml, name)
    except SpecError:
        return f"found a task {quoted(name)} that does not hold in this version"
    differing = _differing(_keys(found), _keys(task), ())
    named = [f"{key} {before}, this one has {now}" for key, before, now in islice(differing, NAMED_KEYS)]
    more = sum(1 for _ in differing)
    rest = f"; and {more} more {'key differs' if more == 1 else 'keys differ'}" if more else ""
    return f"found {'; '.join(named)}{rest}" if named else "found the arms of its robot in another order"


def _keys(task: Task) -> dict[str, object]:
    return {**task.spec.model_dump(mode="json"), "robot": task.robot.model_dump(mode="json")}


def _differing(before: object, now: object, path: tuple[str | int, ...]) -> Iterator[tuple[str, str, str]]:
    """Yield path and both values of every key that differs."""
    if isinstance(before, dict) and isinstance(now, dict):
        for key in dict.fromkeys((*before, *now)):
            yield from _differing(before.get(key), now.get(key), (*path, key))
    elif isinstance(before, list) and isinstance(now, list) and len(before) == len(now):
        for i, (one, other) in enumerate(zip(before, now, strict=True)):
            yield from _differing(one, other, (*path, i))
    elif before != now:
        yield dotted(path), _written(before), _written(now)


def _written(value: object) -> str:
    if value is None or (isinstance(value, list) and any(isinstance(entry, dict) for entry in value)):
        return describe(value)
    return shortened(json.dumps(value, ensure_ascii=False))


class _ProcessKilledError(Exception):
    """A process ended with the call that it computed."""


def compute(
    function: Callable[[Item], Result], items: Sequence[Item], jobs: int | None = None, dask: str | None = None
) -> Iterator[tuple[int, Result | None]]:
    """Call a function on many items in parallel, and yield the index and the result of each as they come.

    The calls are made in processes with one thread each, never in this one: a call may kill its process, and CasADi
    ignores Ctrl-C. If a process is killed, the calls without a result are repeated; if that goes on, one at a time,
    until the call that kills its process is known.

    Args:
        function: Pickles, as its items and results do. What it raises is raised here.
        items: The items.
        jobs: Processes on this machine; by default one for each core.
        dask: Address of the scheduler of a Dask cluster to use instead.

    Yields:
        Index and result of an item; None for an item that is lost, since it kills its process.

    Raises:
        InputError: There is no such cluster, or its workers do not fit.
        RunError: The cluster is gone.
    """
    attempt = partial(_on_this_machine, jobs or os.cpu_count() or 1) if dask is None else partial(_on_cluster, dask)
    patience = PATIENCE if dask is None else 1  # Dask's scheduler itself repeats a call several times
    waiting, failures = dict(enumerate(items)), 0
    while waiting:
        alone = failures >= patience
        try:
            for index, result in attempt(function, dict(islice(waiting.items(), 1 if alone else None))):
                del waiting[index]
                failures = failures if alone else 0
                yield index, result
        except _ProcessKilledError:
            failures = 0 if alone else failures + 1
            if alone:
                lost = next(iter(waiting))
                del waiting[lost]
                yield lost, None


def _on_this_machine(
    jobs: int, function: Callable[[Item], Result], items: Mapping[int, Item]
) -> Iterator[tuple[int, Result]]:
    """Make calls in processes of this machine."""
    processes = max(2, jobs)  # joblib would make the calls of a single one in this process; here the second one idles
    with parallel_config("loky", n_jobs=processes, inner_max_num_threads=1):
        ahead = 1 if jobs == 1 else 2 * jobs
        workers = Parallel(return_as="generator_unordered", batch_size=1, pre_dispatch=ahead)
        results: Generator[tuple[int, Result], None, None] | None = None
        try:
            with _interrupts_blocked():
                results = workers(delayed(_numbered)(function, index, item) for index, item in items.items())
            while (result := next(results, None)) is not None:  # not `yield from`, which would close them unsilenced
                yield result
        except TerminatedWorkerError:
            raise _ProcessKilledError from None
        finally:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)  # joblib's about results that nobody reads
                if results is not None:
                    results.close()


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Start processes that a terminal's Ctrl-C does not reach: this process ends them.

    A new process inherits the blocked signals; one that is interrupted while it imports would print a traceback.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    for tracker in (resource_tracker, loky_resource_tracker):
        tracker.ensure_running()  # started later, they would unblock the signals
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _numbered(function: Callable[[Item], Result], index: int, item: Item) -> tuple[int, Result]:
    """Make a call in a process of its own."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    return index, function(item)


def _on_cluster(
    address: str, function: Callable[[Item], Result], items: Mapping[int, Item]
) -> Iterator[tuple[int, Result]]:
    """Make calls on a Dask cluster through Dask's client; joblib's Dask backend waits for ever for a killed worker."""
    with _client(address) as client:
        from distributed import KilledWorker, as_completed

        calls = {client.submit(function, item, pure=False): index for index, item in items.items()}
        killed = False
        for future, result in as_completed(calls, loop=client.loop, with_results=True, raise_errors=False):
            if future.status == "finished":
                yield calls.pop(future), result
            elif future.status == "error" and isinstance(result[1], KilledWorker):
                killed = True
            elif future.status == "error":
                raise result[1]
            else:  # cancelled
                raise RunError(f"the connection to the Dask scheduler at {address} was lost")
        if killed:
            raise _ProcessKilledError


@contextmanager
def _client(address: str) -> Iterator[Any]:
    """Connect to a Dask cluster whose workers have one thread and this version.

    Raises:
        InputError: There is none, or it has other workers; or Dask is not installed.
    """
    try:
        from distributed import Client
    except ImportError:
        raise InputError("--dask: Dask is not installed, expected the extra: pip install 'psmpc[dask]'") from None
    loggers = [logging.getLogger(name) for name in ("distributed", "tornado", "asyncio")]
    levels = [each.level for each in loggers]
    for each in loggers:  # what they report is in a message of ours, or is of no interest: a call that is repeated
        each.setLevel(logging.CRITICAL + 1)
    try:
        with _connected(Client, address) as client:
            yield client
    finally:
        for each, level in zip(loggers, levels, strict=True):
            each.setLevel(level)


def _connected(client_type: Any, address: str) -> Any:
    """Connect to a scheduler and make sure that its workers compute what this process would.

    Raises:
        InputError: None answers, or it has no such workers.
    """
    try:
        if not re.fullmatch(r"(?:\w+://)?[\w.\-\[\]:]+:\d+", address):
            raise ValueError("it has no port")
        client = client_type(address, timeout=CONNECTING, set_as_default=False)
    except Exception as error:  # whatever answers there
        raise InputError(
            f"--dask: found no Dask scheduler at '{address}' ({' '.join(str(error).split())}); "
            "start one with: dask scheduler --host 127.0.0.1 --dashboard-address 127.0.0.1:8787"
        ) from None
    try:
        client.wait_for_workers(1, timeout=CONNECTING)
    except TimeoutError:
        client.close()
        raise InputError(
            f"--dask: the scheduler at {address} has no workers; start one on this machine with: dask worker {address} "
            "--nthreads 1 --host 127.0.0.1 --dashboard-address 127.0.0.1:0"
        ) from None
    versions = client.run(resolve_name, "psmpc_cli:__version__", on_error="return")
    for worker, threads in client.nthreads().items():
        version = versions.get(worker)
        if threads != 1 or version != __version__:
            client.close()
            raise InputError(
                f"--dask: worker {worker} has {threads} threads and psmpc {version}, expected 1 (--nthreads 1; "
                f"--nworkers for several calls at a time) and {__version__} as here"
            )
    return client
