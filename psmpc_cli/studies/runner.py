"""The runner of studies: cells computed in parallel, and a results file that is filled in and resumed.

A study is a task, the keys that each cell changes in it, and a measure: a function from the run of a cell to a row of
named values. Sweeps and Monte Carlo studies are instances. The results are labelled arrays, which xarray opens.
"""

import logging
import os
import pickle
import re
import signal
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, Future
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext, suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from difflib import unified_diff
from functools import partial
from itertools import islice
from multiprocessing import current_process
from multiprocessing.resource_tracker import ensure_running
from pathlib import Path
from pkgutil import resolve_name
from queue import Empty, SimpleQueue
from tempfile import NamedTemporaryFile, TemporaryDirectory
from typing import Any, TypeVar

import numpy as np
from loky import get_reusable_executor
from loky.process_executor import TerminatedWorkerError

from psmpc_cli import __version__
from psmpc_cli.errors import InputError, LogError, RunError, SpecError, begin_worker, deferred_signals
from psmpc_cli.logs.files import FileLock, check_output
from psmpc_cli.logs.results import Quantity, Results, new_results, read_results
from psmpc_cli.logs.schema import Column
from psmpc_cli.ocp.feasibility.checks import ensure_feasible, load_task
from psmpc_cli.plant import require_plant
from psmpc_cli.progress import Watch, Work
from psmpc_cli.simulation.run import simulate
from psmpc_cli.specs.document import quoted
from psmpc_cli.specs.load import Task, TaskDocuments, parse_task, read_documents
from psmpc_cli.studies.measures import check_columns

logger = logging.getLogger(__name__)

Key = TypeVar("Key")
Item = TypeVar("Item")
Result = TypeVar("Result")

LOST = "its process was killed each time it was computed, perhaps for lack of memory"
"""Failure of a cell that was lost."""

WAITING, COMPUTED, SHARED, FAILED = range(4)
"""Codes of a cell's status; its run is its own, or that of another cell."""

CELL_COLUMNS = (
    Column("status", "1", "status of the cell", dtype="i4", unknown=WAITING),
    Column("origin", "1", "flat index of the cell whose run it shares", dtype="i4", unknown=-1),
    Column("reason", "1", "why the run ended, where it says so, or the cell failed", dtype="text"),
    Column("cell_time", "s", "wall time of the cell's run, with all that is around"),
)
"""What the results have of a cell itself."""

REFERENCE = "reference_"
"""How the names of the reference run's quantities begin."""

CONNECTING = 10
"""Time within which a Dask scheduler answers and has a worker [s]."""

POLL = 0.1
"""Time between two looks for a signal while processes compute [s]."""

IDLE = 30
"""Time after which a process that computes nothing ends [s]."""

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Environment of the processes."""

REDUCED_LOG = ("log.shares=false", "log.plans=false", "log.ticks=false")
"""Changes of a task: what is logged but not measured, and costs solves or memory."""


@dataclass(frozen=True, eq=False)
class Study:
    """A study and the arrays of its results file.

    Attributes:
        kind: Kind of the results file.
        task: The task.
        cells: The keys that each cell changes in the task, each `path=value`.
        dims: Dimensions of the cells' arrays, whose elements in C order are the cells.
        coordinates: The coordinates, and what is known of the cells before they run.
        quantities: What is read from a run; those along a coordinate that there is not are left out. They are pickled.
        identity: What the file of a study to resume has in common with this one, by its name for a user.
        attributes: Further attributes of the file.
        statuses: What the codes of a cell's status mean.
        required_stage: Index of the stage without whose end a cell counts as failed; None if there is none.
        reference: Whether the unchanged task is run as well, to compare the cells with: `of_reference`.
        origins: For each run the first one that is the same (runs,); by default all differ.
    """

    kind: str
    task: Task
    cells: Sequence[tuple[str, ...]]
    dims: tuple[str, ...]
    coordinates: Sequence[Quantity]
    quantities: Sequence[Column]
    identity: Mapping[str, str | int | float] = field(default_factory=dict)
    attributes: Mapping[str, str | int | float] = field(default_factory=dict)
    statuses: tuple[str, ...] = ("waiting", "computed", "shared", "failed")
    required_stage: int | None = None
    reference: bool = False
    origins: np.ndarray | None = None

    @property
    def runs(self) -> list[tuple[str, ...]]:
        """The keys that each run changes in the task: those of the cells, then the reference, if there is one."""
        return [*self.cells, ()] if self.reference else [*self.cells]

    def results(self, path: Path | None = None) -> Results:
        """Build the results of the study before anything is computed, with every array in its final size.

        Args:
            path: The file that they will be written to.
        """
        dim_sizes = {axis.name: len(axis.values) for axis in self.coordinates if axis.dims == (axis.name,)}
        arrays = [*self.coordinates, Quantity("wall_time", (), np.array(0.0), "s", "wall time spent on the study")]
        measurable = [column for column in (*CELL_COLUMNS, *self.quantities) if {*column.dims} <= {*dim_sizes}]
        columns = [replace(column, dims=(*self.dims, *column.dims)) for column in measurable]
        for column in (*columns, *(of_reference(measurable) if self.reference else ())):
            is_text = column.dtype == "text"
            shape = [dim_sizes[name] for name in column.dims]
            values = np.full(shape, "" if is_text else column.unknown, object if is_text else column.dtype)
            meanings = self.statuses if column.path.removeprefix(REFERENCE) == "status" else ()
            arrays.append(Quantity(column.path, column.dims, values, column.units, column.long_name, meanings))
        created = datetime.now(UTC).isoformat(timespec="seconds")
        task = self.task
        task_attributes = {"digest": task.digest, "task_name": task.spec.name, "task_yaml": task.task_yaml}
        attributes = {
            **self.identity,
            **task_attributes,
            "robot_yaml": task.robot_yaml,
            "created": created,
            **self.attributes,
        }
        return new_results(path or Path("a study in memory"), self.kind, attributes, arrays)


def of_reference(columns: Iterable[Column]) -> list[Column]:
    """Return the columns of the reference run, each a single value or along its own dimensions."""
    return [replace(each, path=REFERENCE + each.path, long_name=f"{each.long_name}: task as it is") for each in columns]


def run_study(
    study: Study,
    path: Path | None = None,
    jobs: int | None = None,
    dask: str | None = None,
    force: bool = False,
    resume: bool = False,
    watch: Watch = lambda progress: None,
) -> Results:
    """Compute all cells of a study in parallel: its task, run once with the changed keys of each cell.

    A cell whose run fails or whose process is killed is marked as failed; the others go on. The file is filled in cell
    by cell, so that a study that was stopped can be resumed.

    Args:
        study: The study.
        path: File of the results; None for none that stays.
        jobs: Processes on this machine; by default one for each core.
        dask: Address of the scheduler of a Dask cluster to compute on.
        force: Whether an existing file is overwritten.
        resume: Whether the cells that wait in an existing file are computed; those that failed are computed again.
        watch: Called with the progress at the beginning, after every run, and from time to time meanwhile.

    Raises:
        InputError: The file exists, cannot be written, is being filled in by another process or holds another study; or
            there is no such cluster, or a package that the plant needs. Then no file was touched.
        RunError: The file cannot be written any further, or the cluster is gone.
    """
    require_plant(study.task.spec.plant)
    if dask is not None:
        with _on_cluster(dask):
            pass  # only to see that it can be reached, before a file is touched
    if path is None:
        return _compute_cells(study, study.results(), jobs, dask, None, watch)
    if not resume:
        check_output(path, force)
    with FileLock(path) as lock:
        results = study.results(path)
        if resume:
            results = _resumed(study, results)
        else:
            results.create(force, lock)
        return _compute_cells(study, results, jobs, dask, lock, watch)


def _compute_cells(
    study: Study, results: Results, jobs: int | None, dask: str | None, lock: FileLock | None, watch: Watch
) -> Results:
    """Compute the cells of a study that wait or failed, and enter what was measured as each run ends.

    Cells with equal runs share one: `origins` says which. The reference, the unchanged task, is the run after the last
    cell; its quantities have names of their own.

    Args:
        study: The study.
        results: Its results so far, which are filled in and returned.
        jobs: Processes on this machine.
        dask: Address of a Dask cluster to use instead.
        lock: Lock of the file, which is written after every run; None without a file.
        watch: Called with the progress.
    """
    cell_shape = results["status"].shape
    status = [*results["status"].flat, *([results[f"{REFERENCE}status"]] if study.reference else [])]
    time_before = float(results["wall_time"])
    runs = study.runs
    origins = np.arange(len(runs)) if study.origins is None else study.origins
    runs_to_make = np.unique(origins[np.isin(status, (WAITING, FAILED))])
    began_at = time.monotonic()
    work = Work("runs", len(runs_to_make), watch)
    run_cell = partial(_run_cell, documents_of(study.task), study.quantities, study.required_stage)
    with closing(
        compute(run_cell, {int(cell): runs[cell] for cell in runs_to_make}, jobs, dask, work.wait)
    ) as results_of_runs:
        for origin, measured in results_of_runs:
            row = {"reason": LOST, "cell_time": np.nan, "status": FAILED} if measured is None else measured
            failed = row["status"] == FAILED
            for cell in np.flatnonzero(origins == origin):
                code = row["status"] if failed or cell == origin else SHARED
                is_cell = cell < len(study.cells)
                index = np.unravel_index(cell, cell_shape) if is_cell else ()
                for name, value in {**row, "origin": origin, "status": code}.items():
                    results[name if is_cell else REFERENCE + name][index] = value
            results["wall_time"][()] = time_before + time.monotonic() - began_at
            if lock is not None:
                results.save(lock)
            work.advance(failed=bool(failed))
    return results


def _run_cell(
    documents: TaskDocuments, quantities: Sequence[Column], required_stage: int | None, changes: tuple[str, ...]
) -> dict[str, Any]:
    """Run one cell of a study and measure the run; an error is a result as well, and ends nothing.

    A mission that fails is measured like any other; a run that does not end the required stage counts as failed.

    Args:
        documents: Texts of task and robot.
        quantities: What is measured of the run.
        required_stage: Index of a stage that has to end; None if none has to.
        changes: The keys that the cell changes in the task, each `path=value`.

    Returns:
        What was measured, by name, with reason, status and wall time [s].
    """
    began_at = time.perf_counter()
    try:
        run = simulate(documents.changed(changes))
        row = {
            quantity.path: value for quantity in quantities if quantity.value and np.size(value := quantity.value(run))
        }
        ends_required_stage = required_stage is None or np.isfinite(run.stages["switch_time"][required_stage])
        row["reason"] = run.summary().reason
        row["status"] = COMPUTED if ends_required_stage else FAILED
    except Exception as error:
        logger.exception("a cell failed")
        row = {"reason": f"{type(error).__name__}: {error}", "status": FAILED}
    return {**row, "cell_time": time.perf_counter() - began_at}


def with_changes(task: Task | str | Path, changes: Sequence[str]) -> Task:
    """Return a task, its file or a built-in one of this name, with keys changed.

    Raises:
        SpecError: The task, or a change of it, does not hold, or no run of it could succeed.
    """
    if not isinstance(task, Task):
        return load_task(task, changes)
    return ensure_feasible(documents_of(task).changed(changes)) if changes else task


def documents_of(task: Task) -> TaskDocuments:
    """Read the texts of a task, once for all the variants that are made of it."""
    return read_documents(task.task_yaml, task.robot_yaml, task.spec.name)


def task_in(results: Results, changes: Sequence[str] = ()) -> Task:
    """Return the task of a study from its file, with keys changed.

    Raises:
        LogError: There is none, or it does not hold in this version.
    """
    texts = [results.attributes.get(key) for key in ("task_yaml", "robot_yaml", "task_name")]
    if not all(isinstance(text, str) for text in texts):
        raise LogError(f"{results.path}: found no task and robot, expected the file of a study")
    task, robot, name = map(str, texts)
    try:
        return parse_task(task, robot, name, changes)
    except SpecError as error:
        raise LogError(f"{results.path}: the task or robot in it is not valid in this version:\n{error}") from None


def names_along(task: Task) -> list[Quantity]:
    """Build the further coordinates of a whole run's quantities: stages, and monitors where there are any."""
    judged = task.spec.judged
    coordinates = [Quantity("stage", ("stage",), np.array([each.name for each in task.spec.stages]), "1", "stage")]
    if judged:
        coordinates.append(Quantity("monitor", ("monitor",), np.array(list(judged)), "1", "monitor"))
        coordinates.append(
            Quantity("monitor_unit", ("monitor",), np.array(list(judged.values())), "1", "unit of its margin")
        )
    return coordinates


def _resumed(study: Study, new: Results) -> Results:
    """Read the results of a study that was stopped, to go on with it; more cells may have been added.

    Args:
        study: The study, as it is asked for now.
        new: Its results with nothing computed, into which those of the file are copied.

    Raises:
        InputError: There is no file, or it holds another study: another task, version, or more cells.
    """
    path = new.path
    cells = len(study.cells)
    if not path.exists():
        raise InputError(
            f"--resume: found no file {path}, expected a {study.kind} study that was stopped; omit --resume"
        )
    results = read_results(path, study.kind)
    for name in ("psmpc_version", "digest", *study.identity):
        value_in_file, value_now = (either.attributes.get(name) for either in (results, new))
        if value_in_file != value_now:
            difference = f"found {name.replace('_', ' ')} {value_in_file}, this one has {value_now}"
            if name == "digest":
                difference = _difference(results, new)
            advice = "give the same task and options, or choose another file with -o"
            raise InputError(f"--resume: {path} holds another {study.kind} study: {difference}; {advice}")
    if (cells_in_file := results["status"].size) > cells:
        raise InputError(f"--resume: {path} has {cells_in_file} runs, found {cells}, expected at least as many")
    if missing := [name for name in new.quantities if name not in results.quantities]:
        raise InputError(
            f"--resume: {path} was written by an earlier version, whose studies had no {missing[0]}: start anew with "
            "--force, or choose another file with -o"
        )
    for name, quantity in new.quantities.items():
        dtype = "text" if quantity.is_text else quantity.values.dtype.str
        check_columns(results, [Column(name, quantity.units, quantity.long_name, dtype=dtype, dims=quantity.dims)])
        shape = results[name].shape
        if any(size > most for size, most in zip(shape, quantity.values.shape, strict=True)):
            raise InputError(f"--resume: {path} holds another {study.kind} study: found {name} of shape {shape}")
        quantity.values[tuple(map(slice, shape))] = results[name]
    return replace(new, attributes=results.attributes)


def _difference(*studies: Results) -> str:
    """Write the lines in which the tasks of two studies differ."""
    before, now = (f"{each.attributes['task_yaml']}\n{each.attributes['robot_yaml']}".splitlines() for each in studies)
    lines = list(unified_diff(before, now, n=0, lineterm=""))[2:]
    found, wanted = (quoted("; ".join(line[1:].strip() for line in lines if line[0] == sign)) for sign in "-+")
    return f"found {found} in its task, this one has {wanted}"


@dataclass(frozen=True)
class Workers:
    """Processes that make calls.

    Attributes:
        submit: Function that has a function called on an item.
        result: Function from a call that has ended to what it returned; it raises what the call raised.
        killed: What a call raises that kills its process.
    """

    submit: Callable[[Callable[[Any], Any], Any], Future[Any]]
    result: Callable[[Future[Any]], Any]
    killed: type[Exception]


def compute(
    function: Callable[[Item], Result],
    items: Mapping[Key, Item],
    jobs: int | None = None,
    dask: str | None = None,
    wait: Callable[[], None] = lambda: None,
) -> Generator[tuple[Key, Result | None], None, None]:
    """Call a function on many items in parallel, and yield the key and the result of each as they come.

    The calls are made in processes with one thread each, never in this one, unless it may start none: a call may kill
    its process. If one is killed, the first call without a result is repeated alone, and is lost if that is killed as
    well; then the others go on. Signals are deferred from the first result until the iterator is closed.

    Args:
        function: Pickles, as its items and results do. What it raises is raised here.
        items: The items.
        jobs: Processes on this machine; by default one for each core.
        dask: Address of the scheduler of a Dask cluster to use instead.
        wait: Called again and again while no call ends.

    Yields:
        Key and result of an item; None for an item that is lost, since it kills its process.

    Raises:
        InputError: There is no such cluster, or its workers do not fit.
        RunError: The cluster is gone.
        KeyboardInterrupt: Ctrl-C or SIGTERM came; the processes are killed. No other code of a study is interrupted.
    """
    waiting = dict(items)
    one_at_a_time = False
    in_this_process = dask is None and current_process().daemon
    with deferred_signals() as interruption:
        while waiting:
            submitted = dict(islice(waiting.items(), 1 if one_at_a_time or in_this_process else None))
            ended_calls = SimpleQueue[Future[Any]]()
            worker_source = _place(jobs, dask, in_this_process)
            # a submission raises `killed` if a process was killed before
            with worker_source as workers, suppress(workers.killed):
                with _interrupts_blocked():
                    calls = {workers.submit(function, item): key for key, item in submitted.items()}
                for call in calls:
                    call.add_done_callback(ended_calls.put)
                while calls:
                    interruption.raise_if_signalled()
                    wait()
                    try:
                        call = ended_calls.get(timeout=POLL)
                    except Empty:
                        continue
                    key = calls.pop(call)
                    if not isinstance(call.exception(), workers.killed):
                        del waiting[key]
                        yield key, workers.result(call)
            # any of several calls may have killed the process: the first is repeated alone, and lost if it kills again
            without_result = submitted.keys() & waiting.keys()
            for key in without_result if one_at_a_time else ():
                del waiting[key]
                yield key, None
            one_at_a_time = bool(without_result) and not one_at_a_time


def compute_all(
    function: Callable[[Item], Result],
    items: Mapping[str, Item],
    jobs: int | None = None,
    watch: Watch = lambda progress: None,
    parts: str = "runs",
) -> dict[str, Result]:
    """Call a function on many items in parallel, as `compute` does, and return all results by name.

    Args:
        function: Pickles, as its items and results do.
        items: The items.
        jobs: Processes on this machine; by default one for each core.
        watch: Called with the progress at the beginning, after every call, and from time to time meanwhile.
        parts: What the calls are, in their plural.

    Returns:
        The results, in the order of the items.

    Raises:
        RunError: A call is lost, since it kills its process.
    """
    by_name = dict[str, Result]()
    work = Work(parts, len(items), watch)
    with closing(compute(function, items, jobs, wait=work.wait)) as results:
        for name, result in results:
            if result is None:
                raise RunError(f"{name}: {LOST}: try fewer --jobs")
            by_name[name] = result
            work.advance(name)
    return {name: by_name[name] for name in items}


def _pickled(folder: str, function: Callable[[Item], Result], item: Item) -> Path:
    """Call a function, and return a file in a folder that holds its result.

    The processes of this machine share one pipe for what they return. It would be blocked for ever by one that is
    killed while it writes a result longer than the pipe; a file's name is written at once.
    """
    result = function(item)
    with NamedTemporaryFile(dir=folder, delete=False) as file:
        pickle.dump(result, file, pickle.HIGHEST_PROTOCOL)
    return Path(file.name)


def _unpickled(call: Future[Path]) -> Any:
    """Read what a call on this machine has stored, and remove the file."""
    path = call.result()
    result = pickle.loads(path.read_bytes())
    path.unlink()
    return result


def _place(jobs: int | None, dask: str | None, in_this_process: bool) -> AbstractContextManager[Workers]:
    """Return where calls are made."""
    if dask is not None:
        return _on_cluster(dask)
    if in_this_process:
        return nullcontext(Workers(_called, Future.result, TerminatedWorkerError))
    return _on_this_machine(jobs or os.cpu_count() or 1)


def _called(function: Callable[[Item], Result], item: Item) -> Future[Result]:
    """Call a function at once, and return the call that has ended."""
    call = Future[Result]()
    try:
        call.set_result(function(item))
    except Exception as error:
        call.set_exception(error)
    return call


@contextmanager
def _on_this_machine(jobs: int) -> Iterator[Workers]:
    """Provide processes of this machine, which later calls reuse."""
    ensure_running()  # multiprocessing's tracker of resources, whose start unblocks interrupts
    with TemporaryDirectory(prefix="psmpc-") as folder:
        with _interrupts_blocked():
            executor = get_reusable_executor(
                jobs, timeout=IDLE, env=ONE_THREAD, initializer=begin_worker, initargs=(os.getpid(),)
            )
        try:
            yield Workers(partial(executor.submit, _pickled, folder), _unpickled, TerminatedWorkerError)
        except BaseException:
            executor.shutdown(kill_workers=True)
            raise


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Block Ctrl-C for the processes that are started inside, which inherit that: this process ends them."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _on_cluster(address: str) -> Iterator[Workers]:
    """Connect to a Dask cluster, and make sure that its workers compute the same as this process would.

    That takes the same version of psmpc, and one thread each: sums over several threads are rounded otherwise.

    Args:
        address: Address of its scheduler, HOST:PORT.

    Raises:
        InputError: Dask is not installed, nothing answers there, or the workers do not fit.
        RunError: The connection is lost while it is used.
    """
    try:
        from distributed import Client, KilledWorker
    except ImportError:
        raise InputError("--dask: Dask is not installed, expected the extra: pip install 'psmpc[dask]'") from None
    for name in [*logging.root.manager.loggerDict]:
        if name.partition(".")[0] in ("distributed", "tornado", "asyncio"):
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)  # what they would report is in the messages here
    try:
        if not re.search(r":\d+$", address):
            raise ValueError("expected HOST:PORT")
        client = Client(address, timeout=CONNECTING, set_as_default=False)
        client.wait_for_workers(1, timeout=CONNECTING)
    except Exception as error:  # whatever answers there
        raise InputError(
            f"--dask: found no Dask scheduler with workers at '{address}' ({' '.join(str(error).split())}); start them "
            "with: dask scheduler --host 127.0.0.1, dask worker HOST:PORT --host 127.0.0.1 --nthreads 1"
        ) from None
    with client:
        versions = client.run(resolve_name, "psmpc_cli:__version__", on_error="return")
        for worker, threads in client.nthreads().items():
            version = versions.get(worker, OSError())
            if isinstance(version, OSError):  # it ended or joined just now
                continue
            if threads != 1 or version != __version__:
                raise InputError(
                    f"--dask: worker {worker} has {threads} threads and psmpc {version}, expected 1 "
                    f"(--nthreads 1; --nworkers for several calls at a time) and {__version__} as here"
                )
        try:
            yield Workers(client.get_executor(pure=False).submit, Future.result, KilledWorker)
        except CancelledError:
            raise RunError(f"the connection to the Dask scheduler at {address} was lost") from None
